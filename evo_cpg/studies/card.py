"""Report card: figures of real animals beside ours, each with a rule that was set beforehand.

A rule is a range. A figure is reproduced if the median of ours lies in its range. There are six
kinds of rules:

| rule | range |
|---|---|
| `within` | the animals' own range |
| `third` | a figure, a third less to a third more |
| `points` | a change in percent, 10 percentage points less to 10 more |
| `exponent` | an exponent, 0.1 less to 0.1 more |
| `factor` | a figure, half to twice |
| `above`, `below` | one side of a limit |
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.laboratory.ask import Answer
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
        return self.low <= float(np.median(known)) <= self.high if known else None

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


class Verdict(NamedTuple):
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


def card_table(verdicts: Sequence[Verdict]) -> Table:
    """Return the card as a table."""
    head = ["animal", "its figure", "rule", "ours: median (range)", "over", "reproduced", "source"]
    rows = [
        [
            row.name,
            row.figure,
            row.rule.worded(),
            middle(each.values, row.digits),
            row.ours,
            each.reproduced,
            row.source,
        ]
        for each in verdicts
        for row in [each.row]
    ]
    kept = sum(each.reproduced == "yes" for each in verdicts)
    return Table(f"{kept} of {len(verdicts)} figures are reproduced:", head, rows)


def missing_table(verdicts: Sequence[Verdict], places: Mapping[str, str]) -> Table:
    """Return what is missing in each row, and the command that answers it.

    Args:
        verdicts: the rows with their answers.
        places: configuration or run folder of each animal, as the command takes it.
    """
    rows = [
        [row.name, f"`{row.question.command(places[row.question.animal])}`", row.missing]
        for row in (each.row for each in verdicts)
    ]
    return Table(
        "Command that answers each row, and what is missing:", ["", "command", "missing"], rows
    )
