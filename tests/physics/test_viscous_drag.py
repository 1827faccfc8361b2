"""Drag with a viscosity against measured coefficients, closed forms and theories of swimming."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import (
    STRUCTURES,
    box_chain,
    coast,
    hinge,
    quick_jit,
    random_creature,
    resting,
    single,
    slope,
    surfaces_of,
    whole,
)
from evo_cpg.creature.creature import Actuator, Body, Creature, Material
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.physics.water.buoyancy import make_cells
from evo_cpg.physics.water.viscous_bodies import ellipsoid_resistance, make_viscous_drag
from evo_cpg.physics.water.viscous_drag import ViscousDrag
from evo_cpg.physics.water.water import Current, Water
from measured_water import CYLINDER, FRICTION, PLATE, SPHERE

WATER, VISCOSITY, GRAVITY = 1000.0, 1e-3, 9.81
# Diameter or thickness of the shapes, m.
D = 0.1
FRONT = np.pi / 4 * D**2
_COLUMNS = 12


def in_viscous_water(
    creature: Creature,
    viscosity: float = VISCOSITY,
    resolution: int = 2,
    surface: float | None = None,
    gravity: float = 0.0,
    current: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> World:
    """A creature under water, with the default number of points."""
    tree = build_tree(creature)
    form, skin = surfaces_of(creature, resolution, max(1, resolution // 2))
    law = make_viscous_drag(creature, tree, form, skin, viscosity, surfacing=surface is not None)
    return World(
        tree,
        gravity,
        Water(WATER, surface, (Current(current),)),
        (law,),
        cells=() if surface is None else make_cells(creature, tree),
    )


def capsule_chain(count: int, length: float, radius: float, motor: Actuator | None = None):
    """Capsules in a row along -x that together have the outline of one capsule."""
    one = (length - 2 * radius) / count
    bodies = []
    for i in range(count):
        ends = (-one / 2, 0.0, 0.0), (one / 2, 0.0, 0.0)
        joint = hinge(f"b{i - 1}", *ends, limit=2.0, actuator=motor)
        bodies.append(Body(f"b{i}", Capsule(radius, one), Material(WATER), joint if i else None))
    return Creature("capsules", tuple(bodies))


def moving(world: World, velocity: np.ndarray):
    """The bodies at velocities ``(6, b, n)``, in the straight pose."""
    state = resting_state(world.tree, velocity.shape[2:], jnp.float64)
    bodies = world.bodies(kinematics(world.tree, state), 0.01)
    return bodies.moving(jnp.asarray(velocity, jnp.float64))


def wrench(world: World, velocity: np.ndarray) -> np.ndarray:
    """Wrench on every body at velocities ``(6, b, n)``."""
    law = law_of(world)
    return np.asarray(quick_jit(lambda v: law.wrench(moving(world, v)))(velocity))


def law_of(world: World) -> ViscousDrag:
    law = world.law(ViscousDrag)
    assert law is not None
    return law


def force(world: World, velocity: np.ndarray) -> np.ndarray:
    """Force (N) on a whole creature in translation at velocities ``(n, 3)``.

    Equal array sizes save compilations.
    """
    every = np.zeros((6, world.tree.body_count, max(_COLUMNS, len(velocity))))
    every[3:, :, : len(velocity)] = velocity.T[:, None]
    if world.tree.body_count > 1:
        found = wrench(world, every)
    else:
        # All single bodies share the programs of single operations.
        found = np.asarray(law_of(world).wrench(moving(world, every)))
    return found[3:, :, : len(velocity)].sum(1).T


def coefficients(world: World, direction: int, reynolds, length: float, area: float) -> np.ndarray:
    """Drag coefficients along an axis at Reynolds numbers on a length."""
    speed = np.asarray(reynolds, float) * VISCOSITY / (WATER * length)
    found = force(world, speed[:, None] * np.eye(3)[direction])
    return -found[:, direction] / (0.5 * WATER * speed**2 * area)


@pytest.mark.slow
@pytest.mark.parametrize("resolution", [2, 4])
def test_sphere_follows_the_standard_curve(resolution):
    """Clift, Grace and Weber 1978, within 15 % from Re 1 and 12 % from Re 100 to 1e5."""
    reynolds, measured = np.transpose(SPHERE)
    world = in_viscous_water(single(Sphere(D / 2)), resolution=resolution)
    found = coefficients(world, 0, reynolds, D, FRONT)
    np.testing.assert_allclose(found[:4], measured[:4], rtol=0.15)
    np.testing.assert_allclose(found[4:], measured[4:], rtol=0.12)


@pytest.mark.slow
def test_long_capsule_follows_the_long_cylinder():
    """Wieselsberger 1922 across the flow, within 15 % from Re 64 to 1.1e5."""
    reynolds, measured = np.transpose([pair for pair in CYLINDER if pair[0] >= 64])
    slender = 60
    world = in_viscous_water(single(Capsule(D / 2, (slender - 1) * D)))
    found = coefficients(world, 1, reynolds, D, slender * D**2)
    np.testing.assert_allclose(found, measured, rtol=0.12)


@pytest.mark.parametrize(("slender", "measured"), [(5, 0.74), (10, 0.82), (20, 0.93)])
@pytest.mark.slow
def test_short_capsule_has_less_drag_across(slender, measured):
    """Cylinders with free ends at Re 1e5 (data book)."""
    world = in_viscous_water(single(Capsule(D / 2, (slender - 1) * D)))
    found = coefficients(world, 1, [1e5], D, slender * D**2)
    np.testing.assert_allclose(found, measured, rtol=0.15)


@pytest.mark.parametrize(("slender", "measured"), [(1, 0.47), (2, 0.27), (4, 0.22), (8, 0.20)])
def test_ellipsoid_along_its_axis_is_streamlined(slender, measured):
    """Laminar separation at Re 1e5 on the length. Sources have 0.19 to 0.25 for 4:1."""
    world = in_viscous_water(single(Ellipsoid((slender * D / 2, D / 2, D / 2))))
    found = coefficients(world, 0, [1e5 / slender], D, FRONT)
    np.testing.assert_allclose(found, measured, rtol=0.25)


@pytest.mark.parametrize(
    ("size", "measured"),
    [
        ((1, 1, 1), 1.05),
        ((0.01, 1, 1), 1.17),
        ((0.01, 1, 5), 1.2),
        ((0.01, 10, 1), 1.3),
        ((0.01, 1, 20), 1.5),
        ((0.01, 500, 1), 1.98),
        ((1, 1, 500), 2.05),
        ((4, 1, 1), 0.85),
    ],
)
def test_boxes_and_plates_have_the_drag_of_their_shape(size, measured):
    """Cube, plates across the flow, long bar across, and rod along the flow at Re 1e5."""
    world = in_viscous_water(single(Box(tuple(D * x for x in size))))
    found = coefficients(world, 0, [1e5], D, size[1] * size[2] * D**2)
    np.testing.assert_allclose(found, measured, rtol=0.12)


@pytest.mark.parametrize("thickness", [0.02, 0.1])
def test_thin_ellipsoid_has_the_drag_of_a_disc(thickness):
    """1.17 face on (NACA TR 513) within 25 %. The few points of an edge do not add to it.

    Edge on, friction is that of its two faces: that of a plate with the mean chord.
    """
    disc = single(Ellipsoid((thickness * D / 2, D / 2, D / 2)))
    coarse, fine = (in_viscous_water(disc, resolution=n) for n in (2, 8))
    face = [coefficients(world, 0, [1e5], D, FRONT)[0] for world in (coarse, fine)]
    np.testing.assert_allclose(face, 1.17, rtol=0.25)
    np.testing.assert_allclose(*face, rtol=0.11)
    edge = [coefficients(world, 1, [1e5], D, FRONT)[0] for world in (coarse, fine)]
    assert min(edge) > 2 * 0.0042 and max(edge) < 2 * 0.0042 + 0.5 * thickness


def test_plate_across_the_flow_at_every_reynolds_number():
    """Hoerner: 23 to 1.17 at Re 1 to 1e4. The hump at Re 1e3 is missing."""
    world = in_viscous_water(single(Box((0.01 * D, D, D))))
    reynolds, measured = np.transpose(PLATE)
    found = coefficients(world, 0, reynolds, D, D * D)
    np.testing.assert_allclose(found, measured, rtol=0.25)


@pytest.mark.parametrize(
    ("slender", "along", "across"),
    [(1, 1, 1), (2, 0.602, 0.689), (4, 0.400, 0.514), (8, 0.289, 0.407), (10, 0.265, 0.381)],
)
def test_creeping_flow_around_a_spheroid(slender, along, across):
    """Force over 6 pi mu a U (Chwang and Wu 1975) at Re 0.01 on the length."""
    a = slender * D / 2
    world = in_viscous_water(single(Ellipsoid((a, D / 2, D / 2))))
    speed = 0.01 * VISCOSITY / (WATER * 2 * a)
    found = -force(world, speed * np.eye(3))[[0, 1, 2], [0, 1, 2]]
    expected = 6 * np.pi * VISCOSITY * a * speed * np.array([along, across, across])
    np.testing.assert_allclose(found, expected, rtol=0.01)


def test_resistance_of_ellipsoids_is_exact():
    """Prolate spheroids in closed form, a disc (32/3 and 16 times mu a), a turning sphere."""
    for slender in (1.5, 4.0, 14.3, 100.0):
        e = np.sqrt(1 - 1 / slender**2)
        log = np.log((1 + e) / (1 - e))
        along = 6 * np.pi * 8 / 3 * e**3 / ((1 + e**2) * log - 2 * e)
        across = 6 * np.pi * 16 / 3 * e**3 / ((3 * e**2 - 1) * log + 2 * e)
        found, _ = ellipsoid_resistance(np.array([1.0, 1 / slender, 1 / slender]))
        np.testing.assert_allclose(found, [along, across, across], rtol=1e-6)
    _, torque = ellipsoid_resistance(np.full(3, 0.7))
    np.testing.assert_allclose(torque, 8 * np.pi * 0.7**3, rtol=1e-6)
    force_of_disc, _ = ellipsoid_resistance(np.array([1.0, 1.0, 1e-4]))
    np.testing.assert_allclose(force_of_disc, [32 / 3, 32 / 3, 16], rtol=1e-3)


def test_turning_sphere_in_creeping_flow():
    """A torque of 8 pi mu a^3 w."""
    world = in_viscous_water(single(Sphere(D / 2)), viscosity=10.0)
    velocity = np.zeros((6, 1, _COLUMNS))
    velocity[:3, 0, :3] = 1e-3 * np.eye(3)
    found = np.asarray(law_of(world).wrench(moving(world, velocity)))[:3, 0, :3]
    torque = -8 * np.pi * 10.0 * (D / 2) ** 3 * 1e-3
    np.testing.assert_allclose(found, torque * np.eye(3), rtol=0.01, atol=1e-12)


@pytest.mark.parametrize(("reynolds", "mean"), [pair for pair in FRICTION if pair[0] != 1e6])
def test_friction_of_a_plate_along_the_flow(reynolds, mean):
    """Blasius; turbulent with a transition at 5e5. The edge and creeping flow are left out."""
    plate = in_viscous_water(single(Box((1.0, 1e-4, 1.0))))
    edge, creep = 1.98 * 1e-4 / 2, 8 / reynolds
    found = coefficients(plate, 0, [reynolds], 1.0, 2.0) - edge - creep
    np.testing.assert_allclose(found, mean, rtol=0.15)


def test_friction_grows_along_a_chain_from_the_nose():
    """A plate of ten segments has the transition of one plate, 0.0028 at Re 1e6 (S8)."""
    plates = box_chain(10, "z", size=(0.0999, 1e-5, 1.0), gap=1e-4)
    world = in_viscous_water(plates)
    velocity = np.zeros((6, 10, 2))
    velocity[3] = [1.0, -1.0]
    found = -wrench(world, velocity)[3] / 1000.0
    np.testing.assert_allclose(np.abs(found.sum(0)), 0.0028, rtol=0.15)
    # The boundary layer is thin at the nose, which is at the other end when it swims backwards.
    assert found[0, 0] > 1.5 * found[3, 0]
    np.testing.assert_allclose(found[:, 1], -found[::-1, 0], rtol=1e-6)


@pytest.mark.slow
def test_no_jumps_from_creeping_flow_to_turbulence():
    """The slope of log C over log Re changes smoothly from -1 to 0 for every kind of body."""
    reynolds = np.geomspace(1e-2, 1e6, 801)
    shapes = (Capsule(D / 2, 9 * D), Box((4 * D, D, 0.02 * D)))
    for shape in shapes:
        world = in_viscous_water(single(shape))
        for direction in range(3):
            log = np.log(coefficients(world, direction, reynolds, D, FRONT))
            slope = np.diff(log) / np.diff(np.log(reynolds))
            assert slope.min() > -1.001 and slope.max() < 0.7
            assert np.abs(np.diff(slope)).max() < 0.05


@pytest.mark.slow
def test_no_jumps_between_shapes():
    """Plate, cube and bar; disc, sphere, ellipsoid: C changes by less than twice the size."""
    sizes = np.geomspace(0.02, 50.0, 24)
    largest = np.log(sizes[1] / sizes[0])
    families = (
        lambda x: Box((x * D, D, D)),
        lambda x: Box((D, x * D, D)),
        lambda x: Ellipsoid((x * D / 2, D / 2, D / 2)),
        lambda x: Capsule(D / 2, x * D),
    )
    for family in families:
        # The areas grow with two sizes at most.
        worlds = [in_viscous_water(single(family(x))) for x in sizes]
        for velocity in np.eye(3):
            log = np.log([-force(world, velocity[None])[0] @ velocity for world in worlds])
            assert np.abs(np.diff(log)).max() < 2 * largest


@pytest.mark.parametrize("direction", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_chain_has_the_drag_of_one_body(direction):
    """Fourteen capsules or boxes and one of their outline, within 10 % at any speed."""
    pairs = (
        (capsule_chain(14, 1.5, 0.05), Capsule(0.05, 1.4)),
        (box_chain(14, "z", gap=0.002), Box((14 * 0.2 + 13 * 0.002, 0.1, 0.1))),
    )
    speeds = np.array([1e-4, 1e-2, 0.1, 0.3, 1.0])[:, None] * np.eye(3)[direction]
    for chain, shape in pairs:
        found = force(in_viscous_water(chain), speeds)[:, direction]
        expected = force(in_viscous_water(single(shape)), speeds)[:, direction]
        np.testing.assert_allclose(found, expected, rtol=0.1)


@pytest.fixture(scope="module")
def anything():
    """A random creature's world, and bodies at random velocities of 1e-5 to 10 m/s."""
    with jax.enable_x64(True):
        rng = np.random.default_rng(2)
        world = in_viscous_water(random_creature(rng, STRUCTURES[0]))
        velocity = rng.normal(size=(6, world.tree.body_count, 40))
        velocity *= 10.0 ** rng.uniform(-5, 1, (1, 1, 40))
        yield world, velocity


