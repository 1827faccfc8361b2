"""Poses and velocities of all bodies, from the root to the tips.

All quantities have world axes and refer to each body's working frame. The frame's origin lies at
the body's joint, so the shift from parent to child is a pure translation by ``offset``. Arrays are
``(components, bodies, ...)``.

| symbol | name |
|---|---|
| R_i | ``rotation``: body to world |
| p_i, d_i | ``origin``; ``offset`` from the parent's origin |
| S_i | ``axes``: motion of the body per rate of each degree of freedom |
| w_i, v_i | ``angular``, ``linear`` velocity at the origin |
| A0_i | ``bias_angular``, ``bias_linear``: acceleration at constant velocities of the tree |

A0_i is a spatial acceleration. A material point has the acceleration A0 plus ``w x v``. A free
root's A0 is ``-w x v``. A root that hangs on the world is carried by it as by a parent.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.rotation import quaternion_to_matrix
from evo_cpg.creature.per_body import PerBody, in_dof_order, of_joints
from evo_cpg.creature.tree import Tree
from evo_cpg.creature.walked import outwards
from evo_cpg.physics.tree import hanging, joints, root
from evo_cpg.physics.tree.joint_kinds import Link, linked, local_frames
from evo_cpg.physics.tree.joints import Subspace
from evo_cpg.physics.tree.spatial_algebra import BodyMotion
from evo_cpg.physics.tree.state import State


class Kinematics(NamedTuple):
    """Positions and velocities of all bodies. The module docstring has the symbols."""

    rotation: Float[Array, "3 3 b *n"]
    origin: Float[Array, "3 b *n"]
    offset: Float[Array, "3 b *n"]
    axes: Subspace
    angular: Float[Array, "3 b *n"]
    linear: Float[Array, "3 b *n"]
    bias_angular: Float[Array, "3 b *n"]
    bias_linear: Float[Array, "3 b *n"]


def kinematics(tree: Tree, state: State) -> Kinematics:
    """Return the forward kinematics: positions, and the first pass of Featherstone, table 7.1.

    Each line holds for one body and for a group of like limbs side by side (`PerBody`).

    Raises:
        ValueError: the root hangs on the world, but the state is one of a free root.
    """
    batch_ndim = state.q.ndim - 1
    if tree.hanging is None:
        # The root comes before the joints, because another order changes the rounding.
        rest, rotation = jnp.zeros_like(state.position), quaternion_to_matrix(state.orientation)
        first = Link(rotation, state.position, *root.motion(state.velocity))
        bodies, local = outwards(tree, first, batch_ndim), local_frames(tree, state.q)
        offsets, axes = [rest[:, None]], []
    else:
        if state.base is None:
            raise ValueError("the root hangs on the world, so its state needs a base")
        local = local_frames(tree, state.q)
        i, world = tree.hanging, hanging.fixed_link(state.base)
        first, offset, S = linked(tree, i, world, local[i.bodies], state.qd)
        bodies = PerBody[Link]([], batch_ndim).followed_by(first)
        offsets, axes = [offset], [S]
    for i in tree.groups:
        body, offset, S = linked(tree, i, bodies.of_parents(i), local[i.bodies], state.qd)
        bodies = bodies.followed_by(body)
        offsets.append(offset)
        axes.append(S)
    rotation, origin, *motion = bodies[:]
    none = jnp.zeros((3, 0, *state.position.shape[1:]), state.position.dtype)
    angular, linear = [in_dof_order(S.angular, batch_ndim) for S in axes], None
    if any(S.linear is not None for S in axes):
        parts = [
            jnp.zeros_like(turning) if S.linear is None else in_dof_order(S.linear, batch_ndim)
            for S, turning in zip(axes, angular, strict=True)
        ]
        linear = jnp.concatenate([none, *parts], 1)
    every = Subspace(jnp.concatenate([none, *angular], 1), linear)
    return Kinematics(rotation, origin, jnp.concatenate(offsets, 1), every, *motion)


def motion_of_bodies(
    tree: Tree, kin: Kinematics, velocity: Float[Array, "6 *n"], qd: Float[Array, "d *n"]
) -> BodyMotion:
    """Return the motion of the bodies with other velocities of the root and the joints."""
    batch_ndim = qd.ndim - 1
    if tree.hanging is None:
        bodies = outwards(tree, root.motion(velocity), batch_ndim)
    else:
        i, offset = tree.hanging, kin.offset[:, :1]
        still = BodyMotion(*(jnp.zeros_like(offset) for _ in range(4)))
        S, rates = kin.axes.of(i, batch_ndim), of_joints(qd, i, batch_ndim)
        first = joints.carried(still, offset, S, rates)
        bodies = PerBody[BodyMotion]([], batch_ndim).followed_by(first)
    for i in tree.groups:
        parent, offset = bodies.of_parents(i), kin.offset[:, i.bodies]
        S, rates = kin.axes.of(i, batch_ndim), of_joints(qd, i, batch_ndim)
        bodies = bodies.followed_by(joints.carried(parent, offset, S, rates))
    return bodies[:]
