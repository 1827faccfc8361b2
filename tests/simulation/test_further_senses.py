"""Acceleration, rotation, load, flow and rays against closed forms and scenes made by hand."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit, random_creature, random_state
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.contact.terrain import Block, Boulder, Plane, Shore
from evo_cpg.physics.step.world import World
from evo_cpg.physics.water.water import Current, Vortex, Water
from evo_cpg.simulation.inertial import AccelerationSensor, RotationSensor
from evo_cpg.simulation.lateral_line import FlowSensor
from evo_cpg.simulation.rays import RaySensor, along_rays
from evo_cpg.simulation.sensors import LoadSensor
from evo_cpg.simulation.snapshot import Forces, Snapshot

GRAVITY = 9.81
CREATURE = random_creature(np.random.default_rng(3), ((0, 2), (1, 1), (0, 3)))
TREE = build_tree(CREATURE)
BODY = TREE.names[1]


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


@functools.cache
def state():
    """Return a random state in float64."""
    return random_state(TREE, np.random.default_rng(4))


@functools.cache
def pose():
    """Return rotation, place, velocity and angular velocity of the body."""

    def look(state):
        snapshot = Snapshot(World(TREE, GRAVITY), 1 / 60, state)
        names = "rotation", "position", "velocity", "angular_velocity"
        return [getattr(snapshot, name)[..., 1] for name in names]

    return [np.asarray(x) for x in quick_jit(look)(state())]


def read(sensor, water=None, ground=None, **forces):
    contact = None if ground is None else make_contact_model(CREATURE, TREE, ground)
    world = World(TREE, GRAVITY, water, contact_model=contact)
    none = Forces(jnp.zeros(TREE.dof_count), jnp.zeros((3, 0)), jnp.zeros(0))

    def sense(state, forces):
        return sensor.sense(Snapshot(world, 1 / 60, state), none._replace(**forces))

    return np.asarray(quick_jit(sense)(state(), forces))


def skin(place):
    """Return a place on the body in the world, its velocity, and the body's rotation."""
    rotation, centre, velocity, turning = pose()
    lever = rotation @ place
    return centre + lever, velocity + np.cross(turning, lever), rotation


def test_acceleration_at_rest_points_up_and_is_nothing_in_free_fall():
    sensor = AccelerationSensor(BODY, full_scale=20.0)
    still = np.zeros((3, TREE.body_count))
    up = pose()[0][2] * GRAVITY / 20
    np.testing.assert_allclose(read(sensor, acceleration=still), up, rtol=1e-12)
    falling = still - [[0.0], [0.0], [GRAVITY]]
    np.testing.assert_allclose(read(sensor, acceleration=falling), 0, atol=1e-12)


def test_rotation_is_that_of_the_body_in_its_own_axes():
    rotation, *_, turning = pose()
    found = read(RotationSensor(BODY, 50.0))
    np.testing.assert_allclose(found, rotation.T @ turning / 50, rtol=1e-12)


PLACE = np.array([0.1, -0.2, 0.05])


def test_flow_is_that_of_the_water_past_the_skin():
    vortex = Vortex((0.5, -0.3), 2.0, 0.2)
    place, moving, rotation = skin(PLACE)
    away = place[:2] - vortex.centre
    turn = 2.0 / (2 * np.pi) / (away @ away + 0.04) * np.array([-away[1], away[0]])
    expected = rotation.T @ (np.array([0.3 + turn[0], 0.1 + turn[1], 0.0]) - moving) / 9
    sensor = FlowSensor(BODY, tuple(PLACE), full_scale=9.0)
    water = Water(1000.0, streams=(Current((0.3, 0.1, 0.0)), vortex))
    np.testing.assert_allclose(read(sensor, water), expected, rtol=1e-9)


def test_gradient_of_a_shear_is_its_rate_and_ignores_the_speed():
    """In water that shears, u = (0, k x, 0), the change along the skin's own axis is known."""
    rate = 0.7
    shear = Current((5.0, 0.0, 0.0), ((0, 0, 0), (rate, 0, 0), (0, 0, 0)))
    rotation, *_, turn = pose()
    axis = np.array([2.0, 1.0, 0.0]) / np.sqrt(5)
    along = rotation @ axis
    change = np.array([0, rate * along[0], 0]) - np.cross(turn, along)
    sensor = FlowSensor(BODY, tuple(PLACE), "gradient", (2.0, 1.0, 0.0), full_scale=20.0)
    found = read(sensor, Water(1000.0, streams=(shear,)))
    np.testing.assert_allclose(found, rotation.T @ change / 20, rtol=1e-6)