def test_drag_never_drives(anything):
    """Drag takes energy out of any motion relative to the water, and D only damps."""
    world, velocity = anything
    law = law_of(world)
    part = quick_jit(lambda v: law.parts(moving(world, v))[0])(velocity)
    assert float((part.wrench * velocity).sum(0).max()) < 0
    matrices = np.moveaxis(whole(part.resistance), (0, 1), (2, 3))
    np.testing.assert_allclose(matrices, matrices.swapaxes(2, 3), atol=1e-12)
    assert np.linalg.eigvalsh(matrices).min() > -1e-12


@pytest.mark.slow
def test_derivative_equals_finite_differences(anything):
    world, velocity = anything
    velocity = velocity / np.abs(velocity).max((0, 1))
    law = law_of(world)
    wrench = quick_jit(lambda v: law.wrench(moving(world, v)))
    found = np.asarray(quick_jit(lambda v: law.derivative(moving(world, v)))(velocity))
    for column in range(6):
        expected = slope(wrench, velocity, 1e-6 * (np.arange(6) == column)[:, None, None])
        error, size = (np.abs(x).max((0, 1)) for x in (found[:, column] - expected, expected))
        # A point whose normal velocity changes its sign has a kink.
        assert np.median(error / size) < 1e-8
        assert (error < 1e-6 * size).mean() > 0.9


