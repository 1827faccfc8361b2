"""Edits of copies: mirror a limb, repeat a segment, make a star of limbs, separate copies."""

import copy as copying
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from evo_cpg.creature.axis_kinds import body_and_axis
from evo_cpg.io.schema.copies import Copy, MirrorAxis, copies_named, fill, opposed, reflected
from evo_cpg.io.schema.joint import JointConfig
from evo_cpg.io.schema.tendon import TendonConfig
from evo_cpg.view.drawing_page.document import Data, EditError
from evo_cpg.view.drawing_page.lookup import (
    all_copies,
    bodies,
    entry_index,
    free_name,
    joint_of,
    limb_of,
    parent_of,
    reflected_if,
    tidy,
)
from evo_cpg.view.drawing_page.parts import map_references, rename_references

# Largest distance of a row's joint from the end of its bodies, over their half length.
_GAP = 0.3
_MARKS = {"repeat": "{i}", "radial": "{j}", "mirror": "{side}"}


def mirror(data: Data, name: str, axis: MirrorAxis = "y") -> str:
    """Mirror a limb, with everything that it carries, in the parent's plane normal to an axis.

    Returns:
        New name of the entry.
    """
    index = entry_index(data, name)
    entry, joint, limb = bodies(data)[index], joint_of(data, name), limb_of(data, index)
    for i in limb:
        each = bodies(data)[i]
        if "{side}" in str(each["name"]):
            raise EditError(f"{each['name']} is already copied by `mirror`")
        carrier = parent_of(each) or ""
        numbered = re.search(r"\{[ij]\}", carrier)
        if i != index and not numbered and re.search(r"\d$", carrier):
            carriers = [x for x in all_copies(data) if x.name == carrier]
            if carriers and bodies(data)[carriers[0].entry]["name"] != carrier:
                raise EditError(
                    f"{each['name']} is on {carrier}, one body of a row. Separate the row first"
                )
    side = "xyz".index(axis)
    if joint["at"][side] == 0:
        raise EditError(
            f"{entry['name']}: its joint is in the mirror plane, so both would be in one place. "
            f"Move it along {axis} first"
        )
    if joint["at"][side] < 0:
        # The written limb is on the positive side.
        for i in limb:
            each = bodies(data)[i]
            _reflect_shapes(each, axis)
            own = each["joint"]
            checked = JointConfig.model_validate(own).mirrored(axis)
            own["at"], own["child_at"] = tidy(checked.at), tidy(checked.child_at)
            own["axes"] = _mirrored_axes(own["axes"], axis)
            if "rotation_deg" in own:
                own["rotation_deg"] = tidy(opposed(own["rotation_deg"], axis))
            for kind in ("light_sensors", "depth_sensors"):
                for eye in data["creature"].get(kind) or []:
                    mirrored = ("position", "axis") if eye.get("body") == each["name"] else ()
                    for key in (key for key in mirrored if key in eye):
                        eye[key] = tidy(reflected_if(eye[key], axis))
    _mark_limb(data, limb, "{side}", front=True)
    bodies(data)[index]["mirror"] = axis
    return str(bodies(data)[index]["name"])


def repeat(data: Data, name: str, count: int) -> str:
    """Repeat a segment in a row, in which each body hangs on the one before it.

    Parts on the segment move to the last one of the row. A count of 1 ends the row. If the segment
    sits on a parent of another size, it stays as it is, and a row of the others follows it.

    Returns:
        New name of the entry.
    """
    if count <= 1:
        return _number(data, name, "repeat", count)
    index, further = entry_index(data, name), count - 1
    entry, joint = bodies(data)[index], joint_of(data, name)
    fits = "repeat" in entry or "{i}" in str(entry["name"])
    if not fits:
        at, end = np.array(joint["at"], float), -np.array(joint["child_at"], float)
        fits = bool(np.linalg.norm(at - end) <= _GAP * np.linalg.norm(end))
    if fits:
        return _number(data, name, "repeat", count)
    if re.search(r"\{\w+\}", str(entry["name"])):
        raise EditError(f"{entry['name']} is copied already. Separate the copies first")
    row = copying.deepcopy(entry)
    row["name"] = free_name(data, f"{entry['name']}_{{i}}")
    row["joint"]["parent"] = entry["name"]
    row["joint"]["at"] = tidy(-np.array(row["joint"]["child_at"], float))
    row["joint"].pop("rotation_deg", None)
    if further > 1:
        row["repeat"] = further
    last = str(row["name"]).replace("{i}", str(further))
    for child in bodies(data):
        if parent_of(child) == entry["name"]:
            child["joint"]["parent"] = last
    _reorder(row)
    bodies(data).insert(index + 1, row)
    return str(row["name"])


