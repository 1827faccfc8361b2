"""The articulated-body recursion with implicit forces, in O(bodies).

Every force on a body enters as the wrench ``f_i`` at the present velocity and its derivative
``D_i = -df_i/dV_i`` in the body's frame; every joint torque as its value ``tau`` at the present
rates and its derivative ``-dtau/dqdd``, the diagonal ``T``. Solving for the velocities at the
end of a step of length h,

    (M + h sum J_i^T D_i J_i + T) qdd = tau + sum J_i^T f_i - bias - h sum J_i^T D_i A0_i,

is the articulated-body algorithm (Featherstone 2008, section 7.3) with ``I_i + h D_i`` in place
of ``I_i`` and ``S^T I^A S + T`` in place of ``S^T I^A S``; it multiplies the modified inertia by
the whole spatial acceleration, which is where the last term comes from. A0_i is the velocity-
product acceleration of `Kinematics`, so the recursion solves only for what comes on top of it.

| symbol | name |
|---|---|
| I_i + h D_i | ``inertia``: blocks (angular-angular, angular-linear, linear-linear) |
| p_i | ``bias``: wrench that would be needed for the accelerations A0_i |
| U, G, u | as in the book (there G is D): ``I^A S``, ``S^T U + T``, ``tau - S^T p`` |
"""

import itertools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.fusion.fuse import symmetric
from evo_cpg.physics.kinematics import Kinematics, take
from evo_cpg.spatial.linear import (
    cross,
    dot,
    expand_dims_like,
    inverse_symmetric,
    matmul,
    matmul_t,
    matvec,
    matvec_t,
    skew,
    t_matmul,
    transpose,
)

# With this many axes a joint can turn any way, which has a cheaper recursion.
_BALL_AXES = 3


class Inertia(NamedTuple):
    """Symmetric 6x6 matrices by their 3x3 blocks, world axes, at each body's origin."""

    angular: Float[Array, "3 3 b *n"]
    mixed: Float[Array, "3 3 b *n"]
    linear: Float[Array, "3 3 b *n"]


class Wrench(NamedTuple):
    """Moment (N m) and force (N), world axes, at each body's origin."""

    moment: Float[Array, "3 b *n"]
    force: Float[Array, "3 b *n"]


class Accelerations(NamedTuple):
    """What comes on top of the velocity-product accelerations of `Kinematics`.

    Attributes:
        root: spatial acceleration of the root, angular, then linear.
        qdd: joint accelerations.
        angular: spatial acceleration of every body at its origin, world axes.
        linear: its linear part.
    """

    root: Float[Array, "6 *n"]
    qdd: Float[Array, "d *n"]
    angular: Float[Array, "3 b *n"]
    linear: Float[Array, "3 b *n"]


class _Motion(NamedTuple):
    """The unknown acceleration x of a group's joints, and what drives it.

    ``x = G^-1 (u - U^T A_parent)``. With one or two axes x is ``qdd``; with three it is the
    angular acceleration across the joint, in world axes.

    Attributes:
        torque: in the coordinates of x.
        derivative: T in the coordinates of x.
        axes: (3, k, bodies, ...), from ``qdd`` to the angular acceleration.
        to_axes: its inverse; only with three axes.
    """

    torque: Array
    derivative: Array
    axes: Array
    to_axes: Array | None


