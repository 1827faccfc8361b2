"""Inertia and bias wrench of every body, with the contributions of the force laws.

Contacts are added later (`evo_cpg.physics.step.step_problem`).

A single body turns by ``I w' = -w x I w``. If a step holds the torque of its start, the rotation
grows. A wobbling capsule that spins at 40 rad/s about its axis is 3 times as fast after one second
of steps of 1/240 s. Kahan's method (1993; Hirota and Kimura 2000),

    I (w_1 - w) / h = -1/2 (w x I w_1 + w_1 x I w),

conserves energy and momentum up to a bounded wobble, for any step. So do steps that use the method
for their first solution (`evo_cpg.physics.step.equations.with_mean_products`). Joints, drag and
contact change w_1. The torque (`gyroscopic_change`) is computed for the body alone. It differs from
the torque at the start by O(h).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.algebra.linear import (
    cross,
    dot,
    expand_dims_like,
    matmul,
    matmul_t,
    matvec,
    skew,
    toward_one,
)
from evo_cpg.creature.algebra.numerics import Numbers, is_traced, xp
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.tree.spatial_algebra import BodyMotion, Inertia, Wrench, make_inertia
from evo_cpg.physics.water.force_law import blocks, in_body_axes
from evo_cpg.physics.water.weight import weight

# Radius of gyration below which rounding would turn a body that falls, m.
_TURNS_EASILY = 0.01


def body_equations(world: World, kin: Kinematics, h: float) -> tuple[Inertia, Wrench]:
    """Return the inertia ``I + h D`` and the bias wrench of every body, in world axes.

    The bias wrench is the wrench for the velocity-product accelerations, which come from the change
    of pose. It includes the inertia of the body and of the force laws, but not D. Force laws use
    the velocities in the pose at the start of the step.
    """
    tree, bodies = world.tree, world.bodies(kin, h)
    rotation, velocity = kin.rotation, bodies.velocity
    constant = expand_dims_like(tree.inertia, velocity, velocity.ndim + 1)
    accelerations = in_body_axes(rotation, kin.bias_angular, kin.bias_linear)
    wrench = weight(bodies) - matvec(constant, accelerations)
    matrix = blocks(constant)
    for law in world.forces:
        for part in law.parts(bodies):
            wrench = wrench + part.wrench
            if part.inertia is not None:
                wrench = wrench - matvec(part.inertia, accelerations)
                matrix = matrix + blocks(part.inertia)
            if part.resistance is not None:
                matrix = matrix + part.resistance
    needed = _gyration(world, velocity) - wrench
    moment, force = needed[:3], needed[3:]
    if not world.submerged:
        # Under water drag slows spins, so this correction is not needed.
        moment = moment + gyroscopic_change(tree, velocity[:3], h)
    angular, mixed, linear = (matmul_t(matmul(rotation, block), rotation) for block in matrix)
    bias = Wrench(matvec(rotation, moment), matvec(rotation, force))
    return make_inertia(angular, mixed, linear), bias


def bias_of_mean(world: World, kin: Kinematics, moving: BodyMotion, h: float) -> Wrench:
    """Return the change of the bias wrench by means of velocity products over a step, world axes.

    Args:
        world: the creature and its environment.
        kin: kinematics at the start of the step.
        moving: motion of the bodies at the end of the step, in the pose of the start.
        h: step, s.
    """
    rotation, tree, start = kin.rotation, world.tree, world.bodies(kin, h)
    velocity, other = start.velocity, in_body_axes(rotation, moving.angular, moving.linear)
    end = start.moving(other)
    accelerations = in_body_axes(
        rotation, moving.bias_angular - kin.bias_angular, moving.bias_linear - kin.bias_linear
    )
    constant = expand_dims_like(tree.inertia, velocity, velocity.ndim + 1)
    needed = _gyration(world, other) - _gyration(world, velocity)
    needed = needed + matvec(constant, accelerations)
    for law in world.forces:
        for sign, bodies in ((1.0, start), (-1.0, end)):
            wrench = law.averaged(start, bodies)
            if wrench is not None:
                needed = needed + sign * wrench
        inertia = law.inertia(start)
        if inertia is not None:
            needed = needed + matvec(inertia, accelerations)
    moment, force = 0.5 * needed[:3], 0.5 * needed[3:]
    if not world.submerged:
        moment = moment - gyroscopic_change(tree, velocity[:3], h)
    return Wrench(matvec(rotation, moment), matvec(rotation, force))


def _gyration(world: World, velocity: Float[Array, "6 b *n"]) -> Float[Array, "6 b *n"]:
    """Return ``V x* I V``."""
    inertia = expand_dims_like(world.tree.inertia, velocity, velocity.ndim + 1)
    momentum, w, v = matvec(inertia, velocity), velocity[:3], velocity[3:]
    across = momentum[3:]
    small = _turn_easily(world.tree)
    # In deep water drag keeps v small, so rounding of v x m v does not matter.
    if not world.submerged and (is_traced(small) or small.any()):
        # The part m v of the momentum adds only rounding to the moment v x m v.
        without = xp.where(small[None, None], 0.0, world.tree.inertia[3:, 3:])
        rows = xp.concatenate([world.tree.inertia[3:, :3], without], 1)
        across = matvec(expand_dims_like(rows, velocity, velocity.ndim + 1), velocity)
    moment = cross(w, momentum[:3]) + cross(v, across)
    return jnp.concatenate([moment, cross(w, momentum[3:])])


def _turn_easily(tree: Tree) -> Bool[Numbers, " b"]:
    """Return which bodies are so small that the rounding of ``v x m v`` would turn them.

    The rounding accelerates a body by about ``1e-7 v^2 / r^2`` rad/s^2. Here r is the smallest
    radius of gyration. The rounding matters if r is below `_TURNS_EASILY`. Larger bodies are
    computed as in earlier versions, with the same rounding.
    """
    least = xp.diagonal(central_inertia(tree)).min(1)
    return least < _TURNS_EASILY**2 * tree.mass


def gyroscopic_change(
    tree: Tree, angular: Float[Array, "3 b *n"], h: float
) -> Float[Array, "3 b *n"]:
    """Return the mean of ``w x I w`` over a step minus its initial value, body axes, N m.

    Args:
        tree: the creature.
        angular: w in body axes, rad/s.
        h: step, s.
    """
    own = central_inertia(tree)
    # Cramer's rule multiplies three moments of inertia. The scale keeps the product within float32.
    scale = toward_one(xp.trace(own)) ** 2
    inertia = expand_dims_like(scale[None, None] * own, angular, angular.ndim + 1)
    momentum = matvec(inertia, angular)
    torque = cross(angular, momentum)
    derivative = matmul(skew(angular), inertia) - skew(momentum)
    matrix, empty = inertia + 0.5 * h * derivative, tree.mass <= 0
    if is_traced(empty) or empty.any():
        # A welded body has no inertia, and no such torque.
        ones = np.eye(3)[..., None] * xp.where(empty, 1.0, 0.0)[None, None]
        matrix = matrix + expand_dims_like(ones, angular, angular.ndim + 1)
    change = _solve(matrix, -h * torque)
    return expand_dims_like(0.5 / scale, angular[0])[None] * matvec(derivative, change)


def central_inertia(tree: Tree) -> Float[Numbers, "3 3 b"]:
    """Return the inertias about the centres of mass, in the working frames, kg m^2."""
    x, y, z = tree.com
    none = xp.zeros_like(x)
    across = xp.array([[none, -z, y], [z, none, -x], [-y, x, none]])
    square = (across[:, :, None] * across[None]).sum(1)
    return tree.inertia[:3, :3] + tree.mass[None, None] * square


def _solve(m: Float[Array, "3 3 b *n"], v: Float[Array, "3 b *n"]) -> Float[Array, "3 b *n"]:
    """Solve ``m x = v`` by Cramer's rule."""
    a, b, c = m[:, 0], m[:, 1], m[:, 2]
    across = cross(b, c)
    parts = [dot(v, across), dot(a, cross(v, c)), dot(a, cross(b, v))]
    return jnp.stack(parts) / dot(a, across)[None]
