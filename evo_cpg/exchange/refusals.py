"""What cannot be part of a creature: collected while a file is read, and said all at once."""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from evo_cpg.exchange.errors import ExchangeError

# Elements with the same fault that are named before the rest is counted.
_NAMED = 5

# Elements of a section stand so deep: mujoco, the section, the element.
_DEPTH = 3

# Sections of a file, and what their elements are called here. Elsewhere a joint is a reference.
_SECTIONS = {"actuator": "actuator", "equality": "equality", "tendon": "tendon"}
_KINDS = {"body": "body", "joint": "joint", "freejoint": "joint", "geom": "geom"}


class Refusal(NamedTuple):
    """One fault of one element.

    Attributes:
        element: as it is called in messages.
        problem: what is wrong with it, and what is allowed.
        line: where it stands in the file; None where that cannot be told.
    """

    element: str
    problem: str
    line: int | None = None


class Lines(NamedTuple):
    """Where the elements of a file stand.

    Attributes:
        named: lines of those with a name, by kind and name.
        ordered: lines of all of a kind, in the order of the compiled model.
    """

    named: dict[tuple[str, str], int]
    ordered: dict[str, list[int]]

    def find(self, kind: str, number: int, count: int, name: str | None) -> int | None:
        """The line of an element; None where that cannot be told.

        Args:
            kind: of the element.
            number: in the compiled model.
            count: of such elements in the compiled model. Another count than that in the file
                means that some were included or made of others.
            name: of the element.
        """
        ordered = self.ordered.get(kind, [])
        if len(ordered) == count:
            return ordered[number] or None
        return self.named.get((kind, name)) if name else None


class RefusedError(ExchangeError):
    """Ends the reading of one element; only ever seen within `Refusals.collecting`."""

    def __init__(self, refusal: Refusal):
        super().__init__(refusal.problem)
        self.refusal = refusal


@dataclasses.dataclass
class Refusals:
    """Faults found so far.

    Attributes:
        source: the file.
        found: in the order in which they were found.
    """

    source: Path
    found: list[Refusal] = dataclasses.field(default_factory=list)

    def add(self, refusal: Refusal) -> None:
        """Remember a fault, once."""
        if refusal not in self.found:
            self.found.append(refusal)

    @contextlib.contextmanager
    def collecting(self) -> Iterator[None]:
        """Remember the fault that ends what is done within, and go on after it."""
        try:
            yield
        except RefusedError as error:
            self.add(error.refusal)

    def check(self) -> None:
        """Say all that was found.

        Raises:
            ExchangeError: there is something.
        """
        if not self.found:
            return
        groups: dict[tuple[str, str], list[Refusal]] = {}
        for refusal in self.found:
            kind = refusal.element.removeprefix("unnamed ").partition(" ")[0]
            groups.setdefault((kind, refusal.problem), []).append(refusal)
        said = [_words(group) for group in groups.values()]
        if len(said) == 1:
            raise ExchangeError(f"{self.source}: {said[0]}")
        lines = "".join(f"\n  {words}" for words in said)
        raise ExchangeError(f"{self.source}: no creature can have these {len(said)} things:{lines}")


def _words(group: list[Refusal]) -> str:
    """Elements with the same fault."""
    named = ", ".join(refusal.element for refusal in group[:_NAMED])
    more = f" and {len(group) - _NAMED} more" if len(group) > _NAMED else ""
    lines = [str(refusal.line) for refusal in group[:_NAMED] if refusal.line]
    where = f" (line{'s' * (len(lines) > 1)} {', '.join(lines)})" if lines else ""
    return f"{named}{more}: {group[0].problem}{where}"


def element_lines(path: Path) -> Lines:
    """Find where the elements of a file stand.

    A file of a single line has no lines worth telling. Only the file itself is read, so elements
    of included files have none either.
    """
    lines = Lines({}, {})
    above: list[str] = []
    # The world and the bodies in it, in MuJoCo's order, and those that are open.
    bodies: list[dict[str, list[int]]] = []
    open_bodies: list[int] = []
    parser = expat.ParserCreate()

    def begin(tag: str, attributes: dict[str, str]) -> None:
        section = above[1] if len(above) > 1 else ""
        kind = _KINDS.get(tag) if section == "worldbody" else _SECTIONS.get(section)
        above.append(tag)
        if above[1:] == ["worldbody"] or kind == "body":
            bodies.append({"body": [], "joint": [], "geom": []})
            open_bodies.append(len(bodies) - 1)
        if kind is None:
            return
        here = parser.CurrentLineNumber
        if "name" in attributes:
            lines.named.setdefault((kind, attributes["name"]), here)
        if section == "worldbody":
            bodies[open_bodies[-1]][kind].append(here)
        elif len(above) == _DEPTH:
            lines.ordered.setdefault(kind, []).append(here)

    def end(tag: str) -> None:
        if tag in ("worldbody", "body") and "worldbody" in above:
            open_bodies.pop()
        above.pop()

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    try:
        parser.Parse(path.read_bytes(), True)
    except (expat.ExpatError, OSError, ValueError, IndexError):
        # MuJoCo has read it all the same.
        return Lines({}, {})
    if set(lines.named.values()) <= {1} and parser.CurrentLineNumber == 1:
        return Lines({}, {})
    lines.ordered["body"] = [0]
    for kind in ("body", "joint", "geom"):
        for body in bodies:
            lines.ordered.setdefault(kind, []).extend(body[kind])
    return lines
