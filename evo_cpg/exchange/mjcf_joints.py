"""Joints of a creature as joints of an MJCF body, and back.

| here | in MJCF |
|---|---|
| each turning axis of a joint | a ``hinge`` at its place, named `body.1`, `body.2`, ... |
| each sliding axis | a ``slide``, named alike |
| a ball | a ``ball``, `body.1` |
| a joint without axes | no joint |
| limits of an axis | ``range``, or none |
| stiffness, damping, armature, friction loss of an axis | the same attribute of its joint |
| angle of the relaxed spring | ``springref`` |
| passive stiffness and damping of muscles | added to those of every hinge |

Hinges of one body at different places are refused.
"""

from collections.abc import Iterable, Mapping
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.config.schema.joint import JointConfig
from evo_cpg.creature.creature import NO_LIMIT, Body, Joint
from evo_cpg.exchange.compiled import (
    TOLERANCE,
    Compiled,
    rotation,
    tidy,
    tidy_vector,
)
from evo_cpg.exchange.mjcf_ground import number_text, place_text
from evo_cpg.exchange.mjcf_motors import Driver
from evo_cpg.exchange.mjcf_shapes import Placed
from evo_cpg.spatial.rotation import matrix_to_euler

# Type of the MJCF joint of each kind of axis.
_TYPES = {"turn": "hinge", "slide": "slide", "ball": "ball"}


def joint_names(body: Body) -> list[str]:
    """Return the name of the MJCF joint of each of a body's axes, in their order.

    All axes of a ball have the same name.
    """
    dofs = body.joint.dofs if body.joint else ()
    return [f"{body.name}.{1 if dof.kind == 'ball' else i + 1}" for i, dof in enumerate(dofs)]


def add_joints(element: Element, body: Body, joint: Joint) -> None:
    """Add the joint of a body to its element."""
    # The axes of a ball have the same name and the same values.
    for name, dof in dict(zip(joint_names(body), joint.dofs, strict=True)).items():
        hinge = SubElement(element, "joint", name=name, type=_TYPES[dof.kind])
        if dof.kind != "ball":
            hinge.set("axis", place_text(np.array(dof.axis)))
        if any(dof.place):
            hinge.set("pos", place_text(np.array(dof.place)))
        limited = dof.upper < NO_LIMIT
        hinge.set("limited", "true" if limited else "false")
        if limited:
            lower = 0.0 if dof.kind == "ball" else dof.lower
            hinge.set("range", number_text(lower, dof.upper))
        muscle = dof.muscle
        values = {
            "stiffness": dof.stiffness + (muscle.rest_stiffness if muscle else 0.0),
            "damping": dof.damping + (muscle.damping if muscle else 0.0),
            "armature": dof.armature,
            "springref": dof.rest,
            "frictionloss": dof.friction_loss,
        }
        for key, value in values.items():
            if value:
                hinge.set(key, number_text(value))


def joints_of(model: Any, body: int) -> list[int]:
    """Return the numbers of a body's joints."""
    first = int(model.body_jntadr[body])
    return list(range(first, first + int(model.body_jntnum[body])))


def check_joints(compiled: Compiled, body: int) -> None:
    """Refuse joints of a body that cannot be one joint of a creature."""
    model = compiled.model
    joints = joints_of(model, body)
    if not 1 <= len(joints) <= 3:
        problem = f"it has {len(joints)} joints" if joints else "it is welded to its parent"
        compiled.item("body", body).refuse(problem, "one to three hinges")
    if not all(_is_plain_hinge(compiled, joint) for joint in joints):
        return
    for joint in joints[1:]:
        first = joints[0]
        if np.abs(model.jnt_pos[joint] - model.jnt_pos[first]).max() > TOLERANCE:
            problem = f"its pos differs from {compiled.item('joint', first)}"
            allowed = "the same pos for all hinges of a body"
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
    return True


def read_joint(
    compiled: Compiled,
    body: int,
    placed: Mapping[int, Placed],
    names: Mapping[int, str],
    motors: Mapping[int, Driver | None],
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
    first, limits, rest = joints[0], [], []
    for joint in joints:
        # MuJoCo counts angles from the file's reference, and we count from the neutral pose.
        neutral = model.qpos0[model.jnt_qposadr[joint]]
        limit = tidy_vector(np.rad2deg(model.jnt_range[joint] - neutral))
        limits.append(limit if model.jnt_limited[joint] else None)
        spring = model.qpos_spring[model.jnt_qposadr[joint]] - neutral
        rest.append(tidy(np.rad2deg(spring)) if model.jnt_stiffness[joint] else 0.0)
    dofs = model.jnt_dofadr[joints]
    loss = model.dof_frictionloss[dofs] * (not compiled.disabled("frictionloss"))
    place = np.array(model.jnt_pos[first])
    turn = rotation(compiled, model.body_quat[body])
    at = np.array(model.body_pos[body]) + turn @ place
    euler = np.rad2deg(matrix_to_euler(parent.turn.T @ turn @ own.turn))
    values = {
        "parent": names[above],
        "at": tidy_vector(parent.turn.T @ (at - parent.centre)),
        "child_at": tidy_vector(own.turn.T @ (place - own.centre)),
        "axes": [_axis(own.turn.T @ model.jnt_axis[joint]) for joint in joints],
        # A section that is built from None would have its default.
        "limits_deg": _one_or_each(limits) or limits,
        "rotation_deg": tidy_vector(euler),
        "stiffness": _one_or_each(map(tidy, model.jnt_stiffness[joints])),
        "rest_deg": _one_or_each(rest),
        "damping": _one_or_each(map(tidy, model.dof_damping[dofs])),
        "armature": _one_or_each(map(tidy, model.dof_armature[dofs])),
        "friction_loss": _one_or_each(map(tidy, loss)),
        "actuator": _one_or_each(map(motors.get, joints)),
    }
    item = compiled.item("body", body)
    return item.section(JointConfig, values, f"joint of {item}")


def _one_or_each(values: Iterable[Any]) -> Any:
    """Return the value that all axes have in common, or a list."""
    every = list(values)
    return every[0] if all(value == every[0] for value in every) else every


def _axis(direction: np.ndarray) -> str | tuple[float, ...]:
    vector = tidy_vector(direction)
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if np.array_equal(vector, unit):
            return name
    return vector
