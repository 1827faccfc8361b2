"""Single bodies on the ground against closed forms, at the walkers' own step of 1/240 s."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.creature.algebra.rotation import quaternion_to_matrix
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Sphere
from evo_cpg.physics.contact.contact import find_contacts
from evo_cpg.physics.contact.contact_model import combine
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State
from on_ground import GRAVITY, H, alone, record, recorder, released

# The stiffness c h of each contact point is 60 times the mass of a single body.
STIFFNESS = 60

SHAPES = {
    "box": Box((0.3, 0.2, 0.1)),
    "sphere": Sphere(0.1),
    "capsule": Capsule(0.05, 0.3),
    "ellipsoid": Ellipsoid((0.15, 0.1, 0.06)),
}
# `make test-slow` tests all of them. The fast tests keep the contact points of every shape.
ALL = [pytest.param(name, marks=[] if name == "box" else pytest.mark.slow) for name in SHAPES]


def above(count: int, heights) -> np.ndarray:
    """Return places ``(3, count)`` at given heights over the origin."""
    return np.stack([np.zeros(count), np.zeros(count), np.broadcast_to(heights, count)])


def kept_speed(restitution: float, places: int) -> float:
    """Restitution of a body that lands on several points at once: v+ = e v - (1 + e) v / (1 + k).

    The stiffness k = 60 per point costs 2.6 % of a ball's speed at e = 0.6, at any h.
    """
    return restitution - (1 + restitution) / (1 + STIFFNESS * places)


def random_turns(count: int, seed: int = 0) -> np.ndarray:
    """Return random unit quaternions ``(4, count)``."""
    turns = np.random.default_rng(seed).normal(size=(4, count))
    return turns / np.linalg.norm(turns, axis=0)


def lowest_points(world: World, state: State) -> np.ndarray:
    """Return the lowest points of a body in the world, ``(3, points, *n)``."""

    @quick_jit
    def places(state):
        kin = kinematics(world.tree, state)
        return kin.origin + find_contacts(world.contact_model, kin, H).offset

    return np.asarray(places(state))


@pytest.mark.parametrize(
    ("rule", "expected"),
    [("multiply", 0.32), ("average", 0.6), ("geometric", 0.32**0.5), ("min", 0.4), ("max", 0.8)],
)
def test_combination_rules(rule, expected):
    """A rule is symmetric. Equal materials keep their value, except with products."""
    assert combine(rule, 0.4, 0.8) == pytest.approx(expected, rel=1e-12)
    assert combine(rule, 0.8, 0.4) == pytest.approx(expected, rel=1e-12)
    if rule != "multiply":
        assert combine(rule, 0.4, 0.4) == pytest.approx(0.4, rel=1e-12)


def test_contact_points_have_the_combined_values():
    """Restitution is multiplied by the ground's, 1, and frictions are geometric means."""
    world = alone(SHAPES["box"], restitution=0.54, static=0.8, dynamic=0.4)
    np.testing.assert_allclose(world.contact_model.restitution, 0.54, rtol=1e-12)
    np.testing.assert_allclose(world.contact_model.static_friction, 0.8, rtol=1e-12)
    np.testing.assert_allclose(world.contact_model.dynamic_friction, 0.4, rtol=1e-12)


@pytest.mark.parametrize("name", ["box", pytest.param("sphere", marks=pytest.mark.slow)])
def test_restitution_is_the_ratio_of_speeds(name):
    """The ratio of speeds is within 0.05 of the setting, for drops from 0.2 to 1 m.

    A body that bounces also keeps the speed of `kept_speed`, to a closer tolerance.
    """
    shape = SHAPES[name]
    drops = np.array([0.2, 0.33, 0.5, 0.71, 1.0])
    start = above(len(drops), shape.half_extents[2] + drops)
    run = recorder(alone(shape), 150)
    for setting in (0.0, 0.27, 0.54, 0.75):
        world = alone(shape, setting)
        states, support = run(released(world, start), jnp.asarray(world.contact_model.restitution))
        hit = (np.asarray(support)[:, 2].sum(1) > 0).argmax(0)
        speed = np.asarray(states.velocity)[:, 5]
        columns = np.arange(len(drops))
        # The impact step of a body that does not bounce only moves it down to the ground.
        after = np.maximum(speed[hit, columns], speed[hit + 1, columns])
        ratio = after / -speed[hit - 1, columns]
        np.testing.assert_allclose(ratio, setting, atol=0.05)
        if setting > 0:
            places = len(world.contact_model.bodies)
            np.testing.assert_allclose(ratio, kept_speed(setting, places), atol=0.005)


