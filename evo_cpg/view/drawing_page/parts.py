"""Edits of parts: add, remove, rename, and change shapes."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.io.schema.copies import copies_named, fill
from evo_cpg.io.schema.section import Finite, Vector
from evo_cpg.view.drawing_page.document import Data, DrawingError
from evo_cpg.view.drawing_page.lofting import loft_half_extents, new_loft, stretch_loft
from evo_cpg.view.drawing_page.lookup import (
    Posed,
    all_copies,
    bodies,
    copies_of,
    entry_index,
    entry_of,
    free_name,
    parent_of,
    posed,
    tidy,
)
from evo_cpg.view.drawing_page.placing import facing, on_planes, reflected_if

# Size of a new part, relative to the smallest half extent of its parent, and its length over it.
_SIZE, _SLENDER = 0.5, 5.0
# Torque per rate error of a new motor over the inertia about its joint, 1/s. Animals that come with
# the program have 1000 to 4000.
_STIFF = 1000.0
_AXES, _LIMITS = ("y", "z"), (-45, 45)
_MARK = re.compile(r"\{(?:i|j|side)\}")

# Lengths of a shape by its type. A factor for each of them comes from the axes of the body.
_LENGTHS = {
    "box": {"size": (0, 1, 2)},
    "ellipsoid": {"radii": (0, 1, 2)},
    "sphere": {"radius": None},
    "capsule": {"length": 0, "radius": 1},
    "cylinder": {"length": 0, "radius": 1},
}


def add_part(
    data: Data,
    source: Path,
    parent: str,
    place: Vector,
    normal: Vector,
    name: str = "part",
    each: bool = True,
    shape: Data | None = None,
) -> str:
    """Add a part on a surface.

    Args:
        data: data of the document.
        source: file of the document.
        parent: name of the body that carries the part. It may be one of several copies.
        place: place on its surface, in the frame of that body, m.
        normal: outward normal of the surface there, in the same frame.
        name: name of the new part.
        each: whether all copies of the parent get one, or only this body.
        shape: shape of the part, or None for a capsule that fits the parent.

    Returns:
        Name of the new entry.
    """
    here = posed(data, source)
    index = here.index(parent)
    body, on = here.copies[index], bodies(data)[here.copies[index].entry]
    carrying = _solid(here, body.name)
    at, out = _surface(place, normal, carrying.half_extents)
    carrier = body.name
    copied = len(copies_of(data, body.entry)) > 1
    if copied and each:
        carrier = str(on["name"])
        at, out = reflected_if(at, body.mirror), reflected_if(out, body.mirror)
    marks = list(dict.fromkeys(_MARK.findall(carrier)))
    side = "".join(f"{mark}_" for mark in marks if mark == "{side}")
    number = "_".join(mark for mark in marks if mark != "{side}")
    if not name or _MARK.search(name):
        raise DrawingError(f"{name!r}: a name has no placeholders. Copies get them by themselves")
    own = free_name(data, f"{side}{name}{number}")
    form = shape or _fitting(carrying)
    rotation, child_at = facing(out, _reach(form))
    material = str(on.get("material"))
    entry: Data = {
        "name": own,
        "shape": form,
        "material": material,
        "joint": {
            "parent": carrier,
            "at": tidy(at),
            "child_at": tidy(child_at),
            **({"rotation_deg": tidy(rotation)} if np.any(rotation) else {}),
            "axes": list(_AXES),
            "limits_deg": list(_LIMITS),
            "actuator": {"gain": _gain(form, _density(data, material))},
        },
    }
    bodies(data).append(entry)
    return own


def add_shape(
    data: Data,
    source: Path,
    part: str,
    place: Vector,
    normal: Vector,
    shape: Data | None = None,
) -> None:
    """Add a further shape to a body, rigidly joined to it, on its surface.

    Args:
        data: data of the document.
        source: file of the document.
        part: name of the body. Copies of its entry get the shape, too.
        place: place on its surface, in the frame of that body, m.
        normal: outward normal of the surface there, in the same frame.
        shape: the shape, or None for a capsule that fits the body.
    """
    here = posed(data, source)
    body = here.copies[here.index(part)]
    own = _solid(here, body.name)
    at, out = _surface(place, normal, own.half_extents)
    at, out = reflected_if(at, body.mirror), reflected_if(out, body.mirror)
    form = shape or _fitting(own)
    rotation, joint = facing(out, _reach(form))
    centre = at - np.array(euler_to_matrix(*np.radians(rotation))) @ joint
    further: Data = {"shape": form, "at": tidy(centre)}
    if np.any(rotation):
        further["rotation_deg"] = tidy(rotation)
    entry = bodies(data)[body.entry]
    entry["parts"] = [*(entry.get("parts") or []), further]


def remove_shape(data: Data, name: str, index: int) -> None:
    """Remove a further shape of a body by its number among them, from 0."""
    entry = entry_of(data, name)
    further = entry.get("parts") or []
    if not 0 <= index < len(further):
        raise DrawingError(f"{name} has no further shape {index}")
    entry["parts"] = [each for i, each in enumerate(further) if i != index]
    if not entry["parts"]:
        del entry["parts"]


def _solid(here: Posed, name: str) -> Any:
    """Return the shape of a body, or its first further shape if it has no shape of its own."""
    for each in here.creature.bodies:
        if name in (each.name, each.whole) and each.shape.exists:
            return each.shape
    raise DrawingError(f"{name} has no shape, so it has no surface")


def _surface(
    place: Vector, normal: Vector, half_extents: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a checked place and normal, in the body's planes of symmetry if they are close."""
    at, out = np.asarray(place, float), np.asarray(normal, float)
    if not np.linalg.norm(out) > 0:
        raise DrawingError("the normal of a surface must not be zero")
    return on_planes(at, out, half_extents)


