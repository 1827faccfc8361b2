"""Copies of bodies that are written once: rows, stars and mirror images.

| placeholder | in the names of | value |
|---|---|---|
| ``{i}`` | bodies in a row (``repeat``) | number in the row, from 1 |
| ``{j}`` | rows about the parent's vertical axis (``radial``) | number of the row, from 1 |
| ``{side}`` | mirrored bodies (``mirror``) | ``left`` and ``right``, or as in `SIDES` |

A child of such bodies names its parent with the placeholder, and is copied with the parent.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from evo_cpg.creature.algebra.numerics import Number, Triple, as_vector, xp

MirrorAxis = Literal["x", "y", "z"]

# Values of ``{side}``: for the written limb, on the positive side of the mirror plane, and for its
# mirror image.
SIDES: dict[MirrorAxis, tuple[str, str]] = {
    "x": ("front", "hind"),
    "y": ("left", "right"),
    "z": ("upper", "lower"),
}

# Largest number of bodies of a creature.
_MOST = 1000

_PLACEHOLDER = re.compile(r"\{(i|j|side)\}")


class Entry(NamedTuple):
    """The part of an entry of a creature's ``bodies`` that determines its copies.

    Attributes:
        name: name with placeholders.
        parent: name of the parent with placeholders, or None for the root.
        repeat: number of bodies in a row.
        radial: number of rows around the parent.
        mirror: normal of the mirror plane, or None.
    """

    name: str
    parent: str | None
    repeat: int = 1
    radial: int = 1
    mirror: MirrorAxis | None = None

    def problem(self) -> str | None:
        """Return a description of what is wrong with this entry alone, or None."""
        own = {
            "i": ("repeat", self.repeat > 1, "repeated"),
            "j": ("radial", self.radial > 1, "radial"),
            "side": ("mirror", self.mirror is not None, "mirrored"),
        }
        inherited = placeholders(self.parent or "")
        for mark, (key, copied, adjective) in own.items():
            there = f"{{{mark}}}" in self.name
            if copied and not there:
                return f"name: a {adjective} body needs {{{mark}}} in its name, got {self.name!r}"
            if copied and self.parent is None:
                return f"{key}: the root cannot be {adjective}"
            if copied and mark in inherited:
                return (
                    f"{key}: leave it out, because the body is copied with its parent "
                    f"{self.parent!r}, whose name contains {{{mark}}}"
                )
            if mark in inherited and not there:
                return (
                    f"name: must contain {{{mark}}}, because the body is copied with its parent "
                    f"{self.parent!r}, got {self.name!r}"
                )
            # {i} is allowed without `repeat`: a row may have one body.
            if there and not copied and mark not in inherited and mark != "i":
                return f"name: {{{mark}}} has no value in {self.name!r} without `{key}`"
        return None


class Copy(NamedTuple):
    """One body of a creature.

    Attributes:
        entry: index of its entry in the creature's ``bodies``.
        name: name without placeholders.
        parent: name of the parent without placeholders, or None for the root.
        marks: values of the placeholders of its entry.
        turn_deg: rotation of its joint about its parent's vertical axis, degrees.
        mirror: normal of the mirror plane, or None if it is not mirrored.
    """

    entry: int
    name: str
    parent: str | None
    marks: dict[str, str]
    turn_deg: float
    mirror: MirrorAxis | None


def copies(entries: Sequence[Entry]) -> list[Copy]:
    """Return all bodies, entry by entry.

    The bodies of an entry are sorted limb by limb: around the ring, left before right, and along
    the row. An entry yields no body if no body matches its parent's name with placeholders.

    Raises:
        ValueError: there are more than 1000 bodies.
    """
    found: dict[int, list[Copy]] = {}
    while True:
        before = len(found)
        for number, entry in enumerate(entries):
            if number in found:
                continue
            parents: Sequence[Copy | None] = (None,)
            known = [copy for each in found.values() for copy in each]
            if entry.parent and _PLACEHOLDER.search(entry.parent):
                parents = copies_named(entry.parent, known)
            if not parents:
                continue
            each = entry.repeat * entry.radial * (2 if entry.mirror else 1)
            count = len(known) + len(parents) * each
            if count > _MOST:
                problem = f"{count} bodies with {entry.name!r}. Allowed: up to {_MOST}"
                raise ValueError(f"bodies: {problem}")
            found[number] = [
                copy for parent in parents for copy in _copies_on(number, entry, parent)
            ]
        if len(found) == before:
            return [copy for number in sorted(found) for copy in found[number]]


def copies_named(name: str, among: Sequence[Copy]) -> list[Copy]:
    """Return the bodies that a name, with or without placeholders, stands for."""
    return [copy for copy in among if fill(name, copy.marks) == copy.name]


def fill(name: str, marks: dict[str, str]) -> str:
    """Return a name with its placeholders filled, except placeholders without a value."""
    return _PLACEHOLDER.sub(lambda found: marks.get(found[1], found[0]), name)


def placeholders(name: str) -> set[str]:
    """Return the placeholders in a name: i, j and side."""
    return set(_PLACEHOLDER.findall(name))


def _copies_on(number: int, entry: Entry, parent: Copy | None) -> Iterator[Copy]:
    """Yield the bodies of an entry on one parent (None if its name has no placeholders)."""
    inherited = placeholders(entry.parent or "")
    common = {mark: parent.marks[mark] for mark in inherited} if parent else {}
    inherited_mirror = parent.mirror if parent and "side" in inherited else None
    images: list[tuple[MirrorAxis | None, dict[str, str]]] = [(inherited_mirror, {})]
    if entry.mirror:
        written, image = SIDES[entry.mirror]
        images = [(None, {"side": written}), (entry.mirror, {"side": image})]
    for j in range(entry.radial):
        for mirror, side in images:
            marks = common | side
            if entry.radial > 1:
                marks["j"] = str(j + 1)
            on = parent.name if parent else entry.parent
            for i in range(entry.repeat):
                if "i" not in inherited:
                    marks = marks | {"i": str(i + 1)}
                name = fill(entry.name, marks)
                turn = 360.0 * j / entry.radial if i == 0 else 0.0
                yield Copy(number, name, on, marks, turn, mirror)
                on = name


def unit(vector: Any) -> Triple:
    """Return the direction of a nonzero vector."""
    direction = xp.array(vector, float)
    return as_vector(direction / xp.linalg.norm(direction))


def moved(place: Triple, origin: np.ndarray) -> Triple:
    """Return a position in a frame that is shifted to ``origin``."""
    return as_vector(xp.array(place) - origin) if origin.any() else place


def reflected(place: Triple, axis: MirrorAxis | None) -> Triple:
    """Return the mirror image of a position in the plane with this normal, if there is one."""
    x, y, z = (-value if name == axis else value for name, value in zip("xyz", place, strict=True))
    return x, y, z


def opposed(turn: Sequence[Number], axis: MirrorAxis) -> Triple:
    """Return the mirror image of a rotation axis, or of roll, pitch and yaw.

    A mirrored rotation keeps its sense about the mirror's normal. The sense about directions in
    the mirror plane is reversed.
    """
    x, y, z = (value if name == axis else -value for name, value in zip("xyz", turn, strict=True))
    return x, y, z
