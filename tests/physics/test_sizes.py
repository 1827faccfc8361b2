"""Bodies from 0.1 mm to 100 m follow closed forms in float32.

Lengths are relative to the body's length, and times to the time of a fall by that length.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import hinge, in_water
from evo_cpg.creature.algebra.linear import inverse_symmetric
from evo_cpg.creature.algebra.rotation import quaternion_to_matrix
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.shapes import Box, Capsule, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.native.engine import Engine, using
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.contact.terrain import Block, Plane
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from on_ground import alone

GRAVITY = 9.81
ABYSS = Plane(height=-1000.0)
SIZES = 1e-4, 1e-3, 100.0


def body(shape, density=1000.0):
    return Creature("one", (Body("body", shape, Material(density)),))


def moved(world, steps, h, height=0.0, velocity=None, qd=None, engine="native"):
    """Return the state of one individual at the end of every step, in float32."""
    h = float(h)
    start = resting_state(world.tree, (1,), jnp.float32, position=(0.0, 0.0, height))
    if velocity is not None:
        start = dataclasses.replace(start, velocity=jnp.asarray(velocity, jnp.float32)[:, None])
    if qd is not None:
        start = dataclasses.replace(start, qd=jnp.asarray(qd, jnp.float32)[:, None])

    def advance(carry, _):
        state, warmstart = carry
        state, effort = step(world, state, jnp.zeros_like(state.q), h, warmstart)
        return (state, effort.warmstart), state

    @quick_jit
    def run(state):
        begin = state, first_warmstart(world, (1,), jnp.float32)
        return jax.lax.scan(advance, begin, None, steps)[1]

    with using(Engine(engine)):
        return jax.tree.map(lambda x: np.asarray(x, float)[..., 0], run(start))


@pytest.mark.slow
@pytest.mark.parametrize(("size", "engine"), [(1e-4, "jax"), *((s, "native") for s in SIZES)])
def test_a_symmetric_top_precesses(size, engine):
    """The rate is (I_2 - I_1) / I_2 times its spin, while it falls at up to 10 m/s."""
    world = World(build_tree(body(Capsule(size / 6, 2 * size / 3))), GRAVITY)
    states = moved(world, 240, 1 / 240, velocity=[20.0, 3.0, 1.0, 0.0, 0.0, 0.0], engine=engine)
    turn = np.asarray(quaternion_to_matrix(jnp.asarray(states.orientation.T)))
    own = np.einsum("ijt,ti->jt", turn, states.velocity[:, :3])
    across, along = world.tree.inertia[1, 1, 0], world.tree.inertia[0, 0, 0]
    angle = np.unwrap(np.arctan2(own[2], own[1]))
    rate = np.polyfit(np.arange(240) / 240, angle, 1)[0]
    assert rate == pytest.approx(-20.0 * (across - along) / across, rel=1e-3)
    np.testing.assert_allclose(own[0], 20.0, rtol=1e-3)
    np.testing.assert_allclose(np.hypot(own[1], own[2]), np.sqrt(10.0), rtol=1e-3)
    assert states.velocity[-1, 5] == pytest.approx(-GRAVITY, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_a_sinking_box_reaches_its_terminal_speed(size):
    """``v^2 = (rho_b / rho - 1) g c / C_d`` with the drag of the top and the bottom."""
    density, drag = 3000.0, 0.5
    world = in_water(
        body(Box((size, 0.7 * size, 0.5 * size)), density), form_drag=drag, skin_drag=0.0,
        added_mass=True,
    )  # fmt: skip
    states = moved(world, 400, 0.05 * np.sqrt(size / GRAVITY))
    speed = np.sqrt((density / 1000.0 - 1.0) * GRAVITY * 0.5 * size / drag)
    assert states.velocity[-1, 5] == pytest.approx(-speed, rel=1e-3)


@pytest.mark.parametrize("size", SIZES)
def test_a_floating_box_bobs_like_a_spring(size):
    """The spring has a stiffness of ``rho g a b`` about the half-submerged position."""
    world = in_water(
        body(Box((size, 0.7 * size, 0.5 * size)), 500.0), form_drag=0.0, skin_drag=0.0, surface=0.0
    )
    h = 0.01 * np.sqrt(size / GRAVITY)
    states = moved(world, 400, h, height=0.02 * size)
    rate = np.sqrt(2.0 * GRAVITY / (0.5 * size))
    # Positions belong to the times half a step after the velocities.
    time = h * (np.arange(400) + 1.5)
    wave = 0.02 * np.cos(rate * time) / np.cos(0.5 * rate * h)
    np.testing.assert_allclose(states.position[:, 2] / size, wave, atol=0.03 * 0.02)


@pytest.mark.parametrize(
    ("on", "size"),
    [
        ("floor", SIZES[0]),
        pytest.param("floor", SIZES[1], marks=pytest.mark.slow),
        pytest.param("floor", SIZES[2], marks=pytest.mark.slow),
        *(pytest.param("block", size, marks=pytest.mark.slow) for size in SIZES),
    ],
)
def test_a_box_comes_to_rest_on_the_ground(on, size):
    """A dropped box neither sinks in nor tilts."""
    ground = {"floor": Plane()}
    if on == "block":
        slab = Block((0.0, 0.0, -size), (20.0 * size, 20.0 * size, size))
        ground = {"floor": Plane(height=-1000.0 * size), "obstacles": (slab,)}
    world = alone(Box((size, 0.7 * size, 0.5 * size)), **ground)
    states = moved(world, 150, 0.03 * np.sqrt(size / GRAVITY), height=0.4 * size)
    assert states.position[-1, 2] == pytest.approx(0.25 * size, rel=1e-3)
    turn = np.asarray(quaternion_to_matrix(jnp.asarray(states.orientation[-1])))
    assert turn[2, 2] > 1 - 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_a_sliding_ball_rolls_in_the_end(size):
    """The final speed is 5/7 of the initial speed."""
    world = alone(Sphere(size / 2))
    speed = 0.5 * np.sqrt(GRAVITY * size)
    states = moved(
        world, 100, 0.03 * np.sqrt(size / GRAVITY), height=size / 2,
        velocity=[0.0, 0.0, 0.0, speed, 0.0, 0.0],
    )  # fmt: skip
    assert states.velocity[-1, 3] == pytest.approx(5 / 7 * speed, rel=1e-3)


def angular_momentum(tree, states):
    """Return the angular momentum about the world's origin at each time, ``(times, 3)``."""
    state = jax.tree.map(lambda x: jnp.moveaxis(jnp.asarray(x), 0, -1), states)
    kin = jax.tree.map(np.asarray, quick_jit(functools.partial(kinematics, tree))(state))
    total = 0.0
    for i in range(tree.body_count):
        turn, inertia = kin.rotation[:, :, i], tree.inertia[:, :, i]
        twist = np.concatenate(
            [np.einsum("jit,jt->it", turn, x[:, i]) for x in (kin.angular, kin.linear)]
        )
        own = np.einsum("ij,jt->it", inertia, twist)
        moment, force = (np.einsum("ijt,jt->it", turn, part) for part in (own[:3], own[3:]))
        total = total + moment + np.cross(kin.origin[:, i].T, force.T).T
    return total.T


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["native", "jax"])
@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_tiny_claw_keeps_spinning(axes, engine):
    """A tiny claw on a free joint keeps its rate, and the pair its angular momentum."""
    large, small = 0.5, 0.0005
    joint = hinge("trunk", (large / 2, 0.0, 0.0), (0.0, 0.0, 0.0), "yzx"[:axes], 99.0)
    trunk = Body("trunk", Box((large, 0.7 * large, 0.5 * large)), Material(1000.0))
    claw = Body("claw", Sphere(small), Material(1000.0), joint)
    world = World(build_tree(Creature("pair", (trunk, claw))), 0.0)
    rates = np.array([5.0, 0.0, 0.0])[:axes]
    states = moved(world, 60, 1 / 240, qd=rates, engine=engine)
    # The joint is at the ball's centre, so the ball turns at a constant rate without reaction.
    np.testing.assert_allclose(states.qd[:, 0], 5.0, rtol=1e-3)
    momentum = angular_momentum(world.tree, states)
    own = 0.4 * 1000.0 * world.tree.volume[1] * small**2 * 5.0
    np.testing.assert_allclose(momentum[:, 1], own, rtol=2e-2)


