"""Numbers of a creature that MJCF has no place for, as a text of its ``custom`` element.

| here | in the text |
|---|---|
| restitution, static friction, density | ``bodies.NAME.material`` |
| corners of a mesh in double precision | ``bodies.NAME.mesh`` |
| muscles, and the spring and damper beside them | ``bodies.NAME.muscles``, by axis |
| eyes, depth gauges, pressure sensors, other sensors | ``sensors`` |
| rotation of the root at the start | ``heading`` |

An import uses a number only if the file still agrees with it: whoever changes a mass, a friction or
a muscle's spring in the file gets the changed value.
"""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any, NotRequired
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from pydantic import TypeAdapter, ValidationError
from typing_extensions import TypedDict  # pydantic takes no other before Python 3.12

from evo_cpg.creature.creature import Body, Creature, Material, Muscle
from evo_cpg.creature.mesh import ConvexMesh
from evo_cpg.exchange.compiled import Compiled
from evo_cpg.exchange.mjcf_joints import one_or_each

# Name of our text.
_NAME = "evo_cpg"

# Largest relative difference between a number here and the file's. Meshes are in single precision.
_AGREES, _MESH_AGREES = 1e-9, 1e-5

Custom = Mapping[str, Any]


class _Material(TypedDict):
    density: float
    restitution: float
    static_friction: float
    dynamic_friction: float


class _Mesh(TypedDict):
    vertices: list[tuple[float, float, float]]
    faces: list[list[int]]


class _Muscle(TypedDict):
    muscle: dict[str, Any]
    stiffness: float
    damping: float
    exported: tuple[float, float, float]


class _Body(TypedDict):
    material: _Material
    mesh: NotRequired[_Mesh]
    muscles: NotRequired[list[_Muscle | None]]


class _Sensors(TypedDict):
    light_sensors: list[dict[str, Any]]
    depth_sensors: list[dict[str, Any]]
    pressure_sensors: list[str]
    sensors: list[dict[str, Any]]


class _Text(TypedDict):
    bodies: dict[str, _Body]
    sensors: _Sensors
    heading: float


_TEXT = TypeAdapter(_Text)


def add_custom(
    root: Element, creature: Creature, heading: float, sensors: Sequence[Mapping[str, Any]]
) -> None:
    """Add the text to the ``mujoco`` element.

    Args:
        root: the element.
        creature: the animal.
        heading: rotation of the root at the start, rad.
        sensors: keys of the animal's other sensors.
    """
    sensing = {
        "light_sensors": [
            {
                "body": eye.body,
                "position": _numbers(eye.position),
                "axis": _numbers(eye.axis),
                "field_of_view_deg": float(np.rad2deg(eye.field_of_view)),
            }
            for eye in creature.light_sensors
        ],
        "depth_sensors": [
            {
                "body": gauge.body,
                "position": _numbers(gauge.position),
                "full_scale": float(gauge.full_scale),
            }
            for gauge in creature.depth_sensors
        ],
        "pressure_sensors": list(creature.pressure_sensors),
        "sensors": list(sensors),
    }
    data = {
        "bodies": {body.name: _of_body(body) for body in creature.bodies},
        "sensors": sensing,
        "heading": heading,
    }
    custom = SubElement(root, "custom")
    SubElement(custom, "text", name=_NAME, data=json.dumps(data))


def read_custom(compiled: Compiled) -> Custom:
    """Return the contents of our text, or an empty mapping without it or if it is damaged."""
    model, mujoco = compiled.model, compiled.mujoco
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, _NAME)
    if number < 0:
        return {}
    first, size = int(model.text_adr[number]), int(model.text_size[number])
    raw = bytes(model.text_data[first : first + size]).rstrip(b"\0")
    try:
        return _TEXT.validate_json(raw)
    except ValidationError:
        return {}


