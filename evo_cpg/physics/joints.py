"""Joints of a tree: frames across them, their motion subspace, and their elimination.

A joint has up to three degrees of freedom, and a weld has none. Each one turns about an axis
through the origin of the joint's body, in the frame after the preceding turns. So its world axis
defines a degree of freedom, and S, the motion per rate, has no linear part.

Every recursion over a tree (`kinematics`, `articulated`, `generalized`, `statics`, contacts between
limbs) uses joints through these functions. Torques are in `evo_cpg.physics.joint_torque`.

| symbol | name |
|---|---|
| S_i | ``axes``: world axes of the degrees of freedom |
| I^A_i, p^A_i | articulated-body inertia and bias wrench of the body on the joint |
| U, G, u | ``I^A S``, ``S^T I^A S + T`` and ``tau - S^T p^A`` |
| I^a_i, p^a_i | parts of I^A and p^A that the parent feels through the joint |
| ``K = G^-1 U^T`` | yielding of the joint to its parent's acceleration |
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Group, Tree
from evo_cpg.fusion.fuse import symmetric
from evo_cpg.physics.per_body import PerBody, of_joints, take
from evo_cpg.physics.spatial_algebra import (
    BodyMotion,
    Inertia,
    Motion,
    Wrench,
    make_inertia,
    motion_at_child,
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
from evo_cpg.spatial.rotation import axis_rotation

# Number of axes of a joint that can turn in any direction.
_BALL_AXES = 3


# Position.


def moved(q: Float[Array, "d *n"], rate: Float[Array, "d *n"], h: float) -> Float[Array, "d *n"]:
    """Return the joint angles after h seconds (negative: before) at constant rates."""
    return q + h * rate


def displaced(q: Float[Array, " d"], x: Float[Array, " d"]) -> Float[Array, " d"]:
    """Return joint angles displaced by the joints' static coordinates x."""
    return q + x


def local_frames(tree: Tree, q: Float[Array, "d *n"]) -> PerBody[Float[Array, "3 c *n"]]:
    """Return columns: every body's rotation to its parent, then joint axes in the parent's frame.

    Joints with equal axes are computed together.
    """
    sine, cosine = jnp.sin(q), jnp.cos(q)
    alike: dict[tuple[bytes | int, bytes | int], list[int]] = {}
    first_dof = {body: i for i, body in reversed(list(enumerate(tree.dof_bodies)))}
    axis_count = np.bincount(tree.dof_bodies, minlength=tree.body_count)
    for body in range(0 if tree.hanging else 1, tree.body_count):
        dof = first_dof.get(body, 0)
        axes = tree.joint_axes[:, dof : dof + axis_count[body]]
        orientation = tree.joint_orientation[:, :, body]
        alike.setdefault((_key(axes, body), _key(orientation, body)), []).append(body)
    frames = {}
    for bodies in alike.values():
        dof, count = first_dof.get(bodies[0], 0), axis_count[bodies[0]]
        orientation = expand_dims_like(tree.joint_orientation[:, :, bodies[0]], q, q.ndim + 2)
        columns = [orientation[:, j] for j in range(3)]
        directions = []
        for k in range(count):
            dofs = np.array([first_dof[body] + k for body in bodies])
            columns, direction = _turn(
                columns, tree.joint_axes[:, dof + k], take(sine, dofs, 0), take(cosine, dofs, 0)
            )
            directions.append(direction)
        shape = (3, len(bodies), *q.shape[1:])
        packed = jnp.stack([jnp.broadcast_to(c, shape) for c in columns + directions], 1)
        frames.update(zip(bodies, jnp.unstack(packed, axis=2), strict=True))
    # A free root has no joint, so its frame is not used.
    values: list[Any] = [frames.get(0), *(frames[body] for body in range(1, tree.body_count))]
    return PerBody(values, q.ndim - 1)


def world_frames(
    parent_rotation: Float[Array, "3 3 b *n"], local: Float[Array, "3 c b *n"]
) -> tuple[Float[Array, "3 3 b *n"], Float[Array, "3 k b *n"]]:
    """Return the rotations and the world axes of bodies from `local_frames`."""
    frame = matmul(parent_rotation, local)
    return frame[:, :3], frame[:, 3:]


# Motion subspace.