def test_a_current_is_the_opposite_motion():
    creature = single(Box((0.3, 0.2, 0.1)))
    turned = np.random.default_rng(6).normal(size=(4, _COLUMNS))
    turned /= np.linalg.norm(turned, axis=0)
    state = resting(build_tree(creature), (_COLUMNS,), orientation=turned)
    current = (0.3, -0.2, 0.1)

    def world_force(world: World, motion: tuple[float, ...]) -> np.ndarray:
        velocity = jnp.zeros((6, _COLUMNS)).at[3:].set(jnp.array(motion)[:, None])
        kin = kinematics(world.tree, dataclasses.replace(state, velocity=velocity))
        found = law_of(world).wrench(world.bodies(kin, 0.01))[3:]
        return np.einsum("ijbn,jbn->ibn", kin.rotation, found)

    found = world_force(in_viscous_water(creature, current=current), (0.0, 0.0, 0.0))
    expected = world_force(in_viscous_water(creature), tuple(-x for x in current))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert np.ptp(found, axis=2).max() > 0.1


@pytest.mark.slow
def test_drag_at_a_surface_is_that_of_the_part_under_water():
    """Deep below it nothing changes, above it there is none, and half of a level body has half."""
    shape, velocity = Capsule(0.05, 0.3), np.array([[0.5, 0.0, 0.0], [0.0, 0.4, 0.0]])
    deep = force(in_viscous_water(single(shape)), velocity)
    for height, fraction in ((50.0, 1.0), (-50.0, 0.0), (0.0, 0.5)):
        found = force(in_viscous_water(single(shape), surface=height), velocity)
        np.testing.assert_allclose(found, fraction * deep, rtol=1e-9, atol=1e-12)