def remove_part(data: Data, name: str) -> None:
    """Remove a part with everything that it carries, and the sensors there."""
    index = entry_index(data, name)
    entries, everything = bodies(data), all_copies(data)
    if parent_of(entries[index]) is None:
        raise DrawingError(f"{name} is the root, which carries all other parts")
    gone = {index}
    while True:
        names = {copy.name for copy in everything if copy.entry in gone}
        more = {copy.entry for copy in everything if copy.parent in names} | gone
        if more == gone:
            break
        gone = more
    left = [copy.name for copy in everything if copy.entry not in gone]
    creature = data["creature"]
    creature["bodies"] = [entry for i, entry in enumerate(entries) if i not in gone]

    def is_gone(word: Any) -> bool:
        here = copies_named(str(word), everything)
        return bool(here) and not any(copy.name in left for copy in here)

    for kind in ("light_sensors", "depth_sensors", "sensors"):
        if isinstance(creature.get(kind), list):
            kept = [each for each in creature[kind] if not is_gone(each.get("body"))]
            if len(kept) < len(creature[kind]):
                creature[kind] = kept
    if isinstance(creature.get("pressure_sensors"), list):
        creature["pressure_sensors"] = [x for x in creature["pressure_sensors"] if not is_gone(x)]
    rule = creature.get("self_collision")
    for kind, pairs in rule.items() if isinstance(rule, dict) else ():
        rule[kind] = [pair for pair in pairs if not any(map(is_gone, pair))]
    if creature.get("tendons"):
        for tendon in creature["tendons"]:
            joints = tendon["joints"].items()
            tendon["joints"] = {k: v for k, v in joints if not is_gone(k.rpartition(".")[0])}
        creature["tendons"] = [each for each in creature["tendons"] if each["joints"]]


def rename_part(data: Data, name: str, new: str) -> None:
    """Rename a part, wherever the creature refers to it.

    A name of copies keeps its placeholders.
    """
    entry = entry_of(data, name)
    old = str(entry["name"])
    if new == old:
        return
    if sorted(_MARK.findall(new)) != sorted(_MARK.findall(old)):
        marks = ", ".join(_MARK.findall(old)) or "no placeholders"
        raise DrawingError(f"{new!r}: the name must contain {marks}, as {old!r} does")
    if new != free_name(data, new):
        raise DrawingError(f"{new!r}: another part has this name")
    rename_references(data, dict(_renamed(data, old, new)))
    entry["name"] = new


def _renamed(data: Data, old: str, new: str) -> Iterator[tuple[str, str]]:
    """Yield names of copies before and after a change of the entry's name."""
    yield old, new
    for copy in copies_of(data, entry_index(data, old)):
        yield copy.name, fill(new, copy.marks)


