"""Pose and motion of bodies that hang on their parents by joints: one step of forward kinematics.

`evo_cpg.physics.kinematics` has the symbols. All quantities have world axes.
"""

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from evo_cpg.creature.tree import Group, Tree
from evo_cpg.physics import joints
from evo_cpg.physics.per_body import of_joints
from evo_cpg.spatial.linear import expand_dims_like, matvec


class Link(NamedTuple):
    """Poses and motion of one or several bodies (see `evo_cpg.physics.kinematics.Kinematics`)."""

    rotation: Float[Array, "3 3 *b"]
    origin: Float[Array, "3 *b"]
    angular: Float[Array, "3 *b"]
    linear: Float[Array, "3 *b"]
    bias_angular: Float[Array, "3 *b"]
    bias_linear: Float[Array, "3 *b"]


def linked(
    tree: Tree,
    group: Group,
    parent: Link,
    local: Any,
    qd: Float[Array, "d *n"],
) -> tuple[Link, Float[Array, "3 b *n"], Float[Array, "3 k b *n"]]:
    """Return the bodies of a group, their offsets from their parents (m), and their axes S.

    Args:
        tree: the creature.
        group: the bodies.
        parent: their parents.
        local: their frames from `evo_cpg.physics.joints.local_frames`.
        qd: joint rates of the tree, rad/s.
    """
    own = expand_dims_like(tree.joint_offset[:, group.bodies], parent.origin)
    offset = matvec(parent.rotation, own)
    rotation, axes = joints.world_frames(parent.rotation, local)
    motion = joints.carried(parent, offset, axes, of_joints(qd, group, qd.ndim - 1))
    return Link(rotation, parent.origin + offset, *motion), offset, axes
