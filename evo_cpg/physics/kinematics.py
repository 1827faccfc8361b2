"""Where every body is and how it moves, from the root to the tips.

All quantities have world axes and refer to each body's working frame, whose origin lies at its
joint; going from parent to child is then a pure translation by ``offset``. Arrays are
``(components, bodies, ...)``.

| symbol | name |
|---|---|
| R_i | ``rotation``: body to world |
| p_i, d_i | ``origin``; ``offset`` from the parent's origin |
| S_i | ``axes``: world unit vectors of the joint axes |
| w_i, v_i | ``angular``, ``linear`` velocity at the origin |
| A0_i | ``bias_angular``, ``bias_linear``: spatial acceleration at constant velocities of the root
and the joints; a material point's is ``w x v`` more, so the root's is ``-w x v`` |
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.per_body import PerBody, in_dof_order, of_joints, take
from evo_cpg.physics.state import State
from evo_cpg.spatial.linear import cross, expand_dims_like, matmul, matvec
from evo_cpg.spatial.rotation import axis_rotation, quaternion_to_matrix


class Kinematics(NamedTuple):
    """Positions and velocities of all bodies; the module's docstring has the symbols."""

    rotation: Float[Array, "3 3 b *n"]
    origin: Float[Array, "3 b *n"]
    offset: Float[Array, "3 b *n"]
    axes: Float[Array, "3 d *n"]
    angular: Float[Array, "3 b *n"]
    linear: Float[Array, "3 b *n"]
    bias_angular: Float[Array, "3 b *n"]
    bias_linear: Float[Array, "3 b *n"]


class _Body(NamedTuple):
    """Where one or several bodies are and how they move; see `Kinematics`."""

    rotation: Array
    origin: Array
    angular: Array
    linear: Array
    bias_angular: Array
    bias_linear: Array


def kinematics(tree: Tree, state: State) -> Kinematics:
    """Forward kinematics: the first pass of Featherstone 2008, table 7.1, and positions.

    Each line holds for one body and for a group of like limbs side by side (`PerBody`).
    """
    batch_ndim = state.q.ndim - 1
    rest, rotation = jnp.zeros_like(state.position), quaternion_to_matrix(state.orientation)
    root = _Body(rotation, state.position, *_root_motion(state.velocity))
    bodies, local = PerBody([root], batch_ndim), _local_frames(tree, state.q)
    offsets, axes = [rest[:, None]], [jnp.zeros((3, 0, *rest.shape[1:]), rest.dtype)]
    for i in tree.groups:
        parent = bodies[i.parents]
        offset = matvec(
            parent.rotation, expand_dims_like(tree.joint_offset[:, i.bodies], parent.origin)
        )
        # Columns: those of the body's rotation, and behind them the axes of its joint.
        frame = matmul(parent.rotation, local[i.bodies])
        rotation, S = frame[:, :3], frame[:, 3:]
        moves = _carried(parent, offset, S * of_joints(state.qd, i, batch_ndim)[None])
        bodies = bodies.followed_by(_Body(rotation, parent.origin + offset, *moves))
        offsets.append(offset)
        axes.append(in_dof_order(S, batch_ndim))
    rotation, origin, *motion = bodies.stacked()
    return Kinematics(
        rotation, origin, jnp.concatenate(offsets, 1), jnp.concatenate(axes, 1), *motion
    )


class Motion(NamedTuple):
    """How all bodies move; see `Kinematics`."""

    angular: Float[Array, "3 b *n"]
    linear: Float[Array, "3 b *n"]
    bias_angular: Float[Array, "3 b *n"]
    bias_linear: Float[Array, "3 b *n"]


def motion_of_bodies(
    tree: Tree, kin: Kinematics, velocity: Float[Array, "6 *n"], qd: Float[Array, "d *n"]
) -> Motion:
    """How the bodies would move with other velocities of the root and the joints.

    Args:
        tree: the creature.
        kin: where its bodies are.
        velocity: of the root, as in `State`.
        qd: rad/s.
    """
    batch_ndim = qd.ndim - 1
    bodies = PerBody([_root_motion(velocity)], batch_ndim)
    for i in tree.groups:
        parent, offset = bodies[i.parents], kin.offset[:, i.bodies]
        rates = of_joints(kin.axes, i, batch_ndim) * of_joints(qd, i, batch_ndim)[None]
        bodies = bodies.followed_by(_carried(parent, offset, rates))
    return bodies.stacked()