def rename_references(data: Data, names: dict[str, str]) -> None:
    """Replace names of parts wherever the creature refers to them."""
    creature = data["creature"]
    for entry in bodies(data):
        if parent_of(entry) in names:
            entry["joint"]["parent"] = names[entry["joint"]["parent"]]
    for kind in ("light_sensors", "depth_sensors", "sensors"):
        for each in creature.get(kind) or []:
            if each.get("body") in names:
                each["body"] = names[each["body"]]
    pressed = creature.get("pressure_sensors")
    if isinstance(pressed, list):
        creature["pressure_sensors"] = [names.get(word, word) for word in pressed]
    rule = creature.get("self_collision")
    for kind, pairs in rule.items() if isinstance(rule, dict) else ():
        rule[kind] = [[names.get(word, word) for word in pair] for pair in pairs]
    for tendon in creature.get("tendons") or []:
        joints = [(key.rpartition("."), x) for key, x in tendon["joints"].items()]
        tendon["joints"] = {
            f"{names.get(body, body)}{dot}{axis}": x for (body, dot, axis), x in joints
        }


def set_shape(data: Data, source: Path, name: str, type: str, further: int | None = None) -> None:
    """Replace a shape of a part by one of another type, with about the same extents.

    Args:
        data: data of the document.
        source: file of the document.
        name: name of the part.
        type: type of the new shape.
        further: number of a further shape of the part, from 0, or None for its own shape.
    """
    entry = entry_of(data, name)
    owner = entry if further is None else entry["parts"][further]
    old = owner["shape"] or {}
    if old.get("type") == "mesh":
        here = posed(data, source)
        index = here.creature.body_index(here.copies[here.index(name)].name)
        index += 0 if further is None else further + 1
        x, y, z = map(float, here.creature.bodies[index].shape.half_extents)
    else:
        x, y, z = _half_extents(old)
    across = (y + z) / 2
    made: dict[str, Data] = {
        "box": {"size": [2 * x, 2 * y, 2 * z]},
        "ellipsoid": {"radii": [x, y, z]},
        "sphere": {"radius": (x * y * z) ** (1 / 3)},
        "capsule": {"radius": across, "length": max(2 * x - 2 * across, 0.1 * across)},
        "cylinder": {"radius": across, "length": 2 * x},
    }
    if type != "loft" and type not in made:
        raise DrawingError(f"{type!r}: choose one of {', '.join([*made, 'loft'])}")
    if type == "loft":
        shape = new_loft((x, y, z))
    else:
        shape = {"type": type} | {key: tidy(value) for key, value in made[type].items()}
    owner["shape"] = shape
    if further is None:
        factors = np.array(_half_extents(shape)) / np.array([x, y, z])
        _carry(data, str(entry["name"]), factors)


def resize(data: Data, name: str, key: str, value: Finite | Vector) -> None:
    """Set a size of a part's shape, and move what sits on its surface.

    Args:
        data: data of the document.
        name: name of the part.
        key: key of the size in the shape.
        value: new size, m.
    """
    entry = entry_of(data, name)
    shape = entry["shape"]
    if key not in _LENGTHS.get(shape.get("type"), {}):
        raise DrawingError(f"{name}: its shape has no size {key!r}")
    if isinstance(value, tuple) != isinstance(shape[key], list):
        count = "three numbers" if isinstance(shape[key], list) else "one number"
        raise DrawingError(f"{key}: must be {count}")
    if not (np.asarray(value, float) > 0).all():
        raise DrawingError(f"{key}: must be greater than 0, got {value}")
    before = np.array(_half_extents(shape))
    shape[key] = np.asarray(value).tolist()
    _carry(data, str(entry["name"]), np.array(_half_extents(shape)) / before)


def stretch(data: Data, name: str, factors: Vector) -> None:
    """Stretch a part along its own axes, and move what sits on its surface.

    Args:
        data: data of the document.
        name: name of the part.
        factors: factors along x, y and z.
    """
    ratios = np.asarray(factors, float)
    if (ratios <= 0).any():
        raise DrawingError("the factors of a stretch must be three positive numbers")
    entry = entry_of(data, name)
    shape = entry["shape"]
    kind = shape.get("type")
    if kind == "mesh":
        if "file" not in shape:
            raise DrawingError(f"{name}: only a mesh from a file can be stretched")
        scale = np.broadcast_to(np.asarray(shape.get("scale", 1.0), float), 3)
        shape["scale"] = tidy(scale * ratios)
    elif kind == "loft":
        stretch_loft(shape, ratios)
    elif kind in _LENGTHS:
        before = np.array(_half_extents(shape))
        for key, axes in _LENGTHS[kind].items():
            shape[key] = _stretched(kind, key, shape, axes, ratios)
        ratios = np.array(_half_extents(shape)) / before
    else:
        raise DrawingError(f"{name}: a shape of type {kind!r} cannot be stretched")
    _carry(data, str(entry["name"]), ratios)