@pytest.mark.slow
def test_a_bounce_converges_with_the_time_step():
    """Errors of height and speed 0.3 s after a ball's bounce are proportional to h.

    The closed form uses the restitution of `kept_speed`. The error depends on the time of the
    impact within a step, so it is the root mean square over 32 drop heights.
    """
    setting, end = 0.6, 0.65
    world = alone(SHAPES["sphere"], setting)
    kept = kept_speed(setting, 1)
    drops = np.linspace(0.5, 0.8, 32)
    fall = np.sqrt(2 * drops / GRAVITY)
    start = released(world, above(32, 0.1 + drops))
    rates = np.array([120, 240, 480, 960])
    errors = []
    for rate in rates:
        states, _ = record(world, start, round(end * rate), 1 / rate)
        since = end - fall
        speed = kept * GRAVITY * fall
        height = speed * since - GRAVITY * since**2 / 2
        found = np.asarray(states.position)[-1, 2] - 0.1, np.asarray(states.velocity)[-1, 5]
        expected = height, speed - GRAVITY * since
        errors.append(
            [np.sqrt(np.mean((f - w) ** 2)) for f, w in zip(found, expected, strict=True)]
        )
    order = -np.polyfit(np.log(rates), np.log(errors), 1)[0]
    assert (order > 0.9).all()


def on_slope(degrees: float, tall: float):
    """Return a block on a slope that falls towards +x, and the downhill direction."""
    angle = np.deg2rad(degrees)
    normal = (float(np.sin(angle)), 0.0, float(np.cos(angle)))
    world = alone(Box((0.2, 0.2, tall)), static=0.5, dynamic=0.4, floor=Plane(normal))
    turned = (np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0)
    state = released(world, np.array(normal)[:, None] * tall / 2, orientation=turned)
    return world, state, np.array([np.cos(angle), 0.0, -np.sin(angle)])


@pytest.mark.parametrize("tall", [pytest.param(0.1, marks=pytest.mark.slow), 0.3])
def test_static_friction_holds(tall):
    """A block creeps less than 0.5 mm/s at one degree below atan 0.5 = 26.57 degrees."""
    world, state, downhill = on_slope(25.5, tall)
    states, _ = record(world, state, 480)
    place = np.asarray(states.position)[:, :, 0]
    creep = downhill @ (place[-1] - place[239])
    assert abs(creep) < 0.5e-3
    assert np.linalg.norm(place[239] - np.asarray(state.position)[:, 0]) < 2e-3
    assert np.abs(np.asarray(states.velocity)[-1, :3]).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("degrees", "tall"), [(27.57, 0.3), (35.0, 0.1)])
def test_dynamic_friction_brakes(degrees, tall):
    """A sliding block accelerates by g (sin a - mu_d cos a) above ten Stribeck speeds."""
    world, state, downhill = on_slope(degrees, tall)
    states, _ = record(world, state, 480)
    speed = np.asarray(states.velocity)[:, 3:, 0] @ downhill
    fast = np.flatnonzero(speed > 10 * world.ground.stribeck_speed)
    assert len(fast) > 120
    angle = np.deg2rad(degrees)
    expected = GRAVITY * (np.sin(angle) - 0.4 * np.cos(angle))
    found = (speed[fast[-1]] - speed[fast[0]]) / (H * (fast[-1] - fast[0]))
    assert found == pytest.approx(expected, rel=0.03)
    assert np.abs(np.asarray(states.velocity)[-1, :3]).max() < 1e-3


@pytest.mark.parametrize("name", ["box", "sphere"])
def test_an_oblique_impact_stays_in_the_friction_cone(name):
    """The tangential momentum change is at most mu_s times the normal momentum change.

    A fast ball slips throughout, and the factor is mu_d.
    """
    static, dynamic = 0.5, 0.3
    world = alone(SHAPES[name], 0.5, static, dynamic)
    along = np.array([0.05, 0.3, 1.0, 3.0, 10.0, 30.0])
    columns = np.arange(len(along))
    velocity = np.zeros((6, len(along)))
    velocity[3], velocity[4], velocity[5] = along, -0.4 * along, -2.0
    clearance = SHAPES[name].half_extents[2] + 0.02
    state = released(world, above(len(along), clearance), velocity)
    states, support = record(world, state, 24)
    pressed = np.asarray(support)[:, 2].sum(1) > 0
    first = pressed.argmax(0)
    speeds = np.concatenate([velocity[None], np.asarray(states.velocity)])[:, 3:]
    # The impact of a ball takes one step. The corners of a box touch down one after another.
    change = speeds[first + 1, :, columns] - speeds[first, :, columns]
    across = change[:, 2] + GRAVITY * H
    taken = np.linalg.norm(change[:, :2], axis=1)
    assert (taken <= 1.03 * static * across).all()
    if name == "sphere":
        # Four outer updates miss 2 % of the friction at 10 m/s, and 0.1 % at 30 m/s.
        assert taken[-2] == pytest.approx(dynamic * across[-2], rel=0.03)
        assert taken[-1] == pytest.approx(dynamic * across[-1], rel=0.01)
        np.testing.assert_allclose(change[-1, :2], -taken[-1] * np.array([1, -0.4]) / 1.16**0.5)


