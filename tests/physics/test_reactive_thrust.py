"""Reactive thrust against Lighthill's elongated-body theory, momentum, energy and Galileo."""

import dataclasses
import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.mujoco_model import mujoco_model
from creatures import (
    box_chain,
    hinge,
    in_water,
    mujocos_accelerations,
    quick_jit,
    random_state,
    resting,
    whole,
)
from elongated_body import Plate
from evo_cpg.creature.algebra.linear import cross, expand_dims_like, matvec
from evo_cpg.creature.algebra.rotation import integrate_quaternion, quaternion_to_matrix
from evo_cpg.creature.creature import Actuator, Body, Creature, Material
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid
from evo_cpg.physics.step.equations import body_equations
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.kinematics import kinematics, motion_of_bodies
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.physics.water.added_mass import AddedMass
from evo_cpg.physics.water.fluid import Drag
from evo_cpg.physics.water.force_law import buoyancy_alone, in_body_axes
from evo_cpg.physics.water.reactive_thrust import ReactiveThrust

WATER, GRAVITY = 1000.0, 9.81
LENGTH, HEIGHT, THICKNESS = 1.0, 0.1, 0.01
GROWING, CONSTANT = (lambda x: 0.1 + 0.9 * x * x), np.ones_like
# Swimming speeds over the speed of the wave, and instants of a period.
SPEEDS, PHASES = (0.3, 0.5, 0.7, 0.9), 24


def eel(segments: int, motor: Actuator | None = None, axes: str = "z") -> Creature:
    """A plate of 1 m x 0.1 m in segments."""
    size = (LENGTH / segments, THICKNESS, HEIGHT)
    return box_chain(segments, axes, motor, size, gap=0.0, limit=1.5)


def ideal(creature: Creature, **water) -> World:
    """A creature in water without friction and weight, with reactive thrust."""
    return in_water(creature, 1, 0.0, form_drag=0.0, skin_drag=0.0, reactive_thrust=True, **water)


def moving(tree, motion, time) -> State:
    """The state of a prescribed motion: position, quaternion and angles as functions of time."""
    (position, turn, q), (velocity, change, qd) = jax.jvp(motion, (time,), (jnp.ones(()),))
    size = jnp.sqrt((turn * turn).sum())
    w, x, y, z = turn / size
    dw, dx, dy, dz = change / size
    spin = 2 * jnp.stack(
        [
            w * dx - x * dw + y * dz - z * dy,
            w * dy - y * dw + z * dx - x * dz,
            w * dz - z * dw + x * dy - y * dx,
        ]
    )
    return State(position, turn / size, jnp.concatenate([spin, velocity]), q, qd)


def water_on(world: World, motion, time, change: float = 1e-4):
    """The force of the water on a moving animal, and its moment about the origin of the world."""
    shifted = (time - change / 2, time, time + change / 2)
    first, middle, last = (
        world.bodies(kinematics(world.tree, moving(world.tree, motion, t)), change) for t in shifted
    )
    wrench = sum(law.over_step(first, middle, last) for law in world.forces)
    turn = middle.kin.rotation
    moment, force = (jnp.einsum("ijb,jb->ib", turn, x) for x in (wrench[:3], wrench[3:]))
    about = moment + jnp.cross(middle.kin.origin, force, axis=0)
    return jnp.concatenate([about.sum(1), force.sum(1)])


def tumbling(time):
    """A smooth motion of a straight chain of three bodies in space, which runs forwards."""
    turn = jnp.array([1.0, 0.1, -0.2, 0.3]) + time * jnp.array([0.1, 0.4, 0.5, -0.3])
    place = jnp.array([1.5, 0.3, -0.2]) * time + jnp.array([0.1, 0.2, -0.3]) * time**2
    return place, turn, jnp.zeros(2)


