"""Joints of a tree: frames across them, and their motion subspace.

A joint has up to six degrees of freedom, and a weld has none. There are three kinds (`Group.kind`):

- "turns": up to three axes through the origin of the joint's body, each in the frame after the
  preceding turns. S, the motion per rate, has no linear part.
- "ball": three axes that turn at once, with a rotation vector as coordinates.
- "chain": any other axes, such as slides and axes at their own places. S has a linear part.

Every recursion over a tree (`kinematics`, `articulated`, `generalized`, `statics`, contacts between
limbs) uses joints through these functions. Torques are in `evo_cpg.physics.tree.joint_torque`, and
`evo_cpg.physics.tree.joint_elimination` eliminates joints from the equations of bodies.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import (
    cross,
    dot,
    expand_dims_like,
    matmul,
    matvec,
    matvec_t,
    t_matmul,
)
from evo_cpg.creature.algebra.rotation import (
    axis_rotation,
    quaternion_product,
    quaternion_to_matrix,
    quaternion_to_rotation_vector,
    rotation_vector_to_quaternion,
)
from evo_cpg.creature.creature import SPANNING
from evo_cpg.creature.tree import Group, Tree
from evo_cpg.physics.tree.per_body import PerBody, in_dof_order, of_joints, take
from evo_cpg.physics.tree.spatial_algebra import (
    BodyMotion,
    Inertia,
    Motion,
    Wrench,
    motion_at_child,
    motion_product,
)

# Position.


def moved(
    tree: Tree, q: Float[Array, "d *n"], rate: Float[Array, "d *n"], h: float
) -> Float[Array, "d *n"]:
    """Return the coordinates after h seconds (negative: before) at constant rates."""
    return displaced(tree, q, h * rate)


def displaced(tree: Tree, q: Float[Array, "d *n"], x: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
    """Return coordinates displaced by x: angles and lengths add up, rotations of balls compose."""
    there, starts = q + x, _balls(tree)
    if not len(starts):
        return there
    rows = starts[None] + np.arange(SPANNING)[:, None]
    one, other = (
        rotation_vector_to_quaternion(jnp.stack([take(v, row, 0) for row in rows])) for v in (q, x)
    )
    return there.at[rows].set(quaternion_to_rotation_vector(quaternion_product(one, other)))


def _balls(tree: Tree) -> np.ndarray:
    """Return the first degree of freedom of each ball joint."""
    return np.flatnonzero(np.array(tree.dof_kinds) == "ball")[::SPANNING]


def local_frames(tree: Tree, q: Float[Array, "d *n"]) -> PerBody[Float[Array, "3 c *n"]]:
    """Return columns in the frame of every body's parent, for `placed`.

    They are the axes of the body's frame, then the joint's axes. A chain has its body's origin
    between them, and after them the vectors from the origin to the places of the axes. Joints with
    equal axes are computed together.
    """
    sine, cosine = jnp.sin(q), jnp.cos(q)
    alike: dict[tuple[Any, ...], list[int]] = {}
    own_groups = (tree.hanging, *tree.groups) if tree.hanging else tree.groups
    group_of = {i: group for group in own_groups for i in _range(group.bodies)}
    for body, group in sorted(group_of.items()):
        dofs, key = _dofs(group, body), [_key(tree.joint_orientation[:, :, body], body)]
        fixed = [tree.joint_axes[:, dofs]]
        if group.kind == "chain":
            assert tree.joint_places is not None
            fixed += [tree.joint_offset[:, body], tree.joint_places[:, dofs]]
        key += [_key(x, body) for x in fixed]
        alike.setdefault((group.kind, group.kinds, *key), []).append(body)
    frames = {}
    for (kind, *_), bodies in alike.items():
        first, group = bodies[0], group_of[bodies[0]]
        rows = np.array(
            [[_dofs(group_of[i], i).start + k for i in bodies] for k in range(group.axes)]
        )
        orientation = expand_dims_like(tree.joint_orientation[:, :, first], q, q.ndim + 2)
        columns = [orientation[:, j] for j in range(3)]
        own = tree.joint_axes[:, _dofs(group, first)]
        if kind == "ball":
            found = _rolled(columns, own, jnp.stack([take(q, row, 0) for row in rows]))
        elif kind == "chain":
            found = _shifted(tree, group, first, columns, q, rows)
        else:
            directions = []
            for k, row in enumerate(rows):
                columns, direction = _turn(
                    columns, own[:, k], take(sine, row, 0), take(cosine, row, 0)
                )
                directions.append(direction)
            found = columns + directions
        shape = (3, len(bodies), *q.shape[1:])
        packed = jnp.stack([jnp.broadcast_to(c, shape) for c in found], 1)
        frames.update(zip(bodies, jnp.unstack(packed, axis=2), strict=True))
    # A free root has no joint, so its frame is not used.
    values: list[Any] = [frames.get(body) for body in range(tree.body_count)]
    return PerBody(values, q.ndim - 1)


def _rolled(columns: list[Array], axes: Any, q: Float[Array, "3 b *n"]) -> list[Array]:
    """Return the columns of a ball joint's frame and axes."""
    frame = jnp.stack(jnp.broadcast_arrays(*columns), 1)
    basis = expand_dims_like(axes, q, q.ndim + 1)
    turn = quaternion_to_matrix(rotation_vector_to_quaternion(matvec(basis, q)))
    turned = matmul(frame, turn)
    directions = matmul(turned, basis)
    return [x[:, j] for x in (turned, directions) for j in range(3)]


