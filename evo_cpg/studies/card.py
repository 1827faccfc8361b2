"""Report card: figures of real animals beside ours, each with a rule that was set beforehand.

A rule is a range. A figure is reproduced if the median of ours lies in its range. `Rule` takes the
animals' own range, and `rule` makes the other kinds:

| kind | range |
|---|---|
| third | a figure, a third less to a third more |
| points | a change in percent, 10 percentage points less to 10 more |
| exponent | an exponent, 0.1 less to 0.1 more |
| factor | a figure, half to twice |
| above, below | one side of a limit, without the limit |
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.analysis.laboratory.ask import Answer
from evo_cpg.studies.study import Table, middle


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


def rule(kind: str, figure: float) -> Rule:
    """Return the range of a kind (see the table above) around a figure or beside a limit."""
    ranges = {
        "third": (figure * (1 - 1 / 3), figure * (1 + 1 / 3)),
        "points": (figure - 10.0, figure + 10.0),
        "exponent": (figure - 0.1, figure + 0.1),
        "factor": (figure / 2.0, figure * 2.0),
        "above": (figure, math.inf),
        "below": (-math.inf, figure),
    }
    return Rule(*ranges[kind])


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


def card_tables(verdicts: Sequence[AnsweredRow], places: Mapping[str, str]) -> list[Table]:
    """Return the card: a table for each question, below the command that answers it.

    Args:
        verdicts: the rows with their answers.
        places: configuration or run folder of each animal, as the command takes it.
    """
    groups: dict[str, list[list[str]]] = {}
    for row, values in verdicts:
        command = row.question.command(places[row.question.animal])
        verdict = {True: "yes", False: "no", None: "not measured"}[row.rule.holds(values)]
        low, high = row.rule
        words = f"{low:.3g} to {high:.3g}" if math.isfinite(low) else f"below {high:.3g}"
        words = words if math.isfinite(high) else f"above {low:.3g}"
        figure, ours = f"{row.figure} ({row.source})", f"{middle(values, row.digits)}, {row.ours}"
        cells = [row.name, figure, words, ours, verdict, row.missing]
        groups.setdefault(command, []).append(cells)
    head = "animal", "its figure", "reproduced if", "ours: median (range)", "reproduced", "missing"
    return [Table(f"`{command}`", head, cells) for command, cells in groups.items()]
