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
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.tree import root
from evo_cpg.physics.tree.joint_kinds import joints_of
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.tree.per_body import PerBody, in_dof_order
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
    batch_ndim = torque.ndim - 1
    I_A, p_A = PerBody.of(inertia, batch_ndim), PerBody.of(bias, batch_ndim)
    joints = [(i, joints_of(i, kin.axes, torque, torque_derivative)) for i in tree.groups]
    eliminated = []

    # Second pass, from the tips to the root: articulated-body inertias and bias forces.
    for i, joint in reversed(joints):
        felt = joint.condensed(I_A[i.bodies], p_A[i.bodies])
        I_A = I_A.plus(i.parents, inertia_at_parent(felt.inertia, kin.offset[:, i.bodies]))
        p_A = p_A.plus(i.parents, wrench_at_parent(felt.bias, kin.offset[:, i.bodies]))
        eliminated.append(felt)

    # Third pass, from the root to the tips: accelerations.
    qdd = [jnp.zeros((0, *torque.shape[1:]), torque.dtype)]
    if tree.hanging is None:
        free = root.solved(I_A.root(), p_A.root())
        a = PerBody([jax.tree.map(jnp.zeros_like, free) if held else free], batch_ndim)
        of_root = jnp.concatenate(a.root())
    else:
        joint = joints_of(tree.hanging, kin.axes, torque, torque_derivative)
        still = Motion(*(jnp.zeros_like(kin.offset[:, :1]) for _ in range(2)))
        a_0, x = joint.accelerations(joint.condensed(I_A[:1], p_A[:1]), still)
        a = PerBody.of(a_0, batch_ndim)
        qdd.append(in_dof_order(x, batch_ndim))
        of_root = jnp.zeros((root.ROOT_DOFS, *torque.shape[1:]), torque.dtype)
    for (i, joint), felt in zip(joints, reversed(eliminated), strict=True):
        a_i, x = joint.accelerations(felt, motion_at_child(a[i.parents], kin.offset[:, i.bodies]))
        a = a.followed_by(a_i)
        qdd.append(in_dof_order(x, batch_ndim))
    return Accelerations(of_root, jnp.concatenate(qdd))
