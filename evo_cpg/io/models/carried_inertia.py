"""Inertia of force laws in MuJoCo, such as the water that bodies carry along.

MuJoCo's bodies have their own masses only, and a force that depends on the acceleration of its own
step is unstable if the carried mass is larger. The force is therefore solved for. Let M and M_a be
the mass matrices of bodies and water, B the damping of joints and motors, and f the force of all
else. MuJoCo's implicit step of length h finds ``(M + h B) a = f + q`` with an applied force q. With

    (M + M_a + h B) a = f,    q = -M_a a

the acceleration a is that of bodies and water. Forces of contacts and joint limits do not enter a,
so they move the bodies as if there was no water.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int


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
    water = _mass_matrix(mujoco, model, data, bodies, carried)
    own = np.zeros((model.nv, model.nv))
    for column, unit in zip(own, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    damped = own + water + model.opt.timestep * np.diag(_damping(model))
    data.qfrc_applied[:] = -water @ np.linalg.solve(damped, data.qfrc_smooth)
    mujoco.mj_step2(model, data)


def _mass_matrix(
    mujoco: Any, model: Any, data: Any, bodies: Int[np.ndarray, " b"], carried: CarriedInertia
) -> Float[np.ndarray, "v v"]:
    total, linear, angular = np.zeros((model.nv, model.nv)), *np.zeros((2, 3, model.nv))
    for i, body in enumerate(bodies):
        mujoco.mj_jac(model, data, linear, angular, np.asarray(carried.origin)[:, i], body)
        turn = np.asarray(carried.rotation)[..., i].T
        rows = np.concatenate([turn @ angular, turn @ linear])
        total += rows.T @ np.asarray(carried.inertia)[..., i] @ rows
    return total


def _damping(model: Any) -> Float[np.ndarray, " v"]:
    """Return the damping of joints and motors on each degree of freedom, N m s/rad."""
    damping = np.array(model.dof_damping)
    joints = model.actuator_trnid[:, 0]
    np.add.at(damping, model.jnt_dofadr[joints], -model.actuator_biasprm[:, 2])
    return damping