def test_a_rigid_chain_feels_lighthills_force_and_moment():
    """The integral of ``-dp/dt + d/da (u p - 1/2 (w . p) t)``, with p = 0 before the nose.

    Its moment about the origin is ``int r x f da - int w x p da``: the last term is the moment of a
    section about its own centre, which Kirchhoff's equations add. The integrals and the derivative
    by time are computed along the centreline, without the inertia of a body.
    """
    size = (0.2, 0.05, 0.1)
    world = ideal(box_chain(3, "z", None, size, 0.0))
    law = world.law(ReactiveThrust)
    assert law.bodies == (0, 2)
    masses, axes = law.edges.masses[:, 1], law.edges.directions[..., 1]
    nodes, weights = np.polynomial.legendre.leggauss(5)
    places, weights = -0.2 + 0.3 * nodes, 0.3 * weights

    def along(time):
        """Position, tangent, velocity and momentum per length of points along the centreline."""
        place, turn, _ = tumbling(time)
        rotation = quaternion_to_matrix(turn / jnp.sqrt((turn * turn).sum()))
        state = moving(world.tree, tumbling, time)
        arms = rotation[:, :1] * jnp.append(places, -0.5)[None]
        velocity = state.velocity[3:, None] + jnp.cross(state.velocity[:3, None], arms, axis=0)
        across = rotation @ axes
        momentum = across @ (masses[:, None] * (across.T @ velocity))
        return place[:, None] + arms, rotation[:, 0], velocity, momentum

    @quick_jit
    def expected(time):
        (r, t, v, p), (_, _, _, dp) = jax.jvp(along, (time,), (jnp.ones(()),))
        u = t @ v
        w = v - t[:, None] * u[None]
        flux = u[None] * p - 0.5 * (w * p).sum(0)[None] * t[:, None]
        force = -(dp[:, :-1] @ weights) - flux[:, -1]
        # By parts: int r x d flux/da = [r x flux] - int t x flux.
        inside = -jnp.cross(r, dp, axis=0) - jnp.cross(t[:, None], flux, axis=0)
        inside = inside - jnp.cross(w, p, axis=0)
        moment = inside[:, :-1] @ weights - jnp.cross(r[:, -1], flux[:, -1])
        return jnp.concatenate([moment, force]), u[-1]

    time = jnp.array(0.3)
    forces, along_tail = expected(time)
    found = quick_jit(lambda time: water_on(world, tumbling, time))(time)
    assert float(along_tail) > 1.0 and np.abs(forces).min() > 0.02
    np.testing.assert_allclose(found, forces, rtol=1e-6, atol=1e-6 * np.abs(forces).max())


def waving(segments: int, envelope, amplitude: float):
    """A plate held at a speed along x, whose midline is a wave of 1 Hz and 1 m.

    Returns a function of the speed that returns a motion.
    """
    x = np.linspace(0.0, LENGTH, segments + 1)
    size = amplitude * envelope(x)

    def motion(speed, time):
        height = size * jnp.sin(2 * jnp.pi * (x - time))
        heading = -jnp.arctan(jnp.diff(height) * segments / LENGTH)
        cosine, sine = jnp.cos(heading[0]), jnp.sin(heading[0])
        half, none = LENGTH / segments / 2, jnp.zeros(())
        place = jnp.stack([speed * time - half * cosine, height[0] - half * sine, none])
        turn = jnp.stack([jnp.cos(heading[0] / 2), none, none, jnp.sin(heading[0] / 2)])
        return place, turn, jnp.diff(heading)

    return lambda speed: functools.partial(motion, speed)


@functools.cache
def held_thrust(segments: int, envelope, amplitude: float = 0.05) -> np.ndarray:
    """Mean force along x over a period at `SPEEDS`, over that of elongated-body theory."""
    world, motion = ideal(eel(segments)), waving(segments, envelope, amplitude)

    @quick_jit
    def forces(speeds):
        def at(case):
            return water_on(world, motion(case[0]), case[1])[3]

        times = jnp.arange(PHASES) / PHASES
        grid = jnp.stack(jnp.broadcast_arrays(speeds[:, None], times[None]), -1)
        return jax.lax.map(at, grid.reshape(-1, 2)).reshape(grid.shape[:2])

    theory = plate(envelope, amplitude)
    expected = [theory.thrust(speed, recoil=False) for speed in SPEEDS]
    return np.asarray(forces(jnp.array(SPEEDS)).mean(1)) / expected


