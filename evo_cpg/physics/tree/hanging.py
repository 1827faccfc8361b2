"""A root that hangs on the fixed world by a joint, or that is fixed to it.

The world is the parent of the root. Its frame, the `Base`, does not move. The joint's degrees of
freedom are ordinary ones, and the first of the tree. A joint without axes holds the root still.

Pose and velocity of the root's own frame follow from the base and the degrees of freedom. The state
keeps them for tasks, sensors and films, and recomputes them after every motion.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import matvec_t
from evo_cpg.creature.algebra.rotation import quaternion_to_matrix
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.tree.joint_kinds import Link, linked, local_frames


class Base(NamedTuple):
    """Frame of the fixed world, on which a root hangs.

    Attributes:
        position: position, m.
        orientation: unit quaternion (w, x, y, z), frame to world.
    """

    position: Float[Array, "3 *n"]
    orientation: Float[Array, "4 *n"]


def fixed_link(base: Base) -> Link:
    """Return the frame on which a root hangs as a parent: one body that does not move."""
    rotation, origin = quaternion_to_matrix(base.orientation), base.position[:, None]
    return Link(rotation[:, :, None], origin, *(jnp.zeros_like(origin) for _ in range(4)))


def pushed(
    tree: Tree, base: Base, q: Float[Array, "d *n"], change: Float[Array, "3 *n"]
) -> Float[Array, "k *n"]:
    """Return the changes of the rates of the root's slides by a change of its velocity, m/s.

    Each slide takes the part along itself. The other axes take none.
    """
    group = tree.hanging
    assert group is not None
    local = local_frames(tree, q)[group.bodies]
    _, _, S = linked(tree, group, fixed_link(base), local, jnp.zeros_like(q))
    assert S.linear is not None
    return matvec_t(S.linear[:, np.array(tree.root_slides), 0], change)
