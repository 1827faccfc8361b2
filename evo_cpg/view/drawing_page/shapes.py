"""Edits of shapes: another type, sizes, further shapes of a body, and cross-sections of lofts."""

from pathlib import Path
from typing import Any

import numpy as np

from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.loft import outline, section_axes
from evo_cpg.io.schema.copies import copies_named
from evo_cpg.io.schema.section import Finite, Vector
from evo_cpg.io.schema.shape import LoftConfig
from evo_cpg.view.drawing_page.document import Data, EditError
from evo_cpg.view.drawing_page.joints import facing
from evo_cpg.view.drawing_page.lookup import (
    Posed,
    all_copies,
    bodies,
    entry_index,
    entry_of,
    posed,
    reflected_if,
    tidy,
)

# Distance from a plane of symmetry within which a place is in the plane, in half extents.
_NEAR = 0.15
# Sizes of the sections of a new loft, relative to the middle one.
_TAPER = (0.5, 1.0, 0.5)
# Least factor of a size when a section is scaled.
_LEAST = 0.02


# Size of a new part, relative to the smallest half extent of its parent, and its length over it.
_SIZE, _SLENDER = 0.5, 5.0
# Lengths of a shape by its type. A factor for each of them comes from the axes of the body.
_LENGTHS = {
    "box": {"size": (0, 1, 2)},
    "ellipsoid": {"radii": (0, 1, 2)},
    "sphere": {"radius": None},
    "capsule": {"length": 0, "radius": 1},
    "cylinder": {"length": 0, "radius": 1},
}


def set_shape(data: Data, source: Path, name: str, type: str, further: int | None = None) -> None:
    """Replace a shape of a part by one of another type, with about the same extents.

    ``further`` is the number of a further shape of the part, from 0, or None for its own shape.
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
        x, y, z = half_extents(old)
    across = (y + z) / 2
    made: dict[str, Data] = {
        "box": {"size": [2 * x, 2 * y, 2 * z]},
        "ellipsoid": {"radii": [x, y, z]},
        "sphere": {"radius": (x * y * z) ** (1 / 3)},
        "capsule": {"radius": across, "length": max(2 * x - 2 * across, 0.1 * across)},
        "cylinder": {"radius": across, "length": 2 * x},
    }
    if type != "loft" and type not in made:
        raise EditError(f"{type!r}: choose one of {', '.join([*made, 'loft'])}")
    if type == "loft":
        # A spindle along x.
        sections = [
            {
                "at": tidy([place * x, 0, 0]),
                "width": tidy(2 * y * size),
                "height": tidy(2 * z * size),
            }
            for place, size in zip((1, 0, -1), _TAPER, strict=True)
        ]
        shape = {"type": "loft", "sections": sections}
    else:
        shape = {"type": type} | {key: tidy(value) for key, value in made[type].items()}
    owner["shape"] = shape
    if further is None:
        factors = np.array(half_extents(shape)) / np.array([x, y, z])
        _carry(data, str(entry["name"]), factors)


def resize(data: Data, name: str, key: str, value: Finite | Vector) -> None:
    """Set a size (m) of a part's shape by its key, and move what sits on its surface."""
    entry = entry_of(data, name)
    shape = entry["shape"]
    if key not in _LENGTHS.get(shape.get("type"), {}):
        raise EditError(f"{name}: its shape has no size {key!r}")
    if isinstance(value, tuple) != isinstance(shape[key], list):
        count = "three numbers" if isinstance(shape[key], list) else "one number"
        raise EditError(f"{key}: must be {count}")
    if not (np.asarray(value, float) > 0).all():
        raise EditError(f"{key}: must be greater than 0, got {value}")
    before = np.array(half_extents(shape))
    shape[key] = np.asarray(value).tolist()
    _carry(data, str(entry["name"]), np.array(half_extents(shape)) / before)


