"""Measures of gait equal the numbers computed from a recording."""

import dataclasses
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import evo_cpg as evo
from creatures import hinge
from evo_cpg.creature.axis_kinds import Slide, Turn
from evo_cpg.creature.creature import WORLD, Body, Creature, Material
from evo_cpg.creature.limbs import limbs
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.load import load_config
from evo_cpg.physics.step.world import World
from evo_cpg.simulation.measures import (
    GROUND_MEASURES,
    MEASURES,
    GaitMeasure,
    RootTravel,
    Trial,
    no_displacement,
)
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from tiny_run import REPOSITORY

STEPS = 120
WALKER = REPOSITORY / "configs" / "fukui2003_model1.yaml"


def one_leg():
    """Return the walker's torso with one leg: three bodies to compile, not nine."""
    contents = load_config(WALKER).model_dump(mode="json")
    contents["creature"]["bodies"] = contents["creature"]["bodies"][:3]
    return contents


@pytest.fixture(
    scope="module",
    params=[
        pytest.param("one leg", marks=pytest.mark.slow),
        pytest.param("fukui2003_model1", marks=pytest.mark.slow),
        pytest.param("iwadate2010_swimmer", marks=pytest.mark.slow),
    ],
)
def evaluated(request):
    """Evaluation of some animals, and their recordings."""
    on_ground = request.param != "iwadate2010_swimmer"
    names = [name for name in MEASURES if on_ground or name not in GROUND_MEASURES]
    settings = {"simulation.seconds": STEPS / 60, "measures": names}
    config = one_leg() if request.param == "one leg" else f"configs/{request.param}.yaml"
    experiment = evo.load(config, settings)
    genomes = experiment.random_genomes(3, 4)
    found = experiment.evaluate(0, genomes)
    assert set(names) == set(found.descriptors)
    records = [experiment.record(0, genome) for genome in genomes]
    return experiment, on_ground, found, records


def test_frequency_and_amplitude_leave_out_slides():
    """In two seconds a hinge turns back 16 times, with a variance of 0.25. The root drifts."""
    origin = (0.0, 0.0, 0.0)
    joint = hinge("a", origin, origin, "y", 9.0)
    body = Body("a", Box((0.1,) * 3), Material(1000.0))
    bodies = body, dataclasses.replace(body, name="b", joint=joint)
    slide = dataclasses.replace(joint, parent=WORLD, kinds=(Slide(),))
    tree = build_tree(Creature("crab", bodies, root_joint=slide))
    assert tree.dof_kinds == (Slide(), Turn())
    trial = Trial(World(tree, 9.81), 2.0)
    changes, angle, square = (np.array(x) for x in ([0.0, 16.0], [50.0, 0.0], [900.0, 0.5]))
    strides = {"strides": (changes, changes)}
    assert float(GaitMeasure("frequency").finish(strides, trial)) == 4.0
    swing = {"angle": angle, "square": square}
    assert float(GaitMeasure("amplitude").finish(swing, trial)) == pytest.approx(0.5)


def test_travel_counts_stretches_of_a_closed_path():
    """In 12 s, a root goes once around a square of 2 m, and shakes to and fro once a second."""
    corners = np.array([[0, 0], [2, 0], [2, 2], [0, 2], [0, 0]])
    time = np.arange(121) / 10
    path = np.stack([np.interp(time, 3.0 * np.arange(5), side) for side in corners.T])
    path[0] += 0.3 * np.sin(2 * np.pi * time)
    measure, tally = RootTravel(), (no_displacement((), np.float32, 2), np.float32(0))
    for step in range(120):
        before, after = (
            SimpleNamespace(control_step=0.1, state=SimpleNamespace(position=path[:, i]))
            for i in (step, step + 1)
        )
        tally = measure.update(tally, SimpleNamespace(step=step, before=before, after=after))
    assert float(measure.finish(tally, None)) == pytest.approx(8.0, rel=1e-5)