class _Elimination(NamedTuple):
    """What the outward pass needs from the inward one, per group: ``x = start - follow A_parent``.

    Attributes:
        start: ``G^-1 u``.
        follow_angular: ``G^-1 U^T``, its angular part.
        follow_linear: its linear part.
    """

    start: Array
    follow_angular: Array
    follow_linear: Array


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
        bias: ``V x* I V - f + (I + h D) A0`` of every body.
        torque: on every joint axis at the present rates, N m.
        torque_derivative: ``-dtau/dqdd`` (with armature), kg m^2.
    """
    batch = torque.shape[1:]
    blocks = [_bodies(block, 2) for block in inertia]
    wrenches = [_bodies(part, 1) for part in bias]
    motions = _motions(tree, kin, torque, torque_derivative)
    eliminations: list[_Elimination] = []
    for group, motion in zip(reversed(tree.groups), reversed(motions), strict=True):
        own = Inertia(*(jnp.stack(block[group.bodies], 2) for block in blocks))
        force = Wrench(*(jnp.stack(part[group.bodies], 1) for part in wrenches))
        eliminate = _eliminate_axes if motion.to_axes is None else _eliminate_ball
        elimination, reduced, passed = eliminate(own, force, motion)
        moved, carried = _to_parent(reduced, passed, kin.offset[:, group.bodies])
        eliminations.append(elimination)
        for parts, sums, axis in ((moved, blocks, 2), (carried, wrenches, 1)):
            for part, totals in zip(parts, sums, strict=True):
                add_to_bodies(totals, group.parents, part, axis)

    angular, linear = _free_body(
        Inertia(*(block[0] for block in blocks)), Wrench(*(part[0] for part in wrenches))
    )
    accelerations = [(angular, linear)]
    qdd = [jnp.zeros((0, *batch), torque.dtype)]
    for group, motion, joint in zip(tree.groups, motions, reversed(eliminations), strict=True):
        alpha, a = (
            jnp.stack(parts, 1)
            for parts in zip(*(accelerations[parent] for parent in group.parents), strict=True)
        )
        a = a + cross(alpha, kin.offset[:, group.bodies])
        x = joint.start - matvec(joint.follow_angular, alpha) - matvec(joint.follow_linear, a)
        group_qdd = x if motion.to_axes is None else matvec(motion.to_axes, x)
        alpha = alpha + (matvec(motion.axes, x) if motion.to_axes is None else x)
        accelerations.extend(zip(jnp.unstack(alpha, axis=1), jnp.unstack(a, axis=1), strict=True))
        qdd.append(jnp.swapaxes(group_qdd, 0, 1).reshape(-1, *batch))
    return Accelerations(
        jnp.concatenate([angular, linear]),
        jnp.concatenate(qdd),
        *(jnp.stack(parts, 1) for parts in zip(*accelerations, strict=True)),
    )


def _bodies(x: Array, axis: int) -> list[Array]:
    return list(jnp.unstack(x, axis=axis))


def add_to_bodies(totals: list[Array], bodies: tuple[int, ...], parts: Array, axis: int) -> None:
    """Add to the totals of some bodies, in place, what stands along an axis of an array.

    Args:
        totals: of every body.
        bodies: to which each part belongs; one may occur more than once.
        parts: one for each of ``bodies`` along the axis.
        axis: of ``parts``.
    """
    if len(set(bodies)) == 1:
        totals[bodies[0]] = totals[bodies[0]] + parts.sum(axis)
        return
    waiting = list(range(len(bodies)))
    while waiting:
        # Every body once, so that what is alike in several is added in one operation.
        now = [
            j for k, j in enumerate(waiting) if bodies[j] not in {bodies[i] for i in waiting[:k]}
        ]
        sums = jnp.stack([totals[bodies[j]] for j in now], axis) + take(parts, np.array(now), axis)
        sums = jnp.unstack(sums, axis=axis)
        for k, j in enumerate(now):
            totals[bodies[j]] = sums[k]
        waiting = [j for j in waiting if j not in now]


def _motions(tree: Tree, kin: Kinematics, torque: Array, derivative: Array) -> list[_Motion]:
    """Axes and torques of every group; neighbours with equally many axes are prepared at once."""
    motions: list[_Motion] = []
    batch = torque.shape[1:]
    for axes_count, groups in itertools.groupby(tree.groups, key=lambda group: group.axes):
        run = list(groups)
        dofs = slice(run[0].dofs.start, run[-1].dofs.stop)
        bodies = (dofs.stop - dofs.start) // axes_count
        axes = jnp.swapaxes(kin.axes[:, dofs].reshape(3, bodies, axes_count, *batch), 1, 2)
        tau, diagonal = (
            jnp.swapaxes(part[dofs].reshape(bodies, axes_count, *batch), 0, 1)
            for part in (torque, derivative)
        )
        if axes_count == _BALL_AXES:
            to_axes = _inverse_columns(axes)
            whole = _Motion(
                matvec_t(to_axes, tau),
                symmetric(t_matmul(to_axes, diagonal[:, None] * to_axes)),
                axes,
                to_axes,
            )
        else:
            identity = jnp.eye(axes_count, dtype=tau.dtype)
            whole = _Motion(
                tau, expand_dims_like(identity, tau, tau.ndim + 1) * diagonal[None], axes, None
            )
        first = run[0].bodies.start
        for group in run:
            members = slice(group.bodies.start - first, group.bodies.stop - first)
            motions.append(
                _Motion(
                    whole.torque[:, members],
                    whole.derivative[:, :, members],
                    whole.axes[:, :, members],
                    None if whole.to_axes is None else whole.to_axes[:, :, members],
                )
            )
    return motions


def _eliminate_axes(
    inertia: Inertia, bias: Wrench, motion: _Motion
) -> tuple[_Elimination, Inertia, Wrench]:
    """What the parent feels through joints that give way with the given torques."""
    u_angular = matmul(inertia.angular, motion.axes)
    u_linear = t_matmul(inertia.mixed, motion.axes)
    g_inverse = inverse_symmetric(t_matmul(motion.axes, u_angular) + motion.derivative)
    u = motion.torque - matvec_t(motion.axes, bias.moment)
    # G^-1 U^T; its transpose times u is what the parent feels of the torques.
    follow_angular, follow_linear = matmul_t(g_inverse, u_angular), matmul_t(g_inverse, u_linear)
    reduced = Inertia(
        symmetric(inertia.angular - matmul(u_angular, follow_angular)),
        inertia.mixed - matmul(u_angular, follow_linear),
        symmetric(inertia.linear - matmul(u_linear, follow_linear)),
    )
    passed = Wrench(
        bias.moment + matvec_t(follow_angular, u), bias.force + matvec_t(follow_linear, u)
    )
    return _Elimination(matvec(g_inverse, u), follow_angular, follow_linear), reduced, passed


def _eliminate_ball(
    inertia: Inertia, bias: Wrench, motion: _Motion
) -> tuple[_Elimination, Inertia, Wrench]:
    """The same for three axes, where S is invertible and drops out of the inertias.

    With ``T_w = S^-T T S^-1`` and ``G = A + T_w``, the angular part that is passed on is
    ``A - A G^-1 A = T_w G^-1 A``: a third fewer products than the general form, and no
    cancellation when the joint is free.
    """
    g_inverse = inverse_symmetric(inertia.angular + motion.derivative)
    kept = matmul(motion.derivative, g_inverse)
    give = matmul(g_inverse, inertia.mixed)
    u = motion.torque - bias.moment
    reduced = Inertia(
        symmetric(matmul(kept, inertia.angular)),
        matmul(kept, inertia.mixed),
        symmetric(inertia.linear - t_matmul(inertia.mixed, give)),
    )
    passed = Wrench(motion.torque - matvec(kept, u), bias.force + matvec_t(give, u))
    # G^-1 A = 1 - G^-1 T_w.
    identity = expand_dims_like(jnp.eye(_BALL_AXES, dtype=u.dtype), u, u.ndim + 1)
    elimination = _Elimination(matvec(g_inverse, u), identity - transpose(kept), give)
    return elimination, reduced, passed


def _inverse_columns(m: Float[Array, "3 3 *rest"]) -> Float[Array, "3 3 *rest"]:
    """Inverse of a matrix whose columns are independent: its rows are their cross products."""
    a, b, c = m[:, 0], m[:, 1], m[:, 2]
    rows = jnp.stack([cross(b, c), cross(c, a), cross(a, b)])
    return rows * (1.0 / dot(a, rows[0]))[None, None]


def _to_parent(inertia: Inertia, bias: Wrench, offset: Array) -> tuple[Inertia, Wrench]:
    """Move inertia and wrench from the joint to the parent's origin, ``-offset`` away."""
    shift = skew(offset)
    mixed = inertia.mixed + matmul(shift, inertia.linear)
    angular = symmetric(inertia.angular + matmul_t(shift, inertia.mixed) - matmul(mixed, shift))
    return (
        Inertia(angular, mixed, inertia.linear),
        Wrench(bias.moment + cross(offset, bias.force), bias.force),
    )


def _free_body(inertia: Inertia, bias: Wrench) -> tuple[Array, Array]:
    """Acceleration of a free body: ``I A = -p`` by eliminating the linear part."""
    linear_inverse = inverse_symmetric(inertia.linear)
    coupling = matmul(inertia.mixed, linear_inverse)
    schur = symmetric(inertia.angular - matmul_t(coupling, inertia.mixed))
    angular = matvec(inverse_symmetric(schur), matvec(coupling, bias.force) - bias.moment)
    linear = matvec(linear_inverse, -bias.force - matvec(transpose(inertia.mixed), angular))
    return angular, linear