def _shifted(
    tree: Tree,
    group: Group,
    body: int,
    columns: list[Array],
    q: Float[Array, "d *n"],
    rows: np.ndarray,
) -> list[Array]:
    """Return the columns of a chain's frame (see `local_frames`).

    Args:
        tree: the creature.
        group: the group of the body.
        body: the first of some bodies with equal axes.
        columns: axes of the frame in the neutral pose.
        q: all coordinates.
        rows: coordinates of the bodies, one row for each axis.
    """
    assert tree.joint_places is not None
    dofs = _dofs(group, body)
    origin = expand_dims_like(tree.joint_offset[:, body], q, q.ndim + 1)
    directions, places = [], []
    for k, kind in enumerate(group.kinds):
        axis, place = tree.joint_axes[:, dofs][:, k], tree.joint_places[:, dofs][:, k]
        value, frame = take(q, rows[k], 0), jnp.stack(jnp.broadcast_arrays(*columns), 1)
        arm = matvec(frame, expand_dims_like(place, q, q.ndim + 1))
        if kind == "turn":
            there = origin + arm
            columns, direction = _turn(columns, axis, jnp.sin(value), jnp.cos(value))
            frame = jnp.stack(jnp.broadcast_arrays(*columns), 1)
            origin = there - matvec(frame, expand_dims_like(place, q, q.ndim + 1))
        else:
            direction = matvec(frame, expand_dims_like(axis, q, q.ndim + 1))
            there, origin = origin, origin + direction * value[None]
        directions.append(direction)
        places.append(there)
    return [*columns, origin, *directions, *(place - origin for place in places)]


def placed(
    tree: Tree, group: Group, parent_rotation: Float[Array, "3 3 b *n"], local: Array
) -> tuple[Float[Array, "3 3 b *n"], Float[Array, "3 b *n"], "Subspace"]:
    """Return rotations, offsets from the parents' origins, and S of the bodies of a group.

    Args:
        tree: the creature.
        group: the group of bodies.
        parent_rotation: rotations of their parents.
        local: their columns from `local_frames`.
    """
    if group.kind != "chain":
        offset = matvec(
            parent_rotation, expand_dims_like(tree.joint_offset[:, group.bodies], local[:, 0])
        )
        frame = matmul(parent_rotation, local)
        return frame[:, :3], offset, Subspace(frame[:, 3:], None, group.kind == "ball")
    frame = matmul(parent_rotation, local)
    directions, arms = frame[:, 4 : 4 + group.axes], frame[:, 4 + group.axes :]
    none = jnp.zeros_like(directions[:, 0])
    turns = [kind == "turn" for kind in group.kinds]
    columns = [
        (directions[:, k], cross(arms[:, k], directions[:, k]))
        if turns[k]
        else (none, directions[:, k])
        for k in range(group.axes)
    ]
    angular, linear = (jnp.stack(x, 1) for x in zip(*columns, strict=True))
    return frame[:, :3], frame[:, 3], Subspace(angular, linear)


# Motion subspace.


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
        own = Subspace(self.angular, linear, group.kind == "ball")
        return jax.tree.map(lambda x: of_joints(x, group, batch_ndim), own)

    def take(self, dofs: np.ndarray) -> "Subspace":
        """Return the columns of some degrees of freedom."""
        return jax.tree.map(lambda x: take(x, dofs), self)