@pytest.mark.slow
def test_measures_equal_numbers_from_a_recording(evaluated):
    experiment, on_ground, found, records = evaluated
    tree, rate = experiment.world.tree, experiment.parts.simulation.control_rate
    duration = STEPS / rate
    first = [body.name for body in experiment.creature.bodies].index(tree.names[0])
    weight = float(np.sum(tree.mass)) * experiment.world.gravity
    for i, record in enumerate(records):
        motion = record.recording
        measured = {name: float(values[i]) for name, values in found.descriptors.items()}
        root = motion.position[:, first, : 2 if on_ground else 3]
        displacement = np.linalg.norm(root[-1] - root[0])
        # A recording ends at the start of the last control step.
        slack = float(np.linalg.norm(np.diff(root, axis=0), axis=1).max()) * 1.5
        assert measured["speed"] == pytest.approx(displacement / duration, abs=slack / duration)
        assert measured["cost_of_transport"] == pytest.approx(
            measured["power"] / (weight * measured["speed"]), rel=1e-4
        )
        angles = np.asarray(motion.joint_angle, float)
        assert measured["amplitude"] == pytest.approx(angles.std(0).mean(), rel=0.05)
        swings = (np.diff(np.sign(np.diff(angles, axis=0)), axis=0) != 0).sum(0).mean()
        # Feet chatter, so rounding and the steps of the recording decide a sixth of the swings.
        assert measured["frequency"] == pytest.approx(swings / 2 / duration, rel=0.3, abs=0.1)
        strides = max(measured["frequency"] * duration, 1.0)
        assert measured["stride_length"] * strides == pytest.approx(
            measured["speed"] * duration, rel=1e-4
        )
        up = np.asarray(motion.rotation, float)[:, first, 2, 2]
        assert measured["tilt"] == pytest.approx((1 - up).mean(), abs=2e-3)
        spin = np.asarray(motion.rotation, float)[:, first]
        turn = spin[1:] @ spin[:-1].transpose(0, 2, 1)
        about_the_vertical = (turn[:, 1, 0] - turn[:, 0, 1]).sum() / 2
        assert measured["turning"] == pytest.approx(about_the_vertical / duration, abs=0.05)


def test_duty_factor_slip_and_airborne_follow_from_contact_forces(evaluated):
    experiment, on_ground, found, _ = evaluated
    if not on_ground:
        return
    simulation, tree = experiment.parts.simulation, experiment.world.tree
    genes = experiment.random_genomes(3, 4).T
    frames = jax.jit(lambda genes: rollout(simulation, genes, observers=Recorder(4)))(genes)
    force = np.linalg.norm(np.asarray(frames["contact_force"]), axis=1)
    owners = np.array(simulation.world.contact_model.bodies)
    for i in range(4):
        touching = np.array(
            [(force[:, owners == body, i] > 0).any(1) for body in np.unique(owners) if body > 0]
        )
        fraction = touching.mean(1)
        expected = fraction[fraction > 0].mean() if (fraction > 0).any() else 0.0
        assert float(found.descriptors["duty_factor"][i]) == pytest.approx(expected, abs=0.02)
        legs = [
            np.isin(owners, [tree.names.index(experiment.creature.bodies[k].name) for k in bodies])
            for bodies, _, _ in limbs(experiment.creature)
        ]
        legs = [float((force[:, own, i] > 0).any(1).mean()) for own in legs]
        expected = np.mean([one for one in legs if one > 0] or [0.0])
        found_one = float(found.descriptors["limb_duty_factor"][i])
        assert found_one == pytest.approx(expected, abs=0.02)
        load = np.asarray(frames["contact_force"])[:, 2, :, i]
        slide = np.linalg.norm(np.asarray(frames["contact_velocity"])[:, :2, :, i], axis=1)
        slip = (load * slide).sum() / max(load.sum(), 1e-9)
        relative = float(found.descriptors["relative_slip"][i] * found.descriptors["speed"][i])
        assert relative == pytest.approx(slip, rel=0.03, abs=1e-4)
        nothing = (force[:, :, i] == 0).all(1).mean()
        assert float(found.descriptors["airborne"][i]) >= nothing - 0.02
