"""Refused elements: collected while a file is read, and reported all at once."""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from evo_cpg.errors import UserError

# Elements with the same fault that are named before the rest is counted.
_NAMED = 5


class ExchangeError(UserError):
    """A model that cannot be exchanged; the message is for the user as it stands."""


class Refusal(NamedTuple):
    """One fault of one element.

    Attributes:
        element: its name in messages.
        problem: what is wrong with it, and what is allowed.
        line: of the element in the file; None where it is unknown.
    """

    element: str
    problem: str
    line: int | None = None


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
        """Report all that was found.

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
    """Return a sentence about elements with the same fault."""
    named = ", ".join(refusal.element for refusal in group[:_NAMED])
    more = f" and {len(group) - _NAMED} more" if len(group) > _NAMED else ""
    lines = [str(refusal.line) for refusal in group[:_NAMED] if refusal.line]
    where = f" (line{'s' * (len(lines) > 1)} {', '.join(lines)})" if lines else ""
    return f"{named}{more}: {group[0].problem}{where}"
