"""Limits, checks and verdict of an audit."""

import dataclasses
import difflib
import math
from collections.abc import Sequence
from typing import NamedTuple

from evo_cpg.errors import UserError
from evo_cpg.simulation.limits import Limits

# Start of the keys of second opinions, and the smallest fraction of the displacement with which one
# of them confirms a champion.
SECOND_OPINION, _CONFIRMS = "mujoco", 0.5

# First words of every check of the displacement in a changed trial. The name of the change follows.
KEPT = "displacement kept: "


def limits_from(settings: Sequence[str], limits: Limits | None = None) -> Limits:
    """Return limits with some changed by settings such as ``key=value``.

    Raises:
        LimitError: a key does not exist, or a value is negative or not a finite number.
    """
    changed = {}
    for setting in settings:
        key, _, text = setting.partition("=")
        known = [field.name for field in dataclasses.fields(Limits)]
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            hint = f"Did you mean {near[0]}?" if near else f"Allowed: {', '.join(known)}"
            raise LimitError(f"{setting}: there is no limit {key!r}. {hint}")
        try:
            # Python accepts 1_000, which is no number in YAML.
            value = math.nan if "_" in text else float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value >= 0):
            raise LimitError(f"{setting}: {text!r} is no limit. Allowed: a number of at least 0")
        changed[key] = value
    return dataclasses.replace(limits or Limits(), **changed)


class LimitError(UserError, ValueError):
    """Error for an unknown limit or an invalid value."""


class Check(NamedTuple):
    """Result of one check.

    Attributes:
        key: key of the limit in `Limits`, or a name of its own.
        question: description of the measured quantity.
        measured: measured value.
        limit: allowed value, or None if the value is only reported.
        least: whether the limit is a minimum, not a maximum.
        unit: unit of value and limit.
        detail: additional text.
    """

    key: str
    question: str
    measured: float
    limit: float | None = None
    least: bool = False
    unit: str = ""
    detail: str = ""

    @property
    def passed(self) -> bool | None:
        """Return whether the check passed, or None without a limit."""
        if self.limit is None:
            return None
        if math.isnan(self.measured):
            return False
        return bool(self.measured >= self.limit if self.least else self.measured <= self.limit)

    @property
    def reason(self) -> str:
        """Text that states the violated limit."""
        bound = "less than" if self.least else "more than"
        return (
            f"{self.question}: {shown(self.measured, self.unit)}, {bound} "
            f"{shown(self.limit, self.unit)}"
        )


class Verdict(NamedTuple):
    """Result of an audit.

    Attributes:
        checks: results of all checks.
    """

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Return whether no check failed."""
        return all(check.passed is not False for check in self.checks)

    @property
    def reasons(self) -> list[str]:
        """Reasons of all failed checks."""
        return [check.reason for check in self.checks if check.passed is False]

    @property
    def confirmed(self) -> bool | None:
        """Return whether any second opinion keeps half of the displacement, or None without any."""
        kept = [check.measured >= _CONFIRMS for check in self._second]
        return any(kept) if kept else None

    @property
    def confirmation(self) -> str:
        """Text after the verdict: the fractions that second opinions keep, or "" without any."""
        words = "second opinions keep these fractions of its displacement"
        if self.confirmed is False:
            words = "not confirmed, because no second opinion keeps half of its displacement"
        kept = [
            f"{check.question.removeprefix(KEPT)} {shown(check.measured, check.unit)}"
            for check in self._second
        ]
        return f"{words}: {'; '.join(kept)}" if kept else ""

    @property
    def _second(self) -> list[Check]:
        return [check for check in self.checks if check.key.startswith(SECOND_OPINION)]


def shown(value: float | None, unit: str = "") -> str:
    """Return a number with its unit as text. Fractions are in per cent, and NaN is "diverged"."""
    if value is None:
        return ""
    if math.isnan(value):
        return "diverged"
    if unit == "%":
        return f"{100 * value:.3g} %"
    return f"{value:.3g} {unit}".rstrip()
