"""Kinds of joints: their frames, their motion subspace, and their elimination from the equations.

| kind | axes | elimination |
|---|---|---|
| `Weld` | none | |
| `Turns` | up to three through the origin of the joint's body, one after the other | at once |
| `SomeTurns` | any of up to three axes of the body's frame | at once |
| `Ball` | three that turn at once, with a rotation vector as coordinates | at once |
| `AxisChain` | any others, such as slides and axes at their own places | one by one |

Each kind has the same functions, so that the recursions name no kind. S has a linear part
only for chains, whose axes state what they do (`evo_cpg.creature.axis_kinds.AxisKind`). Symbols of
the elimination (`evo_cpg.physics.tree.articulated`):

| symbol | name |
|---|---|
| S_i | ``S``: motion of the body per rate of each degree of freedom |
| I^A_i, p^A_i | articulated-body inertia and bias wrench of the body on the joint |
| U, G, u | ``I^A S``, ``S^T I^A S + T`` and ``tau - S^T p^A`` |
| I^a_i, p^a_i | parts of I^A and p^A that the parent feels through the joint |
| ``K = G^-1 U^T`` | yielding of the joint to its parent's acceleration |
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

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
)
from evo_cpg.creature.algebra.rotation import (
    axis_rotation,
    half_rotation_to_quaternion,
    quaternion_product,
    quaternion_to_matrix,
    quaternion_to_rotation_vector,
)
from evo_cpg.creature.axis_kinds import SPANNING
from evo_cpg.creature.per_body import PerBody, of_joints, take
from evo_cpg.creature.tree import Group, Tree
from evo_cpg.native.fuse import symmetric
from evo_cpg.physics.tree.joints import Subspace, accelerated, carried, momentum, torque_of
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


class AtOnce(NamedTuple):
    """Joints of a group that turn at one place, eliminated at once in their own coordinates x.

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
            K = Motion(axes - jnp.swapaxes(P, 0, 1), K.linear)
            angular, mixed = matmul(P, inertia.angular), matmul(P, inertia.mixed)
        felt = make_inertia(angular, mixed, linear)
        moment, force = matvec_t(K.angular, u), matvec_t(K.linear, u)
        wrench = Wrench(bias.moment + moment, bias.force + force)
        return Condensed(felt, wrench, K, matvec(G_inverse, u))

    def accelerations(self, condensed: Condensed, motion: Motion) -> tuple[Motion, Array]:
        """Return the accelerations of the bodies, and of the joints in q, ``(k, bodies, ...)``.

        The motion is that of the bodies with locked joints.
        """
        K = condensed.yielding
        x = condensed.free - matvec(K.angular, motion.angular) - matvec(K.linear, motion.linear)
        moved = accelerated(motion, self.S, x)
        return moved, x if self.to_q is None else matvec(self.to_q, x)


class OneByOne(NamedTuple):
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
        """Eliminate the joints. The arguments are those of `AtOnce.condensed`."""
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
        """Return the accelerations. The arguments are those of `AtOnce.accelerations`."""
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


class _Coordinates(NamedTuple):
    """Coordinates of a tree, with their sines and cosines, which are computed together."""

    q: Float[Array, "d *n"]
    sine: Float[Array, "d *n"]
    cosine: Float[Array, "d *n"]


class Turns:
    """Up to three rotations at one place, each about an axis in the frame after those before it."""

    def columns(
        self, tree: Tree, group: Group, body: int, frame: list[Array], x: _Coordinates, rows: Any
    ) -> list[Array]:
        """Return columns in the frame of the parents of bodies, for `placed`.

        Args:
            tree: the creature.
            group: the group of the body.
            body: the first of some bodies with equal axes.
            frame: axes of the bodies' frame in the neutral pose, as columns.
            x: coordinates of the tree.
            rows: coordinates of the bodies, one row for each axis.

        Returns:
            The axes of the bodies' frame, then the joint's axes.
        """
        own, directions = tree.joint_axes[:, dofs_of(group, body)], []
        for k, row in enumerate(rows):
            frame, direction = _turned(
                frame, own[:, k], take(x.sine, row, 0), take(x.cosine, row, 0)
            )
            directions.append(direction)
        return frame + directions

    def placed(
        self, tree: Tree, group: Group, parent_rotation: Array, local: Array
    ) -> tuple[Float[Array, "3 3 b *n"], Float[Array, "3 b *n"], Subspace]:
        """Return rotations, offsets from the parents' origins, and S of the bodies of a group.

        ``local`` are their `columns`.
        """
        offset = expand_dims_like(tree.joint_offset[:, group.bodies], local[:, 0])
        offset, frame = matvec(parent_rotation, offset), matmul(parent_rotation, local)
        return frame[:, :3], offset, Subspace(frame[:, 3:], None, group.at_once)

    def elimination(self, S: Subspace, torque: Array, diagonal: Array) -> AtOnce | OneByOne:
        """Return the joints of a group in the form that eliminates them."""
        axes = len(torque)
        identity = expand_dims_like(np.eye(axes), torque, torque.ndim + 1)
        if axes != SPANNING:
            return AtOnce(S, torque, identity * diagonal[None], None)
        # The inverse of the axes has cross products of its columns as rows.
        a, b, c = S.angular[:, 0], S.angular[:, 1], S.angular[:, 2]
        rows = jnp.stack([cross(b, c), cross(c, a), cross(a, b)])
        to_q = rows * (1.0 / dot(a, rows[0]))[None, None]
        derivative = symmetric(t_matmul(to_q, diagonal[:, None] * to_q))
        return AtOnce(Subspace(identity), matvec_t(to_q, torque), derivative, to_q)


