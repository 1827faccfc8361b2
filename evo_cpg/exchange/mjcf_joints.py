"""Joints of a creature as hinges of an MJCF body, and back.

| here | in MJCF |
|---|---|
| each axis of a joint | a ``hinge`` at the body's origin, named `body.1`, `body.2`, ... |
| limits of each axis | ``range`` |
| stiffness, damping, armature of the joint | the same attribute of every hinge |
| passive stiffness and damping of muscles | added to those of every hinge |

A hinge without a ``range`` is refused, and so are hinges of one body that differ in more than axis
and range.
"""

from collections.abc import Mapping
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.config.schema.joint import ActuatorConfig, JointConfig
from evo_cpg.creature.creature import Body, Joint
from evo_cpg.exchange.compiled import (
    TOLERANCE,
    Compiled,
    rotation,
    tidy,
    tidy_vector,
)
from evo_cpg.exchange.mjcf_ground import number_text, place_text
from evo_cpg.exchange.mjcf_shapes import Placed
from evo_cpg.spatial.rotation import matrix_to_euler


def joint_names(body: Body) -> list[str]:
    """Return the names of a body's hinges, in the order of its axes."""
    count = len(body.joint.dofs) if body.joint else 0
    return [f"{body.name}.{i + 1}" for i in range(count)]


def add_hinges(element: Element, body: Body, joint: Joint) -> None:
    """Add the joint of a body to its element."""
    for name, dof in zip(joint_names(body), joint.dofs, strict=True):
        direction = place_text(np.array(dof.axis))
        hinge = SubElement(element, "joint", name=name, type="hinge", axis=direction)
        hinge.set("limited", "true")
        hinge.set("range", number_text(dof.lower, dof.upper))
        muscle = dof.muscle
        values = {
            "stiffness": dof.stiffness + (muscle.rest_stiffness if muscle else 0.0),
            "damping": dof.damping + (muscle.damping if muscle else 0.0),
            "armature": dof.armature,
        }
        for key, value in values.items():
            if value:
                hinge.set(key, number_text(value))


def joints_of(model: Any, body: int) -> list[int]:
    """Return the numbers of a body's joints."""
    first = int(model.body_jntadr[body])
    return list(range(first, first + int(model.body_jntnum[body])))


def check_joints(
    compiled: Compiled, body: int, motors: Mapping[int, ActuatorConfig | None]
) -> None:
    """Refuse joints of a body that cannot be one joint of a creature."""
    model = compiled.model
    joints = joints_of(model, body)
    if not 1 <= len(joints) <= 3:
        problem = f"it has {len(joints)} joints" if joints else "it is welded to its parent"
        compiled.item("body", body).refuse(problem, "one to three hinges")
    if not all(_is_plain_hinge(compiled, joint) for joint in joints):
        return
    alike = {
        "stiffness": model.jnt_stiffness,
        "damping": model.dof_damping[model.jnt_dofadr],
        "armature": model.dof_armature[model.jnt_dofadr],
    }
    # None marks a refused actuator.
    unread = [joint for joint in joints if motors.get(joint, ...) is None]
    for joint in joints[1:]:
        first, unlike = joints[0], []
        if not unread and motors.get(joint) != motors.get(first):
            unlike.append("actuator")
        for word, values in alike.items():
            if not np.allclose(values[joint], values[first], rtol=TOLERANCE, atol=0):
                unlike.append(word)
        if np.abs(model.jnt_pos[joint] - model.jnt_pos[first]).max() > TOLERANCE:
            unlike.append("pos")
        for word in unlike:
            problem = f"its {word} differs from {compiled.item('joint', first)}"
            allowed = f"the same {word} for all hinges of a body"
            compiled.item("joint", joint).refuse(problem, allowed)


def _is_plain_hinge(compiled: Compiled, joint: int) -> bool:
    """Return whether a joint is a hinge, and refuse its other faults."""
    model, kinds, item = compiled.model, compiled.mujoco.mjtJoint, compiled.item("joint", joint)
    kind = int(model.jnt_type[joint])
    if kind != kinds.mjJNT_HINGE:
        word = str(kinds(kind).name).removeprefix("mjJNT_").lower()
        allowed = "one to three hinges at one place, which turn one after the other"
        item.refuse(f"it is a {word} joint", allowed)
        return False
    if not model.jnt_limited[joint]:
        item.refuse("it has no limits", "limits in the attribute range")
    address = model.jnt_qposadr[joint]
    if model.jnt_stiffness[joint] and model.qpos_spring[address] != model.qpos0[address]:
        item.refuse("its springref differs from its ref", "a spring to the neutral pose")
    return True


def read_joint(
    compiled: Compiled,
    body: int,
    placed: Mapping[int, Placed],
    names: Mapping[int, str],
    motors: Mapping[int, ActuatorConfig | None],
) -> JointConfig:
    """Return the joint of a body whose hinges `check_joints` accepted.

    Args:
        compiled: the model.
        body: number of the body.
        placed: shapes of the bodies, with their frames.
        names: names of the bodies.
        motors: motors by joint.
    """
    above = int(compiled.model.body_parentid[body])
    own, parent = placed[body], placed[above]
    model = compiled.model
    joints = joints_of(model, body)
    first, limits = joints[0], []
    for joint in joints:
        # MuJoCo counts angles from the file's reference, and we count from the neutral pose.
        neutral = model.qpos0[model.jnt_qposadr[joint]]
        limits.append(tidy_vector(np.rad2deg(model.jnt_range[joint] - neutral)))
    place, dof = np.array(model.jnt_pos[first]), int(model.jnt_dofadr[first])
    turn = rotation(compiled, model.body_quat[body])
    at = np.array(model.body_pos[body]) + turn @ place
    euler = np.rad2deg(matrix_to_euler(parent.turn.T @ turn @ own.turn))
    values = {
        "parent": names[above],
        "at": tidy_vector(parent.turn.T @ (at - parent.centre)),
        "child_at": tidy_vector(own.turn.T @ (place - own.centre)),
        "axes": [_axis(own.turn.T @ model.jnt_axis[joint]) for joint in joints],
        "limits_deg": limits[0] if len(set(limits)) == 1 else limits,
        "rotation_deg": tidy_vector(euler),
        "stiffness": tidy(model.jnt_stiffness[first]),
        "damping": tidy(model.dof_damping[dof]),
        "armature": tidy(model.dof_armature[dof]),
        "actuator": motors.get(first),
    }
    item = compiled.item("body", body)
    return item.section(JointConfig, values, f"joint of {item}")


def _axis(direction: np.ndarray) -> str | tuple[float, ...]:
    vector = tidy_vector(direction)
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if np.array_equal(vector, unit):
            return name
    return vector
