"""What is decided while a model is built, and is no number: which points are left out, and so on.

A builder decides by numbers: which surface points another body covers, which bodies are alike,
where an animal comes to rest. Where numbers are traced nothing can be decided by them. So the
building is done twice: with known numbers, noting every choice in turn, and with traced ones about
the same place, taking the choices that were noted. What comes out of the second is a smooth
function of the numbers, and is what the first would build as long as it would choose the same.

Outside `noting` and `repeating` a choice is simply made.
"""

import contextlib
import contextvars
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

_T = TypeVar("_T")


class Choices:
    """All that was chosen while a model was built, in order.

    Two are equal where the same was chosen, wherever searches may have ended.
    """

    def __init__(self) -> None:
        self.made: list[Any] = []
        self.searched: list[Any] = []

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Choices):
            return NotImplemented
        mine, layout = jax.tree.flatten(self.made)
        theirs, their_layout = jax.tree.flatten(other.made)
        return layout == their_layout and all(map(np.array_equal, mine, theirs))

    __hash__ = None  # pyright: ignore[reportAssignmentType]


class _Present(NamedTuple):
    """What is noted now, and what is taken from earlier notes."""

    noted: Choices | None = None
    made: Iterator[Any] = iter(())
    searched: Iterator[Any] = iter(())
    repeats: bool = False


_NOTHING = _Present()
_present: contextvars.ContextVar[_Present] = contextvars.ContextVar("choices", default=_NOTHING)


@contextlib.contextmanager
def _in_present(present: _Present) -> Iterator[None]:
    token = _present.set(present)
    try:
        yield
    finally:
        _present.reset(token)


@contextlib.contextmanager
def noting() -> Iterator[Choices]:
    """Note what is chosen within; of known numbers."""
    choices = Choices()
    with _in_present(_Present(noted=choices)):
        yield choices


@contextlib.contextmanager
def repeating(choices: Choices) -> Iterator[None]:
    """Choose within what was chosen before; the numbers may be traced."""
    present = _Present(None, iter(choices.made), iter(choices.searched), repeats=True)
    with _in_present(present):
        yield


def chosen(choose: Callable[[], _T]) -> _T:
    """What a function of known numbers chooses, or chose when it was noted.

    Args:
        choose: gives a pytree; it is not called where numbers may be traced.
    """
    return _noted_or_repeated("made", choose)


def searched(search: Callable[[], _T]) -> _T:
    """Where a search by known numbers ends, or ended when it was noted.

    That does not follow the numbers; whoever calls this takes a step of Newton's from there, which
    does (the implicit function theorem), and is none where the search was exact.

    Args:
        search: gives a pytree of numbers; it is not called where numbers may be traced.
    """
    return _noted_or_repeated("searched", search)


def _noted_or_repeated(notes: str, make: Callable[[], _T]) -> _T:
    """What a function gives, or gave when it was noted; what it chooses in turn is not noted.

    Args:
        notes: where among the choices.
        make: is called with known numbers only.
    """
    present = _present.get()
    if present.repeats:
        return next(getattr(present, notes))
    with _in_present(_NOTHING):
        given = make()
    if present.noted is not None:
        getattr(present.noted, notes).append(given)
    return given