@pytest.mark.parametrize("shape", [Sphere(0.05), Capsule(0.05, 0.2)])
def test_clearance_has_a_derivative_in_float32(shape):
    """The search for the start height uses this derivative."""
    world = alone(shape, obstacles=(Block((0.0, 0.0, 0.0), (1.0, 1.0, 0.01)),), floor=ABYSS)

    @quick_jit
    def gap(height):
        state = resting_state(world.tree, (), jnp.float32, (0.0, 0.0, height))
        return clearance(world.contact_model, kinematics(world.tree, state)).min()

    for height in (0.0, 0.5):
        _, rise = jax.jvp(gap, (jnp.float32(height),), (jnp.float32(1.0),))
        assert abs(float(rise)) == 1.0


def test_inverses_are_accurate_at_any_scale():
    """Invert moments of inertia from a speck to a hill."""
    rng = np.random.default_rng(0)
    for size in (1, 2, 3):
        root = rng.normal(size=(size, size, 40))
        scale = 10.0 ** rng.uniform(-12, 12, (size, 40))
        m = np.einsum("ijn,kjn->ikn", root, root) + np.eye(size)[:, :, None]
        m = m * scale[:, None] * scale[None]
        single = jnp.asarray(m, jnp.float32)
        found = np.asarray(quick_jit(inverse_symmetric)(single), float)
        exact = np.moveaxis(np.linalg.inv(np.moveaxis(m, -1, 0)), 0, -1)
        np.testing.assert_allclose(
            found * scale[:, None] * scale[None], exact * scale[:, None] * scale[None],
            rtol=1e-3, atol=1e-4,
        )  # fmt: skip