def root_axes(custom: Custom) -> np.ndarray:
    """Return the rotation ``(3, 3)`` from the root's frame to the world's."""
    s, c = np.sin(custom.get("heading", 0.0)), np.cos(custom.get("heading", 0.0))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def restored_mesh(custom: Custom, name: str, shape: dict[str, Any]) -> dict[str, Any]:
    """Return a mesh in double precision, if the file's mesh is its rounded image."""
    found = custom.get("bodies", {}).get(name, {}).get("mesh")
    if not found or shape["type"] != "mesh":
        return shape
    ours, theirs = np.array(found["vertices"]), np.array(shape["vertices"])
    reach = _MESH_AGREES * np.ptp(ours, axis=0).max()
    bounds = [np.array([points.min(0), points.max(0)]) for points in (ours, theirs)]
    alike = len(ours) == len(theirs) and np.abs(bounds[0] - bounds[1]).max() < reach
    return {"type": "mesh", **found} if alike else shape


def restored_material(
    custom: Custom, name: str, material: dict[str, float], weighed: bool
) -> dict[str, float]:
    """Return a material with the numbers that MJCF lacks, if its density and friction agree.

    Args:
        custom: contents of our text.
        name: name of the body.
        material: keys of the material.
        weighed: whether the density gives the mass, so that it must agree.
    """
    found = custom.get("bodies", {}).get(name, {}).get("material")
    if not found:
        return material
    density = not weighed or np.isclose(found["density"], material["density"], rtol=_MESH_AGREES)
    friction = Material(**material).dynamic_friction
    slides = np.isclose(found["dynamic_friction"], friction, rtol=_AGREES)
    return dict(found) if density and slides else material


def restore_muscles(custom: Custom, name: str, joint: dict[str, Any]) -> None:
    """Replace the motor and the spring of each axis that are those of muscles."""
    found = custom.get("bodies", {}).get(name, {}).get("muscles")
    if not found or not joint["axes"]:
        return
    count = len(joint["axes"])
    lists = {
        key: list(joint[key]) if isinstance(joint.get(key), list) else [joint.get(key, 0.0)] * count
        for key in ("stiffness", "damping", "actuator")
    }
    for i, axis in enumerate(found):
        if axis is None or i >= count:
            continue
        motor = lists["actuator"][i] or {}
        numbers = (lists["stiffness"][i], lists["damping"][i], motor.get("gear", 0.0))
        if np.allclose(numbers, axis["exported"], rtol=_AGREES, atol=0.0):
            lists["stiffness"][i], lists["damping"][i] = axis["stiffness"], axis["damping"]
            lists["actuator"][i] = {"type": "muscle", **axis["muscle"]}
    for key, values in lists.items():
        joint.pop(key, None)
        if every := one_or_each(values):
            joint[key] = every


def _of_body(body: Body) -> dict[str, Any]:
    """Return the numbers of a body that MJCF has no place for."""
    material = {name: float(x) for name, x in dataclasses.asdict(body.material).items()}
    data: dict[str, Any] = {"material": material}
    if isinstance(body.shape, ConvexMesh):
        faces = [list(map(int, face)) for face in body.shape.faces]
        data["mesh"] = {"vertices": body.shape.points.tolist(), "faces": faces}
    dofs = body.joint.dofs if body.joint else ()
    if any(dof.muscle for dof in dofs):
        data["muscles"] = [dof.muscle and _of_muscle(dof.muscle, dof) for dof in dofs]
    return data


def _of_muscle(muscle: Muscle, dof: Any) -> dict[str, Any]:
    numbers = {name: x for name, x in dataclasses.asdict(muscle).items() if name != "bend"}
    keys = {name: x if isinstance(x, bool) else float(x) for name, x in numbers.items()}
    return {
        "muscle": keys | {"bend_deg": float(np.rad2deg(muscle.bend))},
        "stiffness": float(dof.stiffness),
        "damping": float(dof.damping),
        "exported": [
            float(dof.stiffness + muscle.rest_stiffness),
            float(dof.damping + muscle.damping),
            float(muscle.strength),
        ],
    }


def _numbers(values: Any) -> list[float]:
    return [float(value) for value in values]