def fall(shape: Shape, density: float, viscosity: float, seconds: float, h: float) -> np.ndarray:
    """Downward speeds (m/s) of a body that is released at rest."""
    world = in_viscous_water(single(shape, density), viscosity, gravity=GRAVITY)
    start = resting_state(world.tree, dtype=jnp.float64)
    return -coast(world, start, seconds, h).velocity[:, 5]


@pytest.mark.parametrize("viscosity", [100.0, 0.5, 0.003])
def test_terminal_speed_of_a_sphere(viscosity):
    """Clift and Gauvin 1970 at Re of 0.1, 300 and 1e5."""

    def drag(speed: float) -> float:
        re = WATER * speed * D / viscosity
        c = 24 / re * (1 + 0.152 * re**0.677) + 0.417 / (1 + 5070 * re**-0.94)
        return 0.5 * WATER * speed**2 * FRONT * c

    weight = 500.0 * Sphere(D / 2).volume * GRAVITY
    low, high = 1e-4, 100.0
    while high / low > 1.0001:
        middle = np.sqrt(low * high)
        low, high = (low, middle) if drag(middle) > weight else (middle, high)
    found = fall(Sphere(D / 2), 1500.0, viscosity, 4.0, 1 / 60)[-1]
    assert found == pytest.approx(low, rel=0.06)


