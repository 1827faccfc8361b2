"""A champion's commands, and its controller with MuJoCo's senses, on the exported model."""

import dataclasses
import sys

import equinox as eqx
import jax
import numpy as np
import pytest

from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.control.postures import PostureController
from evo_cpg.exchange.refusals import ExchangeError
from evo_cpg.exchange.second_opinion import Brain, own_opinion, second_opinion
from evo_cpg.physics.contact_model import Ground, make_contact_model
from evo_cpg.simulation.physics_steps import EachPhysicsStep
from evo_cpg.simulation.rollout import rollout
from tiny_run import CONFIG, PAIR


def lived(path, *overrides):
    """A random individual's trial."""
    experiment = build_experiment(load_config(path, overrides), path)
    simulation = experiment.simulation
    genes = simulation.genome.random(jax.random.key(1), (1,), np.float32)
    steps = jax.device_get(
        jax.jit(lambda g: rollout(simulation, g, observers=EachPhysicsStep()))(genes)
    )
    return experiment, np.asarray(genes[:, 0]), steps


@pytest.fixture(scope="module")
def swimmer():
    return lived(CONFIG, *PAIR, "simulation.steps=90", "simulation.substeps=4")


def test_without_mujoco_there_is_none(swimmer, monkeypatch):
    experiment, _, steps = swimmer
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ExchangeError, match="MuJoCo is not installed here; "):
        second_opinion(experiment.simulation, experiment.creature, steps)


def test_in_water_commands_and_controller_lead_to_our_own_motion(swimmer):
    """Both programs solve the same equations there; ours has steps of 1/240 s, MuJoCo 1/2000 s."""
    experiment, genes, steps = swimmer
    simulation = experiment.simulation
    own = own_opinion(simulation, steps)
    told = second_opinion(simulation, experiment.creature, steps)
    brain = Brain(simulation, genes)
    sensed = second_opinion(simulation, experiment.creature, steps, brain=brain)
    assert (told.program, sensed.program) == ("MuJoCo", "MuJoCo, own senses")
    assert np.abs(own.joint_angle).max() > 0.1
    for other in (told, sensed):
        np.testing.assert_allclose(other.joint_angle, own.joint_angle, atol=5e-3)
        np.testing.assert_allclose(other.path, own.path, atol=2e-3)


@pytest.mark.slow
def test_mujocos_animal_carries_water_and_sheds_it():
    """A chain of five bodies with reactive thrust, in steps of 1/960 s here and 1/2000 s there."""
    chain = [*PAIR, "creature.bodies.1.repeat=4", "world.water.reactive_thrust=true"]
    experiment, _, steps = lived(CONFIG, *chain, "simulation.steps=60", "simulation.substeps=16")
    own = own_opinion(experiment.simulation, steps)
    told = second_opinion(experiment.simulation, experiment.creature, steps)
    assert np.abs(own.joint_angle).max() > 0.1 and own.displacement > 5e-3
    np.testing.assert_allclose(told.joint_angle, own.joint_angle, atol=1e-4)
    np.testing.assert_allclose(told.path, own.path, atol=5e-4)


def test_who_is_in_water_is_not_airborne(swimmer):
    """Without ground the word means nothing, and above a floor the water holds the animal."""
    experiment, _, steps = swimmer
    simulation, creature = experiment.simulation, experiment.creature
    assert own_opinion(simulation, steps).airborne is None
    assert second_opinion(simulation, creature, steps).airborne is None
    world = simulation.world
    contact_model = make_contact_model(creature, world.tree, Ground())
    for surface, share in ((None, None), (2.0, 0.0), (-2.0, 1.0)):
        water = dataclasses.replace(world.water, surface=surface)
        changed = dataclasses.replace(world, water=water, contact_model=contact_model)
        pool = dataclasses.replace(simulation, world=changed)
        assert own_opinion(pool, steps).airborne == share


def test_mujocos_animal_in_water_is_not_airborne():
    """It hangs a metre above the floor of a pool that is 3 m deep."""
    pool = ["world.ground={}", "world.water.surface=3", "simulation.start_clearance=1"]
    experiment, _, steps = lived(CONFIG, *PAIR, *pool, "simulation.steps=12")
    own = own_opinion(experiment.simulation, steps)
    told = second_opinion(experiment.simulation, experiment.creature, steps)
    assert (own.airborne, told.airborne) == (0.0, 0.0)
    assert not np.any(steps.contact_force)


def test_a_controller_hears_what_mujocos_animal_feels(swimmer):
    """Started elsewhere, one that corrects its angles comes to other commands than were given."""
    experiment, genes, steps = swimmer
    simulation, creature = experiment.simulation, experiment.creature
    bent = steps._replace(
        before=eqx.tree_at(lambda state: state.q, steps.before, steps.before.q + 0.3),
    )
    told = second_opinion(simulation, creature, bent)
    sensed = second_opinion(simulation, creature, bent, brain=Brain(simulation, genes))
    # The commands alone keep what is off; centring in the controller takes it back.
    own = own_opinion(simulation, steps).joint_angle
    off = [np.abs(each.joint_angle - own)[:, -1].max() for each in (told, sensed)]
    assert off[0] > 0.2 and off[1] < 0.7 * off[0]


@pytest.mark.slow
def test_on_the_ground_hard_contacts_bear_the_weight_in_the_end():
    """A hexapod that holds one posture stands in both programs, as high to 2 mm."""
    path = CONFIG.with_name("hexapod.yaml")
    experiment, _, _ = lived(path, "simulation.steps=1")
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
