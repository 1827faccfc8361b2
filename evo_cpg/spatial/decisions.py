"""Decisions made while a model is built: which points are left out, which bodies are alike.

A builder decides by numbers, and traced numbers decide nothing. So the building is done twice. With
known numbers it notes every decision in turn. With traced numbers it repeats them. The result of
the second is a smooth function of the numbers.

It is what the first would build as long as each decision holds. `replaying_decisions` can collect
the conditions for that, as functions of the same numbers: see `chosen` and `searched`.

Outside `recording_decisions` and `replaying_decisions` a decision is simply made.
"""

import contextlib
import contextvars
import functools
import operator
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

_T = TypeVar("_T")

# A truth value, which may be traced.
Condition = Any


class Undecidable(Exception):
    """A decision of which traced numbers cannot tell whether it holds."""


class StaticDecisions:
    """All that was chosen while a model was built, in order.

    Two are equal where the same was chosen, wherever searches may have ended.
    """

    def __init__(self) -> None:
        self.made: list[Any] = []
        self.searched: list[Any] = []

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, StaticDecisions):
            return NotImplemented
        mine, layout = jax.tree.flatten(self.made)
        theirs, their_layout = jax.tree.flatten(other.made)
        return layout == their_layout and all(map(np.array_equal, mine, theirs))

    __hash__ = None  # pyright: ignore[reportAssignmentType]


class _Present(NamedTuple):
    """What is noted now, and what is taken from earlier notes."""

    noted: StaticDecisions | None = None
    made: Iterator[Any] = iter(())
    searched: Iterator[Any] = iter(())
    repeats: bool = False
    conditions: list[Condition] | None = None


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
def recording_decisions() -> Iterator[StaticDecisions]:
    """Note what is chosen within; of known numbers."""
    choices = StaticDecisions()
    with _in_present(_Present(noted=choices)):
        yield choices


@contextlib.contextmanager
def replaying_decisions(
    choices: StaticDecisions, conditions: list[Condition] | None = None
) -> Iterator[None]:
    """Choose within what was chosen before; the numbers may be traced.

    Args:
        choices: that were noted.
        conditions: a list to which is added for every choice whether it holds.
    """
    made, searched = iter(choices.made), iter(choices.searched)
    with _in_present(_Present(None, made, searched, True, conditions)):
        yield


def chosen(choose: Callable[[], _T], holds: Callable[[_T], Condition] | None = None) -> _T:
    """Return what a function of known numbers chooses, or chose when it was noted.

    Args:
        choose: gives a pytree.
        holds: whether a choice builds the right thing for the present numbers, which may be traced;
            None where that is so if ``choose`` gives the same again.

    Raises:
        Undecidable: conditions are collected, and the numbers are traced in a way that no condition
            can be computed.
    """
    made = _noted_or_repeated("made", choose)
    _collect(lambda: holds(made) if holds else _equal(made, choose()))
    return made


def searched(search: Callable[[], _T], holds: Callable[[_T], Condition]) -> _T:
    """Return where a search by known numbers ends, or ended when it was noted.

    That does not follow the numbers. Whoever calls this takes steps of Newton's from there, which
    do (the implicit function theorem), and are none where the search was exact.

    Args:
        search: gives a pytree of numbers; it is not called where numbers may be traced.
        holds: whether these steps end where a search of the present numbers would.

    Raises:
        Undecidable: see `chosen`.
    """
    found = _noted_or_repeated("searched", search)
    _collect(lambda: holds(found))
    return found


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


def all_hold(conditions: Iterable[Condition]) -> Condition:
    """Whether all of some conditions hold."""
    return functools.reduce(operator.and_, conditions, True)


def _collect(condition: Callable[[], Condition]) -> None:
    """Add a condition to those that are collected, if any are."""
    conditions = _present.get().conditions
    if conditions is None:
        return
    try:
        with _in_present(_NOTHING):
            conditions.append(condition())
    except (jax.errors.JAXTypeError, jax.errors.JAXIndexError, TypeError) as error:
        raise Undecidable(str(error).partition("\n")[0]) from error


def _equal(made: Any, again: Any) -> Condition:
    """Whether two choices are the same; the second may be traced."""
    mine, layout = jax.tree.flatten(made)
    theirs, their_layout = jax.tree.flatten(again)
    if layout != their_layout:
        return False
    return all_hold(
        (jnp if isinstance(other, jax.Array) else np).array_equal(one, other)
        for one, other in zip(mine, theirs, strict=True)
    )