def _stretched(kind: str, key: str, shape: Data, axes: Any, factors: np.ndarray) -> Any:
    if axes is None:
        return tidy(shape[key] * _overall(factors))
    if isinstance(axes, tuple):
        return tidy(np.array(shape[key], float) * factors)
    if key == "length" and kind == "capsule":
        # The ends keep their radius, so the cylinder takes the whole change.
        whole = shape["length"] + 2 * shape["radius"]
        new_radius = shape["radius"] * _overall(factors[1:])
        return tidy(max(whole * factors[0] - 2 * new_radius, 0.01 * new_radius))
    if key == "length":
        return tidy(shape[key] * factors[0])
    return tidy(shape[key] * _overall(factors[1:]))


def _overall(factors: np.ndarray) -> float:
    """Return the factor that differs most from 1, for a size that several axes share."""
    return float(factors[np.abs(np.log(factors)).argmax()])


def _carry(data: Data, name: str, factors: np.ndarray) -> None:
    """Move joints and sensors with the surface of a part that is stretched."""
    entry = entry_of(data, name)
    joint = entry.get("joint")
    if isinstance(joint, dict) and "child_at" in joint:
        joint["child_at"] = tidy(np.array(joint["child_at"], float) * factors)
        for axis in joint["axes"] if isinstance(joint.get("axes"), list) else ():
            if isinstance(axis, dict) and axis.get("at"):
                axis["at"] = tidy(np.array(axis["at"], float) * factors)
    for further in entry.get("parts") or []:
        further["at"] = tidy(np.array(further["at"], float) * factors)
    everything = all_copies(data)
    own = {copy.name for copy in everything if copy.entry == entry_index(data, name)}
    # The bodies of a row hang on each other, so `at` of the row moves, too.
    for i in {copy.entry for copy in everything if copy.parent in own}:
        carried = bodies(data)[i]["joint"]
        carried["at"] = tidy(np.array(carried["at"], float) * factors)
    for kind in ("light_sensors", "depth_sensors"):
        for each in data["creature"].get(kind) or []:
            if each.get("position") and any(
                copy.name in own for copy in copies_named(str(each.get("body")), everything)
            ):
                each["position"] = tidy(np.array(each["position"], float) * factors)


def _half_extents(shape: Data | None) -> tuple[float, float, float]:
    given = shape or {}
    try:
        x, y, z = map(float, _halves(given))
    except (ArithmeticError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, DrawingError):
            raise
        raise DrawingError(f"the sizes of a {given.get('type')} are missing or wrong") from None
    if not min(x, y, z) > 0:
        raise DrawingError(f"the sizes of a {given.get('type')} must be greater than 0")
    return x, y, z


def _halves(shape: Data) -> Sequence[float]:
    """Return the half extents of a shape whose sizes may be wrong."""
    match shape.get("type"):
        case "box":
            return [size / 2 for size in shape["size"]]
        case "ellipsoid":
            return shape["radii"]
        case "sphere":
            return [shape["radius"]] * 3
        case "capsule":
            return [shape["length"] / 2 + shape["radius"], shape["radius"], shape["radius"]]
        case "cylinder":
            return [shape["length"] / 2, shape["radius"], shape["radius"]]
        case "loft":
            return loft_half_extents(shape).tolist()
        case other:
            raise DrawingError(f"a shape of type {other!r} has no sizes that can be changed here")


def _fitting(parent: Any) -> Data:
    """Return the shape of a new part, which fits its parent."""
    radius = _SIZE * float(parent.half_extents.min())
    length = min(_SLENDER * radius, 2 * float(parent.half_extents.max()))
    return {"type": "capsule", "radius": tidy(radius), "length": tidy(max(length, radius))}


def _reach(shape: Data) -> float:
    """Return the half extent of a shape along its x axis, m."""
    return _half_extents(shape)[0]


def _density(data: Data, material: str) -> float:
    found = (data["creature"].get("materials") or {}).get(material)
    return float(found.get("density", 1000.0)) if isinstance(found, dict) else 1000.0


def _gain(shape: Data, density: float) -> Any:
    """Return the gain of a motor that moves a body of a shape about its end, with two digits."""
    x, y, z = _half_extents(shape)
    inertia = density * 8 * x * y * z * (2 * x) ** 2 / 3
    return float(f"{_STIFF * inertia:.1e}") or 1e-9
