"""Bodies that are written once and stand in a creature several times: rows, stars and images.

| placeholder | in names of | is |
|---|---|---|
| ``{i}`` | a row (``repeat``) | its place, from 1 |
| ``{j}`` | what is turned about the parent's vertical axis (``radial``) | its place, from 1 |
| ``{side}`` | what has a mirror image (``mirror``) | ``left`` and ``right``, or as `SIDES` says |

What hangs on such bodies names its parent with the placeholder, and is copied with it.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

MirrorAxis = Literal["x", "y", "z"]

# What ``{side}`` is on the positive side of the plane, where limbs are written, and on the other.
SIDES: dict[MirrorAxis, tuple[str, str]] = {
    "x": ("front", "hind"),
    "y": ("left", "right"),
    "z": ("upper", "lower"),
}

# Bodies of a creature.
_MOST = 1000

_PLACEHOLDER = re.compile(r"\{(i|j|side)\}")


class Entry(NamedTuple):
    """An entry of a creature's ``bodies``, as far as it says which bodies there are.

    Attributes:
        name: with placeholders.
        parent: likewise; None for the root.
        repeat: bodies in a row.
        radial: rows around the parent.
        mirror: normal of the plane in which they are mirrored, or None.
    """

    name: str
    parent: str | None
    repeat: int = 1
    radial: int = 1
    mirror: MirrorAxis | None = None

    def problem(self) -> str | None:
        """What is wrong with it by itself, or None."""
        own = {
            "i": ("repeat", self.repeat > 1, "repeated"),
            "j": ("radial", self.radial > 1, "radial"),
            "side": ("mirror", self.mirror is not None, "mirrored"),
        }
        inherited = set(_PLACEHOLDER.findall(self.parent or ""))
        for mark, (key, copied, adjective) in own.items():
            there = f"{{{mark}}}" in self.name
            if copied and not there:
                return f"name: a {adjective} body needs {{{mark}}} in its name, got {self.name!r}"
            if copied and self.parent is None:
                return f"{key}: the root, which has no joint, cannot be {adjective}"
            if copied and mark in inherited:
                return (
                    f"{key}: is copied with its parent {self.parent!r} already, whose name has "
                    f"{{{mark}}}"
                )
            if mark in inherited and not there:
                return (
                    f"name: is copied with its parent {self.parent!r}, and needs {{{mark}}} in "
                    f"its name too, got {self.name!r}"
                )
            # A row of one is a row.
            if there and not copied and mark not in inherited and mark != "i":
                return f"name: {{{mark}}} stands for nothing in {self.name!r} without `{key}`"
        return None


class Copy(NamedTuple):
    """One body of a creature.

    Attributes:
        entry: place of what it is written as.
        name: without placeholders.
        parent: likewise; None for the root.
        marks: what its entry's placeholders stand for.
        turn_deg: by which its joint is turned about its parent's vertical axis, degrees.
        mirror: normal of the plane in which it is mirrored; None if it is as written.
    """

    entry: int
    name: str
    parent: str | None
    marks: dict[str, str]
    turn_deg: float
    mirror: MirrorAxis | None


def copies(entries: Sequence[Entry]) -> list[Copy]:
    """All bodies, those of an entry side by side in the order of the entries.

    Those of an entry stand limb by limb: around the ring, left before right, and along the row.
    An entry whose parent's name has placeholders that no body of another entry fills has none.

    Raises:
        ValueError: there are more than anybody simulates.
    """
    found: dict[int, list[Copy]] = {}

    def require_few(entry: Entry, parents: int) -> None:
        each = entry.repeat * entry.radial * (2 if entry.mirror else 1)
        count = sum(map(len, found.values())) + parents * each
        if count > _MOST:
            raise ValueError(f"bodies: {count} bodies with {entry.name!r}; allowed: up to {_MOST}")

    while True:
        before = len(found)
        for number, entry in enumerate(entries):
            if number in found:
                continue
            if not _PLACEHOLDER.search(entry.parent or ""):
                require_few(entry, 1)
                found[number] = list(_copies_on(number, entry, None))
                continue
            parents = copies_named(entry.parent or "", [c for each in found.values() for c in each])
            if parents:
                require_few(entry, len(parents))
                found[number] = [
                    copy for parent in parents for copy in _copies_on(number, entry, parent)
                ]
        if len(found) == before:
            return [copy for number in sorted(found) for copy in found[number]]


def copies_named(name: str, among: Sequence[Copy]) -> list[Copy]:
    """The bodies that a name with placeholders, or without, stands for."""
    return [copy for copy in among if fill(name, copy.marks) == copy.name]


def fill(name: str, marks: dict[str, str]) -> str:
    """A name with its placeholders filled; those without a meaning stay."""
    return _PLACEHOLDER.sub(lambda found: marks.get(found[1], found[0]), name)


def _copies_on(number: int, entry: Entry, parent: Copy | None) -> Iterator[Copy]:
    """The bodies of an entry that hang on one parent, which is None if it has no placeholders."""
    inherited = set(_PLACEHOLDER.findall(entry.parent or ""))
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
