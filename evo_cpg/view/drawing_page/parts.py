"""Edits of parts and their sensors: add, remove, rename."""

import itertools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from evo_cpg.creature.axis_kinds import body_and_axis
from evo_cpg.io.schema.copies import copies_named, fill
from evo_cpg.io.schema.section import Vector
from evo_cpg.view.drawing_page.document import Data, EditError
from evo_cpg.view.drawing_page.joints import facing
from evo_cpg.view.drawing_page.lookup import (
    all_copies,
    bodies,
    entry_index,
    entry_of,
    free_name,
    limb_of,
    parent_of,
    posed,
    reflected_if,
    tidy,
)
from evo_cpg.view.drawing_page.shapes import fitting, half_extents, solid, surface

# Torque per rate error of a new motor over the inertia about its joint, 1/s. Animals that come with
# the program have 1000 to 4000.
_STIFF = 1000.0
_AXES, _LIMITS = ("y", "z"), (-45, 45)
_MARK = re.compile(r"\{(?:i|j|side)\}")

Kind = Literal["light_sensors", "depth_sensors", "sensors"]


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
    """Add a part on a surface, at a place (m) with its outward normal in the parent's frame.

    The parent is a body, which may be one of several copies. ``each`` gives all of them a part.
    Without a shape, the part is a capsule that fits the parent.

    Returns:
        Name of the new entry.
    """
    here = posed(data, source)
    index = here.index(parent)
    body, on = here.copies[index], bodies(data)[here.copies[index].entry]
    carrying = solid(here, body.name)
    at, out = surface(place, normal, carrying.half_extents)
    carrier = body.name
    copied = sum(x.entry == body.entry for x in here.copies) > 1
    if copied and each:
        carrier = str(on["name"])
        at, out = reflected_if(at, body.mirror), reflected_if(out, body.mirror)
    marks = list(dict.fromkeys(_MARK.findall(carrier)))
    side = "".join(f"{mark}_" for mark in marks if mark == "{side}")
    number = "_".join(mark for mark in marks if mark != "{side}")
    if not name or _MARK.search(name):
        raise EditError(f"{name!r}: a name has no placeholders. Copies get them by themselves")
    own = free_name(data, f"{side}{name}{number}")
    form = shape or fitting(carrying)
    rotation, child_at = facing(out, half_extents(form)[0])
    material = str(on.get("material"))
    found = (data["creature"].get("materials") or {}).get(material)
    density = float(found.get("density", 1000.0)) if isinstance(found, dict) else 1000.0
    x, y, z = half_extents(form)
    # Inertia of a box about its end.
    inertia = density * 8 * x * y * z * (2 * x) ** 2 / 3
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
            "actuator": {"gain": float(f"{_STIFF * inertia:.1e}") or 1e-9},
        },
    }
    bodies(data).append(entry)
    return own


def remove_part(data: Data, name: str) -> None:
    """Remove a part with everything that it carries, and the sensors there."""
    index = entry_index(data, name)
    entries, everything = bodies(data), all_copies(data)
    if parent_of(entries[index]) is None:
        raise EditError(f"{name} is the root, which carries all other parts")
    gone = limb_of(data, index)
    left = [copy.name for copy in everything if copy.entry not in gone]
    data["creature"]["bodies"] = [entry for i, entry in enumerate(entries) if i not in gone]

    def kept(word: str) -> list[str]:
        here = copies_named(word, everything)
        return [] if here and not any(copy.name in left for copy in here) else [word]

    map_references(data, kept)


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
        raise EditError(f"{new!r}: the name must contain {marks}, as {old!r} does")
    if new != free_name(data, new):
        raise EditError(f"{new!r}: another part has this name")
    index = entry_index(data, old)
    copied = [each for each in all_copies(data) if each.entry == index]
    rename_references(data, {old: new} | {each.name: fill(new, each.marks) for each in copied})
    entry["name"] = new


def rename_references(data: Data, names: dict[str, str]) -> None:
    """Replace names of parts wherever the creature refers to them."""
    for entry in bodies(data):
        if parent_of(entry) in names:
            entry["joint"]["parent"] = names[entry["joint"]["parent"]]
    map_references(data, lambda name: [names.get(name, name)])


