"""The articulated-body algorithm with implicit forces, in O(bodies).

Every force on a body enters as the wrench ``f_i`` at the present velocity and what it loses per
change of velocity, ``D_i``; every joint torque as its value ``tau`` at the present rates and its
derivative ``-dtau/dqdd``, the diagonal ``T``. Solving for the velocities at the end of a step of
length h,

    (M + h sum J_i^T D_i J_i + T) qdd = tau + sum J_i^T f_i - bias,

is the algorithm of Featherstone 2008, table 7.1, with ``I_i + h D_i`` in place of ``I_i`` and
``S^T I^A S + T`` in place of ``S^T I^A S``. Its first pass, outwards, is
`evo_cpg.physics.kinematics.kinematics`; `solve` has the other two.

Differs from the table in where the velocity-product accelerations c_i are: summed up from the root
they are A0_i of `Kinematics`, p_i holds what they need, and the passes solve only for what comes on
top of them. All is in world axes, so X_i moves by an offset.

| symbol | name |
|---|---|
| I_i + h D_i, p_i | ``inertia``, ``bias``: wrench that is needed for the accelerations A0_i |
| S_i | ``S``: axes of the joint; through the body's origin, so a motion along them only turns it |
| I^A_i, p^A_i | ``I_A``, ``p_A``: of all that hangs on the body |
| U_i, D_i, u_i of the book | ``U``, ``G``, ``u``: D_i is another thing here |
| I^a_i, p^a_i | ``I_a``, ``p_a``: what of them the parent feels through the joint |
| ``G_i^-1 U_i^T`` | ``K``: how the joint gives way to its parent's acceleration |
| a'_i, a_i | spatial acceleration of the body as if it had no joint; as it is |

Each line holds for one body and for a group of like limbs side by side (`PerBody`).
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Group, Tree
from evo_cpg.fusion.fuse import symmetric
from evo_cpg.physics.kinematics import Kinematics
from evo_cpg.physics.per_body import PerBody, in_dof_order, of_joints
from evo_cpg.physics.spatial_algebra import (
    Inertia,
    Motion,
    Wrench,
    acceleration_of_free_body,
    inertia_at_parent,
    make_inertia,
    motion_at_child,
    turned,
    wrench_at_parent,
)
from evo_cpg.spatial.linear import (
    cross,
    dot,
    expand_dims_like,
    inverse_symmetric,
    matmul,
    matmul_t,
    matvec,
    matvec_t,
    t_matmul,
    transpose,
)

# With this many axes a joint can turn any way.
_BALL_AXES = 3


class Accelerations(NamedTuple):
    """What comes on top of the velocity-product accelerations of `Kinematics`.

    Attributes:
        root: acceleration of the root's velocity, angular, then linear.
        qdd: joint accelerations.
    """

    root: Float[Array, "6 *n"]
    qdd: Float[Array, "d *n"]


class _Joint(NamedTuple):
    """The joints of a group, in coordinates x of their own.

    With one or two axes x is ``q``; with three it is the turn across the joint in world axes, where
    S is 1.

    Attributes:
        axes: S, (3, k, bodies, ...).
        torque: tau, in these coordinates.
        derivative: T, likewise.
        to_q: from x to ``q``; None where they are the same.
    """

    axes: Array
    torque: Array
    derivative: Array
    to_q: Array | None


def solve(
    tree: Tree,
    kin: Kinematics,
    inertia: Inertia,
    bias: Wrench,
    torque: Float[Array, "d *n"],
    torque_derivative: Float[Array, "d *n"],
) -> Accelerations:
    """Accelerations of the root and of all joints.

    Args:
        tree: the creature.
        kin: its present kinematics.
        inertia: ``I + h D`` of every body.
        bias: ``V x* I V - f + I A0`` of every body.
        torque: on every joint axis at the present rates, N m.
        torque_derivative: ``-dtau/dqdd`` (with armature), kg m^2.
    """
    batch_ndim = torque.ndim - 1
    I_A, p_A = PerBody.of(inertia, batch_ndim), PerBody.of(bias, batch_ndim)
    joints = [(i, _joint(i, kin, torque, torque_derivative)) for i in tree.groups]
    yielding = []

    # Second pass, from the tips to the root: articulated-body inertias and bias forces.
    for i, joint in reversed(joints):
        I_i, p_i, S = I_A[i.bodies], p_A[i.bodies], joint.axes
        U = turned(I_i, S)
        G_inverse = inverse_symmetric(t_matmul(S, U.moment) + joint.derivative)
        u = joint.torque - matvec_t(S, p_i.moment)
        K, I_a = _give_way(I_i, U, G_inverse, joint)
        p_a = Wrench(p_i.moment + matvec_t(K.angular, u), p_i.force + matvec_t(K.linear, u))
        I_A = I_A.plus(i.parents, inertia_at_parent(I_a, kin.offset[:, i.bodies]))
        p_A = p_A.plus(i.parents, wrench_at_parent(p_a, kin.offset[:, i.bodies]))
        yielding.append((K, matvec(G_inverse, u)))

    # Third pass, from the root to the tips: accelerations.
    a = PerBody([acceleration_of_free_body(I_A.root(), p_A.root())], batch_ndim)
    qdd = [jnp.zeros((0, *torque.shape[1:]), torque.dtype)]
    for (i, joint), (K, G_inverse_u) in zip(joints, reversed(yielding), strict=True):
        a_i = motion_at_child(a[i.parents], kin.offset[:, i.bodies])
        x = G_inverse_u - matvec(K.angular, a_i.angular) - matvec(K.linear, a_i.linear)
        a = a.followed_by(a_i._replace(angular=a_i.angular + matvec(joint.axes, x)))
        x = x if joint.to_q is None else matvec(joint.to_q, x)
        qdd.append(in_dof_order(x, batch_ndim))
    return Accelerations(jnp.concatenate(a.root()), jnp.concatenate(qdd))


def _give_way(
    inertia: Inertia, U: Wrench, G_inverse: Array, joint: _Joint
) -> tuple[Motion, Inertia]:
    """``K = G^-1 U^T`` and ``I^a = I^A - U K``.

    Where S is 1, U has the blocks (A, B^T) of I^A themselves, and G is A + T. With
    ``P = T G^-1 = 1 - A G^-1`` both have a form without cancellation when the joint is free.
    """
    K = Motion(matmul_t(G_inverse, U.moment), matmul_t(G_inverse, U.force))
    linear = inertia.linear - matmul(U.force, K.linear)
    if joint.to_q is None:
        angular = inertia.angular - matmul(U.moment, K.angular)
        return K, make_inertia(angular, inertia.mixed - matmul(U.moment, K.linear), linear)
    P = matmul(joint.derivative, G_inverse)
    K = Motion(joint.axes - transpose(P), K.linear)
    return K, make_inertia(matmul(P, inertia.angular), matmul(P, inertia.mixed), linear)


def _joint(
    group: Group,
    kin: Kinematics,
    torque: Float[Array, "d *n"],
    torque_derivative: Float[Array, "d *n"],
) -> _Joint:
    """The joints of a group; see `solve`."""
    axes, tau, diagonal = (
        of_joints(x, group, torque.ndim - 1) for x in (kin.axes, torque, torque_derivative)
    )
    identity = expand_dims_like(np.eye(group.axes), tau, tau.ndim + 1)
    if group.axes != _BALL_AXES:
        return _Joint(axes, tau, identity * diagonal[None], None)
    to_q = _inverse_columns(axes)
    derivative = symmetric(t_matmul(to_q, diagonal[:, None] * to_q))
    return _Joint(identity, matvec_t(to_q, tau), derivative, to_q)


def _inverse_columns(m: Float[Array, "3 3 *rest"]) -> Float[Array, "3 3 *rest"]:
    """Inverse of a matrix whose columns are independent: its rows are their cross products."""
    a, b, c = m[:, 0], m[:, 1], m[:, 2]
    rows = jnp.stack([cross(b, c), cross(c, a), cross(a, b)])
    return rows * (1.0 / dot(a, rows[0]))[None, None]
