"""Collect refused elements while a file is read, and report all of them at once."""

import contextlib
import dataclasses
from collections.abc import Iterator
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
    """

    element: str
    problem: str
    line: int | None = None


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
        found: faults in the order of their discovery.
    """

    source: Path
    found: list[Refusal] = dataclasses.field(default_factory=list)

    def add(self, refusal: Refusal) -> None:
        """Record a fault, once."""
        if refusal not in self.found:
            self.found.append(refusal)

    @contextlib.contextmanager
    def collecting(self) -> Iterator[None]:
        """Record the fault that ends the block, and continue after the block."""
        try:
            yield
        except RefusedError as error:
            self.add(error.refusal)

    def check(self) -> None:
        """Report all faults.

        Raises:
            ExchangeError: there are faults.
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
        raise ExchangeError(
            f"{self.source}: a creature cannot have these {len(said)} things:{lines}"
        )


def _words(group: list[Refusal]) -> str:
    """Return a sentence about elements that share a fault."""
    named = ", ".join(refusal.element for refusal in group[:_NAMED])
    more = f" and {len(group) - _NAMED} more" if len(group) > _NAMED else ""
    lines = [str(refusal.line) for refusal in group[:_NAMED] if refusal.line]
    where = f" (line{'s' * (len(lines) > 1)} {', '.join(lines)})" if lines else ""
    return f"{named}{more}: {group[0].problem}{where}"
