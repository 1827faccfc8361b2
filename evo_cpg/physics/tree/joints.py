"""Motion subspace S of joints: motion of bodies per rate of each degree of freedom.

A joint has up to six degrees of freedom, and a weld has none. Every recursion over a tree
(`kinematics`, `articulated`, `generalized`, `statics`, contacts between limbs) uses S through these
functions. Frames and elimination depend on the kind of the joint, and are in
`evo_cpg.physics.tree.joint_kinds`. Torques are in `evo_cpg.physics.tree.joint_torque`.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import cross, dot, matmul, matvec, matvec_t, t_matmul
from evo_cpg.creature.per_body import of_joints, take
from evo_cpg.creature.tree import Group
from evo_cpg.physics.tree.spatial_algebra import (
    BodyMotion,
    Inertia,
    Motion,
    Wrench,
    motion_at_child,
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
            turned = cross(velocity.angular, across.linear) + cross(velocity.linear, across.angular)
            product = Motion(cross(velocity.angular, across.angular), turned)
            bias = jax.tree.map(jnp.add, bias, product)
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
    S: Subspace, wrench: Wrench, which: tuple[np.ndarray, np.ndarray] | None = None
) -> Float[Array, "k *n"]:
    """Return ``S^T f``, with a wrench for each degree of freedom.

    S is ``(3, k, *n)``. ``which`` are the indices of the degree of freedom and the wrench of each
    product, by default all in order.
    """
    if which is not None:
        S = jax.tree.map(lambda x: take(x, which[0]), S)
        wrench = Wrench(*(take(x, which[1]) for x in wrench))
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
