"""Edits of lofts: add, remove, move and scale cross-sections."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evo_cpg.creature.loft import outline, section_axes
from evo_cpg.io.schema.section import Finite, Vector
from evo_cpg.io.schema.shape import LoftConfig
from evo_cpg.view.drawing_page.document import Data, DrawingError
from evo_cpg.view.drawing_page.lookup import entry_of, posed, tidy
from evo_cpg.view.drawing_page.placing import reflected_if

# Sizes of the sections of a new loft, relative to the middle one.
_TAPER = (0.5, 1.0, 0.5)
# Least factor of a size when a section is scaled.
_LEAST = 0.02


def new_loft(half_extents: Sequence[float]) -> Data:
    """Return a spindle along x with some half extents, m."""
    x, y, z = half_extents
    return {
        "type": "loft",
        "sections": [
            {
                "at": tidy([place * x, 0, 0]),
                "width": tidy(2 * y * size),
                "height": tidy(2 * z * size),
            }
            for place, size in zip((1, 0, -1), _TAPER, strict=True)
        ],
    }


def loft_half_extents(shape: Data) -> np.ndarray:
    """Return half the sizes ``(3,)`` of the box around a loft, m."""
    made = LoftConfig.model_validate(shape)
    reach = []
    for each, (across, up) in zip(made.drawn, section_axes(made.drawn), strict=True):
        sizes = np.array([across * each.width / 2, up * each.height / 2])
        corners = np.abs(outline(made.corners) @ sizes).max(0)
        reach.append(np.linalg.norm(sizes, axis=0) if made.corners is None else corners)
    places = np.array([each.at for each in made.drawn])
    return (np.max(places + reach, axis=0) - np.min(places - reach, axis=0)) / 2


def stretch_loft(shape: Data, factors: np.ndarray) -> None:
    """Stretch a loft along the axes of its frame."""
    sections = shape["sections"]
    axes = section_axes(LoftConfig.model_validate(shape).drawn)
    for each, (across, up) in zip(sections, axes, strict=True):
        each["at"] = tidy(np.array(each["at"], float) * factors)
        each["width"] = tidy(each["width"] * np.linalg.norm(across * factors))
        each["height"] = tidy(each["height"] * np.linalg.norm(up * factors))


def add_section(data: Data, name: str, after: int) -> None:
    """Add a section halfway to the next one, or beyond the last one.

    Args:
        data: data of the document.
        name: name of the part.
        after: number of the section before the new one, from 0.
    """
    sections = _sections(data, name)
    here = _section(sections, name, after)
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
    sections = _sections(data, name)
    _section(sections, name, index)
    if len(sections) == 2:
        raise DrawingError(f"{name}: a loft needs two sections")
    del sections[index]


def move_section(data: Data, source: Path, part: str, index: int, by: Vector) -> None:
    """Move a section of a loft.

    Args:
        data: data of the document.
        source: file of the document.
        part: name of the body. The sections of its copies move alike.
        index: number of the section, from 0.
        by: displacement in the axes of the root at rest, m.
    """
    here = posed(data, source)
    body = here.index(part)
    own = here.rotations[body].T @ np.asarray(by, float)
    section = _section(_sections(data, part), part, index)
    moved = reflected_if(own, here.copies[body].mirror)
    section["at"] = tidy(np.array(section["at"], float) + moved)


def scale_section(data: Data, part: str, index: int, factors: tuple[Finite, Finite]) -> None:
    """Scale a section of a loft.

    Args:
        data: data of the document.
        part: name of the part.
        index: number of the section, from 0.
        factors: factors of width and height.
    """
    section = _section(_sections(data, part), part, index)
    for key, factor in zip(("width", "height"), factors, strict=True):
        section[key] = tidy(section[key] * max(abs(factor), _LEAST))


def _sections(data: Data, name: str) -> list[Data]:
    shape = entry_of(data, name).get("shape")
    if not isinstance(shape, dict) or shape.get("type") != "loft":
        raise DrawingError(f"{name} is no loft")
    return shape["sections"]


def _section(sections: list[Data], name: str, index: int) -> Data:
    if not 0 <= index < len(sections):
        raise DrawingError(f"{name} has no section {index}")
    return sections[index]