def radial(data: Data, name: str, count: int) -> str:
    """Arrange copies of a limb in a star, about the parent's vertical axis.

    Returns:
        New name of the entry.
    """
    return _number(data, name, "radial", count)


def separate(data: Data, name: str) -> None:
    """Write each copy of an entry as an entry of its own, so that they can differ."""
    index = entry_index(data, name)
    entry, everything = bodies(data)[index], all_copies(data)
    own = [each for each in everything if each.entry == index]
    if len(own) == 1 and own[0].name == entry["name"]:
        raise EditError(f"{entry['name']} is a single part")
    if re.search(r"\{\w+\}", parent_of(entry) or ""):
        raise EditError(
            f"{entry['name']} is copied with its parent. Separate {parent_of(entry)} first"
        )
    # What the copies carry is copied with them, and would lose its pattern.
    indices = limb_of(data, index)

    def separated(name: Any) -> list[Copy]:
        """Return the bodies of a name with placeholders, if they get entries of their own."""
        found = copies_named(str(name), everything) if "{" in str(name) else []
        return found if any(each.entry in indices for each in found) else []

    def names(name: str) -> list[str]:
        return [each.name for each in separated(name)] or [name]

    made: list[Data] = []
    for i, written in enumerate(bodies(data)):
        if i in indices:
            made += [_single(written, each) for each in everything if each.entry == i]
        else:
            made.append(written)
    creature = data["creature"]
    creature["bodies"] = made
    tendons: list[Data] = []
    for tendon in creature.get("tendons") or []:
        if any(separated(body_and_axis(joint)[0]) for joint in tendon["joints"]):
            own = TendonConfig.model_validate(tendon).build(everything)
            tendons += [tendon | {"name": x.name, "joints": dict(x.joints)} for x in own]
        else:
            tendons.append(tendon)
    if tendons:
        creature["tendons"] = tendons

    def moved(sensor: Data, name: str) -> Data:
        body = next(each for each in everything if each.name == name)
        own = copying.deepcopy(sensor) | {"body": name}
        for key in {"position", "axis"} & set(own) if body.mirror else ():
            own[key] = tidy(reflected_if(sensor[key], body.mirror))
        return own

    map_references(data, names, moved)


def _single(entry: Data, body: Copy) -> Data:
    """Return the entry of one copy."""
    made = {k: copying.deepcopy(v) for k, v in entry.items() if k not in _MARKS}
    made["name"] = body.name
    if body.mirror:
        _reflect_shapes(made, body.mirror)
    if "joint" not in made:
        return made
    checked = JointConfig.model_validate(made["joint"]).turned(body.turn_deg)
    if body.mirror:
        checked = checked.mirrored(body.mirror)
    joint = made["joint"]
    joint["parent"] = body.parent
    for key in ("at", "child_at", "rotation_deg") if body.mirror or body.turn_deg else ():
        new = getattr(checked, key)
        if key in joint or np.any(new):
            joint[key] = tidy(new)
    if body.mirror and "axes" in joint:
        joint["axes"] = _mirrored_axes(joint["axes"], body.mirror)
    return made


def _mirrored_axes(axes: Any, mirror: MirrorAxis) -> Any:
    """Return the axes of a mirrored joint, as they are written."""
    if not isinstance(axes, list):
        return axes
    made = []
    for entry in axes:
        if not isinstance(entry, dict):
            made.append(_image(entry, mirror, opposed))
            continue
        image = dict(entry)
        if "turn" in entry:
            image["turn"] = _image(entry["turn"], mirror, opposed)
        if "slide" in entry:
            image["slide"] = _image(entry["slide"], mirror, reflected)
        if entry.get("at"):
            image["at"] = tidy(reflected_if(entry["at"], mirror))
        made.append(image)
    return made