def stretch(data: Data, name: str, factors: Vector) -> None:
    """Stretch a part along its own x, y and z, and move what sits on its surface."""
    ratios = np.asarray(factors, float)
    if (ratios <= 0).any():
        raise EditError("the factors of a stretch must be three positive numbers")
    entry = entry_of(data, name)
    shape = entry["shape"]
    kind = shape.get("type")
    if kind == "mesh":
        if "file" not in shape:
            raise EditError(f"{name}: only a mesh from a file can be stretched")
        scale = np.broadcast_to(np.asarray(shape.get("scale", 1.0), float), 3)
        shape["scale"] = tidy(scale * ratios)
    elif kind == "loft":
        axes = section_axes(LoftConfig.model_validate(shape).drawn)
        for each, (across, up) in zip(shape["sections"], axes, strict=True):
            each["at"] = tidy(np.array(each["at"], float) * ratios)
            each["width"] = tidy(each["width"] * np.linalg.norm(across * ratios))
            each["height"] = tidy(each["height"] * np.linalg.norm(up * ratios))
    elif kind in _LENGTHS:
        before = np.array(half_extents(shape))
        # A size that several axes share takes the factor that differs most from 1.
        overall, across = (
            float(shared[np.abs(np.log(shared)).argmax()]) for shared in (ratios, ratios[1:])
        )
        for key, axes in _LENGTHS[kind].items():
            if axes is None:
                new = shape[key] * overall
            elif isinstance(axes, tuple):
                new = np.array(shape[key], float) * ratios
            elif key == "length" and kind == "capsule":
                # The ends keep their radius, so the cylinder takes the whole change.
                whole, radius = shape["length"] + 2 * shape["radius"], shape["radius"] * across
                new = max(whole * ratios[0] - 2 * radius, 0.01 * radius)
            else:
                new = shape[key] * (ratios[0] if key == "length" else across)
            shape[key] = tidy(new)
        ratios = np.array(half_extents(shape)) / before
    else:
        raise EditError(f"{name}: a shape of type {kind!r} cannot be stretched")
    _carry(data, str(entry["name"]), ratios)


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


def half_extents(shape: Data | None) -> tuple[float, float, float]:
    """Return half the sizes of a shape along its axes, m.

    Raises:
        EditError: a size is missing or wrong.
    """
    given = shape or {}
    try:
        match kind := given.get("type"):
            case "box":
                halves = [size / 2 for size in given["size"]]
            case "ellipsoid":
                halves = given["radii"]
            case "sphere":
                halves = [given["radius"]] * 3
            case "capsule":
                radius = given["radius"]
                halves = [given["length"] / 2 + radius, radius, radius]
            case "cylinder":
                halves = [given["length"] / 2, given["radius"], given["radius"]]
            case "loft":
                made, reach = LoftConfig.model_validate(given), []
                for each, (across, up) in zip(made.drawn, section_axes(made.drawn), strict=True):
                    sizes = np.array([across * each.width / 2, up * each.height / 2])
                    corners = np.abs(outline(made.corners) @ sizes).max(0)
                    is_round = made.corners is None
                    reach.append(np.linalg.norm(sizes, axis=0) if is_round else corners)
                places = np.array([each.at for each in made.drawn])
                box = np.max(places + reach, axis=0) - np.min(places - reach, axis=0)
                halves = (box / 2).tolist()
            case _:
                raise EditError(f"a shape of type {kind!r} has no sizes that can be changed here")
        x, y, z = map(float, halves)
    except (ArithmeticError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, EditError):
            raise
        raise EditError(f"the sizes of a {given.get('type')} are missing or wrong") from None
    if not min(x, y, z) > 0:
        raise EditError(f"the sizes of a {given.get('type')} must be greater than 0")
    return x, y, z


def add_shape(
    data: Data, source: Path, part: str, place: Vector, normal: Vector, shape: Data | None = None
) -> None:
    """Add a further shape to a body and its copies, rigidly joined to it on its surface.

    The place (m) and the outward normal there are in the body's frame. Without a shape, a capsule
    is added that fits the body.
    """
    here = posed(data, source)
    body = here.copies[here.index(part)]
    own = solid(here, body.name)
    at, out = surface(place, normal, own.half_extents)
    at, out = reflected_if(at, body.mirror), reflected_if(out, body.mirror)
    form = shape or fitting(own)
    rotation, joint = facing(out, half_extents(form)[0])
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
        raise EditError(f"{name} has no further shape {index}")
    entry["parts"] = [each for i, each in enumerate(further) if i != index]
    if not entry["parts"]:
        del entry["parts"]


