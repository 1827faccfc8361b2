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
| A0_i | ``bias_angular``, ``bias_linear``: spatial acceleration while the root's and the joints'
accelerations are zero |
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.fusion.kernels import side_by_side
from evo_cpg.physics.state import State
from evo_cpg.spatial.linear import compute_once, cross, lift, matmul, matvec
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


def kinematics(tree: Tree, state: State) -> Kinematics:
    """Forward kinematics, Featherstone 2008, section 5.3 (first pass)."""
    rotation, axes, offset = _poses(tree, state)
    rates = axes * state.qd[None]
    spin, spin_rate = _joint_motion(tree, rates)
    parents = np.array(tree.parents[1:], int)

    rest = jnp.zeros_like(state.position)
    angular, origin = _split(
        accumulate(
            tree,
            jnp.concatenate([state.velocity[:3], state.position]),
            jnp.concatenate([spin, offset]),
        )
    )
    parent_angular = take(angular, parents)
    linear, bias_angular = _split(
        accumulate(
            tree,
            jnp.concatenate([state.velocity[3:], rest]),
            jnp.concatenate(
                [cross(parent_angular, offset), cross(parent_angular, spin) + spin_rate]
            ),
        )
    )
    bias_linear = accumulate(
        tree, rest, cross(take(bias_angular, parents), offset) + cross(linear[:, 1:], spin)
    )
    root_offset = jnp.zeros_like(state.position)[:, None]
    return Kinematics(
        rotation,
        origin,
        jnp.concatenate([root_offset, offset], 1),
        axes,
        angular,
        linear,
        bias_angular,
        bias_linear,
    )


def accumulate(
    tree: Tree, root: Float[Array, "c *n"], steps: Float[Array, "c joints *n"]
) -> Float[Array, "c b *n"]:
    """Sum from the root to every body: ``y_i = y_parent + steps_i``.

    Args:
        tree: the creature.
        root: value of the root.
        steps: what each other body adds to its parent's value.
    """
    values: list[Array] = [root]
    for group in tree.groups:
        before = jnp.stack([values[parent] for parent in group.parents], 1)
        after = before + steps[:, group.bodies.start - 1 : group.bodies.stop - 1]
        values.extend(after[:, j] for j in range(after.shape[1]))
    return jnp.stack(values, 1)


def _split(pair: Float[Array, "6 *rest"]) -> tuple[Array, Array]:
    return pair[:3], pair[3:]


def take(x: Array, indices: np.ndarray, axis: int = 1) -> Array:
    """Pick bodies by constant indices: slices where they run on, which XLA fuses, no gather."""
    step = int(indices[1] - indices[0]) if len(indices) > 1 else 1
    if len(indices) and step > 0 and (np.diff(indices) == step).all():
        return jax.lax.slice_in_dim(x, int(indices[0]), int(indices[-1]) + 1, step, axis)
    pieces = [jax.lax.slice_in_dim(x, int(i), int(i) + 1, axis=axis) for i in indices]
    return jnp.concatenate(pieces, axis) if pieces else jax.lax.slice_in_dim(x, 0, 0, axis=axis)


def _poses(tree: Tree, state: State) -> tuple[Array, Array, Array]:
    """World rotations of all bodies, world joint axes, and world offsets of all joints."""
    batch = state.q.shape[1:]
    local = _local_frames(tree, state.q)
    rotations = [quaternion_to_matrix(state.orientation)]
    world_axes, offsets = [], []
    for group in tree.groups:
        count = group.bodies.stop - group.bodies.start
        parent = side_by_side(jnp.stack([rotations[parent] for parent in group.parents], 2))
        offsets.append(matvec(parent, lift(tree.joint_offset[:, group.bodies], parent[0])))
        frame = jnp.stack([local[i] for i in range(group.bodies.start, group.bodies.stop)], 2)
        turned = matmul(parent, frame)
        rotations.extend(turned[:, :3, i] for i in range(count))
        axes = jnp.swapaxes(turned[:, 3:], 1, 2)
        world_axes.append(axes.reshape(3, count * group.axes, *batch))
    rotation = jnp.stack(rotations, 2)
    empty = jnp.zeros((3, 0, *batch), state.q.dtype)
    return (
        rotation,
        jnp.concatenate([empty, *world_axes], 1),
        jnp.concatenate([empty, *offsets], 1),
    )


def _local_frames(tree: Tree, q: Float[Array, "d *n"]) -> dict[int, Float[Array, "3 c *n"]]:
    """Rotation of every body to its parent and, behind it, the joint axes in the parent's frame.

    Joints with the same axes are treated at once.
    """
    sine, cosine = compute_once(jnp.stack([jnp.sin(q), jnp.cos(q)]))
    alike: dict[tuple[bytes, bytes], list[int]] = {}
    first_dof = {body: i for i, body in reversed(list(enumerate(tree.dof_bodies)))}
    axis_count = np.bincount(tree.dof_bodies, minlength=tree.body_count)
    for body, dof in sorted(first_dof.items()):
        axes = tree.joint_axes[:, dof : dof + axis_count[body]]
        orientation = tree.joint_orientation[:, :, body]
        alike.setdefault((axes.tobytes(), orientation.tobytes()), []).append(body)
    frames = {}
    for bodies in alike.values():
        dof, count = first_dof[bodies[0]], axis_count[bodies[0]]
        orientation = lift(tree.joint_orientation[:, :, bodies[0]], q, q.ndim + 2)
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
        frames.update({body: packed[:, :, i] for i, body in enumerate(bodies)})
    return frames


def _turn(
    columns: list[Array], axis: np.ndarray, sine: Array, cosine: Array
) -> tuple[list[Array], Array]:
    """Turn a frame, given by its columns, about one of its own axes; also returns that axis."""
    along = int(np.abs(axis).argmax())
    if np.count_nonzero(axis) > 1:
        frame = jnp.stack(jnp.broadcast_arrays(*columns), 1)
        turned = matmul(frame, axis_rotation(axis, sine, cosine))
        return [turned[:, j] for j in range(3)], matvec(frame, lift(axis, frame[0]))
    i, j = (along + 1) % 3, (along + 2) % 3
    # A Python float takes the arrays' precision; a NumPy one would make float32 float64.
    direction = float(axis[along])
    sine, cosine = sine[None] * direction, cosine[None]
    turned = list(columns)
    turned[i] = cosine * columns[i] + sine * columns[j]
    turned[j] = cosine * columns[j] - sine * columns[i]
    return turned, columns[along] * direction


def _joint_motion(tree: Tree, rates: Float[Array, "3 d *n"]) -> tuple[Array, Array]:
    """Angular velocity across each joint, and its rate of change seen from the parent."""
    spins, spin_rates = [], []
    for group in tree.groups:
        count = group.bodies.stop - group.bodies.start
        rate = rates[:, group.dofs].reshape(3, count, group.axes, *rates.shape[2:])
        spin = rate[:, :, 0]
        spin_rate = jnp.zeros_like(spin)
        for k in range(1, group.axes):
            spin_rate = spin_rate + cross(spin, rate[:, :, k])
            spin = spin + rate[:, :, k]
        spins.append(spin)
        spin_rates.append(spin_rate)
    empty = jnp.zeros((3, 0, *rates.shape[2:]), rates.dtype)
    return jnp.concatenate([empty, *spins], 1), jnp.concatenate([empty, *spin_rates], 1)
