"""Map a tree's degrees of freedom to MuJoCo's, and put a state into MuJoCo's data.

The functions take a compiled model that was exported (`evo_cpg.exchange.mjcf_export`). They do not
import MuJoCo.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.root import ROOT_DOFS
from evo_cpg.physics.state import State

# MuJoCo's number of the transmission by a tendon.
_TENDON = 3


def dof_order(model: Any, tree: Tree) -> Int[np.ndarray, " d"]:
    """Return MuJoCo's index of each degree of freedom of the tree, after those of a free root."""
    order, first = [], root_dofs(tree)
    for name in dict.fromkeys(tree.names[i] for i in tree.dof_bodies):
        body = model.body(name)
        order.extend(range(body.dofadr[0] - first, body.dofadr[0] - first + body.dofnum[0]))
    return np.array(order, int)


def root_dofs(tree: Tree) -> int:
    """Return the number of MuJoCo's degrees of freedom of a free root, or 0 without one."""
    return ROOT_DOFS if tree.hanging is None else 0


def motor_order(model: Any, tree: Tree) -> Int[np.ndarray, " motors"]:
    """Return the index of the degree of freedom or the tendon that each of MuJoCo's motors drives.

    Tendons are counted after all degrees of freedom of the tree.
    """
    own = np.argsort(dof_order(model, tree))
    names, order = () if tree.tendons is None else tree.tendons.names, []
    for kind, (driven, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        if kind == _TENDON:
            order.append(tree.dof_count + names.index(model.tendon(driven).name))
        else:
            order.append(own[model.jnt_dofadr[driven] - root_dofs(tree)])
    return np.array(order, int)


def load_state(model: Any, data: Any, tree: Tree, state: State) -> Float[np.ndarray, "3 3"]:
    """Put one individual's pose and velocities into MuJoCo's data.

    The frame on which a root hangs is part of MuJoCo's model.

    Returns:
        The root's rotation matrix: MuJoCo has the root's angular velocity in the root's axes.
    """
    order = dof_order(model, tree)
    rotation = root_rotation(np.asarray(state.orientation, float))
    if tree.hanging is None:
        data.qpos[:3], data.qpos[3:7] = state.position, state.orientation
        data.qvel[:3], data.qvel[3:6] = state.linear_velocity, rotation.T @ state.angular_velocity
    data.qpos[root_coordinates(tree) + order] = state.q
    data.qvel[root_dofs(tree) + order] = state.qd
    return rotation


def root_coordinates(tree: Tree) -> int:
    """Return the number of MuJoCo's coordinates of a free root: one more than `root_dofs`."""
    return ROOT_DOFS + 1 if tree.hanging is None else 0


def root_rotation(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation from root to world for a quaternion (w, x, y, z)."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
