"""Edits of joints: keys, axes with the values of each axis, and places."""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from evo_cpg.io.schema.section import Vector
from evo_cpg.view.drawing_page.document import Data, EditError
from evo_cpg.view.drawing_page.lookup import Posed, bodies, joint_of, posed, reflected_if, tidy

# Keys whose value may be a list with one value for each axis.
_NUMBERS = ("stiffness", "rest_deg", "damping", "armature", "friction_loss")
# A motor in place of muscles, which turn a single axis only.
_SERVO: Data = {"gain": 1}
# Limits of the schema, which a joint without the key has.
_LIMITS = [-60, 60]


# Angle within which a direction counts as one of the parent's axes, degrees.
_SNAP_DEG = 4.0
# A part that points backward by more than this cosine keeps its parent's axes, as in a spine.
_BACKWARD = -0.5


def set_joint(data: Data, name: str, key: str, value: Any) -> None:
    """Set a key of a part's joint, or leave it out (None).

    Without limits, ``limits_deg`` is null, which differs from left out.
    """
    joint = joint_of(data, name)
    if value is None and key != "limits_deg":
        joint.pop(key, None)
    else:
        joint[key] = value


def set_axes(
    data: Data, name: str, axes: Literal["ball"] | list[Any], kept: list[int | None] | None = None
) -> None:
    """Set the axes of a part's joint. Values of each axis follow their axis.

    ``kept`` has for each new axis the number of the former axis that it replaces, from 0, or None
    for a further one. By default the axes keep their order.
    """
    joint = joint_of(data, name)
    was_ball = joint.get("axes") == "ball"
    joint["axes"] = axes
    if axes == "ball":
        # A ball has one value where other joints have one for each axis.
        for key in (*_NUMBERS, "actuator"):
            given = joint.get(key)
            if isinstance(given, list):
                first = next((each for each in given if each is not None), None)
                joint[key] = first
                if first is None:
                    del joint[key]
        joint.pop("rest_deg", None)
        motor = joint.get("actuator")
        if isinstance(motor, dict) and motor.get("type") == "muscle":
            joint["actuator"] = dict(_SERVO)
        limits = joint.get("limits_deg", _LIMITS)
        if limits:
            pairs = limits if isinstance(limits[0], (list, type(None))) else [limits]
            largest = max((abs(x) for pair in pairs if pair for x in pair), default=180)
            joint["limits_deg"] = [0, min(largest, 180)]
        return
    if was_ball and joint.get("limits_deg"):
        joint["limits_deg"] = [-joint["limits_deg"][1], joint["limits_deg"][1]]
    sources = list(range(len(axes))) if kept is None else list(kept)
    for key in (*_NUMBERS, "actuator", "limits_deg"):
        values = joint.get(key)
        # One pair of limits is for all axes.
        single = key == "limits_deg" and values and not isinstance(values[0], (list, type(None)))
        if isinstance(values, list) and not single:
            first = next((each for each in values if each is not None), None)
            joint[key] = [
                values[source] if source is not None and source < len(values) else first
                for source in sources
            ]
    _suit_slides(joint, [isinstance(axis, dict) and "slide" in axis for axis in axes])
    for key in (*_NUMBERS, "actuator", "limits_deg"):
        if joint.get(key) == []:
            del joint[key]


def _suit_slides(joint: Data, slides: list[bool]) -> None:
    """Replace values of slides that only turning axes can have."""
    limits = joint.get("limits_deg")
    if any(slides) and limits and isinstance(limits[0], (list, type(None))):
        joint["limits_deg"] = [
            None if slide else each for slide, each in zip(slides, limits, strict=True)
        ]
    elif limits and not isinstance(limits[0], (int, float)):
        joint["limits_deg"] = [_LIMITS if each is None else each for each in limits]
    if not any(slides):
        return
    if joint.get("rest_deg"):
        given = joint["rest_deg"]
        every = given if isinstance(given, list) else [given] * len(slides)
        joint["rest_deg"] = [0 if slide else x for slide, x in zip(slides, every, strict=True)]
    motors = joint.get("actuator")
    every = motors if isinstance(motors, list) else [motors] * len(slides)
    suited = [
        dict(_SERVO)
        if slide and isinstance(motor, dict) and motor.get("type") == "muscle"
        else motor
        for slide, motor in zip(slides, every, strict=True)
    ]
    if suited != every:
        joint["actuator"] = suited


