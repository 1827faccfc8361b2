"""Gait numbers of synthetic recordings."""

import dataclasses

import numpy as np
import pytest

import trials
from creatures import AXES, box_chain, in_water
from evo_cpg.analysis.chains import axis_signs, joint_rows
from evo_cpg.analysis.gait import gait
from evo_cpg.analysis.gait_numbers import GaitNumbers, gait_numbers
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.step.world import World
from evo_cpg.simulation.recording import Recording

STEP = 1 / 60
COUNT = 600
TIME = STEP * np.arange(COUNT)[:, None]
# Lag of a wave from head to tail, degrees per joint.
LAG = 50.0


def snake(mirrored: tuple[str, ...] = ()) -> Creature:
    """Return six boxes in a row. The joints of ``mirrored`` bodies turn about -z."""
    bodies = []
    for body in box_chain(6, "z").bodies:
        joint = body.joint
        if body.name in mirrored:
            joint = dataclasses.replace(joint, axes=((0.0, 0.0, -1.0),))
        bodies.append(dataclasses.replace(body, joint=joint))
    return Creature("snake", tuple(bodies))


def recording(
    creature: Creature, place: np.ndarray, angles: np.ndarray, bends: bool = True
) -> Recording:
    """Return a recording of a row of bodies that bends about z, with the root at a place.

    Axes that point down turn the other way. Without ``bends``, all bodies are at one place.
    """
    count, bodies = len(place), len(creature.bodies)
    still = np.zeros_like(angles)
    down = [body.joint.axes[0][2] < 0 for body in creature.bodies[1:]]
    heading = bends * np.cumsum(np.where(down, -angles, angles), axis=1)
    heading = np.concatenate([np.zeros((count, 1)), heading], 1)
    cos, sin, none = np.cos(heading), np.sin(heading), np.zeros_like(heading)
    rotation = np.stack([cos, -sin, none, sin, cos, none, none, none, none + 1], -1)
    ahead = np.stack([cos, sin, none], -1)
    steps = -0.11 * (ahead[:, 1:] + ahead[:, :-1])
    behind = np.concatenate([np.zeros((count, 1, 3)), np.cumsum(steps, 1)], 1)
    return Recording(
        time=STEP * np.arange(count),
        position=place[:, None] + bends * behind,
        rotation=rotation.reshape(count, bodies, 3, 3),
        joint_angle=angles,
        target_rate=still,
        cpg_output=still,
        torque=still,
        distance=np.zeros(count),
        light=np.full((count, 3), np.nan),
        dof_names=build_tree(creature).dof_names,
    )


def numbers_of(
    creature: Creature,
    world: World,
    place: np.ndarray,
    angles: np.ndarray,
    bends: bool = True,
    **frames: np.ndarray,
) -> GaitNumbers:
    simulation = dataclasses.replace(trials.experiment(len(place)).simulation, world=world)
    frames = {"energy": np.ones((len(place), 1))} | frames
    return gait_numbers(simulation, creature, frames, recording(creature, place, angles, bends))


def lying(creature: Creature) -> World:
    tree = build_tree(creature)
    return World(tree, 9.81, contact_model=make_contact_model(creature, tree, Ground()))


def wave(joints: int = 5, frequency: float = 1.0) -> np.ndarray:
    return 0.3 * np.sin(2 * np.pi * frequency * TIME - np.radians(LAG) * np.arange(joints))


def swims(speed: float = 0.5, height: float = 0.0) -> np.ndarray:
    return np.hstack([speed * TIME, 0 * TIME, 0 * TIME + height])


def test_cost_of_transport_leaves_out_the_last_step():
    """10 samples have 9 displacements. The recording ends before the tenth one."""
    creature = snake()
    energy = np.full((10, 1), 2.0)
    energy[-1] = 50.0
    found = numbers_of(creature, in_water(creature), swims()[:10], 0 * wave()[:10], energy=energy)
    distance = 0.5 * 9 * STEP
    expected = 18.0 / (float(creature.mass) * 9.81 * distance)
    assert found.value("cost_of_transport") == pytest.approx(expected, rel=1e-6)
    assert found.value("speed") == pytest.approx(0.5)


