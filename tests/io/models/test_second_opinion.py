"""Recorded commands, and the controller with MuJoCo's senses, on the exported model."""

import dataclasses
import sys

import equinox as eqx
import jax
import numpy as np
import pytest

from evo_cpg.analysis.second_opinion import ControllerInLoop, own_opinion, second_opinion
from evo_cpg.control.postures import PostureController
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.simulation.observers import EachPhysicsStep
from evo_cpg.simulation.rollout import rollout
from tiny_run import CONFIG, PAIR, TINY


def trial(path, *overrides):
    """Return experiment, genes and physics steps of a random individual's trial."""
    experiment = build_experiment(load_config(path, overrides), path)
    simulation = experiment.simulation
    genes = simulation.genome.random(jax.random.key(1), (1,), np.float32)
    steps = jax.device_get(
        jax.jit(lambda g: rollout(simulation, g, observers=EachPhysicsStep()))(genes)
    )
    return experiment, np.asarray(genes[:, 0]), steps


@pytest.fixture(scope="module")
def swimmer():
    return trial(CONFIG, *PAIR, "simulation.seconds=1.5", "simulation.substeps=4")


def test_missing_mujoco_raises(swimmer, monkeypatch):
    experiment, _, steps = swimmer
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ExchangeError, match=r"MuJoCo is not installed\. Install it with "):
        second_opinion(experiment.simulation, experiment.creature, steps)


def agrees(experiment, genes, steps, angle):
    """Compare recorded commands and MuJoCo's own senses with our opinion, and return it."""
    simulation = experiment.simulation
    own = own_opinion(simulation, steps)
    for brain, name in (
        (None, "MuJoCo"),
        (ControllerInLoop(simulation, genes), "MuJoCo, own senses"),
    ):
        other = second_opinion(simulation, experiment.creature, steps, brain=brain)
        assert other.program == name
        np.testing.assert_allclose(other.joint_angle, own.joint_angle, atol=angle)
        np.testing.assert_allclose(other.path, own.path, atol=2e-3)
    return own


@pytest.mark.slow
def test_both_programs_agree_in_water(swimmer):
    """Our steps are 1/240 s, and MuJoCo's 1/2000 s."""
    assert np.abs(agrees(*swimmer, 5e-3).joint_angle).max() > 0.1


TORQUE = "{type: torque, gear: 1, torque_limit: 0.5}"
MUSCLE = "{type: muscle, area: 2e-4, arm: 0.02, fibre_length: 0.05, bend_deg: 40}"


@pytest.mark.slow
@pytest.mark.parametrize("actuator", [TORQUE, MUSCLE], ids=["torque motor", "muscle"])
def test_motors_agree_in_both_programs(actuator):
    """Our steps are 1/960 s here, and MuJoCo's 1/2000 s. Limits of joints are other laws there."""
    own_motor = f"creature.bodies.1.joint.actuator={actuator}"
    free = "creature.bodies.1.joint.limits_deg=null"
    long = "simulation.seconds=1", "simulation.substeps=16"
    own = agrees(*trial(CONFIG, *PAIR, own_motor, free, *long), 5e-3)
    assert np.abs(own.joint_angle).max() > 0.1


BOX = "shape: {type: box, size: [0.2, 0.1, 0.1]}, material: body"
PLANAR = "{parent: world, at: [0, 0, 0], child_at: [0, 0, 0], axes: [{slide: x}, {slide: y}, z]}"
BEHIND = "at: [-0.11, 0, 0], child_at: [0.11, 0, 0], limits_deg: null"
KINDS = f"""creature.bodies=[
    {{name: head, {BOX}, joint: {PLANAR}}},
    {{name: neck, {BOX}, joint: {{parent: head, {BEHIND}, axes: [{{slide: x}}],
        actuator: {{gain: 5, stiffness: 20}}}}}},
    {{name: trunk, {BOX}, joint: {{parent: neck, {BEHIND}, axes: ball, actuator: {{gain: 1}}}}}},
    {{name: tail, {BOX}, joint: {{parent: trunk, {BEHIND},
        axes: [{{turn: z, at: [0.11, 0.03, 0]}}], actuator: {{gain: 1}}}}}}]"""


@pytest.mark.slow
def test_slides_balls_and_a_planar_root_agree_in_both_programs():
    """A head slides and turns in the plane, with a slide, a ball and an eccentric hinge behind."""
    long = "simulation.seconds=1", "simulation.substeps=8"
    own = agrees(*trial(CONFIG, *TINY, KINDS, *long), 2e-3)
    assert own.slides.tolist() == [True, True, False, True, False, False, False, False]
    driven = np.abs(own.joint_angle).max(1)
    assert (driven[4:] > 0.05).all() and driven[3] > 1e-3 and (driven[:3] > 1e-4).all()