@pytest.mark.slow
def test_order_of_the_step():
    """Second order at any Reynolds number (here 1e5, 1e3 and 1e-3)."""
    world = in_viscous_water(single(Sphere(D / 2)))
    rest = jnp.zeros(0)

    def end(viscosity, speed, steps):
        changed = eqx.tree_at(lambda w: w.law(ViscousDrag).viscosity, world, viscosity)
        state = resting(world.tree, velocity=jnp.array([0, 0, 0, speed, 0, 0]))
        h = 0.2 / steps
        return jax.lax.fori_loop(
            0, steps, lambda _, s: step(changed, s, rest, h)[0], state
        ).velocity[3]

    coarse, middle, fine = (
        quick_jit(functools.partial(end, steps=steps)) for steps in (16, 32, 2048)
    )
    for viscosity, speed in ((1e-3, 1.0), (0.1, 1.0), (10.0, 1e-4)):
        exact = fine(viscosity, speed)
        errors = [abs(float(found(viscosity, speed) - exact)) for found in (coarse, middle)]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.25)


@pytest.mark.slow
def test_gradient_by_viscosity_equals_finite_differences():
    """Swimming distance of a short chain, in double precision."""
    world = in_viscous_water(box_chain(3, "z", Actuator(5.0)), viscosity=0.1)
    h = 1 / 120

    def swim(viscosity):
        changed = eqx.tree_at(lambda w: w.law(ViscousDrag).viscosity, world, viscosity)

        def advance(state, n):
            target = 3.0 * jnp.sin(9.0 * n * h - jnp.arange(2.0))
            return step(changed, state, target, h)[0], None

        start = resting_state(world.tree, dtype=jnp.float64)
        return jax.lax.scan(advance, start, jnp.arange(40))[0].position @ jnp.array([1.0, 0.3, 0.1])

    value, gradient = map(float, quick_jit(jax.value_and_grad(swim))(0.1))
    expected = float(slope(quick_jit(swim), 0.1, 1e-5))
    assert abs(value) > 1e-4
    assert gradient == pytest.approx(expected, rel=1e-6)