def map_references(
    data: Data,
    images: Callable[[str], list[str]],
    moved: Callable[[Data, str], Data] = lambda sensor, name: sensor | {"body": name},
) -> None:
    """Replace each name of a part by others, in sensors, pairs that may collide, and tendons.

    Args:
        data: data of the document.
        images: names in place of a name. Without any, what refers to the name is removed.
        moved: sensor in place of another one, for the body of a name.
    """
    creature = data["creature"]
    for kind in get_args(Kind):
        if isinstance(creature.get(kind), list):
            creature[kind] = [
                each if name == str(each.get("body")) else moved(each, name)
                for each in creature[kind]
                for name in images(str(each.get("body")))
            ]
    pressed = creature.get("pressure_sensors")
    if isinstance(pressed, list):
        creature["pressure_sensors"] = [new for word in pressed for new in images(str(word))]
    rule = creature.get("self_collision")
    for kind, pairs in rule.items() if isinstance(rule, dict) else ():
        found = (itertools.product(*(images(str(word)) for word in pair)) for pair in pairs)
        rule[kind] = [list(pair) for some in found for pair in some]
    for tendon in creature.get("tendons") or []:
        joints = [(*body_and_axis(joint), x) for joint, x in tendon["joints"].items()]
        tendon["joints"] = {f"{new}.{axis}": x for body, axis, x in joints for new in images(body)}
    if creature.get("tendons"):
        creature["tendons"] = [each for each in creature["tendons"] if each["joints"]]


def add_eye(
    data: Data,
    source: Path,
    part: str,
    place: Vector,
    axis: Vector,
    each: bool = True,
    field_of_view_deg: float = 180,
) -> None:
    """Add an eye to a body, at a place (m) that looks along an axis of the body's frame.

    ``each`` gives all copies of the body an eye. The field of view is the full opening angle.
    """
    eye, out = _add_sensor(data, source, "light_sensors", part, place, axis, each)
    eye["axis"] = tidy(out / np.linalg.norm(out))
    eye["field_of_view_deg"] = tidy(field_of_view_deg)


def add_depth_gauge(data: Data, source: Path, part: str, place: Vector, each: bool = True) -> None:
    """Add a depth gauge on a surface, see `add_eye`."""
    gauge, _ = _add_sensor(data, source, "depth_sensors", part, place, (0, 0, 1), each)
    gauge["full_scale"] = 1


def remove_sensor(data: Data, kind: Kind, index: int) -> None:
    """Remove a sensor by its number in its list."""
    found = data["creature"].get(kind)
    if not isinstance(found, list) or not 0 <= index < len(found):
        raise EditError(f"{kind} has no entry {index}")
    del found[index]


def set_pressure(data: Data, part: str, on: bool) -> None:
    """Give all bodies of a part pressure sensors, or remove them."""
    everything = all_copies(data)
    given = data["creature"].get("pressure_sensors", "all")
    names = [each.name for each in everything] if given == "all" else list(given)
    index = next((x.entry for x in everything if x.name == part), None)
    if index is None:
        index = next((i for i, x in enumerate(bodies(data)) if x.get("name") == part), None)
    if index is None:
        raise EditError(f"there is no part {part!r}")
    own = [each.name for each in everything if each.entry == index]
    entry = str(bodies(data)[index]["name"])
    kept: list[Any] = [name for name in names if name not in (*own, entry)]
    kept += [entry] if on else []
    plain = [each.name for each in everything]
    listed = {x for name in kept for x in plain if name == x} | (set(own) if on else set())
    data["creature"]["pressure_sensors"] = "all" if listed == set(plain) else kept


def _add_sensor(
    data: Data, source: Path, kind: Kind, part: str, place: Vector, axis: Vector, each: bool
) -> tuple[Data, np.ndarray]:
    """Add a sensor at its place, and return it and its direction in the frame of its entry."""
    here = posed(data, source)
    body = here.copies[here.index(part)]
    carrier, shape = body.name, here.creature.bodies[here.creature.body_index(body.name)].shape
    at, out = surface(place, axis, shape.half_extents, "axis of an eye")
    if each and sum(x.entry == body.entry for x in here.copies) > 1:
        carrier = str(bodies(data)[body.entry]["name"])
        at, out = reflected_if(at, body.mirror), reflected_if(out, body.mirror)
    sensor: Data = {"body": carrier, "position": tidy(at)}
    creature = data["creature"]
    if not isinstance(creature.get(kind), list):
        creature[kind] = []
    creature[kind].append(sensor)
    return sensor, out