def carried(
    parent: Any, offset: Float[Array, "3 b *n"], axes: Float[Array, "3 k b *n"], rates: Array
) -> BodyMotion:
    """Return the motion of bodies that their parents carry and their joints turn.

    Args:
        parent: motion of each body's parent, with the attributes of `BodyMotion`.
        offset: vectors from the parents' origins to the bodies' origins, m.
        axes: S, world axes of the degrees of freedom.
        rates: rates of the k degrees of freedom of each of b bodies, ``(k, b, *n)``, rad/s.
    """
    if not axes.shape[1]:
        bias = Motion(parent.bias_angular, parent.bias_linear)
        return BodyMotion(
            *motion_at_child(Motion(parent.angular, parent.linear), offset),
            *motion_at_child(bias, offset),
        )
    spin, spin_rate = _across(axes * rates[None])
    linear = parent.linear + cross(parent.angular, offset)
    return BodyMotion(
        parent.angular + spin,
        linear,
        parent.bias_angular + cross(parent.angular, spin) + spin_rate,
        parent.bias_linear + cross(parent.bias_angular, offset) + cross(linear, spin),
    )


def accelerated(motion: Motion, axes: Float[Array, "3 k b *n"], x: Array) -> Motion:
    """Return the accelerations ``a + S x`` of bodies whose joints accelerate by x.

    Args:
        motion: a, accelerations of the bodies with locked joints.
        axes: S, world axes of the degrees of freedom.
        x: accelerations of the degrees of freedom, ``(k, b, *n)``.
    """
    return motion._replace(angular=motion.angular + matvec(axes, x))


def torque_of(axes: Float[Array, "3 k b *n"], wrench: Wrench) -> Float[Array, "k b *n"]:
    """Return ``S^T f`` of wrenches on bodies, N m."""
    return matvec_t(axes, wrench.moment)


def torque_on_each(
    axes: Float[Array, "3 k *n"], wrench: Wrench, which: np.ndarray | None = None
) -> Float[Array, "k *n"]:
    """Return ``S^T f``, with a wrench for each degree of freedom.

    Args:
        axes: S, world axes of the degrees of freedom.
        wrench: wrenches about the origin of the joint's body.
        which: indices of the wrenches, or None for all in order.
    """
    return dot(axes, wrench.moment if which is None else take(wrench.moment, which))


def momentum(inertia: Inertia, axes: Float[Array, "3 k *rest"]) -> Wrench:
    """Return ``I S``: k wrenches."""
    return Wrench(matmul(inertia.angular, axes), t_matmul(inertia.mixed, axes))


def momentum_of_each(inertia: Inertia, axes: Float[Array, "3 d *n"]) -> Wrench:
    """Return ``I S``, with an inertia for each degree of freedom: d wrenches."""
    found = momentum(inertia, axes[:, None])
    return Wrench(found.moment[:, 0], found.force[:, 0])


def speed_along(
    axes: Float[Array, "3 d *n"], offset: Float[Array, "3 p d *n"], normal: Float[Array, "3 p *n"]
) -> Float[Array, "p d *n"]:
    """Return the speed of points along their normals, per rate of each degree of freedom.

    Args:
        axes: S, world axes of the degrees of freedom.
        offset: vectors from the origins of the joints' bodies to the points, m.
        normal: unit normals.
    """
    lever = cross(offset, jnp.broadcast_to(normal[:, :, None], offset.shape))
    return dot(axes[:, None], lever)


def about(
    axes: Float[Array, "3 d *n"], origins: Float[Array, "3 d *n"]
) -> tuple[Float[Array, "3 d *n"], Float[Array, "3 d *n"]]:
    """Return the motion S about a common point: angular parts, and minus the linear parts.

    Args:
        axes: S, world axes of the degrees of freedom.
        origins: vectors from the common point to the origins of the joints' bodies, m.
    """
    return axes, cross(axes, origins)


# Elimination.


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