def test_no_flow_is_felt_above_the_surface_or_without_water():
    sensor, current = FlowSensor(BODY), (Current((0.5, 0.0, 0.0)),)
    high = float(pose()[1][2])
    assert not read(sensor).any()
    assert not read(sensor, Water(1000.0, high - 0.1, current)).any()
    assert read(sensor, Water(1000.0, high + 0.1, current)).any()


def distances(parts, start, heading, most=10.0):
    start, heading = (
        np.asarray(x, float).T for x in (np.atleast_2d(start), np.atleast_2d(heading))
    )
    heading = heading / np.linalg.norm(heading, axis=0)
    return np.asarray(quick_jit(lambda s, h: along_rays(parts, s, h, most))(start, heading))


def test_rays_end_where_geometry_says():
    slope = Plane((0.0, 0.6, 0.8), 0.0)
    assert distances((slope,), [0, 0, 1], [0, 0, -1]) == pytest.approx(1.0)
    # A ray that grazes the plane, at 0.6 degrees.
    grazing = distances((Plane(),), [0, 0, 0.1], [1, 0, -0.01], 20.0)
    assert grazing == pytest.approx(0.1 * np.hypot(1, 0.01) / 0.01)
    ball = Boulder((3.0, 0.0, 0.0), 1.0)
    aside = [[0, y, 0] for y in (0.0, 0.5, 0.99, 1.01)]
    expected = [3 - np.sqrt(1 - y * y) for y in (0.0, 0.5, 0.99)] + [10.0]
    found = distances((ball,), aside, [[1, 0, 0]] * 4)
    np.testing.assert_allclose(found, expected, rtol=1e-3)
    block = Block((2.0, 0.0, 0.0), (0.5, 0.5, 0.5), np.pi / 4)
    assert distances((block,), [0, 0.1, 0], [1, 0, 0]) == pytest.approx(2 - np.sqrt(0.5) + 0.1)
    assert distances((block, ball), [0, 0, 0.6], [1, 0, 0]) == pytest.approx(3 - 0.8, rel=1e-3)
    assert distances((block,), [0, 0, 0], [-1, 0, 0]) == pytest.approx(10.0)
    shore = Shore("x", 0.0, 2.0, 0.0, -1.0)
    assert distances((shore,), [3, 0, -0.5], [-1, 0, 0]) == pytest.approx(2.0, abs=0.01)


@pytest.mark.slow
def test_rays_never_pass_thin_walls():
    """Random rays through many thin walls end at the wall that a fine walk along them meets."""
    draw = np.random.default_rng(0)
    walls = tuple(
        Block(tuple(draw.uniform(-2, 2, 3)), (0.8, 0.01, 0.8), float(turn))
        for turn in draw.uniform(0, np.pi, 5)
    )
    start, heading = draw.uniform(-2, 2, (2, 120, 3))
    found = distances(walls, start, heading, 4.0)
    heading = heading / np.linalg.norm(heading, axis=1, keepdims=True)
    steps = np.linspace(0, 4, 8001)
    points = np.moveaxis(start[:, None] + steps[:, None] * heading[:, None], 2, 0)
    inside = np.stack([np.asarray(wall.distance(points)[0]) for wall in walls]).min(0) <= 0
    expected = np.where(inside.any(1), steps[inside.argmax(1)], 4.0)
    assert 10 < (expected < 4).sum() < 110
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_rays_spread_from_the_side_of_minus_y():
    sensor = RaySensor(BODY, count=3, spread_deg=90.0, axis=(0.0, 0.0, -2.0))
    side = np.sqrt(0.5)
    expected = np.array([[0, -side, -side], [0, 0, -1], [0, side, -side]]).T
    np.testing.assert_allclose(sensor.directions, expected, atol=1e-12)
    place, _, rotation = skin(PLACE)
    ground = Ground(floor=Plane(height=float(place[2]) - 0.4))
    sensor = dataclasses.replace(sensor, position=tuple(PLACE), range=1.0)
    down = -(rotation @ expected)[2]
    reached = np.where(down > 0.4, 1 - 0.4 / np.maximum(down, 0.4), 0.0)
    np.testing.assert_allclose(read(sensor, ground=ground), reached, atol=1e-9)
    assert not read(sensor).any()


def test_load_without_ground_is_nothing():
    assert read(LoadSensor(BODY)) == [0.0]
