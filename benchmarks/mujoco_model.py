"""The same creature as a MuJoCo model: the tests' oracle and the benchmarks' peer."""

import mujoco
import numpy as np

from evo_cpg.creature.creature import Actuator, Body, Creature
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.contact import Ground
from evo_cpg.physics.state import State


def mujoco_model(
    creature: Creature,
    options: dict[str, float | str] | None = None,
    fluid: str = "",
    motors: bool = False,
    limits: bool = False,
    ground: Ground | None = None,
    height: float = 0.0,
) -> mujoco.MjModel:
    """Compile a creature for MuJoCo.

    Args:
        creature: the animal.
        options: attributes of MuJoCo's ``option`` element.
        fluid: attributes added to every geom, such as ``fluidshape="ellipsoid"``.
        motors: add the motor of every axis that has one (see `motor_order`): a velocity
            servo, or a position servo where it has a spring.
        limits: hold every joint within its limits, with MuJoCo's own soft constraint.
        ground: a level floor that every body may touch, but no body another.
        height: of the root's centre at the start, m.
    """
    children: dict[str | None, list[Body]] = {}
    for body in creature.bodies:
        children.setdefault(body.joint.parent if body.joint else None, []).append(body)

    def element(body: Body) -> str:
        joint = body.joint
        anchor = np.array(joint.child_anchor if joint else (0.0, 0.0, 0.0))
        if joint is None:
            place, joints = f'pos="0 0 {height}"', "<freejoint/>"
        else:
            parent = creature.bodies[creature.body_index(joint.parent)]
            parent_anchor = parent.joint.child_anchor if parent.joint else np.zeros(3)
            place = (
                f'pos="{_text(np.array(joint.parent_anchor) - parent_anchor)}" '
                f'quat="{_text(_quaternion(np.array(joint.orientation)))}"'
            )
            joints = "".join(
                f'<joint name="{body.name}.{i}" type="hinge" axis="{_text(axis)}" '
                f'stiffness="{joint.stiffness}" damping="{joint.damping}" '
                f'armature="{joint.armature}" limited="{str(limits).lower()}" '
                f'range="{joint.lower[i]} {joint.upper[i]}"/>'
                for i, axis in enumerate(joint.axes)
            )
        inner = "".join(element(child) for child in children.get(body.name, []))
        geom = _geom(body, -anchor, fluid)
        return f'<body name="{body.name}" {place}>{joints}{geom}{inner}</body>'

    servos = "".join(
        _motor(f"{body.name}.{i}", body.joint.actuator)
        for body in creature.bodies
        if motors and body.joint and body.joint.actuator
        for i in range(len(body.joint.axes))
    )
    attributes = " ".join(f'{key}="{value}"' for key, value in (options or {}).items())
    flag = '<flag contact="disable"/>' if ground is None else ""
    floor = (
        ""
        if ground is None
        else f'<geom type="plane" size="0 0 1" pos="0 0 {ground.height}" contype="1" '
        f'conaffinity="0" friction="{ground.dynamic_friction} 0 0"/>'
    )
    xml = (
        f'<mujoco><compiler angle="radian"/><option {attributes}>{flag}</option>'
        '<default><geom contype="0" conaffinity="1" condim="3"/></default>'
        f"<worldbody>{floor}{element(children[None][0])}</worldbody>"
        f"<actuator>{servos}</actuator></mujoco>"
    )
    return mujoco.MjModel.from_xml_string(xml)


def dof_order(model: mujoco.MjModel, tree: Tree) -> np.ndarray:
    """Index of MuJoCo's joint degree of freedom for each of the tree's, the root's six left out."""
    order = []
    for name in dict.fromkeys(tree.names[i] for i in tree.dof_bodies):
        body = model.body(name)
        order.extend(range(body.dofadr[0] - 6, body.dofadr[0] - 6 + body.dofnum[0]))
    return np.array(order, int)


def motor_order(model: mujoco.MjModel, tree: Tree) -> np.ndarray:
    """Index of the tree's degree of freedom that each of MuJoCo's motors drives."""
    driven = model.jnt_dofadr[model.actuator_trnid[:, 0]] - 6
    return np.argsort(dof_order(model, tree))[driven]


def load_state(model: mujoco.MjModel, data: mujoco.MjData, tree: Tree, state: State) -> np.ndarray:
    """Put one individual's pose and velocities into MuJoCo's data.

    Returns:
        The root's rotation matrix: MuJoCo has the root's angular velocity in its own axes.
    """
    order = dof_order(model, tree)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(state.orientation, float))
    rotation = rotation.reshape(3, 3)
    data.qpos[:3], data.qpos[3:7] = state.position, state.orientation
    data.qpos[7 + order] = state.q
    data.qvel[:3], data.qvel[3:6] = state.velocity[3:], rotation.T @ state.velocity[:3]
    data.qvel[6 + order] = state.qd
    return rotation


def _motor(joint: str, actuator: Actuator) -> str:
    limit = actuator.torque_limit
    force = f'forcerange="{-limit} {limit}"' if np.isfinite(limit) else ""
    if actuator.stiffness:
        return f'<position joint="{joint}" kp="{actuator.stiffness}" kv="{actuator.gain}" {force}/>'
    return f'<velocity joint="{joint}" kv="{actuator.gain}" {force}/>'


def _geom(body: Body, centre: np.ndarray, fluid: str) -> str:
    shape, density = body.shape, body.material.density
    if isinstance(shape, Box):
        kind = f'type="box" size="{_text(shape.half_extents)}"'
    elif isinstance(shape, Ellipsoid):
        kind = f'type="ellipsoid" size="{_text(shape.half_extents)}"'
    elif isinstance(shape, Capsule):
        # MuJoCo's capsules lie along z.
        kind = f'type="capsule" size="{shape.radius} {shape.length / 2}" zaxis="1 0 0"'
    else:
        raise TypeError(type(shape))
    friction = f'friction="{body.material.dynamic_friction} 0 0"'
    return f'<geom {kind} pos="{_text(centre)}" density="{density}" {friction} {fluid}/>'


def _text(values) -> str:
    return " ".join(f"{value:.17g}" for value in values)


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.flatten())
    return quaternion
