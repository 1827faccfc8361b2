"""Decisions made while a model is built: for example, the points to omit or the bodies to merge.

A builder decides by the values of numbers, and traced numbers have no values. So a model is built
twice. The first build, with known numbers, records every decision. The second build, with traced
numbers, replays the decisions. Its result is a smooth function of the numbers.

Both builds agree as long as every decision holds. `replaying_decisions` can collect the conditions
for this, as functions of the traced numbers (`chosen`, `searched`).

Outside `recording_decisions` and `replaying_decisions` a decision is made without a record.
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
    """Raised if traced numbers cannot decide whether a decision holds."""


class StaticDecisions:
    """Decisions made while a model was built, in order.

    Two records are equal if their choices are equal. The results of searches may differ.
    """

    def __init__(self) -> None:
        self.made: list[Any] = []
        self.searched: list[Any] = []

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, StaticDecisions):
            return NotImplemented
        return bool(_equal(self.made, other.made))

    __hash__ = None  # pyright: ignore[reportAssignmentType]


class _Present(NamedTuple):
    """State of a context: its record of new decisions, and the decisions that it replays."""

    record: StaticDecisions | None = None
    made: Iterator[Any] = iter(())
    searched: Iterator[Any] = iter(())
    replays: bool = False
    conditions: list[Condition] | None = None


_NOTHING = _Present()
_present: contextvars.ContextVar[_Present] = contextvars.ContextVar("decisions", default=_NOTHING)


@contextlib.contextmanager
def _in_present(present: _Present) -> Iterator[None]:
    token = _present.set(present)
    try:
        yield
    finally:
        _present.reset(token)


@contextlib.contextmanager
def recording_decisions() -> Iterator[StaticDecisions]:
    """Record the decisions made within the context. The numbers must be known."""
    decisions = StaticDecisions()
    with _in_present(_Present(record=decisions)):
        yield decisions


@contextlib.contextmanager
def replaying_decisions(
    decisions: StaticDecisions, conditions: list[Condition] | None = None
) -> Iterator[None]:
    """Replay recorded decisions within the context. The numbers may be traced.

    Args:
        decisions: recorded decisions.
        conditions: list to which the condition of every decision is appended, or None to skip the
            conditions.
    """
    made, searched = iter(decisions.made), iter(decisions.searched)
    with _in_present(_Present(None, made, searched, True, conditions)):
        yield


def chosen(choose: Callable[[], _T], holds: Callable[[_T], Condition] | None = None) -> _T:
    """Return the choice of a function of known numbers, or in a replay its recorded choice.

    Args:
        choose: function that returns a pytree.
        holds: function that returns whether a choice is right for the present numbers, which may be
            traced. None requires that ``choose`` returns an equal choice again.

    Raises:
        Undecidable: if conditions are collected and no condition can be computed from the traced
            numbers.
    """
    made = _recorded_or_replayed("made", choose)
    _collect(lambda: holds(made) if holds else _equal(made, choose()))
    return made


def decided(condition: Callable[[], Condition]) -> bool:
    """Return whether a condition holds, which is right as long as its truth value stays."""
    return chosen(lambda: bool(condition()), lambda made: condition() == made)


def some_hold(conditions: Callable[[], Condition]) -> bool:
    """Return whether any of some conditions holds, to decide whether a model gets a part.

    The part stays right if all conditions cease to hold.
    """
    return chosen(lambda: bool(conditions().any()), lambda made: made | ~conditions().any())


def searched(search: Callable[[], _T], holds: Callable[[_T], Condition]) -> _T:
    """Return the result of a search with known numbers, or in a replay its recorded result.

    The result has no derivative by the numbers. The caller adds Newton steps, which have the right
    derivative (implicit function theorem). The steps are zero if the search was exact.

    Args:
        search: function that returns a pytree of numbers, never called with traced numbers.
        holds: function that returns whether the Newton steps end at the result of a search with the
            present numbers.

    Raises:
        Undecidable: as in `chosen`.
    """
    found = _recorded_or_replayed("searched", search)
    _collect(lambda: holds(found))
    return found


def _recorded_or_replayed(kind: str, make: Callable[[], _T]) -> _T:
    """Return the result of a function, or in a replay its recorded result.

    Decisions made inside the function are not recorded.

    The kind is the name of the record's list, "made" or "searched".
    """
    present = _present.get()
    if present.replays:
        # JAX keeps the type that an index array had in a float64 program. So each program gets
        # arrays of its own.
        made = next(getattr(present, kind))
        return jax.tree.map(lambda x: x.copy() if isinstance(x, np.ndarray) else x, made)
    with _in_present(_NOTHING):
        given = make()
    if present.record is not None:
        getattr(present.record, kind).append(given)
    return given


def all_hold(conditions: Iterable[Condition]) -> Condition:
    """Return whether all conditions hold."""
    return functools.reduce(operator.and_, conditions, True)


def _collect(condition: Callable[[], Condition]) -> None:
    """Append a condition to the collected conditions, if they are collected."""
    conditions = _present.get().conditions
    if conditions is None:
        return
    try:
        with _in_present(_NOTHING):
            conditions.append(condition())
    except (jax.errors.JAXTypeError, jax.errors.JAXIndexError, TypeError) as error:
        raise Undecidable(str(error).partition("\n")[0]) from error


def _equal(made: Any, again: Any) -> Condition:
    """Return whether two choices are equal. The second may be traced."""
    mine, layout = jax.tree.flatten(made)
    theirs, their_layout = jax.tree.flatten(again)
    if layout != their_layout:
        return False
    return all_hold(
        (jnp if isinstance(other, jax.Array) else np).array_equal(one, other)
        for one, other in zip(mine, theirs, strict=True)
    )
