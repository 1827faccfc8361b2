"""Reactive thrust against Lighthill's elongated-body theory, momentum, energy and Galileo."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import box_chain, in_water, quick_jit, random_state
from elongated_body import Plate
from evo_cpg.creature.creature import Actuator, Body, Creature, Joint, Material
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape
from evo_cpg.physics import root
from evo_cpg.physics.added_mass import AddedMass
from evo_cpg.physics.fluid import Drag
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.reactive_thrust import ReactiveThrust
from evo_cpg.physics.state import State, resting_state
from evo_cpg.physics.step import step
from evo_cpg.physics.world import World

WATER = 1000.0
LENGTH, HEIGHT, THICKNESS = 1.0, 0.1, 0.01
GROWING, CONSTANT = (lambda x: 0.1 + 0.9 * x * x), np.ones_like


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
        rotation = root.rotation(turn / jnp.sqrt((turn * turn).sum()))
        state = moving(world.tree, tumbling, time)
        arms = rotation[:, :1] * jnp.append(places, -0.5)[None]
        velocity = state.velocity[3:, None] + jnp.cross(state.velocity[:3, None], arms, axis=0)
        across = rotation @ axes
        momentum = across @ (masses[:, None] * (across.T @ velocity))
        return place[:, None] + arms, rotation[:, 0], velocity, momentum

    time = jnp.array(0.3)
    (r, t, v, p), (_, _, _, dp) = jax.jvp(along, (time,), (jnp.ones(()),))
    u = t @ v
    w = v - t[:, None] * u[None]
    flux = u[None] * p - 0.5 * (w * p).sum(0)[None] * t[:, None]
    force = -(dp[:, :-1] @ weights) - flux[:, -1]
    # By parts: int r x d flux/da = [r x flux] - int t x flux.
    inside = -jnp.cross(r, dp, axis=0) - jnp.cross(t[:, None], flux, axis=0)
    inside = inside - jnp.cross(w, p, axis=0)
    moment = inside[:, :-1] @ weights - jnp.cross(r[:, -1], flux[:, -1])
    expected = jnp.concatenate([moment, force])
    found = quick_jit(lambda time: water_on(world, tumbling, time))(time)
    assert float(u[-1]) > 1.0 and np.abs(expected).min() > 0.02
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