class Joints(NamedTuple):
    """Joints of a group, in their own coordinates x.

    For one or two axes x is ``q``. For three axes x is the rotation across the joint in world axes,
    and S is 1.

    Attributes:
        axes: S, world axes of the degrees of freedom, (3, k, bodies, ...).
        torque: tau, in the coordinates x.
        derivative: T, in the coordinates x.
        to_q: matrix from x to ``q``, or None if x is ``q``.
    """

    axes: Array
    torque: Array
    derivative: Array
    to_q: Array | None

    @classmethod
    def of(
        cls,
        group: Group,
        axes: Float[Array, "3 d *n"],
        torque: Float[Array, "d *n"],
        torque_derivative: Float[Array, "d *n"],
    ) -> "Joints":
        """Return the joints of a group (see `evo_cpg.physics.articulated.solve`)."""
        axes, tau, diagonal = (
            of_joints(x, group, torque.ndim - 1) for x in (axes, torque, torque_derivative)
        )
        identity = expand_dims_like(np.eye(group.axes), tau, tau.ndim + 1)
        if group.axes != _BALL_AXES:
            return cls(axes, tau, identity * diagonal[None], None)
        to_q = _inverse_columns(axes)
        derivative = symmetric(t_matmul(to_q, diagonal[:, None] * to_q))
        return cls(identity, matvec_t(to_q, tau), derivative, to_q)

    def condensed(self, inertia: Inertia, bias: Wrench) -> Condensed:
        """Eliminate the joints: ``I^a = I^A - U K`` and ``p^a = p^A + K^T u``.

        If S is 1, U consists of the blocks (A, B^T) of I^A, and G is A + T. Then
        ``P = T G^-1 = 1 - A G^-1`` gives I^a a form without cancellation for a free joint.

        Args:
            inertia: I^A of the bodies.
            bias: p^A of the bodies.
        """
        if not self.axes.shape[1]:
            return Condensed(inertia, bias, Motion(self.axes, self.axes), self.torque)
        U = momentum(inertia, self.axes)
        G_inverse = inverse_symmetric(t_matmul(self.axes, U.moment) + self.derivative)
        u = self.torque - torque_of(self.axes, bias)
        K = Motion(matmul_t(G_inverse, U.moment), matmul_t(G_inverse, U.force))
        linear = inertia.linear - matmul(U.force, K.linear)
        if self.to_q is None:
            angular = inertia.angular - matmul(U.moment, K.angular)
            mixed = inertia.mixed - matmul(U.moment, K.linear)
        else:
            P = matmul(self.derivative, G_inverse)
            K = Motion(self.axes - transpose(P), K.linear)
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
        if not self.axes.shape[1]:
            return motion, condensed.free
        K = condensed.yielding
        x = condensed.free - matvec(K.angular, motion.angular) - matvec(K.linear, motion.linear)
        moved = accelerated(motion, self.axes, x)
        return moved, x if self.to_q is None else matvec(self.to_q, x)


def _inverse_columns(m: Float[Array, "3 3 *rest"]) -> Float[Array, "3 3 *rest"]:
    """Return the inverse of a matrix, with cross products of its columns as rows."""
    a, b, c = m[:, 0], m[:, 1], m[:, 2]
    rows = jnp.stack([cross(b, c), cross(c, a), cross(a, b)])
    return rows * (1.0 / dot(a, rows[0]))[None, None]


def _key(values: Any, body: int) -> bytes | int:
    """Return a key that equal values share. Traced values have a key for each body."""
    return values.tobytes() if isinstance(values, np.ndarray) else body


def _turn(
    columns: list[Array], axis: np.ndarray | Array, sine: Array, cosine: Array
) -> tuple[list[Array], Array]:
    """Turn a frame, given by its columns, about one of its own axes, and return the axis, too."""
    if not isinstance(axis, np.ndarray) or np.count_nonzero(axis) > 1:
        frame = jnp.stack(jnp.broadcast_arrays(*columns), 1)
        turned = matmul(frame, axis_rotation(axis, sine, cosine))
        return [turned[:, j] for j in range(3)], matvec(frame, expand_dims_like(axis, frame[0]))
    along = int(np.abs(axis).argmax())
    i, j = (along + 1) % 3, (along + 2) % 3
    # A Python float keeps the arrays' precision. A NumPy float would turn float32 into float64.
    direction = float(axis[along])
    sine, cosine = sine[None] * direction, cosine[None]
    turned = list(columns)
    turned[i] = cosine * columns[i] + sine * columns[j]
    turned[j] = cosine * columns[j] - sine * columns[i]
    return turned, columns[along] * direction


def _across(rates: Float[Array, "3 axes bodies *n"]) -> tuple[Array, Array]:
    """Return the angular velocity across each joint, and its rate of change seen from the parent.

    Args:
        rates: rate of each degree of freedom along its axis, rad/s.
    """
    spin = rates[:, 0]
    spin_rate = jnp.zeros_like(spin)
    for k in range(1, rates.shape[1]):
        spin_rate = spin_rate + cross(spin, rates[:, k])
        spin = spin + rates[:, k]
    return spin, spin_rate