@pytest.mark.slow
def test_mujocos_animal_carries_water_and_sheds_it():
    """A chain of five bodies with reactive thrust, in steps of 1/960 s here and 1/2000 s there."""
    chain = [*PAIR, "creature.bodies.1.repeat=4", "world.water.reactive_thrust=true"]
    experiment, _, steps = trial(CONFIG, *chain, "simulation.seconds=1", "simulation.substeps=16")
    own = own_opinion(experiment.simulation, steps)
    other = second_opinion(experiment.simulation, experiment.creature, steps)
    assert np.abs(own.joint_angle).max() > 0.1 and own.displacement > 5e-3
    np.testing.assert_allclose(other.joint_angle, own.joint_angle, atol=1e-4)
    np.testing.assert_allclose(other.path, own.path, atol=5e-4)


@pytest.mark.slow
def test_an_animal_in_water_is_not_airborne(swimmer):
    """The fraction is None without ground or with water everywhere."""
    experiment, _, steps = swimmer
    simulation, creature = experiment.simulation, experiment.creature
    assert own_opinion(simulation, steps).airborne is None
    assert second_opinion(simulation, creature, steps).airborne is None
    world = simulation.world
    contact_model = make_contact_model(creature, world.tree, Ground())
    for surface, fraction in ((None, None), (2.0, 0.0), (-2.0, 1.0)):
        water = dataclasses.replace(world.water, surface=surface)
        changed = dataclasses.replace(world, water=water, contact_model=contact_model)
        pool = dataclasses.replace(simulation, world=changed)
        assert own_opinion(pool, steps).airborne == fraction


@pytest.mark.slow
def test_the_controller_uses_the_senses_of_mujocos_animal(swimmer):
    """A controller that corrects angles reduces an initial error. Recorded commands do not."""
    experiment, genes, steps = swimmer
    simulation, creature = experiment.simulation, experiment.creature
    bent = steps._replace(
        before=eqx.tree_at(lambda state: state.q, steps.before, steps.before.q + 0.3)
    )
    commanded = second_opinion(simulation, creature, bent)
    sensed = second_opinion(simulation, creature, bent, brain=ControllerInLoop(simulation, genes))
    # Recorded commands keep the error, and the controller reduces it.
    own = own_opinion(simulation, steps).joint_angle
    off = [np.abs(each.joint_angle - own)[:, -1].max() for each in (commanded, sensed)]
    assert off[0] > 0.2 and off[1] < 0.7 * off[0]


@pytest.mark.slow
def test_the_controller_feels_loads_of_mujocos_animal():
    """The load of the cheetah's hind leg is input to its oscillators."""
    path = CONFIG.with_name("half_cheetah.yaml")
    experiment = build_experiment(load_config(path), path)
    simulation, tree = experiment.simulation, experiment.simulation.world.tree
    genes = np.zeros(simulation.controller.gene_count, np.float32)
    genes[-4:] = 3.0
    state = jax.tree.map(np.asarray, resting_state(tree))
    borne = np.zeros((8, len(tree.names)))
    foot = tree.names.index("bfoot")
    commands = []
    for load in (0.0, simulation.world.weight):
        borne[:, foot] = load
        brain = ControllerInLoop(simulation, genes, jax.random.key_data(jax.random.key(0))[:, None])
        commands.append(np.asarray(brain.think(state, borne).torque)[:, 0])
    moved = np.array(tree.dof_names)[np.abs(commands[1] - commands[0]) > 0.1]
    assert "bthigh.y" in moved


@pytest.mark.slow
def test_a_standing_hexapod_has_equal_heights_in_both_programs():
    """A hexapod holds one posture with hard contacts. Heights agree to 2 mm."""
    path = CONFIG.with_name("hexapod.yaml")
    experiment, _, _ = trial(path, "simulation.seconds=0.0167")
    simulation = dataclasses.replace(experiment.simulation, steps=120)
    assert isinstance(simulation.controller, PostureController)
    genes = np.zeros((simulation.controller.gene_count, 1), np.float32)
    genes[1::2] = 1.0  # every joint at 170 degrees
    steps = jax.device_get(
        jax.jit(lambda g: rollout(simulation, g, observers=EachPhysicsStep()))(genes)
    )
    own = own_opinion(simulation, steps)
    hard = second_opinion(simulation, experiment.creature, steps, hard=True)
    assert hard.program == "MuJoCo, hard contacts"
    assert hard.upright == own.upright == 1.0
    assert hard.path[2, -1] == pytest.approx(own.path[2, -1], abs=2e-3)
    assert np.abs(hard.path[:2, -1] - own.path[:2, -1]).max() < 0.05


def test_the_controller_in_the_loop_sees_the_moving_light():
    """Fed with our own states, it gives our own commands. With a light at rest it would not."""
    flees = "{type: follow, light: {distance: 0.6, bearing_deg: 60}, speed: 6, flees: 9}"
    experiment, genes, steps = trial(CONFIG, *PAIR, "simulation.substeps=1", f"task={flees}")
    simulation = experiment.simulation
    resting = dataclasses.replace(simulation, task=dataclasses.replace(simulation.task, speed=0.0))
    off = []
    for own in (simulation, resting):
        brain = ControllerInLoop(own, genes)
        for index in range(40):
            state = jax.tree.map(lambda x, i=index: x[..., i], steps.before)
            command = brain.think(state, np.zeros((1, 2)))
        off.append(np.abs(command.target_rate[:, 0] - steps.target_rate[:, 39]).max())
    assert off[0] < 1e-5 < 1e-3 < off[1]
