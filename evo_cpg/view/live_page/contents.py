"""Contents of a live page that change, and the pace at which they are made."""

import contextlib
import time
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

Answer = dict[str, Any]

# Largest fraction of the time that one kind of work takes.
_LARGEST_FRACTION = 0.2


class Numbered(NamedTuple):
    """Content with a number that grows when other content replaces it.

    Attributes:
        number: the number, 0 before there is content.
        content: the content, as JSON.
    """

    number: int = 0
    content: Mapping[str, Any] = MappingProxyType({})

    def replaced(self, content: Answer) -> "Numbered":
        """Return other content."""
        return Numbered(self.number + 1, content)

    def since(self, known: int) -> Answer | None:
        """Return the content with its number, or None if it has the known number."""
        return None if self.number in (0, known) else {**self.content, "number": self.number}


class Pace:
    """Limit on the time that repeated work takes.

    Args:
        seldom: least time between two starts, s.
    """

    def __init__(self, seldom: float):
        self._seldom, self._next = seldom, 0.0

    @property
    def due(self) -> bool:
        """Whether the work may start."""
        return time.monotonic() >= self._next

    @contextlib.contextmanager
    def working(self) -> Iterator[None]:
        """Measure the work of the ``with`` block."""
        began = time.monotonic()
        try:
            yield
        finally:
            took = time.monotonic() - began
            self._next = began + max(self._seldom, took / _LARGEST_FRACTION)
