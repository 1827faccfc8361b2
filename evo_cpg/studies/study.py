"""What a study is: runs that are declared once, and parts that make tables and pictures of them."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from evo_cpg.analysis.compare import compare, holm

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop


class Runs(NamedTuple):
    """An experiment, evolved several times with the seeds 0, 1, ...

    Attributes:
        config: name of a shipped configuration.
        overrides: what is changed of it, ``key=value``.
        count: of runs side by side.
    """

    config: str
    overrides: tuple[str, ...] = ()
    count: int = 8


class Table(NamedTuple):
    """A table of results.

    Attributes:
        title: above it.
        head: of the columns.
        rows: of cells.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def tabled(rows: Sequence[Mapping[str, str]], title: str = "") -> Table:
    """Return a table of rows by the heads of their columns; a cell that a row lacks is empty."""
    head = list(dict.fromkeys(column for row in rows for column in row))
    return Table(title, head, [[row.get(column, "") for column in head] for row in rows])


class Part(NamedTuple):
    """What can be renewed by itself.

    Attributes:
        title: what it is about, for a list.
        runs: names of the study's runs that it takes; none where it measures without them.
        report: makes its tables, and its pictures by `Workshop.picture`.
    """

    title: str
    runs: tuple[str, ...]
    report: "Callable[[Workshop], list[Table]]"


class Study(NamedTuple):
    """A study.

    Attributes:
        name: on the command line.
        title: for a list.
        runs: by their names, which are those of their folders.
        parts: by name.
    """

    name: str
    title: str
    runs: Mapping[str, Runs]
    parts: Mapping[str, Part]


def percent(fraction: float) -> str:
    """A share as it stands in a table."""
    return f"{100 * fraction:.1f} %"


def middle(values: Sequence[float] | np.ndarray, digits: int = 2) -> str:
    """Median and range."""
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    if not known.size:
        return "none"
    low, median, high = known.min(), np.median(known), known.max()
    return f"{median:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def in_order(values: Sequence[float] | np.ndarray, digits: int = 2) -> str:
    """All of them, sorted."""
    return ", ".join(f"{value:.{digits}f}" for value in sorted(map(float, values)))


def beside(values: Mapping[str, Sequence[float]], first: str) -> dict[str, str]:
    """How often each setting beats the first one, and how sure that is, in words.

    The p values are those of Mann and Whitney's test, two-sided, with Holm's correction for as many
    settings as stand beside the first.

    Args:
        values: of the runs of each setting, to be maximised.
        first: name of the setting that the others are compared with.
    """
    found = {
        name: compare({name: own, first: values[first]})
        for name, own in values.items()
        if name != first
    }
    tested = {name: each[0] for name, each in found.items() if each}
    adjusted = holm(np.array([each.p_value for each in tested.values()]))
    words = {
        name: f"in {each.wins:.0%} of pairs, p = {p:.2g}"
        for (name, each), p in zip(tested.items(), adjusted, strict=True)
    }
    return dict.fromkeys(values, "") | words
