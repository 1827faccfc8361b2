"""Collect refused elements while a file is read, and report all of them at once.

The caller may accept the loss of refused elements (``drop``). They are then listed, not refused.
Faults without which nothing is left, such as a file without a moving body, are always refused.
"""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from evo_cpg.errors import UserError

# Largest number of elements with the same fault that are named. Further elements are only counted.
_NAMED = 5


class ExchangeError(UserError):
    """A model cannot be exchanged. The message is for the user."""


class Refusal(NamedTuple):
    """One fault of one element.

    Attributes:
        element: name of the element in messages.
        problem: fault of the element, and allowed values.
        line: line of the element in the file, or None if unknown.
        vital: whether the model is useless without the element, so that it cannot be dropped.
    """

    element: str
    problem: str
    line: int | None = None
    vital: bool = False


class RefusedError(ExchangeError):
    """Ends the reading of one element. `Refusals.collecting` catches it."""

    def __init__(self, refusal: Refusal):
        super().__init__(refusal.problem)
        self.refusal = refusal


@dataclasses.dataclass
class Refusals:
    """Faults found so far.

    Attributes:
        source: the file.
        drop: whether the user accepts the loss of refused elements.
        found: faults in the order of their discovery.
        lost: elements that lose something without harm, by its name and their kind.
        warnings: warnings of MuJoCo.
        changes: elements that get another value than in the file. Their problem is the text with
            both values.
    """

    source: Path
    drop: bool = False
    found: list[Refusal] = dataclasses.field(default_factory=list)
    lost: dict[tuple[str, str], list[str]] = dataclasses.field(default_factory=dict)
    warnings: list[str] = dataclasses.field(default_factory=list)
    changes: list[Refusal] = dataclasses.field(default_factory=list)

    def add(self, refusal: Refusal) -> None:
        """Record a fault, once."""
        if refusal not in self.found:
            self.found.append(refusal)

    def leave_out(self, what: str, *elements: str) -> None:
        """Record something that is left out without harm, of some elements or of the model."""
        for element in elements or ("",):
            kind = element.removeprefix("unnamed ").partition(" ")[0]
            owners = self.lost.setdefault((what, kind), [])
            owners += [element] * bool(element and element not in owners)

    def change(self, element: str, old_and_new: str) -> None:
        """Record that an element gets another value than in the file."""
        self.changes.append(Refusal(element, old_and_new))

    @property
    def changed(self) -> list[str]:
        """Sentences about changed values. All elements are named."""
        return _sentences(self.changes, len(self.changes))

    @property
    def left_out(self) -> list[str]:
        """Phrases about what is left out without harm, such as ``margin of 3 geoms``."""
        phrases = []
        for (what, kind), elements in self.lost.items():
            plural = "bodies" if kind == "body" else f"{kind}s"
            several = f"{what} of {len(elements)} {plural}"
            phrases.append(several if len(elements) > 1 else " of ".join([what, *elements]))
        return phrases

    @contextlib.contextmanager
    def collecting(self) -> Iterator[None]:
        """Record the fault that ends the block, and continue after the block."""
        try:
            yield
        except RefusedError as error:
            self.add(error.refusal)

    @property
    def dropped(self) -> list[str]:
        """Sentences about the elements whose loss the user accepts."""
        return _sentences([refusal for refusal in self.found if not refusal.vital])

    def check(self) -> None:
        """Report all faults, except those that the user accepts.

        Raises:
            ExchangeError: there are faults.
        """
        vital = [refusal for refusal in self.found if refusal.vital]
        said = _sentences(vital if self.drop else self.found)
        if not said:
            return
        hint = "" if vital else "\nThe option --drop imports the model without them."
        if len(said) == 1:
            raise ExchangeError(f"{self.source}: {said[0]}{hint}")
        lines = "".join(f"\n  {words}" for words in said)
        raise ExchangeError(
            f"{self.source}: a creature cannot have these {len(said)} things:{lines}{hint}"
        )


def _sentences(refusals: Sequence[Refusal], most: int = _NAMED) -> list[str]:
    """Return a sentence for each fault of elements of a kind, of which ``most`` are named."""
    groups: dict[tuple[str, str], list[Refusal]] = {}
    for refusal in refusals:
        kind = refusal.element.removeprefix("unnamed ").partition(" ")[0]
        groups.setdefault((kind, refusal.problem), []).append(refusal)
    said = []
    for group in groups.values():
        named = ", ".join(refusal.element for refusal in group[:most])
        more = f" and {len(group) - most} more" if len(group) > most else ""
        lines = [str(refusal.line) for refusal in group[:most] if refusal.line]
        where = f" (line{'s' * (len(lines) > 1)} {', '.join(lines)})" if lines else ""
        said.append(f"{named}{more}: {group[0].problem}{where}")
    return said