@pytest.mark.parametrize("speed", [0.0, 1e-7, 0.1])
def test_a_standing_animal_has_no_stride_length_or_relative_slip(speed):
    """The animal wriggles, and the tail is always in contact and slides along."""
    creature = snake()
    world = lying(creature)
    force = np.zeros((COUNT, 3, len(world.contact_model.bodies), 1))
    force[:, 2, np.array(world.contact_model.bodies) == 5] = 3.0
    place, velocity = swims(speed), np.zeros_like(force)
    velocity[:, 0] = speed
    frames = {"contact_force": force, "contact_velocity": velocity}
    found = numbers_of(creature, world, place, wave(), bends=False, **frames)
    assert found.value("path_speed") == pytest.approx(speed, rel=1e-3, abs=1e-9)
    assert found.value("slip") == pytest.approx(speed, rel=1e-3, abs=1e-9)
    keys = ("stride_length", "relative_stride", "relative_slip")
    if speed > 0.01:
        assert found.value("stride_length") == pytest.approx(speed, rel=1e-3)
        assert found.value("relative_slip") == pytest.approx(1.0, rel=1e-3)
    else:
        assert np.isnan([found.value(key) for key in keys]).all()
        missing = {each.key: each.missing for each in found.quantities}
        words = "its path in the second half of the trial is shorter than 1 % of its length"
        assert [missing[key] for key in keys] == [words] * 3
    swimmer = numbers_of(creature, in_water(creature), place, wave(), bends=speed > 0.01)
    assert np.isnan(swimmer.value("strouhal")) == (speed < 0.01)


@pytest.mark.parametrize("height", [-0.5, 0.04, 0.06, 2.0])
def test_only_an_animal_in_water_has_a_strouhal_number(height):
    """Boxes 0.1 m high reach 0.05 m down."""
    creature = snake()
    world = in_water(creature, surface=0.0)
    found = numbers_of(creature, world, swims(height=height), wave())
    keys = ("wave_slip", "strouhal")
    values = [found.value(key) for key in keys]
    assert np.isfinite(found.value("wave_speed"))
    if height < 0.05:
        assert np.isfinite(values).all()
    else:
        missing = [each.missing for each in found.quantities if each.key in keys]
        assert np.isnan(values).all() and all("out of the water" in words for words in missing)


@pytest.mark.parametrize("mirrored", [("b2", "b4"), ("b1",)])
def test_lags_and_wave_do_not_depend_on_axis_signs(mirrored):
    """Describe one motion by angles about z, and partly about -z."""
    plain, other = snake(), snake(mirrored)
    signs = np.array([-1.0 if body.name in mirrored else 1.0 for body in other.bodies[1:]])
    one = numbers_of(plain, in_water(plain), swims(), wave())
    two = numbers_of(other, in_water(other), swims(), wave() * signs)
    assert one.value("lag") == pytest.approx(LAG, abs=0.5)
    for key in ("lag", "wave_count", "wave_speed", "wave_slip", "strouhal", "stride_frequency"):
        assert two.value(key) == pytest.approx(one.value(key), rel=1e-9)
    np.testing.assert_allclose(two.lags.lag, one.lags.lag, atol=1e-6)
    motion = recording(other, swims(), wave() * signs)
    found = gait(motion, signs=two.axis_signs)
    np.testing.assert_allclose(found.lag, LAG, atol=0.5)


def test_signs_of_axes_in_the_neutral_pose():
    """One limb is turned over and one is perpendicular. A row of one axis has sign 1."""
    over = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    square = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
    bodies = [*snake(("b3",)).bodies]
    for i, turn in ((2, over), (5, square)):
        joint = dataclasses.replace(bodies[i].joint, orientation=turn)
        bodies[i] = dataclasses.replace(bodies[i], joint=joint)
    tree = build_tree(Creature("turned", tuple(bodies)))
    rows = joint_rows(tree)
    # Bodies behind b2 are turned over with it, and b3 also turns about -z.
    np.testing.assert_array_equal(axis_signs(tree, rows), [1, -1, 1, -1, 1])
    # Each arm on a body without an axis begins a row.
    alone = Creature("alone", (bodies[0], *(_on_the_first(body) for body in bodies[1:])))
    tree = build_tree(alone)
    rows = joint_rows(tree)
    np.testing.assert_array_equal(axis_signs(tree, rows), np.ones(5))


def _on_the_first(body):
    joint = dataclasses.replace(body.joint, parent="b0", axes=(AXES["y"],))
    return dataclasses.replace(body, joint=joint)
