"""Added mass against Lamb's and Kirchhoff's equations, momentum and a change of frame."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.special

from creatures import (
    STRUCTURES,
    coast,
    in_water,
    quick_jit,
    random_creature,
    random_state,
    resting,
    single,
)
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.physics.water.added_mass import AddedMass, added_inertia, ellipsoid

GRAVITY, WATER = 9.81, 1000.0


def ideal(creature: Creature, gravity: float = 0.0, **water) -> World:
    """Return the world of a creature in water without drag, but with added mass."""
    return in_water(creature, 1, gravity, form_drag=0.0, skin_drag=0.0, added_mass=True, **water)


@pytest.mark.parametrize("axes", [(1, 0.1, 0.1), (1, 0.1, 0.05), (1, 0.01, 0.01), (3, 2, 1)])
def test_coefficients_of_ellipsoids(axes):
    """Lamb's integrals by Carlson's: alpha = 2/3 abc R_D(b^2, c^2, a^2), M = alpha / (2 - alpha).

    A body of revolution has no added inertia about its long axis. The added inertia of a slender
    body about its other axes is the inertia of its own volume, V (a^2 + b^2) / 5.
    """
    a = np.array(axes, float)
    volume = 4 / 3 * np.pi * a.prod()
    alpha = np.array(
        [
            2 / 3 * a.prod() * scipy.special.elliprd(*np.delete(a, i) ** 2, a[i] ** 2)
            for i in range(3)
        ]
    )
    found = ellipsoid(Ellipsoid(axes)) / volume
    np.testing.assert_allclose(found[3:], alpha / (2 - alpha), rtol=1e-9)
    if axes[1] == axes[2]:
        assert found[0] == 0
    if axes == (1, 0.01, 0.01):
        np.testing.assert_allclose(found[1:3], (1 + 0.01**2) / 5, rtol=0.005)


def test_coefficients_of_other_shapes():
    """A sphere's added mass is half of its water. A box equals its ellipsoid of equal volume."""
    sphere = ellipsoid(Sphere(0.2))
    np.testing.assert_allclose(sphere, [0, 0, 0, *[Sphere(0.2).volume / 2] * 3], rtol=1e-9)
    ball, box = Ellipsoid((0.3, 0.2, 0.1)), Box((0.6, 0.4, 0.2))
    ratio = box.volume / ball.volume
    np.testing.assert_allclose(ellipsoid(box)[3:], ratio * ellipsoid(ball)[3:], rtol=1e-9)
    np.testing.assert_allclose(
        ellipsoid(box)[:3], ratio ** (5 / 3) * ellipsoid(ball)[:3], rtol=1e-9
    )
    assert ellipsoid(Capsule(0.1, 0.3))[0] == 0


@pytest.mark.parametrize("density", [100.0, 3000.0])
def test_first_acceleration_of_a_sphere(density):
    """The acceleration is (rho V - m) g / (m + rho V / 2): 2 g for a bubble, not 1000 g."""
    world = ideal(single(Sphere(0.1), density), GRAVITY)
    motion = coast(world, resting_state(world.tree, dtype=jnp.float64), 1e-3, 1e-3)
    expected = (WATER - density) * GRAVITY / (density + WATER / 2)
    assert motion.velocity[0, 5] / 1e-3 == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
def test_tumbling_ellipsoid_follows_kirchhoff():
    """Compare with (I + M) dV/dt = -V x* (I + M) V in body axes by an adaptive Runge-Kutta method.

    The step is of first order, so half the step gives half the difference.
    """
    shape = Ellipsoid((0.3, 0.2, 0.1))
    world = ideal(single(shape, WATER))
    whole = world.tree.inertia[..., 0] + world.law(AddedMass).carried[..., 0]
    start = np.array([1.0, 2.0, -1.5, 0.5, -0.3, 0.8])

    def kirchhoff(_, v):
        momentum = whole @ v
        moment = np.cross(v[:3], momentum[:3]) + np.cross(v[3:], momentum[3:])
        force = np.cross(v[:3], momentum[3:])
        return np.linalg.solve(whole, -np.concatenate([moment, force]))

    exact = scipy.integrate.solve_ivp(kirchhoff, (0, 1), start, rtol=1e-10, atol=1e-12).y[:, -1]
    state = resting(world.tree, velocity=start)
    errors = []
    for h in (1 / 500, 1 / 1000):
        motion = coast(world, state, 1.0, h)
        end = jax.tree.map(lambda x: jnp.asarray(x[-1]), motion)
        rotation = np.asarray(kinematics(world.tree, end).rotation[:, :, 0])
        found = np.concatenate([rotation.T @ end.velocity[:3], rotation.T @ end.velocity[3:]])
        errors.append(np.linalg.norm(found - exact))
    assert errors[1] < 0.02 * np.linalg.norm(exact)
    assert 1.7 < errors[0] / errors[1] < 2.3