def solid(here: Posed, name: str) -> Any:
    """Return the shape of a body, or its first further shape if it has no shape of its own."""
    for each in here.creature.bodies:
        if name in (each.name, each.whole) and each.shape.exists:
            return each.shape
    raise EditError(f"{name} has no shape, so it has no surface")


def surface(
    place: Vector, normal: Vector, half_extents: np.ndarray, what: str = "normal of a surface"
) -> tuple[np.ndarray, np.ndarray]:
    """Return a checked place and normal, in the body's planes of symmetry if they are close."""
    at, out = np.asarray(place, float), np.asarray(normal, float)
    if not np.linalg.norm(out) > 0:
        raise EditError(f"the {what} must not be zero")
    near = np.abs(at) < _NEAR * np.asarray(half_extents, float)
    # At a corner the normal may point along the plane's normal alone.
    flat = np.where(near, 0.0, out)
    return np.where(near, 0.0, at), flat if flat.any() else out


def fitting(parent: Any) -> Data:
    """Return the shape of a new part, which fits its parent."""
    radius = _SIZE * float(parent.half_extents.min())
    length = min(_SLENDER * radius, 2 * float(parent.half_extents.max()))
    return {"type": "capsule", "radius": tidy(radius), "length": tidy(max(length, radius))}


def add_section(data: Data, name: str, after: int) -> None:
    """Add a section halfway from one section, by its number from 0, to the next or beyond it."""
    sections, here = _section(data, name, after)
    if after + 1 < len(sections):
        other, fraction = sections[after + 1], 0.5
    else:
        # The last section may be a tip, which then moves to the new end.
        other, fraction = sections[after - 1], -1.0
    made = {
        key: tidy(
            (1 - fraction) * np.array(here[key], float) + fraction * np.array(other[key], float)
        )
        for key in ("at", "width", "height")
    }
    if after + 1 < len(sections):
        sections.insert(after + 1, made)
        return
    made |= {key: here[key] for key in ("width", "height")}
    if not here["width"] * here["height"]:
        before = sections[after - 1]
        here |= {key: tidy(before[key] / 2) for key in ("width", "height")}
    sections.append(made)


def remove_section(data: Data, name: str, index: int) -> None:
    """Remove a section of a loft by its number, from 0. Two sections stay."""
    sections, _ = _section(data, name, index)
    if len(sections) == 2:
        raise EditError(f"{name}: a loft needs two sections")
    del sections[index]


def move_section(data: Data, source: Path, part: str, index: int, by: Vector) -> None:
    """Move a section of a loft, and the sections of its copies alike.

    The displacement is in the axes of the root at rest (m).
    """
    here = posed(data, source)
    body = here.index(part)
    own = here.rotations[body].T @ np.asarray(by, float)
    _, section = _section(data, part, index)
    moved = reflected_if(own, here.copies[body].mirror)
    section["at"] = tidy(np.array(section["at"], float) + moved)


def scale_section(data: Data, part: str, index: int, factors: tuple[Finite, Finite]) -> None:
    """Scale the width and the height of a section of a loft."""
    _, section = _section(data, part, index)
    for key, factor in zip(("width", "height"), factors, strict=True):
        section[key] = tidy(section[key] * max(abs(factor), _LEAST))


def _section(data: Data, name: str, index: int) -> tuple[list[Data], Data]:
    """Return the sections of a loft, and one of them by its number."""
    shape = entry_of(data, name).get("shape")
    if not isinstance(shape, dict) or shape.get("type") != "loft":
        raise EditError(f"{name} is no loft")
    sections = shape["sections"]
    if not 0 <= index < len(sections):
        raise EditError(f"{name} has no section {index}")
    return sections, sections[index]
