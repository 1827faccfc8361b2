"""Map a tree's degrees of freedom to MuJoCo's, and exchange states and inertia with MuJoCo.

The functions take a compiled model that was exported (`evo_cpg.io.models.mjcf_export`). They do not
import MuJoCo.

Bodies may carry the inertia of water along, but MuJoCo's bodies have their own masses only. A force
that depends on the acceleration of its own step is unstable if the carried mass is larger, so it is
solved for. Let M and M_a be the mass matrices of bodies and water, B the damping of joints and
motors, and f the force of all else. MuJoCo's implicit step of length h finds
``(M + h B) a = f + q`` with an applied force q. With

    (M + M_a + h B) a = f,    q = -M_a a

the acceleration a is that of bodies and water. Forces of contacts and joint limits do not enter a,
so they move the bodies as if there was no water.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial.transform import Rotation

from evo_cpg.creature.axis_kinds import SPANNING
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.tree.root import ROOT_DOFS
from evo_cpg.physics.tree.state import State

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
    kinds, parts = model.actuator_trntype, model.actuator_trnid
    for kind, (driven, _), gear in zip(kinds, parts, model.actuator_gear, strict=True):
        if kind == _TENDON:
            order.append(tree.dof_count + names.index(model.tendon(driven).name))
        else:
            # The gear of a motor on a ball is a vector along its axis.
            component = np.abs(gear[:3]).argmax()
            order.append(own[model.jnt_dofadr[driven] - root_dofs(tree) + component])
    return np.array(order, int)


def load_state(model: Any, data: Any, tree: Tree, state: State) -> Float[np.ndarray, "3 3"]:
    """Put one individual's pose and velocities into MuJoCo's data.

    The frame on which a root hangs is part of MuJoCo's model.

    Returns:
        The root's rotation matrix: MuJoCo has the root's angular velocity in the root's axes.
    """
    order = root_dofs(tree) + dof_order(model, tree)
    rotation = root_rotation(np.asarray(state.orientation, float))
    if tree.hanging is None:
        data.qpos[:3], data.qpos[3:7] = state.position, state.orientation
        data.qvel[:3], data.qvel[3:6] = state.linear_velocity, rotation.T @ state.angular_velocity
    plain, balls = _kinds_of(tree)
    q, qd = np.array(state.q, float), np.array(state.qd, float)
    data.qpos[model.jnt_qposadr[model.dof_jntid[order[plain]]]] = q[plain]
    for ball in balls:
        axes = np.asarray(tree.joint_axes[:, ball], float)
        start = model.jnt_qposadr[model.dof_jntid[order[ball[0]]]]
        data.qpos[start : start + 4] = ball_quaternion(axes, q[ball])
        qd[ball] = axes @ qd[ball]
    data.qvel[order] = qd
    return rotation


def joint_state(
    model: Any, tree: Tree, qpos: Float[np.ndarray, " p"], qvel: Float[np.ndarray, " v"]
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, " d"]]:
    """Return the coordinates of the tree's joints and their rates from MuJoCo's vectors."""
    order = root_dofs(tree) + dof_order(model, tree)
    plain, balls = _kinds_of(tree)
    q, qd = np.zeros(tree.dof_count), qvel[order]
    q[plain] = qpos[model.jnt_qposadr[model.dof_jntid[order[plain]]]]
    for ball in balls:
        axes = np.asarray(tree.joint_axes[:, ball], float)
        start = model.jnt_qposadr[model.dof_jntid[order[ball[0]]]]
        turn = Rotation.from_quat(qpos[start : start + 4], scalar_first=True)
        q[ball], qd[ball] = axes.T @ turn.as_rotvec(), axes.T @ qd[ball]
    return q, qd


def ball_quaternion(
    axes: Float[np.ndarray, "3 3"], q: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4"]:
    """Return the quaternion (w, x, y, z) across a ball joint.

    Args:
        axes: axes of the ball in the child's frame, as columns.
        q: rotation vector along these axes, rad.
    """
    return Rotation.from_rotvec(axes @ q).as_quat(scalar_first=True)


def _kinds_of(tree: Tree) -> tuple[list[int], list[list[int]]]:
    """Return the degrees of freedom that are one number of MuJoCo's pose, and those of balls."""
    plain = [i for i, kind in enumerate(tree.dof_kinds) if not kind.at_once]
    return plain, [list(range(first, first + SPANNING)) for first in tree.balls]


def root_rotation(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation from root to world for a quaternion (w, x, y, z)."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


class CarriedInertia(NamedTuple):
    """Inertia that bodies carry, and their poses.

    Attributes:
        inertia: inertia about the origin of each body, in its axes.
        rotation: rotation of each body to the world.
        origin: origin of each body, m.
    """

    inertia: Float[np.ndarray | Array, "6 6 b"]
    rotation: Float[np.ndarray | Array, "3 3 b"]
    origin: Float[np.ndarray | Array, "3 b"]


def step_with_inertia(
    mujoco: Any, model: Any, data: Any, bodies: Int[np.ndarray, " b"], carried: CarriedInertia
) -> None:
    """Take a step of MuJoCo in which bodies carry inertia.

    Args:
        mujoco: the module.
        model: the model.
        data: its data, with applied forces on bodies and motor commands.
        bodies: MuJoCo's index of each body.
        carried: the inertia.
    """
    data.qfrc_applied[:] = 0.0
    mujoco.mj_step1(model, data)
    mujoco.mj_fwdActuation(model, data)
    mujoco.mj_fwdAcceleration(model, data)
    water, linear, angular = np.zeros((model.nv, model.nv)), *np.zeros((2, 3, model.nv))
    for i, body in enumerate(bodies):
        mujoco.mj_jac(model, data, linear, angular, np.asarray(carried.origin)[:, i], body)
        turn = np.asarray(carried.rotation)[..., i].T
        rows = np.concatenate([turn @ angular, turn @ linear])
        water += rows.T @ np.asarray(carried.inertia)[..., i] @ rows
    own = np.zeros((model.nv, model.nv))
    for column, unit in zip(own, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    # Damping of joints and motors on each degree of freedom, N m s/rad.
    damping = np.array(model.dof_damping)
    joints = model.actuator_trnid[:, 0]
    np.add.at(damping, model.jnt_dofadr[joints], -model.actuator_biasprm[:, 2])
    damped = own + water + model.opt.timestep * np.diag(damping)
    data.qfrc_applied[:] = -water @ np.linalg.solve(damped, data.qfrc_smooth)
    mujoco.mj_step2(model, data)