def plate(envelope, amplitude: float) -> Plate:
    """The plate of elongated-body theory."""
    masses = ideal(eel(3)).law(ReactiveThrust).edges.masses
    own = WATER * HEIGHT * THICKNESS
    return Plate(lambda x: amplitude * envelope(x), 1.0, 1.0, own, float(masses[0, 1]))


@pytest.mark.slow
def test_thrust_of_a_held_plate():
    """Elongated-body theory for a wave of 1 m/s and 0.05 m, at 0.3 to 0.9 of its speed: 1 %."""
    np.testing.assert_allclose(held_thrust(20, CONSTANT), 1.0, atol=0.02)


@pytest.mark.slow
def test_thrust_of_a_held_plate_with_a_growing_wave():
    """5 % with 40 segments; with U/V = 0.9 thrust is an eighth of its two parts."""
    np.testing.assert_allclose(held_thrust(40, GROWING), 1.0, atol=0.06)


@pytest.mark.slow
def test_held_thrust_converges_with_the_segments():
    """In second order, and in first order if the wave grows at the tail, whose end is straight."""
    for envelope, order in ((CONSTANT, 2.0), (GROWING, 1.0)):
        thrust = [held_thrust(n, envelope) for n in (10, 20, 40)]
        ratio = (thrust[0] - thrust[1]) / (thrust[1] - thrust[2])
        assert np.abs(np.log2(ratio) - order).max() < 0.25, ratio


FRICTION = 0.02
WAVES = tuple((envelope, size) for envelope in (GROWING, CONSTANT) for size in (0.02, 0.05, 0.1))


class Swim(NamedTuple):
    """Mean speeds over two periods, m/s, and mean powers, W, of free plates with `WAVES`."""

    speed: np.ndarray
    motors: np.ndarray
    friction: np.ndarray
    wake: np.ndarray


@functools.cache
def swim(segments: int, h: float, seconds: float = 12.0) -> Swim:
    """Free plates that servos bend."""
    world = in_water(
        eel(segments, Actuator(1e3)),
        1,
        0.0,
        form_drag=0.0,
        skin_drag=FRICTION,
        reactive_thrust=True,
    )
    x = np.linspace(0.0, LENGTH, segments + 1)
    midlines = [size * envelope(x) * np.exp(-2j * np.pi * x) for envelope, size in WAVES]
    slopes = jnp.asarray(np.diff(np.stack(midlines, -1), axis=0) * segments / LENGTH)

    def angles(time):
        u = jnp.clip(time / 2, 0.0, 1.0)
        wave = (slopes * jnp.exp(2j * jnp.pi * time)).real
        return -jnp.diff(jnp.arctan(u * u * (3 - 2 * u) * wave), axis=0)

    def power(law, before, after):
        mean = dataclasses.replace(
            before, velocity=(before.velocity + after.velocity) / 2, qd=(before.qd + after.qd) / 2
        )
        bodies = world.bodies(kinematics(world.tree, mean), h)
        return (world.law(law).wrench(bodies) * bodies.velocity).sum((0, 1))

    def advance(state, n):
        now, ahead = angles(n * h), angles((n + 1) * h)
        after, effort = step(world, state, (ahead - now) / h + 30.0 * (now - state.q), h)
        motors = (effort.torque * (state.qd + after.qd) / 2).sum(0)
        powers = motors, power(Drag, state, after), power(ReactiveThrust, state, after)
        return after, (state.position, *powers)

    start = resting_state(world.tree, (len(WAVES),), jnp.float64)
    steps = jnp.arange(round(seconds / h) + 1)
    path, *powers = map(np.asarray, quick_jit(lambda s: jax.lax.scan(advance, s, steps))(start)[1])
    window = round(2 / h)
    speed = np.linalg.norm(path[-1] - path[-1 - window], axis=0) / 2
    return Swim(speed, *(each[-1 - window : -1].mean(0) for each in powers))


@pytest.mark.slow
@pytest.mark.parametrize("segments", [10, 20])
def test_free_swimming_with_recoil(segments):
    """The speed of elongated-body theory, for two envelopes and three amplitudes: 7 %."""
    friction = 0.5 * WATER * FRICTION * 2 * (HEIGHT + THICKNESS)
    expected = [plate(*wave).swimming_speed(friction) for wave in WAVES]
    np.testing.assert_allclose(swim(segments, 1 / 120).speed, expected, rtol=0.08)


