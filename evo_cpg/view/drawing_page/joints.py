"""Edits of joints: single keys, and the axes together with the values of each axis."""

from collections.abc import Sequence
from typing import Any, Literal

from evo_cpg.view.drawing_page.document import Data
from evo_cpg.view.drawing_page.lookup import joint_of

# Keys whose value may be a list with one value for each axis.
_NUMBERS = ("stiffness", "rest_deg", "damping", "armature", "friction_loss")
# A motor in place of muscles, which turn a single axis only.
_SERVO: Data = {"gain": 1}
# Limits of the schema, which a joint without the key has.
_LIMITS = [-60, 60]


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

    Args:
        data: data of the document.
        name: name of the part.
        axes: the new axes, as in the file.
        kept: for each new axis the number of the former axis that it replaces, from 0, or None for
            a further one. By default the axes keep their order.
    """
    joint = joint_of(data, name)
    was_ball = joint.get("axes") == "ball"
    joint["axes"] = axes
    if axes == "ball":
        _become_ball(joint)
        return
    if was_ball and joint.get("limits_deg"):
        joint["limits_deg"] = [-joint["limits_deg"][1], joint["limits_deg"][1]]
    sources = list(range(len(axes))) if kept is None else list(kept)
    for key in (*_NUMBERS, "actuator"):
        if isinstance(joint.get(key), list):
            joint[key] = _followed(joint[key], sources)
    limits = joint.get("limits_deg")
    if limits and isinstance(limits[0], (list, type(None))):
        joint["limits_deg"] = _followed(limits, sources)
    _suit_slides(joint, [isinstance(axis, dict) and "slide" in axis for axis in axes])
    for key in (*_NUMBERS, "actuator", "limits_deg"):
        if joint.get(key) == []:
            del joint[key]


def _followed(values: list[Any], sources: Sequence[int | None]) -> list[Any]:
    first = next((each for each in values if each is not None), None)
    return [
        values[source] if source is not None and source < len(values) else first
        for source in sources
    ]


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
        dict(_SERVO) if slide and _is_muscle(motor) else motor
        for slide, motor in zip(slides, every, strict=True)
    ]
    if suited != every:
        joint["actuator"] = suited


def _become_ball(joint: Data) -> None:
    """Replace values of each axis by values that a ball can have."""
    for key in (*_NUMBERS, "actuator"):
        given = joint.get(key)
        if isinstance(given, list):
            first = next((each for each in given if each is not None), None)
            joint[key] = first
            if first is None:
                del joint[key]
    joint.pop("rest_deg", None)
    if _is_muscle(joint.get("actuator")):
        joint["actuator"] = dict(_SERVO)
    limits = joint.get("limits_deg", _LIMITS)
    if limits:
        pairs = limits if isinstance(limits[0], (list, type(None))) else [limits]
        largest = max((abs(x) for pair in pairs if pair for x in pair), default=180)
        joint["limits_deg"] = [0, min(largest, 180)]


def _is_muscle(motor: Any) -> bool:
    return isinstance(motor, dict) and motor.get("type") == "muscle"
