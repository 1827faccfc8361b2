"""Report card: figures of real animals beside ours, each with a rule that was set beforehand.

A rule is a range. A figure is reproduced if the median of ours lies in its range. There are
these kinds of rules:

| rule | range |
|---|---|
| `within` | the animals' own range |
| `third` | a figure, a third less to a third more |
| `points` | a change in percent, 10 percentage points less to 10 more |
| `exponent` | an exponent, 0.1 less to 0.1 more |
| `factor` | a figure, half to twice |
| `above`, `below` | one side of a limit, without the limit |
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.analysis.laboratory.ask import Answer
from evo_cpg.studies.study import Table, middle

_THIRD, _POINTS, _EXPONENT, _FACTOR = 1 / 3, 10.0, 0.1, 2.0


class Rule(NamedTuple):
    """Range in which a figure counts as reproduced.

    Attributes:
        low: lower end, or minus infinity.
        high: upper end, or infinity.
    """

    low: float
    high: float

    def holds(self, values: Sequence[float]) -> bool | None:
        """Return whether the median of the finite values is in the range, or None without any."""
        known = [value for value in values if math.isfinite(value)]
        if not known:
            return None
        median = float(np.median(known))
        if math.isinf(self.low) or math.isinf(self.high):
            return self.low < median < self.high
        return self.low <= median <= self.high

    def worded(self) -> str:
        """Return the range in words, such as ``0.2 to 0.4`` or ``above 0``."""
        if math.isinf(self.low):
            return f"below {self.high:.3g}"
        return (
            f"above {self.low:.3g}"
            if math.isinf(self.high)
            else f"{self.low:.3g} to {self.high:.3g}"
        )


def within(low: float, high: float) -> Rule:
    """Return the animals' own range."""
    return Rule(low, high)


def third(figure: float) -> Rule:
    """Return the range of a third around a positive figure."""
    return Rule(figure * (1 - _THIRD), figure * (1 + _THIRD))


def points(percent: float) -> Rule:
    """Return the range of 10 percentage points around a change in percent."""
    return Rule(percent - _POINTS, percent + _POINTS)


def exponent(figure: float) -> Rule:
    """Return the range of 0.1 around an exponent."""
    return Rule(figure - _EXPONENT, figure + _EXPONENT)


def factor(figure: float) -> Rule:
    """Return the range from half of a positive figure to twice the figure."""
    return Rule(figure / _FACTOR, figure * _FACTOR)


def above(limit: float) -> Rule:
    """Return all values above a limit."""
    return Rule(limit, math.inf)


def below(limit: float) -> Rule:
    """Return all values below a limit."""
    return Rule(-math.inf, limit)


class Question(NamedTuple):
    """A question to an animal in the laboratory.

    Attributes:
        animal: name of a shipped configuration, or of runs of the study, whose champions answer.
        knobs: values of each knob.
        seconds: duration of a trial, s.
    """

    animal: str
    knobs: Mapping[str, Sequence[Any]]
    seconds: float

    def command(self, place: str) -> str:
        """Return the command that asks the same question.

        Args:
            place: configuration or run folder, as the command takes it.
        """
        values = (
            f"{name}={','.join(f'{x:.6g}' if isinstance(x, float) else str(x) for x in each)}"
            for name, each in self.knobs.items()
        )
        return " ".join(["evo-cpg lab", place, *values, f"--seconds {self.seconds:g}"])


class Row(NamedTuple):
    """A row of the card.

    Attributes:
        name: animal and quantity.
        figure: the animal's figure, with its unit.
        source: paper, or the words "secondary source" behind it.
        rule: range in which ours counts as reproduced.
        question: question that ours answers.
        measure: function of the answers that returns our values, one for each setting or seed.
        ours: what the values are: settings or seeds.
        missing: what is missing, in words.
        digits: decimals of our values.
    """

    name: str
    figure: str
    source: str
    rule: Rule
    question: Question
    measure: Callable[[Sequence[Answer]], Sequence[float]]
    ours: str
    missing: str = ""
    digits: int = 2


class AnsweredRow(NamedTuple):
    """A row with its answer.

    Attributes:
        row: the row.
        values: our values.
    """

    row: Row
    values: Sequence[float]

    @property
    def reproduced(self) -> str:
        """Return "yes", "no", or "not measured" without finite values."""
        return {True: "yes", False: "no", None: "not measured"}[self.row.rule.holds(self.values)]


def card_tables(verdicts: Sequence[AnsweredRow], places: Mapping[str, str]) -> list[Table]:
    """Return the card: a table for each question, below the command that answers it.

    Args:
        verdicts: the rows with their answers.
        places: configuration or run folder of each animal, as the command takes it.
    """
    groups: dict[str, list[AnsweredRow]] = {}
    for one in verdicts:
        question = one.row.question
        groups.setdefault(question.command(places[question.animal]), []).append(one)
    return [
        Table(f"`{command}`", _HEAD, [_cells(one) for one in own])
        for command, own in groups.items()
    ]


_HEAD = ("animal", "its figure", "reproduced if", "ours: median (range)", "reproduced", "missing")


def _cells(verdict: AnsweredRow) -> list[str]:
    row = verdict.row
    return [
        row.name,
        f"{row.figure} ({row.source})",
        row.rule.worded(),
        f"{middle(verdict.values, row.digits)}, {row.ours}",
        verdict.reproduced,
        row.missing,
    ]


class Absent(NamedTuple):
    """A figure of an animal that no simulation of ours answers.

    Attributes:
        name: animal and quantity.
        figure: the animal's figure.
        source: paper.
        reason: reason, in one clause.
    """

    name: str
    figure: str
    source: str
    reason: str


def absent_table(rows: Sequence[Absent]) -> Table:
    """Return the figures without an answer as a table."""
    head = ("animal", "its figure", "why ours has none")
    return Table("", head, [[row.name, f"{row.figure} ({row.source})", row.reason] for row in rows])