@pytest.mark.slow
def test_motors_pay_for_friction_and_wake():
    """0.1 % of their work is left over, and 2 % where the animal still gathers speed."""
    found = swim(10, 1 / 120)
    left = found.motors + found.friction + found.wake
    assert (found.wake < 0).all() and (np.abs(left) < [0.03, *[2e-3] * 5] * found.motors).all()


@pytest.mark.slow
def test_the_wake_has_the_power_of_theory():
    """``1/2 m U <w^2>`` of the tail with recoil: 25 %, since w is the difference of two waves."""
    found = swim(20, 1 / 120)
    cases = zip(WAVES, found.speed, strict=True)
    theory = [plate(*wave).wake_power(speed) for wave, speed in cases]
    np.testing.assert_allclose(-found.wake, theory, rtol=0.25)


@pytest.mark.slow
def test_swimming_converges_in_second_order_with_the_step():
    coarse, middle, fine = (swim(10, 1 / n).speed for n in (60, 120, 240))
    assert np.abs(np.log2((coarse - middle) / (middle - fine)) - 2).max() < 0.15


@pytest.mark.slow
def test_swimming_hardly_depends_on_the_segments():
    """10 segments are within 2.5 % of 20, and 20 within 1.5 % of 40."""
    few, some, many = (swim(n, 1 / 120).speed for n in (10, 20, 40))
    np.testing.assert_allclose(few, some, rtol=0.025)
    np.testing.assert_allclose(some, many, rtol=0.015)


def patchwork() -> Creature:
    """A chain in space: a capsule, and boxes of which one has a large section."""
    shapes = [
        Box((0.2, 0.05, 0.1)),
        Capsule(0.04, 0.1),
        Box((0.15, 0.12, 0.05)),
        Ellipsoid((0.1, 0.02, 0.05)),
    ]
    bodies = []
    for i, shape in enumerate(shapes):
        joint = None
        if i:
            ahead = float(shapes[i - 1].half_extents[0])
            ends = (-ahead, 0.0, 0.0), (float(shape.half_extents[0]), 0.0, 0.0)
            joint = hinge(f"b{i - 1}", *ends, "yz", 9.0)
        bodies.append(Body(f"b{i}", shape, Material(900.0), joint))
    return Creature("patchwork", tuple(bodies))


@pytest.mark.slow
def test_momentum_and_energy_of_body_and_carried_water():
    """They change by the force q at the edges alone, and by its power ``-1/2 u w . p``."""
    world = ideal(patchwork())
    tree, law = world.tree, world.law(ReactiveThrust)
    inertias = jnp.asarray(tree.inertia + world.law(AddedMass).carried)

    def momentum_and_energy(state):
        bodies = world.bodies(kinematics(tree, state), 0.0)
        momentum = jnp.einsum("ijb,jb->ib", inertias, bodies.velocity)
        energy = 0.5 * (momentum * bodies.velocity).sum()
        return total(bodies, momentum), energy

    def total(bodies, wrench):
        moment, force = (
            jnp.einsum("ijb,jb->ib", bodies.kin.rotation, x) for x in (wrench[:3], wrench[3:])
        )
        about = moment + jnp.cross(bodies.kin.origin, force, axis=0)
        return jnp.concatenate([about.sum(1), force.sum(1)])

    @quick_jit
    def balance(state, torque):
        kin = kinematics(tree, state)
        inertia, bias = body_equations(world, kin, 0.0)
        acceleration, qdd = solve(tree, kin, inertia, bias, torque, jnp.zeros_like(torque))
        turn = jax.jvp(
            lambda t: integrate_quaternion(state.orientation, state.velocity[:3], t), (0.0,), (1.0,)
        )[1]
        change = State(state.velocity[3:], turn, acceleration, state.qd, qdd)
        (rate, power) = jax.jvp(momentum_and_energy, (state,), (change,))[1]
        bodies = world.bodies(kin, 0.0)
        shed = law.wrench(bodies)
        work = (shed * bodies.velocity).sum()
        return rate, total(bodies, shed), power - (torque * state.qd).sum(), work

    rng = np.random.default_rng(3)
    for _ in range(5):
        state = random_state(tree, rng)
        rate, shed, power, work = balance(state, jnp.asarray(rng.normal(size=tree.dof_count)))
        np.testing.assert_allclose(rate, shed, atol=1e-9 * np.abs(shed).max())
        assert float(power) == pytest.approx(float(work), rel=1e-9) and work < 0