@pytest.mark.parametrize("name", ["sphere", pytest.param("capsule", marks=pytest.mark.slow)])
def test_a_sliding_body_starts_to_roll(name):
    """Angular momentum about the ground is conserved: v = v0 / (1 + I / m r^2), 5/7 v0 for a ball.

    Friction brakes with mu g until the body rolls. Then the speed is constant.
    """
    shape, friction = SHAPES[name], 0.5
    world = alone(shape, static=friction, dynamic=friction)
    radius = shape.half_extents[2]
    start = np.array([0.5, 1.0, 2.0])
    velocity = np.zeros((6, 3))
    velocity[4] = start
    states, _ = record(world, released(world, above(3, radius), velocity), 480)
    speed, spin = np.asarray(states.velocity)[:, 4], np.asarray(states.velocity)[:, 0]
    kept = 1 / (1 + shape.inertia(1.0)[0, 0] / radius**2)
    slides = (1 - kept) * start / (friction * GRAVITY)
    np.testing.assert_allclose(speed[-1], kept * start, rtol=0.02)
    np.testing.assert_allclose(speed[-1], speed[239], rtol=0.005)
    np.testing.assert_allclose(-spin[-1] * radius, speed[-1], rtol=0.005)
    for column, duration in enumerate(slides):
        half = round(duration / 2 / H)
        expected = start[column] - friction * GRAVITY * half * H
        assert speed[half - 1, column] == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_an_ellipsoid_lies_still_and_rocks():
    """It rests on its flat side. Tilted, it rocks with w^2 = m g (a^2 / c - c) / (I + m c^2).

    The radius of curvature under it is a^2 / c in the plane of the rocking.
    """
    shape = SHAPES["ellipsoid"]
    a, _, c = shape.radii
    world = alone(shape, static=0.8, dynamic=0.8)
    tilt = np.array([0.0, 0.06])
    turns = np.stack([np.cos(tilt / 2), 0 * tilt, np.sin(tilt / 2), 0 * tilt])
    low = np.sqrt((a * np.sin(tilt)) ** 2 + (c * np.cos(tilt)) ** 2)
    state = dataclasses.replace(released(world, above(2, low)), orientation=jnp.asarray(turns))
    states, _ = record(world, state, 480)
    place, spin = np.asarray(states.position), np.asarray(states.velocity)[:, 1]
    assert np.abs(place[:, :, 0] - np.array([0, 0, c])).max() < 1e-4
    assert np.abs(spin[:, 0]).max() < 1e-6
    turning = spin[:, 1]
    crossings = np.flatnonzero(np.diff(np.sign(turning)))
    places = crossings + turning[crossings] / (turning[crossings] - turning[crossings + 1])
    found = np.pi / (H * np.diff(places).mean())
    inertia = shape.inertia(1.0)[1, 1]
    expected = np.sqrt(GRAVITY * (a**2 / c - c) / (inertia + c**2))
    assert len(crossings) > 5
    assert found == pytest.approx(expected, rel=0.03)