# Links, wavelengths per length, and bending angle (rad) of a swimming worm.
_LINKS, _WAVES, _BEND = 16, 1.5, 0.25


def worm_angles(time, lib):
    """Joint angles (rad): a wave from head to tail that grows over half a second."""
    u = lib.clip(2 * time, 0.0, 1.0)
    joints = lib.arange(_LINKS - 1)
    phase = 2 * np.pi * (time - _WAVES * (joints + 1) / _LINKS)
    return _BEND * u * u * (3 - 2 * u) * lib.sin(phase)


def resistive_worm(length: float, slender: float, seconds: float) -> np.ndarray:
    """Path of the head of a worm without inertia, by resistive-force theory (Gray-Hancock 1955).

    Forces per length are those of a spheroid. The velocity of the head leaves no force and moment.
    """
    one, pieces, h = length / _LINKS, 8, 0.005
    e = np.sqrt(1 - 1 / slender**2)
    log = np.log((1 + e) / (1 - e))
    along = 3 * np.pi * 8 / 3 * e**3 / ((1 + e**2) * log - 2 * e)
    across = 3 * np.pi * 16 / 3 * e**3 / ((3 * e**2 - 1) * log + 2 * e)

    def shape(time: float, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turns = place[2] + np.concatenate([[0.0], np.cumsum(worm_angles(time, np))])
        back = -np.stack([np.cos(turns), np.sin(turns)], 1)
        starts = np.concatenate([[[0.0, 0.0]], np.cumsum(one * back, 0)[:-1]])
        fractions = (np.arange(pieces) + 0.5) / pieces
        points = place[:2] + starts[:, None] + one * fractions[:, None] * back[:, None]
        return points.reshape(-1, 2), np.repeat(back, pieces, 0)

    def velocity(time: float, place: np.ndarray) -> np.ndarray:
        points, tangents = shape(time, place)
        change = 1e-5
        bending = (shape(time + change, place)[0] - shape(time - change, place)[0]) / (2 * change)
        resist = across * np.eye(2) + (along - across) * np.einsum("pi,pj->pij", tangents, tangents)
        arm = points - place[:2]
        moves = np.zeros((len(points), 2, 3))
        moves[:, :, :2], moves[:, 0, 2], moves[:, 1, 2] = np.eye(2), -arm[:, 1], arm[:, 0]
        whole = np.einsum("pji,pjk,pkl->il", moves, resist, moves)
        return -np.linalg.solve(whole, np.einsum("pji,pjk,pk->i", moves, resist, bending))

    place, path = np.zeros(3), []
    for n in range(round(seconds / h)):
        half = place + 0.5 * h * velocity(n * h, place)
        place = place + h * velocity((n + 0.5) * h, half)
        path.append(place[:2])
    return np.array(path)


@pytest.mark.slow
def test_worm_swims_as_in_resistive_force_theory():
    """A worm of 1:14.3 with ``rho f L^2 / mu = 2``, as C. elegans in water: within 10 %."""
    length, slender, seconds, h = 1.0, 14.3, 4.0, 1 / 240
    creature = capsule_chain(_LINKS, length, length / slender / 2, Actuator(1e6))
    world = in_viscous_water(creature, viscosity=500.0)

    def advance(state, n):
        now, ahead = worm_angles(n * h, jnp), worm_angles((n + 1) * h, jnp)
        state, _ = step(world, state, (ahead - now) / h + 30.0 * (now - state.q), h)
        return state, (state.position[:2], state.q)

    start = resting_state(world.tree, dtype=jnp.float64)
    steps = jnp.arange(round(seconds / h))
    path, angles = map(np.asarray, quick_jit(lambda s: jax.lax.scan(advance, s, steps)[1])(start))
    assert np.abs(angles[-1] - worm_angles(seconds, np)).max() < 0.02
    expected = resistive_worm(length, slender, seconds)
    found = np.linalg.norm(path[-1] - path[-1 - round(2 / h)]) / 2
    theory = np.linalg.norm(expected[-1] - expected[-1 - round(2 / 0.005)]) / 2
    assert found == pytest.approx(theory, rel=0.1), (found, theory)
    assert 0.02 < theory < 0.3