@pytest.mark.slow
def test_accelerations_agree_with_mujoco():
    """MuJoCo gets the wrenches of our laws, with the added mass at our accelerations."""
    creature = patchwork()
    world = in_water(creature, 1, GRAVITY, reactive_thrust=True)
    tree, state = world.tree, random_state(world.tree, np.random.default_rng(4))

    @quick_jit
    def motion(state):
        kin = kinematics(tree, state)
        inertia, bias = body_equations(world, kin, 0.0)
        none = jnp.zeros_like(state.qd)
        found = solve(tree, kin, inertia, bias, none, none)
        bodies, change = world.bodies(kin, 0.0), motion_of_bodies(tree, kin, *found)
        acceleration = in_body_axes(
            kin.rotation, change.angular + kin.bias_angular, change.linear + kin.bias_linear
        )
        carried = matvec(world.law(AddedMass).inertia(bodies), acceleration)
        wrench = sum(law.wrench(bodies) for law in world.forces) + buoyancy_alone(bodies) - carried
        moment = wrench[:3] - cross(expand_dims_like(tree.com, wrench[3:]), wrench[3:])
        at_centre = [jnp.einsum("ijb,jb->bi", kin.rotation, x) for x in (wrench[3:], moment)]
        return jnp.concatenate(found), jnp.concatenate(at_centre, 1)

    ours, applied = motion(state)
    model = mujoco_model(creature)
    data = mujoco.MjData(model)
    data.xfrc_applied[[model.body(name).id for name in tree.names]] = applied
    theirs = mujocos_accelerations(model, data, tree, state)
    np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.slow
def test_gradients_equal_central_differences():
    """Displacement by the shed mass, the wave's amplitude and its frequency: 1e-6."""
    creature = box_chain(3, "z", Actuator(5.0), (0.2, 0.04, 0.1))

    world = in_water(creature, 1, reactive_thrust=True)

    def displacement(values):
        scale, amplitude, frequency = values
        changed = eqx.tree_at(_masses, world, scale * _masses(world))

        def advance(state, n):
            rate = amplitude * jnp.sin(2 * jnp.pi * frequency * n / 120 - jnp.array([0.0, 1.0]))
            return step(changed, state, rate, 1 / 120)[0], None

        start = resting_state(world.tree, dtype=jnp.float64)
        return jax.lax.scan(advance, start, jnp.arange(30))[0].position[:2].sum()

    values, value = jnp.array([1.0, 4.0, 1.5]), quick_jit(jax.value_and_grad(displacement))
    slope = value(values)[1]
    for i in range(3):
        ahead, behind = (value(values.at[i].add(change))[0] for change in (1e-4, -1e-4))
        assert float(slope[i]) == pytest.approx(float((ahead - behind) / 2e-4), rel=1e-6)


def _masses(world: World):
    return world.law(ReactiveThrust).edges.masses


def wrenches(world: World, state: State):
    """The wrenches of reactive thrust, and the velocities of the bodies."""

    @quick_jit
    def compute(state):
        bodies = world.bodies(kinematics(world.tree, state), 0.01)
        return world.law(ReactiveThrust).wrench(bodies), bodies.velocity

    return tuple(map(np.asarray, compute(state)))