class Ball(Turns):
    """A rotation in any direction. Its coordinates are components of a rotation vector."""

    @override
    def columns(
        self, tree: Tree, group: Group, body: int, frame: list[Array], x: _Coordinates, rows: Any
    ) -> list[Array]:
        q = jnp.stack([take(x.q, row, 0) for row in rows])
        neutral = jnp.stack(jnp.broadcast_arrays(*frame), 1)
        basis = expand_dims_like(tree.joint_axes[:, dofs_of(group, body)], q, q.ndim + 1)
        turn = quaternion_to_matrix(half_rotation_to_quaternion(0.5 * matvec(basis, q)))
        turned = matmul(neutral, turn)
        directions = matmul(turned, basis)
        return [x[:, j] for x in (turned, directions) for j in range(3)]


class SomeTurns(Turns):
    """Turns about axes of the body's frame, of which an individual may have some only (`TreeWalk`).

    An absent axis moves nothing. It has an armature of 1 and no torque, so the elimination passes
    it unchanged.
    """

    @override
    def columns(
        self, tree: Tree, group: Group, body: int, frame: list[Array], x: _Coordinates, rows: Any
    ) -> list[Array]:
        assert tree.walk is not None
        signs = expand_dims_like(tree.walk.turns, x.q)
        found = super().columns(tree, group, body, frame, x._replace(sine=signs * x.sine), rows)
        own = [take(signs, row, 0)[None] for row in rows]
        directions = [column * sign for column, sign in zip(found[3:], own, strict=True)]
        return found[:3] + directions

    @override
    def elimination(self, S: Subspace, torque: Array, diagonal: Array) -> AtOnce:
        identity = expand_dims_like(np.eye(len(torque)), torque, torque.ndim + 1)
        return AtOnce(S, torque, identity * diagonal[None], None)


class Weld(Turns):
    """A joint without axes. It has no equations, and one by one nothing is eliminated."""

    @override
    def elimination(self, S: Subspace, torque: Array, diagonal: Array) -> OneByOne:
        return OneByOne(S, torque, diagonal)


class AxisChain(Weld):
    """Any axes. Each turns the body about itself or carries it along itself, or both."""

    @override
    def columns(
        self, tree: Tree, group: Group, body: int, frame: list[Array], x: _Coordinates, rows: Any
    ) -> list[Array]:
        """Return the columns.

        The body's origin is between the frame and the axes. Behind them are the vectors from the
        origin to the places of the axes.
        """
        assert tree.joint_places is not None
        dofs, like = dofs_of(group, body), x.q.ndim + 1
        origin = expand_dims_like(tree.joint_offset[:, body], x.q, like)
        directions, places = [], []
        for k, kind in enumerate(group.kinds):
            value, axis = take(x.q, rows[k], 0), tree.joint_axes[:, dofs][:, k]
            there, neutral = origin, jnp.stack(jnp.broadcast_arrays(*frame), 1)
            if kind.rotation:
                place = expand_dims_like(tree.joint_places[:, dofs][:, k], x.q, like)
                there = origin + matvec(neutral, place)
                frame, direction = _turned(frame, axis, jnp.sin(value), jnp.cos(value))
                origin = there - matvec(jnp.stack(jnp.broadcast_arrays(*frame), 1), place)
            else:
                direction = matvec(neutral, expand_dims_like(axis, x.q, like))
            if kind.translation:
                origin = origin + direction * (kind.translation * value)[None]
            directions.append(direction)
            places.append(there)
        return [*frame, origin, *directions, *(place - origin for place in places)]

    @override
    def placed(
        self, tree: Tree, group: Group, parent_rotation: Array, local: Array
    ) -> tuple[Float[Array, "3 3 b *n"], Float[Array, "3 b *n"], Subspace]:
        frame = matmul(parent_rotation, local)
        directions, arms = frame[:, 4 : 4 + group.axes], frame[:, 4 + group.axes :]
        angular, linear = [], []
        for k, kind in enumerate(group.kinds):
            along = directions[:, k]
            angular.append(along if kind.rotation else jnp.zeros_like(along))
            moving = [cross(arms[:, k], along)] if kind.rotation else []
            moving += [kind.translation * along] if kind.translation else []
            linear.append(sum(moving[1:], moving[0]))
        return frame[:, :3], frame[:, 3], Subspace(jnp.stack(angular, 1), jnp.stack(linear, 1))