def facing(normal: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the orientation of a part that points along a direction.

    Its x axis points along the direction. If the direction is backward, its x axis points against
    the direction, so that the bodies of a spine all face forward.

    Args:
        normal: direction in the parent's frame.
        reach: distance from the part's centre to its end, m.

    Returns:
        Roll, pitch and yaw in degrees, and the position of the joint in the part's frame, m.
    """
    direction = normal / np.linalg.norm(normal)
    largest = np.abs(direction).argmax()
    if abs(direction[largest]) > np.cos(np.radians(_SNAP_DEG)):
        direction = np.sign(direction[largest]) * np.eye(3)[largest]
    x, y, z = direction
    sign = -1.0 if x < _BACKWARD else 1.0
    x, y, z = sign * x, sign * y, sign * z
    yaw = np.degrees(np.arctan2(y, x)) if np.hypot(x, y) > 1e-9 else 0.0
    pitch = np.degrees(-np.arcsin(np.clip(z, -1, 1)))
    return np.array([0.0, pitch, yaw]), np.array([-sign * reach, 0.0, 0.0])


def shift(data: Data, source: Path, part: str, by: Vector) -> None:
    """Move a part with everything that it carries, and all copies of its entry alike.

    The displacement is in the axes of the root at rest (m).
    """
    here = posed(data, source)
    index = here.index(part)
    joint, parent = _joint(data, here, index)
    body = here.copies[index]
    about = Rotation.from_euler("z", body.turn_deg, degrees=True).as_matrix()
    # The place is in the frame of the body's own parent, and then as written in the entry.
    at = reflected_if(about @ np.array(joint["at"], float), body.mirror)
    at = at + here.rotations[parent].T @ np.asarray(by, float)
    joint["at"] = tidy(about.T @ reflected_if(at, body.mirror))


def turn(data: Data, source: Path, part: str, rotation: tuple[Vector, Vector, Vector]) -> None:
    """Turn a part about its joint, and all copies of its entry alike.

    The rotation matrix turns the part's axes into the axes of the root at rest.
    """
    here = posed(data, source)
    index = here.index(part)
    joint, parent = _joint(data, here, index)
    turned = np.asarray(rotation, float)
    if not np.allclose(turned @ turned.T, np.eye(3), atol=1e-3):
        raise EditError("a turn needs a rotation matrix")
    body = here.copies[index]
    between = here.rotations[parent].T @ turned
    between = Rotation.from_euler("z", -body.turn_deg, degrees=True).as_matrix() @ between
    if body.mirror:
        mirror = np.diag(reflected_if(np.ones(3), body.mirror))
        between = mirror @ between @ mirror
    # Roll, pitch and yaw are about the parent's x, then y, then z. At a pitch of 90 degrees only
    # their sum or difference counts, and roll is 0.
    pitch = np.arcsin(np.clip(-between[2, 0], -1, 1))
    if np.hypot(between[0, 0], between[1, 0]) < 1e-6:
        roll, yaw = 0.0, np.arctan2(-between[0, 1], between[1, 1])
    else:
        roll = np.arctan2(between[2, 1], between[2, 2])
        yaw = np.arctan2(between[1, 0], between[0, 0])
    joint["rotation_deg"] = tidy(np.round(np.degrees([roll, pitch, yaw]), 2) + 0.0)


def _joint(data: Data, here: Posed, index: int) -> tuple[Data, int]:
    """Return the joint of a body, and the index of its parent."""
    body = here.copies[index]
    if body.parent is None:
        raise EditError(f"{body.name} is the root, to which all other places are relative")
    names = [each.name for each in here.copies]
    return bodies(data)[body.entry]["joint"], names.index(body.parent)