def test_the_derivative_in_the_step_is_that_of_the_force():
    """Where all water is shed. D is half of the symmetric part, and the rest is the skew part."""
    world = ideal(patchwork())
    law, h = world.law(ReactiveThrust), 0.01
    state = random_state(world.tree, np.random.default_rng(6), (), 0.1)
    state = dataclasses.replace(state, orientation=jnp.array([1.0, 0, 0, 0]), q=0 * state.q)
    state = dataclasses.replace(state, velocity=state.velocity.at[3].add(5.0))

    @quick_jit
    def both(state, change):
        bodies = world.bodies(kinematics(world.tree, state), h)
        own = jax.jvp(lambda v: law.wrench(bodies.moving(v)), (bodies.velocity,), (change,))[1]
        (part,) = law.parts(bodies)
        skew = law.averaged(bodies, bodies.moving(bodies.velocity + change))
        return own, skew - law.averaged(bodies, bodies), part.resistance

    change = jnp.asarray(np.random.default_rng(7).normal(size=(6, world.tree.body_count)))
    own, found, resistance = both(state, change)
    found = found - 2 * np.einsum("ijb,jb->ib", whole(resistance), change) / h
    np.testing.assert_allclose(found, own, atol=1e-9 * np.abs(own).max())


def test_wrenches_turn_and_move_with_the_animal():
    world, rng = ideal(patchwork()), np.random.default_rng(8)
    state = random_state(world.tree, rng)
    turn = rng.normal(size=4)
    turn = jnp.asarray(turn / np.linalg.norm(turn))
    matrix = quaternion_to_matrix(turn)
    w, x, y, z = turn
    product = jnp.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    moved = dataclasses.replace(
        state,
        position=matrix @ state.position + jnp.array([1.0, 2.0, 3.0]),
        orientation=product @ state.orientation,
        velocity=jnp.concatenate([matrix @ state.velocity[:3], matrix @ state.velocity[3:]]),
    )
    expected, _ = wrenches(world, state)
    np.testing.assert_allclose(
        wrenches(world, moved)[0], expected, atol=1e-9 * np.abs(expected).max()
    )


@pytest.mark.slow
def test_a_uniform_current_is_a_moving_frame():
    stream, creature = np.array([0.7, -0.4, 0.2]), patchwork()
    still, streaming = ideal(creature), ideal(creature, current=tuple(stream))
    state = random_state(still.tree, np.random.default_rng(9))
    carried = dataclasses.replace(state, velocity=state.velocity.at[3:].add(stream))

    def after(world, state):
        found = quick_jit(lambda s: step(world, s, jnp.zeros_like(s.qd), 1 / 120)[0])(state)
        return np.concatenate([found.velocity, found.qd])

    ours, expected = after(streaming, carried), after(still, state)
    ours[3:6] -= stream
    np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-9)


def test_an_animal_at_the_surface_sheds_what_is_under_water():
    deep, floating = ideal(eel(4)), ideal(eel(4), surface=0.0)
    velocity = np.tile([[0.0], [0.0], [0.0], [1.0], [0.5], [0.0]], 3)
    state = resting(deep.tree, (3,), np.array([-1.0, 0.0, 1.0]), velocity=velocity)
    expected = wrenches(deep, state)[0] * np.array([1.0, 0.5, 0.0])
    np.testing.assert_allclose(wrenches(floating, state)[0], expected, rtol=1e-9, atol=1e-9)


def test_water_leaves_at_the_rear_end_of_the_motion():
    """Forwards at the tail, backwards at the nose, and sideways nowhere."""
    world = ideal(eel(4))
    state = resting_state(world.tree, (3,), jnp.float64)
    velocity = state.velocity.at[3].set(jnp.array([1.0, -1.0, 0.0])).at[4].set(0.5)
    found, _ = wrenches(world, dataclasses.replace(state, velocity=velocity))
    mass = world.law(ReactiveThrust).edges.masses[0, 0]
    np.testing.assert_allclose(found[3:5, 3, 0], [0.125 * mass, -0.5 * mass])
    np.testing.assert_allclose(found[3:5, 0, 1], [-0.125 * mass, -0.5 * mass])
    assert not found[:, :3, 0].any() and not found[:, 1:, 1].any() and not found[..., 2].any()


def test_edges_never_push_the_animal():
    world = ideal(patchwork())
    state = random_state(world.tree, np.random.default_rng(10), (200,))
    wrench, velocity = wrenches(world, state)
    power = (wrench * velocity).sum(0)
    assert power.max() <= 1e-9 and (power.sum(0) < 0).mean() > 0.5
