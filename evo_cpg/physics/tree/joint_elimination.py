"""Elimination of joints from the equations of their bodies (`evo_cpg.physics.tree.articulated`).

The kinds of joints are those of `evo_cpg.physics.tree.joints`.

| symbol | name |
|---|---|
| S_i | ``S``: motion of the body per rate of each degree of freedom |
| I^A_i, p^A_i | articulated-body inertia and bias wrench of the body on the joint |
| U, G, u | ``I^A S``, ``S^T I^A S + T`` and ``tau - S^T p^A`` |
| I^a_i, p^a_i | parts of I^A and p^A that the parent feels through the joint |
| ``K = G^-1 U^T`` | yielding of the joint to its parent's acceleration |
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import (
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
from evo_cpg.creature.creature import SPANNING
from evo_cpg.creature.tree import Group
from evo_cpg.native.fuse import symmetric
from evo_cpg.physics.tree.joints import Subspace, accelerated, momentum, torque_of
from evo_cpg.physics.tree.per_body import of_joints
from evo_cpg.physics.tree.spatial_algebra import Inertia, Motion, Wrench, make_inertia


class Condensed(NamedTuple):
    """Joints of a group, eliminated from the equations of their bodies.

    Attributes:
        inertia: I^a, the inertias that the parents feel.
        bias: p^a, the bias wrenches that the parents feel.
        yielding: K, the joints' yielding to accelerations of the parents.
        free: ``G^-1 u``: joint accelerations if the parents do not accelerate.
    """

    inertia: Inertia
    bias: Wrench
    yielding: Motion
    free: Array


def joints_of(
    group: Group,
    S: Subspace,
    torque: Float[Array, "d *n"],
    torque_derivative: Float[Array, "d *#n"],
) -> "Joints | Chain":
    """Return the joints of a group (see `evo_cpg.physics.tree.articulated.solve`).

    Args:
        group: the group.
        S: motion per rate of all degrees of freedom, ``(3, d, *n)``.
        torque: tau of all degrees of freedom.
        torque_derivative: the diagonal T.
    """
    own = S.of(group, torque.ndim - 1)
    tau, diagonal = (of_joints(x, group, torque.ndim - 1) for x in (torque, torque_derivative))
    if group.kind == "chain" or not group.axes:
        return Chain(own, tau, diagonal)
    identity = expand_dims_like(np.eye(group.axes), tau, tau.ndim + 1)
    if group.axes != SPANNING:
        return Joints(own, tau, identity * diagonal[None], None)
    to_q = _inverse_columns(own.angular)
    derivative = symmetric(t_matmul(to_q, diagonal[:, None] * to_q))
    return Joints(Subspace(identity), matvec_t(to_q, tau), derivative, to_q)


class Joints(NamedTuple):
    """Joints of a group that turn at one place, in their own coordinates x.

    For one or two axes x is ``q``. For three axes x is the rotation across the joint in world axes,
    and S is 1.

    Attributes:
        S: motion per rate of each degree of freedom, without linear parts.
        torque: tau, in the coordinates x.
        derivative: T, in the coordinates x.
        to_q: matrix from x to ``q``, or None if x is ``q``.
    """

    S: Subspace
    torque: Array
    derivative: Array
    to_q: Array | None

    def condensed(self, inertia: Inertia, bias: Wrench) -> Condensed:
        """Eliminate the joints: ``I^a = I^A - U K`` and ``p^a = p^A + K^T u``.

        If S is 1, U consists of the blocks (A, B^T) of I^A, and G is A + T. Then
        ``P = T G^-1 = 1 - A G^-1`` gives I^a a form without cancellation for a free joint.

        Args:
            inertia: I^A of the bodies.
            bias: p^A of the bodies.
        """
        axes = self.S.angular
        U = momentum(inertia, self.S)
        G_inverse = inverse_symmetric(t_matmul(axes, U.moment) + self.derivative)
        u = self.torque - torque_of(self.S, bias)
        K = Motion(matmul_t(G_inverse, U.moment), matmul_t(G_inverse, U.force))
        linear = inertia.linear - matmul(U.force, K.linear)
        if self.to_q is None:
            angular = inertia.angular - matmul(U.moment, K.angular)
            mixed = inertia.mixed - matmul(U.moment, K.linear)
        else:
            P = matmul(self.derivative, G_inverse)
            K = Motion(axes - transpose(P), K.linear)
            angular, mixed = matmul(P, inertia.angular), matmul(P, inertia.mixed)
        felt = make_inertia(angular, mixed, linear)
        moment, force = matvec_t(K.angular, u), matvec_t(K.linear, u)
        wrench = Wrench(bias.moment + moment, bias.force + force)
        return Condensed(felt, wrench, K, matvec(G_inverse, u))

    def accelerations(self, condensed: Condensed, motion: Motion) -> tuple[Motion, Array]:
        """Return the accelerations of the bodies, and of the joints in q, ``(k, bodies, ...)``.

        Args:
            condensed: result of the elimination.
            motion: accelerations of the bodies with locked joints.
        """
        K = condensed.yielding
        x = condensed.free - matvec(K.angular, motion.angular) - matvec(K.linear, motion.linear)
        moved = accelerated(motion, self.S, x)
        return moved, x if self.to_q is None else matvec(self.to_q, x)


class Chain(NamedTuple):
    """Joints of a group with any axes, eliminated one by one, the last axis first.

    The axes are those of a chain of bodies without mass whose origins coincide. G of one axis is a
    number. A weld has no axes.

    Attributes:
        S: motion per rate of each degree of freedom.
        torque: tau.
        derivative: the diagonal T.
    """

    S: Subspace
    torque: Array
    derivative: Array

    def condensed(self, inertia: Inertia, bias: Wrench) -> Condensed:
        """Eliminate the joints. The arguments are those of `Joints.condensed`."""
        found = []
        for k in reversed(range(len(self.torque))):
            S = self._axis(k)
            moment, force = (x[:, 0] for x in momentum(inertia, S))
            G = torque_of(S, Wrench(moment, force))[0] + self.derivative[k]
            G_inverse = (1.0 / G)[None]
            u = self.torque[k] - torque_of(S, bias)[0]
            K = Motion(G_inverse * moment, G_inverse * force)
            inertia = make_inertia(
                inertia.angular - moment[:, None] * K.angular[None],
                inertia.mixed - moment[:, None] * K.linear[None],
                inertia.linear - force[:, None] * K.linear[None],
            )
            bias = Wrench(bias.moment + K.angular * u[None], bias.force + K.linear * u[None])
            found.append((K, G_inverse[0] * u))
        yields = [K for K, _ in reversed(found)]
        angular, linear = (
            jnp.stack(x) if x else self.S.angular.swapaxes(0, 1)
            for x in ([K.angular for K in yields], [K.linear for K in yields])
        )
        free = jnp.stack([x for _, x in reversed(found)]) if found else self.torque
        return Condensed(inertia, bias, Motion(angular, linear), free)

    def accelerations(self, condensed: Condensed, motion: Motion) -> tuple[Motion, Array]:
        """Return the accelerations. The arguments are those of `Joints.accelerations`."""
        K, found = condensed.yielding, []
        for k in range(len(self.torque)):
            x = condensed.free[k] - dot(K.angular[k], motion.angular)
            x = x - dot(K.linear[k], motion.linear)
            motion = accelerated(motion, self._axis(k), x[None])
            found.append(x)
        return motion, jnp.stack(found) if found else condensed.free

    def _axis(self, k: int) -> Subspace:
        """Return one column of S."""
        return jax.tree.map(lambda x: x[:, k : k + 1], self.S)


def _inverse_columns(m: Float[Array, "3 3 *rest"]) -> Float[Array, "3 3 *rest"]:
    """Return the inverse of a matrix, with cross products of its columns as rows."""
    a, b, c = m[:, 0], m[:, 1], m[:, 2]
    rows = jnp.stack([cross(b, c), cross(c, a), cross(a, b)])
    return rows * (1.0 / dot(a, rows[0]))[None, None]