def _image(direction: Any, mirror: MirrorAxis, image: Callable[..., Any]) -> Any:
    """Return the mirror image of an axis, by its name if it has one."""
    if not isinstance(direction, str):
        return tidy(image(tuple(direction), mirror))
    sign, name = (-1.0, direction[1:]) if direction.startswith("-") else (1.0, direction)
    i = "xyz".index(name)
    # The image of an axis is the same axis, or points against it.
    ahead = image(tuple(sign * np.eye(3)[i]), mirror)[i] > 0
    return "xyz"[i] if ahead else f"-{'xyz'[i]}"


def _number(data: Data, name: str, key: str, count: int) -> str:
    if not 1 <= count <= 1000:
        raise EditError(f"{key}: must be a whole number from 1 to 1000, got {count!r}")
    index, mark = entry_index(data, name), _MARKS[key]
    entry = bodies(data)[index]
    if parent_of(entry) is None:
        raise EditError(f"{name} is the root, which cannot be copied")
    if key in entry or mark in str(entry["name"]):
        if mark in (parent_of(entry) or ""):
            raise EditError(f"{entry['name']} is copied with its parent {parent_of(entry)}")
        limb, was = limb_of(data, index), entry.get(key, 1)
        own = [each for each in all_copies(data) if each.entry == index]
        entry[key] = count
        names = {}
        for each in own:
            number = int(each.marks.get(mark[1:-1], "1"))
            # Parts on the last body of a row stay on its last body.
            if (key == "repeat" and number == was) or number > count:
                marks = each.marks | {mark[1:-1]: str(count)}
                names[each.name] = fill(str(entry["name"]), marks)
        rename_references(data, {old: new for old, new in names.items() if old != new})
        if count == 1 and key == "radial":
            del entry[key]
            _mark_limb(data, limb, mark, front=False, remove=True)
        return str(bodies(data)[index]["name"])
    if count == 1:
        return str(entry["name"])
    if key == "radial":
        _mark_limb(data, limb_of(data, index), mark, front=False)
        bodies(data)[index][key] = count
        return str(bodies(data)[index]["name"])
    old = str(entry["name"])
    new = free_name(data, f"{re.sub(r'[0-9]+$', '', old) or old}{mark}")
    entry["name"] = new
    entry[key] = count
    last = new.replace(mark, str(count))
    rename_references(data, {old: last})
    # The row itself keeps its parent, and its eyes look from its first body.
    for kind in ("light_sensors", "depth_sensors"):
        for each in data["creature"].get(kind) or []:
            if each.get("body") == last:
                each["body"] = new.replace(mark, "1")
    _reorder(entry)
    return new


def _mark_limb(data: Data, limb: list[int], mark: str, front: bool, remove: bool = False) -> None:
    """Add a placeholder to the names of a limb's entries, or remove it."""
    names: dict[str, str] = {}
    for i in limb:
        old = str(bodies(data)[i]["name"])
        if remove:
            new = old.replace(mark, "1")
        else:
            bare = re.sub(r"^(left|right|front|hind|upper|lower)_", "", old) if front else old
            new = f"{mark}_{bare}" if front else f"{old}_{mark}"
            new = free_name(data, new)
        names[old] = new
        bodies(data)[i]["name"] = new
    rename_references(data, names)


def _reflect_shapes(entry: Data, axis: MirrorAxis) -> None:
    """Replace the shapes of an entry by their mirror images."""
    further = entry.get("parts") or []
    shapes = [entry.get("shape"), *(each.get("shape") for each in further)]
    if any(isinstance(shape, dict) and shape.get("type") == "mesh" for shape in shapes):
        raise EditError(f"{entry['name']}: a mesh has no mirror image of its own in the file")
    if entry.get("inertia"):
        raise EditError(f"{entry['name']}: an inertia in numbers cannot be mirrored here")
    for shape in shapes:
        if isinstance(shape, dict) and shape.get("type") == "loft":
            for section in shape["sections"]:
                section["at"] = tidy(reflected_if(section["at"], axis))
    for each in further:
        each["at"] = tidy(reflected_if(each["at"], axis))
        if "rotation_deg" in each:
            each["rotation_deg"] = tidy(opposed(each["rotation_deg"], axis))


def _reorder(entry: Data) -> None:
    """Move the number of copies to the place behind the name, for readers."""
    ordered = {"name": entry["name"], **{k: entry[k] for k in _MARKS if k in entry}, **entry}
    entry.clear()
    entry.update(ordered)
