"""Edits of sensors: eyes, depth gauges and pressure sensors."""

from pathlib import Path
from typing import Any, Literal

import numpy as np

from evo_cpg.io.schema.section import Vector
from evo_cpg.view.drawing_page.document import Data, DrawingError
from evo_cpg.view.drawing_page.lookup import all_copies, bodies, copies_of, posed, tidy
from evo_cpg.view.drawing_page.placing import on_planes, reflected_if

Kind = Literal["light_sensors", "depth_sensors", "sensors"]


def add_eye(
    data: Data,
    source: Path,
    part: str,
    place: Vector,
    axis: Vector,
    each: bool = True,
    field_of_view_deg: float = 180,
) -> None:
    """Add an eye on a surface.

    Args:
        data: data of the document.
        source: file of the document.
        part: name of the body that carries it.
        place: position in the frame of that body, m.
        axis: viewing direction in the same frame.
        each: whether all copies of the part get one, or only this body.
        field_of_view_deg: full opening angle, degrees.
    """
    carrier, at, out = _place(data, source, part, place, axis, each)
    _list(data, "light_sensors").append(
        {
            "body": carrier,
            "position": tidy(at),
            "axis": tidy(out / np.linalg.norm(out)),
            "field_of_view_deg": tidy(field_of_view_deg),
        }
    )


def add_depth_gauge(data: Data, source: Path, part: str, place: Vector, each: bool = True) -> None:
    """Add a depth gauge on a surface, see `add_eye`."""
    carrier, at, _ = _place(data, source, part, place, (0, 0, 1), each)
    _list(data, "depth_sensors").append({"body": carrier, "position": tidy(at), "full_scale": 1})


def remove_sensor(data: Data, kind: Kind, index: int) -> None:
    """Remove a sensor by its number in its list."""
    found = data["creature"].get(kind)
    if not isinstance(found, list) or not 0 <= index < len(found):
        raise DrawingError(f"{kind} has no entry {index}")
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
        raise DrawingError(f"there is no part {part!r}")
    own = [each.name for each in copies_of(data, index)]
    entry = str(bodies(data)[index]["name"])
    kept: list[Any] = [name for name in names if name not in (*own, entry)]
    kept += [entry] if on else []
    plain = [each.name for each in everything]
    listed = {x for name in kept for x in plain if name == x} | (set(own) if on else set())
    data["creature"]["pressure_sensors"] = "all" if listed == set(plain) else kept


def _place(
    data: Data,
    source: Path,
    part: str,
    place: Vector,
    axis: Vector,
    each: bool,
) -> tuple[str, np.ndarray, np.ndarray]:
    """Return the name of the carrier, and place and direction in the frame of its entry."""
    here = posed(data, source)
    body = here.copies[here.index(part)]
    at, out = np.asarray(place, float), np.asarray(axis, float)
    if not np.linalg.norm(out) > 0:
        raise DrawingError("the axis of an eye must not be zero")
    shape = here.creature.bodies[here.creature.body_index(body.name)].shape
    at, out = on_planes(at, out, shape.half_extents)
    if each and len(copies_of(data, body.entry)) > 1:
        name = str(bodies(data)[body.entry]["name"])
        return name, reflected_if(at, body.mirror), reflected_if(out, body.mirror)
    return body.name, at, out


def _list(data: Data, kind: Kind) -> list[Data]:
    creature = data["creature"]
    if not isinstance(creature.get(kind), list):
        creature[kind] = []
    return creature[kind]