def subspace(parts: Sequence[Subspace], like: Float[Array, "3 *n"]) -> Subspace:
    """Return S of all degrees of freedom, ``(3, d, *n)``, from the parts of the groups.

    Args:
        parts: S of each group, in the order of the tree.
        like: vector with the shape of one column.
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

    Args:
        parent: motion of each body's parent, with the attributes of `BodyMotion`.
        offset: vectors from the parents' origins to the bodies' origins, m.
        S: motion per rate of each degree of freedom.
        rates: rates of the k degrees of freedom of each of b bodies, ``(k, b, *n)``.
    """
    if S.linear is not None or S.at_once or not S.angular.shape[1]:
        bias = Motion(parent.bias_angular, parent.bias_linear)
        velocity = motion_at_child(Motion(parent.angular, parent.linear), offset)
        bias = motion_at_child(bias, offset)
        for across in _one_after_the_other(S, rates):
            bias = jax.tree.map(jnp.add, bias, motion_product(velocity, across))
            velocity = jax.tree.map(jnp.add, velocity, across)
        return BodyMotion(*velocity, *bias)
    spin, spin_rate = _across(S.angular * rates[None])
    linear = parent.linear + cross(parent.angular, offset)
    return BodyMotion(
        parent.angular + spin,
        linear,
        parent.bias_angular + cross(parent.angular, spin) + spin_rate,
        parent.bias_linear + cross(parent.bias_angular, offset) + cross(linear, spin),
    )


def _one_after_the_other(S: Subspace, rates: Array) -> list[Motion]:
    """Return the motions across joints, of each axis, or of all axes that turn at once."""
    angular = S.angular * rates[None]
    linear = jnp.zeros_like(angular) if S.linear is None else S.linear * rates[None]
    if S.at_once:
        return [Motion(angular.sum(1), linear.sum(1))]
    return [Motion(angular[:, k], linear[:, k]) for k in range(angular.shape[1])]


def accelerated(motion: Motion, S: Subspace, x: Array) -> Motion:
    """Return the accelerations ``a + S x`` of bodies whose joints accelerate by x.

    Args:
        motion: a, accelerations of the bodies with locked joints.
        S: motion per rate of each degree of freedom.
        x: accelerations of the degrees of freedom, ``(k, b, *n)``.
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

    Args:
        S: motion per rate of each degree of freedom, ``(3, k, *n)``.
        wrench: wrenches about the origin of the joint's body.
        which: indices of the wrenches, or None for all in order.
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


def momentum_of_each(inertia: Inertia, S: Subspace) -> Wrench:
    """Return ``I S``, with an inertia for each degree of freedom: d wrenches."""
    found = momentum(inertia, jax.tree.map(lambda x: x[:, None], S))
    return Wrench(found.moment[:, 0], found.force[:, 0])


def speed_along(
    S: Subspace, offset: Float[Array, "3 p d *n"], normal: Float[Array, "3 p *n"]
) -> Float[Array, "p d *n"]:
    """Return the speed of points along their normals, per rate of each degree of freedom.

    Args:
        S: motion per rate of each degree of freedom, ``(3, d, *n)``.
        offset: vectors from the origins of the joints' bodies to the points, m.
        normal: unit normals.
    """
    along = jnp.broadcast_to(normal[:, :, None], offset.shape)
    speed = dot(S.angular[:, None], cross(offset, along))
    return speed if S.linear is None else speed + dot(S.linear[:, None], along)


def about(
    S: Subspace, origins: Float[Array, "3 d *n"]
) -> tuple[Float[Array, "3 d *n"], Float[Array, "3 d *n"]]:
    """Return the motion S about a common point: angular parts, and minus the linear parts.

    Args:
        S: motion per rate of each degree of freedom, ``(3, d, *n)``.
        origins: vectors from the common point to the origins of the joints' bodies, m.
    """
    moments = cross(S.angular, origins)
    return S.angular, moments if S.linear is None else moments - S.linear


def _range(bodies: slice) -> range:
    return range(bodies.start, bodies.stop)


def _dofs(group: Group, body: int) -> slice:
    """Return the degrees of freedom of a body of a group."""
    start = group.dofs.start + (body - group.bodies.start) * group.axes
    return slice(start, start + group.axes)


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
