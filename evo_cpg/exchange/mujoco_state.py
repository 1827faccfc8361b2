"""Map a tree's degrees of freedom to MuJoCo's, and put a state into MuJoCo's data.

The functions take a compiled model that was exported (`evo_cpg.exchange.mjcf_export`). They do not
import MuJoCo.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.state import State

# MuJoCo's number of the transmission by a tendon.
_TENDON = 3


def dof_order(model: Any, tree: Tree) -> Int[np.ndarray, " d"]:
    """Return MuJoCo's index of each degree of freedom of the tree, counted after the root's six."""
    order = []
    for name in dict.fromkeys(tree.names[i] for i in tree.dof_bodies):
        body = model.body(name)
        order.extend(range(body.dofadr[0] - 6, body.dofadr[0] - 6 + body.dofnum[0]))
    return np.array(order, int)


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
            order.append(own[model.jnt_dofadr[driven] - 6])
    return np.array(order, int)


def load_state(model: Any, data: Any, tree: Tree, state: State) -> Float[np.ndarray, "3 3"]:
    """Put one individual's pose and velocities into MuJoCo's data.

    Returns:
        The root's rotation matrix: MuJoCo has the root's angular velocity in the root's axes.
    """
    order = dof_order(model, tree)
    rotation = root_rotation(np.asarray(state.orientation, float))
    data.qpos[:3], data.qpos[3:7] = state.position, state.orientation
    data.qpos[7 + order] = state.q
    data.qvel[:3], data.qvel[3:6] = state.linear_velocity, rotation.T @ state.angular_velocity
    data.qvel[6 + order] = state.qd
    return rotation


def root_rotation(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation from root to world for a quaternion (w, x, y, z)."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