@pytest.mark.slow
def test_impulse_of_a_tree_is_conserved():
    """Joint forces are internal, so impulse and moment of bodies and water change by h^2 only."""
    h = 1e-6
    rng = np.random.default_rng(5)
    world = ideal(random_creature(rng, STRUCTURES[1]))
    state = random_state(world.tree, rng)
    after = quick_jit(lambda s: step(world, s, jnp.zeros_like(s.qd), h)[0])(state)

    pose = quick_jit(lambda state: kinematics(world.tree, state))

    def impulse(state):
        kin = jax.tree.map(np.asarray, pose(state))
        total = np.zeros(6)
        for i in range(world.tree.body_count):
            rotation = np.kron(np.eye(2), kin.rotation[:, :, i])
            velocity = np.concatenate([kin.angular[:, i], kin.linear[:, i]])
            whole = world.tree.inertia[..., i] + world.law(AddedMass).carried[..., i]
            momentum = rotation @ whole @ rotation.T @ velocity
            total += momentum
            total[:3] += np.cross(kin.origin[:, i], momentum[3:])
        return total

    before, later = impulse(state), impulse(after)
    force = np.abs(later - before).max() / h
    assert force < 1e-3 * np.abs(before).max()


@pytest.mark.slow
def test_a_uniform_stream_is_a_moving_frame():
    """Bodies that move with a stream behave as in still water (Galilean invariance)."""
    stream = np.array([0.7, -0.4, 0.2])
    creature = random_creature(np.random.default_rng(6), STRUCTURES[0])
    still, moving = ideal(creature), ideal(creature, current=tuple(stream))
    state = random_state(still.tree, np.random.default_rng(7))
    carried = dataclasses.replace(state, velocity=state.velocity.at[3:].add(stream))

    def velocity(world, state):
        after = quick_jit(lambda s: step(world, s, jnp.zeros_like(s.qd), 1 / 120)[0])(state)
        return np.concatenate([after.velocity, after.qd])

    ours = velocity(moving, carried)
    ours[3:6] -= stream
    np.testing.assert_allclose(ours, velocity(still, state), rtol=1e-8, atol=1e-8)


def test_water_entry_slows_a_body_and_exit_does_not():
    """If gravity is zero, m v = (m + rho V / 2) v' on entry, and v' is constant on exit."""
    world = ideal(single(Sphere(0.1), 500.0), surface=0.0)
    velocity = np.eye(6)[:, 5:] * np.array([-1.0, 1.0])
    state = resting(world.tree, (2,), np.array([0.15, -0.15]), velocity=velocity)
    motion = coast(world, state, 0.6, 1 / 1000)
    assert motion.position[-1, 2, 0] < -0.1 and motion.position[-1, 2, 1] > 0.1
    np.testing.assert_allclose(motion.velocity[-1, 5], [-0.5, 1.0], rtol=0.005)


def test_water_moves_with_the_centre_of_a_body():
    """M_o = T^T M T in the working frame, with T from this frame to the centre of mass."""
    creature = random_creature(np.random.default_rng(8), STRUCTURES[0])
    tree = build_tree(creature)
    inertia = added_inertia(creature, tree, WATER)[..., 1]
    x, y, z = tree.com[:, 1]
    about_centre = np.eye(6)
    about_centre[3:, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    velocity = np.random.default_rng(9).normal(size=6)
    moved = about_centre @ velocity
    np.testing.assert_allclose(moved[3:], velocity[3:] + np.cross(velocity[:3], tree.com[:, 1]))
    energy = moved**2 @ (WATER * ellipsoid(creature.bodies[1].shape))
    assert velocity @ inertia @ velocity == pytest.approx(energy, rel=1e-12)