_KINDS = {
    "weld": Weld(),
    "turns": Turns(),
    "some turns": SomeTurns(),
    "ball": Ball(),
    "chain": AxisChain(),
}


def displaced(tree: Tree, q: Float[Array, "d *n"], x: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
    """Return coordinates displaced by x: angles and lengths add up, rotations of balls compose."""
    there = q + x
    if not tree.balls:
        return there
    rows = np.array(tree.balls)[None] + np.arange(SPANNING)[:, None]
    one, other = (
        half_rotation_to_quaternion(0.5 * jnp.stack([take(v, row, 0) for row in rows]))
        for v in (q, x)
    )
    return there.at[rows].set(quaternion_to_rotation_vector(quaternion_product(one, other)))


def local_frames(tree: Tree, q: Float[Array, "d *n"]) -> PerBody[Float[Array, "3 c *n"]]:
    """Return columns in the frame of every body's parent, for `linked` (see `Turns.columns`).

    Joints with equal axes are computed together.
    """
    x = _Coordinates(q, jnp.sin(q), jnp.cos(q))
    alike: dict[tuple[Any, ...], list[int]] = {}
    groups = (tree.hanging, *tree.groups) if tree.hanging else tree.groups
    group_of = {
        body: group for group in groups for body in range(group.bodies.start, group.bodies.stop)
    }
    for body, group in sorted(group_of.items()):
        dofs = dofs_of(group, body)
        fixed = [tree.joint_orientation[:, :, body], tree.joint_axes[:, dofs]]
        if group.kind == "chain":
            assert tree.joint_places is not None
            fixed += [tree.joint_offset[:, body], tree.joint_places[:, dofs]]
        # Equal arrays are equal bytes. Traced values differ from body to body.
        key = [x.tobytes() if isinstance(x, np.ndarray) else body for x in fixed]
        alike.setdefault((group.kind, group.kinds, *key), []).append(body)
    frames = {}
    for (kind, *_), bodies in alike.items():
        first, group = bodies[0], group_of[bodies[0]]
        starts = [dofs_of(group_of[body], body).start for body in bodies]
        rows = np.array([[start + k for start in starts] for k in range(group.axes)])
        neutral = expand_dims_like(tree.joint_orientation[:, :, first], q, q.ndim + 2)
        columns = [neutral[:, j] for j in range(3)]
        found = _KINDS[kind].columns(tree, group, first, columns, x, rows)
        shape = (3, len(bodies), *q.shape[1:])
        packed = jnp.stack([jnp.broadcast_to(c, shape) for c in found], 1)
        frames.update(zip(bodies, jnp.unstack(packed, axis=2), strict=True))
    # A free root has no joint, so its frame is not used.
    values: list[Any] = [frames.get(body) for body in range(tree.body_count)]
    return PerBody(values, q.ndim - 1)


def dofs_of(group: Group, body: int) -> slice:
    """Return the degrees of freedom of a body of a group."""
    start = group.dofs.start + (body - group.bodies.start) * group.axes
    return slice(start, start + group.axes)


def _turned(
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


class Link(NamedTuple):
    """Poses and motion of one or several bodies (see `kinematics.Kinematics`)."""

    rotation: Float[Array, "3 3 *b"]
    origin: Float[Array, "3 *b"]
    angular: Float[Array, "3 *b"]
    linear: Float[Array, "3 *b"]
    bias_angular: Float[Array, "3 *b"]
    bias_linear: Float[Array, "3 *b"]


def linked(
    tree: Tree, group: Group, parent: Link, local: Any, qd: Float[Array, "d *n"]
) -> tuple[Link, Float[Array, "3 b *n"], Subspace]:
    """Return the bodies of a group, their offsets from their parents (m), and S.

    ``local`` is their part of `local_frames`.
    """
    rotation, offset, S = _KINDS[group.kind].placed(tree, group, parent.rotation, local)
    motion = carried(parent, offset, S, of_joints(qd, group, qd.ndim - 1))
    return Link(rotation, parent.origin + offset, *motion), offset, S


def joints_of(
    group: Group,
    S: Subspace,
    torque: Float[Array, "d *n"],
    torque_derivative: Float[Array, "d *#n"],
) -> AtOnce | OneByOne:
    """Return the joints of a group (see `evo_cpg.physics.tree.articulated.solve`).

    S, tau and the diagonal T are those of all degrees of freedom.
    """
    own = S.of(group, torque.ndim - 1)
    tau, diagonal = (of_joints(x, group, torque.ndim - 1) for x in (torque, torque_derivative))
    return _KINDS[group.kind].elimination(own, tau, diagonal)
