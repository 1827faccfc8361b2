"""Declarations of a study: runs, and parts that make tables and pictures of the runs."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from evo_cpg.analysis.compare import compare, holm

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop


class Runs(NamedTuple):
    """Experiment that is evolved several times with successive seeds.

    Attributes:
        config: name of a shipped configuration.
        overrides: changes to the configuration, ``key=value``.
        count: number of runs side by side.
    """

    config: str
    overrides: tuple[str, ...] = ()
    count: int = 8


class Table(NamedTuple):
    """Table of results.

    Attributes:
        title: title above the table, if any.
        head: head of each column.
        rows: cells of each row.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def tabled(rows: Sequence[Mapping[str, str]], title: str = "") -> Table:
    """Return a table of rows whose cells are named by column. A missing cell is empty."""
    head = list(dict.fromkeys(column for row in rows for column in row))
    return Table(title, head, [[row.get(column, "") for column in head] for row in rows])


class Part(NamedTuple):
    """Part of a study that can be made separately.

    Attributes:
        title: subject of the part, in the list of parts.
        runs: names of the study's runs that the part uses, if any.
        report: function that returns the tables, and draws pictures to `Workshop.picture`.
    """

    title: str
    runs: tuple[str, ...]
    report: "Callable[[Workshop], list[Table]]"


class Study(NamedTuple):
    """Study: its runs, and the parts that report them.

    Attributes:
        name: name on the command line.
        title: title in the list of studies.
        runs: runs by name. Their folder has the same name.
        parts: parts, which can be made separately, by name.
    """

    name: str
    title: str
    runs: Mapping[str, Runs]
    parts: Mapping[str, Part]


def percent(fraction: float) -> str:
    """Return a fraction as a percentage with one decimal."""
    return f"{100 * fraction:.1f} %"


def middle(values: Sequence[float] | np.ndarray, digits: int = 2) -> str:
    """Return median and range of the finite values as text, or "none" without finite values."""
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    if not known.size:
        return "none"
    low, median, high = known.min(), np.median(known), known.max()
    return f"{median:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def in_order(values: Sequence[float] | np.ndarray, digits: int = 2) -> str:
    """Return all values as text, sorted from the smallest."""
    return ", ".join(f"{value:.{digits}f}" for value in sorted(map(float, values)))


def beside(values: Mapping[str, Sequence[float]], first: str) -> dict[str, str]:
    """Return the fraction of pairs in which each setting beats the first setting, with p values.

    The p values are from the two-sided Mann-Whitney test. Holm's correction covers all settings
    except the first.

    Args:
        values: values of the runs of each setting, to be maximised.
        first: name of the setting that the other settings are compared with.

    Returns:
        Text for each setting. It is empty for the first setting, and if no test is possible.
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
