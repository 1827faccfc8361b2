"""Articulated-body algorithm with implicit forces, in O(bodies).

A force on a body enters as the wrench ``f_i`` at the present velocity and its decrease per change
of velocity, ``D_i``. A joint torque enters as its value ``tau`` at the present rates and its
derivative ``-dtau/dqdd``, the diagonal ``T``. The velocities at the end of a step of length h obey

    (M + h sum J_i^T D_i J_i + T) qdd = tau + sum J_i^T f_i - bias.

The solver is the algorithm of Featherstone 2008, table 7.1, with ``I_i + h D_i`` in place of
``I_i`` and ``S^T I^A S + T`` in place of ``S^T I^A S``. The first pass, outwards, is
`evo_cpg.physics.tree.kinematics.kinematics`. `solve` does the other two passes. The algebra of one
joint and its symbols are in `evo_cpg.physics.tree.joint_kinds`.

Differs from the table in the place of the velocity-product accelerations c_i. Their sums from the
root are A0_i of `Kinematics`, and p_i includes the wrench for them. The passes solve only for the
accelerations in addition to A0_i. All is in world axes, so X_i is a shift by an offset.

| symbol | name |
|---|---|
| I_i + h D_i, p_i | ``inertia``, ``bias``: wrench that is needed for the accelerations A0_i |
| I^A_i, p^A_i | ``I_A``, ``p_A``: articulated inertia and bias of the body's subtree |
| a_i | ``a``: spatial acceleration of the body |

Each line holds for one body and for a group of like limbs side by side (`PerBody`).

**Derivatives.** The solution y obeys ``r(x, y) = 0``. The residual r is inverse dynamics, and x are
the inertias, offsets, axes and forces. So ``dy = -M^-1 dr``, with dr at constant y. The inverse is
symmetric, so a gradient solves the equations once more, and with the same eliminated joints. JAX's
derivative of the passes would take three times as many operations, because it also differentiates
the elimination.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import matvec, matvec_t
from evo_cpg.creature.algebra.numerics import MixedArray
from evo_cpg.creature.per_body import PerBody, in_dof_order
from evo_cpg.creature.tree import Tree
from evo_cpg.creature.walk import TreeWalk
from evo_cpg.creature.walked import inwards, outwards
from evo_cpg.native.fuse import self_adjoint
from evo_cpg.physics.tree import root
from evo_cpg.physics.tree.generalized import body_accelerations, generalized_force
from evo_cpg.physics.tree.joint_kinds import joints_of
from evo_cpg.physics.tree.joints import Subspace
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.tree.spatial_algebra import (
    Inertia,
    Motion,
    Wrench,
    inertia_at_parent,
    motion_at_child,
    wrench_at_parent,
)


class Accelerations(NamedTuple):
    """Accelerations in addition to the velocity-product accelerations of `Kinematics`.

    Attributes:
        root: acceleration of the root's velocity: angular, rad/s^2, then linear, m/s^2. It is zero
            if the root hangs on the world, because its joint moves it.
        qdd: joint accelerations, rad/s^2.
    """

    root: Float[Array, "6 *n"]
    qdd: Float[Array, "d *n"]


class _Given(NamedTuple):
    """Quantities that the accelerations depend on, as in `solve`."""

    offset: Float[Array, "3 b *n"]
    axes: Subspace
    inertia: Inertia
    bias: Wrench
    torque: Float[Array, "d *n"]
    torque_derivative: Float[Array, "d *#n"]
    walk: TreeWalk | None


def solve(
    tree: Tree,
    kin: Kinematics,
    inertia: Inertia,
    bias: Wrench,
    torque: Float[Array, "d *n"],
    torque_derivative: Float[Array, "d *#n"],
    held: bool = False,
) -> Accelerations:
    """Return the accelerations of the root and of all joints.

    Args:
        tree: the creature.
        kin: present kinematics of the creature.
        inertia: ``I + h D`` of every body.
        bias: ``V x* I V - f + I A0`` of every body.
        torque: torque on every joint axis at the present rates, N m.
        torque_derivative: ``-dtau/dqdd`` (with armature), kg m^2.
        held: whether the root is held, and has no acceleration.
    """
    eliminate = jax.custom_jvp(functools.partial(_eliminate, tree, held))

    @eliminate.defjvp
    def differentiate(primals: tuple[_Given], tangents: tuple[_Given]) -> tuple[Array, Array]:
        (given,), y = primals, eliminate(*primals)
        residual = functools.partial(_residual, tree, kin, jax.lax.stop_gradient(y))
        change = jax.jvp(residual, primals, tangents)[1]
        return y, self_adjoint(functools.partial(_solve_again, tree, held), given, -change)

    # The walk may be traced, and rules of derivatives do not see what their function closes over.
    walk = jax.tree.map(jnp.asarray, tree.walk, is_leaf=lambda x: isinstance(x, MixedArray))
    given = _Given(kin.offset, kin.axes, inertia, bias, torque, torque_derivative, walk)
    y = eliminate(given)
    return Accelerations(y[root.ROOT], y[root.JOINTS])


def _residual(tree: Tree, kin: Kinematics, y: Array, given: _Given) -> Float[Array, "v *n"]:
    """Return the generalized force that is missing for accelerations y (`solve`)."""
    offset, axes, inertia, bias, torque, torque_derivative, walk = given
    kin, tree = kin._replace(offset=offset, axes=axes), dataclasses.replace(tree, walk=walk)
    a = body_accelerations(tree, kin, y)
    moment = matvec(inertia.angular, a.angular) + matvec(inertia.mixed, a.linear)
    force = matvec_t(inertia.mixed, a.angular) + matvec(inertia.linear, a.linear)
    total = generalized_force(tree, kin, Wrench(moment + bias.moment, force + bias.force))
    return total.at[root.JOINTS].add(torque_derivative * y[root.JOINTS] - torque)


def _solve_again(
    tree: Tree, held: bool, given: _Given, force: Float[Array, "v *n"]
) -> Float[Array, "v *n"]:
    """Return ``M^-1 f`` with the matrix M of `solve`."""
    bias = jax.tree.map(jnp.zeros_like, given.bias)
    if tree.hanging is None:
        moment, push = -force[:3], -force[3 : root.ROOT_DOFS]
        bias = Wrench(bias.moment.at[:, 0].set(moment), bias.force.at[:, 0].set(push))
    return _eliminate(tree, held, given._replace(bias=bias, torque=force[root.JOINTS]))


def _eliminate(tree: Tree, held: bool, given: _Given) -> Float[Array, "v *n"]:
    """Return the accelerations of `solve` as one vector."""
    offset, axes, inertia, bias, torque, torque_derivative, walk = given
    batch_ndim, tree = torque.ndim - 1, dataclasses.replace(tree, walk=walk)
    I_A, p_A = inwards(tree, inertia, batch_ndim), inwards(tree, bias, batch_ndim)
    joints = [(i, joints_of(i, axes, torque, torque_derivative)) for i in tree.groups]
    eliminated = []

    # Second pass, from the tips to the root: articulated-body inertias and bias forces.
    for i, joint in reversed(joints):
        felt = joint.condensed(I_A[i.bodies], p_A[i.bodies])
        I_A = I_A.plus_to_parents(i, inertia_at_parent(felt.inertia, offset[:, i.bodies]))
        p_A = p_A.plus_to_parents(i, wrench_at_parent(felt.bias, offset[:, i.bodies]))
        eliminated.append(felt)

    # Third pass, from the root to the tips: accelerations.
    qdd = [jnp.zeros((0, *torque.shape[1:]), torque.dtype)]
    if tree.hanging is None:
        free = root.solved(I_A.root(), p_A.root())
        a = outwards(tree, jax.tree.map(jnp.zeros_like, free) if held else free, batch_ndim)
        of_root = jnp.concatenate(a.root())
    else:
        joint = joints_of(tree.hanging, axes, torque, torque_derivative)
        still = Motion(*(jnp.zeros_like(offset[:, :1]) for _ in range(2)))
        a_0, x = joint.accelerations(joint.condensed(I_A[:1], p_A[:1]), still)
        a = PerBody.of(a_0, batch_ndim)
        qdd.append(in_dof_order(x, batch_ndim))
        of_root = jnp.zeros((root.ROOT_DOFS, *torque.shape[1:]), torque.dtype)
    for (i, joint), felt in zip(joints, reversed(eliminated), strict=True):
        a_i, x = joint.accelerations(felt, motion_at_child(a.of_parents(i), offset[:, i.bodies]))
        a = a.followed_by(a_i)
        qdd.append(in_dof_order(x, batch_ndim))
    return jnp.concatenate([of_root, *qdd])