def test_a_block_rests_on_the_ground_at_its_height():
    """After a fall of 0.2 m onto ground at 1.7 m it is less than 2 mm deep, and carried."""
    height = 1.7
    world = alone(SHAPES["box"], 0.5, floor=Plane(height=height))
    states, support = record(world, released(world, above(1, height + 0.25)), 720)
    rest = np.asarray(states.position)[-1, 2, 0] - height - 0.05
    weight = GRAVITY * world.tree.mass.sum()
    assert -2e-3 < rest < 1e-4
    assert np.asarray(support)[-1, 2].sum() == pytest.approx(weight, rel=1e-3)
    assert np.abs(np.asarray(states.velocity)[-1]).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_a_fall_at_ten_metres_per_second_stays_shallow(name):
    """The depth stays below a fall of half a step, h v / 2 = 21 mm, in any orientation.

    A ball is 0.7 mm deep. The impact spins the other shapes at up to 100 rad/s, so another point is
    lowest in the next step: 9 mm for the box, 20 mm for the flat ellipsoid. An ellipsoid continues
    to spin and rock. The other shapes come to rest, less than 2 mm deep.
    """
    world = alone(SHAPES[name], 0.0)
    count = 32
    velocity = np.zeros((6, count))
    velocity[5] = -10.0
    start = released(world, above(count, 0.5 + H * 10 * np.linspace(0, 1, count)), velocity)
    start = dataclasses.replace(start, orientation=jnp.asarray(random_turns(count)))
    states, _ = record(world, start, 960)
    over_time = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), states)
    deep = -lowest_points(world, over_time)[2]

    assert deep.max() < 10.0 * H / 2
    if name != "ellipsoid":
        assert deep[..., -1].max() < 2e-3
        assert np.abs(np.asarray(states.velocity)[-1]).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_push_out_does_bounded_work(name):
    """A buried body gains at most the energy of its depth and of the push-out speed, 0.5 m/s.

    An ellipsoid gains up to 0.8 m/s, because its lowest point moves over its surface.
    """
    world, count = alone(SHAPES[name], 0.8), 64
    state = released(world, above(count, np.linspace(-0.04, 0.03, count)))
    state = dataclasses.replace(state, orientation=jnp.asarray(random_turns(count)))
    depth = np.maximum(-lowest_points(world, state)[2].min(0), 0.0)
    states, _ = record(world, state, 480)
    mass, inertia = world.tree.mass.sum(), np.asarray(world.tree.inertia)[:3, :3, 0]
    rotation = np.asarray(quaternion_to_matrix(jnp.moveaxis(states.orientation, 1, 0)))
    spin, velocity = np.split(np.asarray(states.velocity), 2, axis=1)
    own = np.einsum("xyt...,tx...->yt...", rotation, spin)
    energy = 0.5 * np.einsum("xt...,xy,yt...->t...", own, inertia, own)
    energy += 0.5 * mass * (velocity**2).sum(1)
    energy += mass * GRAVITY * (np.asarray(states.position)[:, 2] - np.asarray(state.position)[2])
    speed = 1.0 if name == "ellipsoid" else 0.5
    assert depth.max() > 0.1
    assert (energy.max(0) - mass * GRAVITY * depth).max() < 0.5 * mass * speed**2


@pytest.mark.parametrize("name", SHAPES)
def test_the_lowest_contact_point_is_the_support_point(name):
    """The lowest contact point is the shape's support point, for any orientation.

    Four corners of a box are points. The others are higher by at least a third of its height.
    """
    shape, count = SHAPES[name], 300
    world = alone(shape)
    turns = random_turns(count)
    state = dataclasses.replace(released(world, above(count, 0.3)), orientation=jnp.asarray(turns))
    places = lowest_points(world, state)
    rotations = np.asarray(quaternion_to_matrix(jnp.asarray(turns)))
    half = shape.half_extents
    corners = np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3) * half
    for n in range(count):
        rotation, ours = rotations[:, :, n], places[:, :, n].T - np.array([0, 0, 0.3])
        lowest = rotation @ shape.support(-rotation[2])
        np.testing.assert_allclose(ours[ours[:, 2].argmin()], lowest, atol=1e-12)
        if name == "box":
            every = corners @ rotation.T
            distance = np.linalg.norm(every[:, None] - ours[None], axis=-1).min(1)
            chosen = distance < 1e-12
            assert chosen.sum() == 4
            height = every[:, 2] - every[:, 2].min()
            assert height[~chosen].min() >= height.max() / 3 - 1e-12


def test_tangents_are_perpendicular_for_any_normal():
    """The normals of a ceiling, downwards and nearly downwards, are included."""
    rng = np.random.default_rng(0)
    normal = np.concatenate([rng.normal(size=(3, 40)), [[0.0], [0.0], [-1.0]]], 1)
    normal[:2, :20] *= 0.1
    normal /= np.linalg.norm(normal, axis=0)
    world = alone(SHAPES["sphere"])
    kin, model = kinematics(world.tree, released(world, np.zeros((3, 1)))), world.contact_model

    @jax.vmap
    def frame_on(normal):
        ground = dataclasses.replace(model.ground, floor=Plane(tuple(normal)))
        return find_contacts(model._replace(ground=ground), kin, H).frame[:, :, 0, 0]

    frame = np.moveaxis(quick_jit(frame_on)(normal.T), 0, -1)
    np.testing.assert_allclose(frame[2], normal, atol=1e-6)
    product = np.einsum("ikp,jkp->pij", frame, frame)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-5)
