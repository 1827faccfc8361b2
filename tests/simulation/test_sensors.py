"""Sensors against eq. 1, plain geometry and hydrostatics."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from creatures import quick_jit, random_creature, random_state
from evo_cpg.creature.algebra.rotation import euler_to_matrix, integrate_quaternion
from evo_cpg.creature.creature import DepthSensor
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.physics.water.water import Water
from evo_cpg.simulation.sensors import (
    VelocitySensor,
    bearings,
    body_loads,
    depth_readings,
    light_readings,
    light_strength,
    place_sensors,
    pressure_readings,
)
from evo_cpg.simulation.snapshot import Forces, Snapshot
from on_ground import alone, record, released
from trials import EYES, swimmer


@given(st.floats(0, np.pi), st.floats(0.1, 2 * np.pi))
def test_strength_is_eq_1_within_the_field_of_view_and_0_beyond(angle, field):
    strength = float(light_strength(jnp.cos(jnp.array([angle])), jnp.array([field]))[0])
    expected = np.cos(np.pi * angle / field) if angle < field / 2 else 0.0
    # float32 resolves the angle to 5e-4 rad where the cosine is flat.
    assert strength == pytest.approx(expected, abs=np.pi / field * 6e-4)
    assert 0.0 <= strength <= 1.0


@pytest.mark.parametrize("light", [(3.0, 1.0, 0.5), (-2.0, 4.0, -1.0), (0.3, -0.2, 2.0)])
def test_eyes_see_from_their_place_along_their_axis(x64, light):
    creature = swimmer(EYES)
    tree = build_tree(creature)
    turn, bend = np.array([0.4, -0.3, 1.1]), 0.7
    root = np.asarray(euler_to_matrix(*turn))
    place = np.array([0.2, -0.1, 0.3])
    state = State(
        position=jnp.asarray(place),
        orientation=jnp.asarray(quaternion(root)),
        velocity=jnp.zeros(6),
        q=jnp.array([bend]),
        qd=jnp.zeros(1),
    )
    sensors = place_sensors(creature, tree)
    seen = quick_jit(lambda state, light: light_readings(sensors, kinematics(tree, state), light))
    strength, cosine, sine = map(np.asarray, seen(state, np.array(light)))
    tail = root @ np.asarray(euler_to_matrix(0.0, 0.0, bend))
    joint = place + root @ [-0.11, 0, 0]
    positions = [place + root @ [0.1, 0, 0], joint + tail @ [-0.21, 0, 0.02]]
    axes = [root @ [1, 0, 0], tail @ [0, 1, 0]]
    for i, (position, axis, eye) in enumerate(zip(positions, axes, EYES, strict=True)):
        ray = (np.array(light) - position) / np.linalg.norm(np.array(light) - position)
        angle = np.arccos(axis @ ray)
        half = eye.field_of_view / 2
        expected = np.cos(np.pi * angle / eye.field_of_view) if angle < half else 0.0
        assert float(strength[i]) == pytest.approx(expected, abs=1e-9)
        assert float(cosine[i]) == pytest.approx(axis[2], abs=1e-9)
        assert float(sine[i]) == pytest.approx(np.hypot(axis[0], axis[1]), abs=1e-6)


def test_bearings_lead_from_parts_to_the_light(x64):
    """From the centre of a part, the bearing in the world leads to the light."""
    tree = build_tree(random_creature(np.random.default_rng(0), ((0, 2), (1, 1), (0, 3))))
    state, light = random_state(tree, np.random.default_rng(1)), np.array([1.0, -2.0, 0.5])

    def look(state, light):
        now = Snapshot(World(tree, 9.81), 1 / 60, state, light)
        return bearings(now), now.rotation, now.position

    found, rotation, position = map(np.asarray, quick_jit(look)(state, light))
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), 1.0, atol=1e-9)
    seen, away = np.einsum("ijb,jb->ib", rotation, found), light[:, None] - position
    np.testing.assert_allclose(seen * np.linalg.norm(away, axis=0), away, atol=1e-8)
    assert not np.asarray(quick_jit(lambda x: look(x, None)[0])(state)).any()


def test_eyes_in_the_dark_feel_only_the_vertical(x64):
    tree = build_tree(swimmer(EYES))
    sensors = place_sensors(swimmer(EYES), tree)
    turned = tuple(map(float, quaternion(np.asarray(euler_to_matrix(0.4, -0.3, 1.1)))))

    @quick_jit
    def seen(light):
        kin = kinematics(tree, resting_state(tree, dtype=jnp.float64, orientation=turned))
        return light_readings(sensors, kin, light), light_readings(sensors, kin, None)

    lit, dark = jax.device_get(seen(np.array([3.0, 1.0, 0.5])))
    assert float(lit[0].max()) > 0.5
    np.testing.assert_array_equal(dark[0], [0.0, 0.0])
    np.testing.assert_array_equal(dark[1], lit[1])
    np.testing.assert_array_equal(dark[2], lit[2])


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return the unit quaternion (w, x, y, z) of a rotation by less than a half turn."""
    w = np.sqrt(1 + np.trace(rotation)) / 2
    skew = rotation - rotation.T
    return np.array([w, *(np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / (4 * w))])


