"""Motion subspace S of joints: motion of bodies per rate of each degree of freedom.

A joint has up to six degrees of freedom, and a weld has none. Every recursion over a tree
(`kinematics`, `articulated`, `generalized`, `statics`, contacts between limbs) uses S through these
functions. Frames and elimination depend on the kind of the joint, and are in
`evo_cpg.physics.tree.joint_kinds`. Torques are in `evo_cpg.physics.tree.joint_torque`.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import cross, dot, matmul, matvec, matvec_t, t_matmul
from evo_cpg.creature.tree import Group
from evo_cpg.physics.tree.per_body import in_dof_order, of_joints, take
from evo_cpg.physics.tree.spatial_algebra import (
    BodyMotion,
    Inertia,
    Motion,
    Wrench,
    motion_at_child,
    motion_product,
)


class Subspace(eqx.Module):
    """S: motion of bodies per rate of each degree of freedom, at the bodies' origins.

    Attributes:
        angular: angular parts, in the world, ``(3, k, ..., *n)``.
        linear: linear parts, in the world, or None if all are zero.
        at_once: whether the axes turn at once, and not one after the other.
    """

    angular: Array
    linear: Array | None = None
    at_once: bool = eqx.field(static=True, default=False)

    def of(self, group: Group, batch_ndim: int) -> "Subspace":
        """Return a group's part ``(3, k, b, *n)`` of a subspace of all degrees of freedom."""
        linear = self.linear if group.kind == "chain" else None
        own = Subspace(self.angular, linear, group.at_once)
        return jax.tree.map(lambda x: of_joints(x, group, batch_ndim), own)

    def take(self, dofs: np.ndarray) -> "Subspace":
        """Return the columns of some degrees of freedom."""
        return jax.tree.map(lambda x: take(x, dofs), self)


def subspace(parts: Sequence[Subspace], like: Float[Array, "3 *n"]) -> Subspace:
    """Return S of all degrees of freedom, ``(3, d, *n)``, from the parts of the groups.

    ``like`` has the shape of one column.
    """
    none, batch_ndim = jnp.zeros((3, 0, *like.shape[1:]), like.dtype), like.ndim - 1
    angular = [in_dof_order(S.angular, batch_ndim) for S in parts]
    if all(S.linear is None for S in parts):
        return Subspace(jnp.concatenate([none, *angular], 1))
    linear = [
        jnp.zeros_like(turning) if S.linear is None else in_dof_order(S.linear, batch_ndim)
        for S, turning in zip(parts, angular, strict=True)
    ]
    return Subspace(jnp.concatenate([none, *angular], 1), jnp.concatenate([none, *linear], 1))


def carried(parent: Any, offset: Float[Array, "3 b *n"], S: Subspace, rates: Array) -> BodyMotion:
    """Return the motion of bodies that their parents carry and their joints move.

    The axes of a joint move the body one after the other. Each adds ``v x S_k qd_k`` to the
    acceleration, with the motion v before it.

    The offsets lead from the parents' origins to the bodies', m. The rates are ``(k, b, *n)``.
    """
    if S.linear is not None or S.at_once or not S.angular.shape[1]:
        bias = Motion(parent.bias_angular, parent.bias_linear)
        velocity = motion_at_child(Motion(parent.angular, parent.linear), offset)
        bias = motion_at_child(bias, offset)
        turning = S.angular * rates[None]
        moving = jnp.zeros_like(turning) if S.linear is None else S.linear * rates[None]
        if S.at_once:
            each = [Motion(turning.sum(1), moving.sum(1))]
        else:
            each = [Motion(turning[:, k], moving[:, k]) for k in range(len(rates))]
        for across in each:
            bias = jax.tree.map(jnp.add, bias, motion_product(velocity, across))
            velocity = jax.tree.map(jnp.add, velocity, across)
        return BodyMotion(*velocity, *bias)
    # Angular velocity across each joint, and its rate of change seen from the parent.
    turning = S.angular * rates[None]
    spin = turning[:, 0]
    spin_rate = jnp.zeros_like(spin)
    for k in range(1, len(rates)):
        spin_rate = spin_rate + cross(spin, turning[:, k])
        spin = spin + turning[:, k]
    linear = parent.linear + cross(parent.angular, offset)
    return BodyMotion(
        parent.angular + spin,
        linear,
        parent.bias_angular + cross(parent.angular, spin) + spin_rate,
        parent.bias_linear + cross(parent.bias_angular, offset) + cross(linear, spin),
    )


def accelerated(motion: Motion, S: Subspace, x: Array) -> Motion:
    """Return the accelerations ``a + S x`` of bodies whose joints accelerate by x.

    ``a`` is the accelerations of the bodies with locked joints.
    """
    angular, linear = motion.angular + matvec(S.angular, x), motion.linear
    return Motion(angular, linear if S.linear is None else linear + matvec(S.linear, x))


def torque_of(S: Subspace, wrench: Wrench) -> Float[Array, "k b *n"]:
    """Return ``S^T f`` of wrenches on bodies, N m or N."""
    torque = matvec_t(S.angular, wrench.moment)
    return torque if S.linear is None else torque + matvec_t(S.linear, wrench.force)


def torque_on_each(
    S: Subspace, wrench: Wrench, which: np.ndarray | None = None
) -> Float[Array, "k *n"]:
    """Return ``S^T f``, with a wrench for each degree of freedom.

    S is ``(3, k, *n)``. ``which`` is the index of each wrench, by default all in order.
    """
    if which is not None:
        wrench = Wrench(*(take(x, which) for x in wrench))
    torque = dot(S.angular, wrench.moment)
    return torque if S.linear is None else torque + dot(S.linear, wrench.force)


def momentum(inertia: Inertia, S: Subspace) -> Wrench:
    """Return ``I S``: k wrenches."""
    moment, force = matmul(inertia.angular, S.angular), t_matmul(inertia.mixed, S.angular)
    if S.linear is None:
        return Wrench(moment, force)
    return Wrench(
        moment + matmul(inertia.mixed, S.linear), force + matmul(inertia.linear, S.linear)
    )


def about(
    S: Subspace, origins: Float[Array, "3 d *n"]
) -> tuple[Float[Array, "3 d *n"], Float[Array, "3 d *n"]]:
    """Return the motion S about a common point: angular parts, and minus the linear parts.

    The origins of the joints' bodies count from the common point, m.
    """
    moments = cross(S.angular, origins)
    return S.angular, moments if S.linear is None else moments - S.linear