def _root_motion(velocity: Float[Array, "6 *n"]) -> Motion:
    angular, linear = velocity[:3], velocity[3:]
    return Motion(angular, linear, jnp.zeros_like(angular), cross(linear, angular))


def _carried(parent: Any, offset: Array, rates: Array) -> Motion:
    """How bodies move that their parents carry.

    Args:
        parent: of each, with the attributes of `Motion`.
        offset: from the parents' origins, m.
        rates: of the joint's axes, each along its axis.
    """
    spin, spin_rate = _joint_motion(rates)
    linear = parent.linear + cross(parent.angular, offset)
    return Motion(
        parent.angular + spin,
        linear,
        parent.bias_angular + cross(parent.angular, spin) + spin_rate,
        parent.bias_linear + cross(parent.bias_angular, offset) + cross(linear, spin),
    )


def _local_frames(tree: Tree, q: Float[Array, "d *n"]) -> PerBody[Float[Array, "3 c *n"]]:
    """Rotation of every body to its parent and, behind it, the joint axes in the parent's frame.

    Joints with the same axes are treated at once.
    """
    sine, cosine = jnp.sin(q), jnp.cos(q)
    alike: dict[tuple[bytes | int, bytes | int], list[int]] = {}
    first_dof = {body: i for i, body in reversed(list(enumerate(tree.dof_bodies)))}
    axis_count = np.bincount(tree.dof_bodies, minlength=tree.body_count)
    for body, dof in sorted(first_dof.items()):
        axes = tree.joint_axes[:, dof : dof + axis_count[body]]
        orientation = tree.joint_orientation[:, :, body]
        alike.setdefault((_key(axes, body), _key(orientation, body)), []).append(body)
    frames = {}
    for bodies in alike.values():
        dof, count = first_dof[bodies[0]], axis_count[bodies[0]]
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
    # The root has no joint, and its place is not looked at.
    values: list[Any] = [None, *(frames[body] for body in range(1, tree.body_count))]
    return PerBody(values, q.ndim - 1)


def _key(values: Any, body: int) -> bytes | int:
    """By which equal values are found; traced ones are like no others."""
    return values.tobytes() if isinstance(values, np.ndarray) else body


def _turn(
    columns: list[Array], axis: np.ndarray | Array, sine: Array, cosine: Array
) -> tuple[list[Array], Array]:
    """Turn a frame, given by its columns, about one of its own axes; also returns that axis."""
    if not isinstance(axis, np.ndarray) or np.count_nonzero(axis) > 1:
        frame = jnp.stack(jnp.broadcast_arrays(*columns), 1)
        turned = matmul(frame, axis_rotation(axis, sine, cosine))
        return [turned[:, j] for j in range(3)], matvec(frame, expand_dims_like(axis, frame[0]))
    along = int(np.abs(axis).argmax())
    i, j = (along + 1) % 3, (along + 2) % 3
    # A Python float takes the arrays' precision; a NumPy one would make float32 float64.
    direction = float(axis[along])
    sine, cosine = sine[None] * direction, cosine[None]
    turned = list(columns)
    turned[i] = cosine * columns[i] + sine * columns[j]
    turned[j] = cosine * columns[j] - sine * columns[i]
    return turned, columns[along] * direction


def _joint_motion(rates: Float[Array, "3 axes bodies *n"]) -> tuple[Array, Array]:
    """Angular velocity across each joint, and its rate of change seen from the parent.

    Args:
        rates: of the joint's axes, each along its axis.
    """
    spin = rates[:, 0]
    spin_rate = jnp.zeros_like(spin)
    for k in range(1, rates.shape[1]):
        spin_rate = spin_rate + cross(spin, rates[:, k])
        spin = spin + rates[:, k]
    return spin, spin_rate
