"""Pose and motion of bodies that hang on their parents by joints: one step of forward kinematics.

`evo_cpg.physics.tree.kinematics` has the symbols. All quantities have world axes.
"""

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from evo_cpg.creature.tree import Group, Tree
from evo_cpg.physics.tree import joints
from evo_cpg.physics.tree.joints import Subspace
from evo_cpg.physics.tree.per_body import of_joints


class Link(NamedTuple):
    """Poses and motion of one or several bodies (see `kinematics.Kinematics`)."""

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
) -> tuple[Link, Float[Array, "3 b *n"], Subspace]:
    """Return the bodies of a group, their offsets from their parents (m), and S.

    Args:
        tree: the creature.
        group: the bodies.
        parent: their parents.
        local: their frames from `evo_cpg.physics.tree.joints.local_frames`.
        qd: joint rates of the tree, rad/s.
    """
    rotation, offset, S = joints.placed(tree, group, parent.rotation, local)
    motion = joints.carried(parent, offset, S, of_joints(qd, group, qd.ndim - 1))
    return Link(rotation, parent.origin + offset, *motion), offset, S