def test_pressure_sensors_compare_the_ground_with_the_water():
    """The pressure of the water at 0.5 m is 4.9 kPa on the cross-section of the tail."""
    creature = swimmer(EYES)
    tree = build_tree(creature)
    creature = dataclasses.replace(creature, pressure_sensors=tree.names)
    sensors = place_sensors(creature, tree)
    contact_model = make_contact_model(creature, tree, Ground())
    start = resting_state(tree, (3,), position=(0.0, 0.0, -0.5))
    kin = quick_jit(lambda start: kinematics(tree, start))(start)
    touched = np.array(contact_model.bodies) == 1
    area = tree.volume[1] ** (2 / 3)
    weight = 1000 * 9.81 * 0.5 * area
    support = np.zeros((3, len(contact_model.bodies), 3))
    support[2, np.flatnonzero(touched)[:2]] = np.array([0.0, 0.49 * weight, 0.51 * weight])
    support = jnp.asarray(support, jnp.float32)

    def felt(water):
        world = World(tree, 9.81, water, contact_model=contact_model)
        return np.asarray(
            quick_jit(lambda kin: pressure_readings(sensors, world, kin, support))(kin)
        )

    np.testing.assert_array_equal(felt(None), [[0, 0, 0], [0, 1, 1]])
    np.testing.assert_array_equal(felt(Water(1000.0)), [[0, 0, 0], [0, 1, 1]])
    np.testing.assert_array_equal(felt(Water(1000.0, 0.0)), [[0, 0, 0], [0, 0, 1]])
    afloat = World(tree, 9.81, Water(1000.0))
    np.testing.assert_array_equal(pressure_readings(sensors, afloat, kin, None), np.zeros((2, 3)))


def test_depth_gauges_read_the_depth_of_their_place(x64):
    """The head is at -0.5 m and pitched by 0.3 rad. The tail's gauge is far below its scale."""
    gauges = (
        DepthSensor("head", (0.1, 0.0, 0.02), 2.0),
        DepthSensor("tail", (-0.1, 0.0, 0.0), 0.1),
        DepthSensor("head", (0.0, 0.0, 0.0), 0.5),
    )
    creature = dataclasses.replace(swimmer(EYES), depth_sensors=gauges)
    tree = build_tree(creature)
    sensors = place_sensors(creature, tree)
    pitch = np.asarray(euler_to_matrix(0.0, 0.3, 0.0))
    down = tuple(map(float, quaternion(pitch)))
    own = -0.5 + pitch[2] @ [0.1, 0.0, 0.02]
    start = resting_state(tree, dtype=jnp.float64, position=(0.0, 0.0, -0.5), orientation=down)
    kin = quick_jit(lambda start: kinematics(tree, start))(start)
    for surface, expected in (
        (0.0, [-own / 2.0, 1.0, 1.0]),
        (-0.3, [(-0.3 - own) / 2.0, 1.0, 0.4]),
        (-1.0, [0.0, 0.0, 0.0]),
        (None, [0.0, 0.0, 0.0]),
    ):
        world = World(tree, 9.81, Water(1000.0, surface))
        np.testing.assert_allclose(depth_readings(sensors, world, kin), expected, rtol=0, atol=1e-9)


def test_velocities_equal_central_differences(x64):
    """Differences are taken of poses. A velocity sensor returns them in the body's axes."""
    rng = np.random.default_rng(3)
    tree = build_tree(random_creature(rng, ((0, 2), (1, 1), (0, 3), (3, 1))))
    state, h = random_state(tree, rng, (4,)), 1e-6

    def pose(time):
        v = state.velocity
        turned = integrate_quaternion(state.orientation, v[:3], time)
        place, q = state.position + time * v[3:], state.q + time * state.qd
        now = Snapshot(World(tree, 9.81), 1 / 60, State(place, turned, v, q, state.qd))
        none = Forces(jnp.zeros_like(state.q), jnp.zeros((3, 0, 4)), jnp.zeros((0, 4)))
        read = [VelocitySensor("b3", largest).sense(now, none) for largest in (100.0, 1e-3)]
        speeds = now.velocity, now.centre_of_mass_velocity, now.angular_velocity
        return now.position, now.centre_of_mass, now.rotation, speeds, read

    poses = quick_jit(lambda: [pose(time) for time in (0.0, h, -h)])()
    now, later, before = jax.tree.map(np.asarray, poses)
    rate, centre, turn = (
        (ahead - behind) / (2 * h) for ahead, behind in zip(later[:3], before[:3], strict=True)
    )
    _, _, rotation, (velocity, of_the_centre, angular_velocity), (read, over) = now
    np.testing.assert_allclose(velocity, rate, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(of_the_centre, centre, rtol=1e-6, atol=1e-6)
    turning = np.einsum("ijbn,kjbn->ikbn", turn, rotation)
    spin = np.stack([turning[2, 1], turning[0, 2], turning[1, 0]])
    np.testing.assert_allclose(angular_velocity, spin, rtol=1e-6, atol=1e-6)
    i = tree.names.index("b3")
    own = np.einsum("ijn,in->jn", rotation[:, :, i], rate[:, i])
    np.testing.assert_allclose(read, own / 100.0, rtol=1e-6, atol=1e-8)
    assert np.abs(over).max() == 1.0


@pytest.mark.slow
def test_load_of_a_body_at_rest_is_its_whole_weight():
    with jax.enable_x64(True):
        world = alone(Box((0.2, 0.1, 0.1)))
        _, force = record(world, released(world, [[0.0], [0.0], [0.05]]), 120)
        # On a flat floor the contact frame's third axis is vertical.
        load = body_loads(world, jnp.asarray(force[-1]))
        assert load.shape == (1, 1)
        assert float(load[0, 0]) == pytest.approx(1.0, abs=1e-6)
        weightless = dataclasses.replace(world, gravity=0.0)
        assert float(body_loads(weightless, jnp.asarray(force[-1]))[0, 0]) == 0.0
