"""The benchmark suite behind `python -m benchmarks`: its cases, and how they run.

All contenders of a case run in turn, several times, in one session on the same cores. Rates are
medians over these rounds, and ratios are medians of the ratios within a round. Compilation is timed
apart. docs/benchmarks.md describes the measurement of each figure.
"""

import contextlib
import functools
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
from rich.console import Console

from benchmarks import (
    bodies,
    breeding,
    engines,
    generation,
    gradient,
    large_creatures,
    loop,
    machine,
    moving,
    nerves,
    picture,
    report,
    rows,
    scaling,
    startup,
)
from benchmarks.animals import ANIMALS
from benchmarks.compare import Verdict, compare
from benchmarks.plan import Plan
from benchmarks.rows import Row
from evo_cpg.api.progress import Work, working
from evo_cpg.training.devices import use_cores

# Length of a call, s, and number of rounds, in a full run and in a quick run.
_THOROUGH, _QUICK = (0.5, 7), (0.05, 3)
# Longest wait for a peer's compilation in a first look, s.
_QUICK_LIMIT = 30.0


class Case(NamedTuple):
    """A case that the user can request by name.

    Attributes:
        measure: function that yields rows as soon as they are measured. Its arguments are the plan
            and the peak of the machine, 1/s.
        sized: whether `--sizes` applies to the case.
    """

    measure: Callable[[Plan, float], Iterable[Row]]
    sized: bool = True


class Selection(NamedTuple):
    """Choices of the user.

    Attributes:
        cases: names, in any order, or none for all.
        sizes: sizes of the populations, or None for each case's own.
        quick: whether to measure little, for a first look.
        limit: longest compile time of a peer in a process of its own, s.
        json: file for the rows, or None for no file.
        plot: file for the picture, or None for no picture.
        earlier: file of rows to compare with, or None for none.
        tolerance: largest fraction that a rate or ratio may lose against the earlier rows.
    """

    cases: Sequence[str] = ()
    sizes: tuple[int, ...] | None = None
    quick: bool = False
    limit: float = 120.0
    json: Path | None = None
    plot: Path | None = None
    earlier: Path | None = None
    tolerance: float = 0.1


def _animal(name: str, plan: Plan, peak: float) -> Iterable[Row]:
    return moving.measure(ANIMALS[name](), plan, peak)


def _alone(measure: Callable[[Plan], Iterable[Row]], plan: Plan, peak: float) -> Iterable[Row]:
    return measure(plan)


CASES: dict[str, Case] = {
    **{name: Case(functools.partial(_animal, name)) for name in ANIMALS},
    "cpg": Case(nerves.measure_cpg),
    "brain": Case(nerves.measure_brain),
    "ga": Case(functools.partial(_alone, breeding.measure), sized=False),
    "generation": Case(functools.partial(_alone, generation.measure), sized=False),
    "gradient": Case(functools.partial(_alone, gradient.measure), sized=False),
    "bodies": Case(functools.partial(_alone, bodies.measure)),
    "loop": Case(functools.partial(_alone, loop.measure), sized=False),
    "large-creatures": Case(functools.partial(_alone, large_creatures.measure)),
    "engines": Case(functools.partial(_alone, engines.measure)),
    "scaling": Case(functools.partial(_alone, scaling.measure)),
    "startup": Case(functools.partial(_alone, startup.measure), sized=False),
}


def main(selection: Selection) -> bool:
    """Measure, print and store the selected cases.

    Returns:
        True if no row became slower than the earlier rows allow, or if there are none.

    Raises:
        RowsError: the file of earlier rows cannot be read, or has other contents.
    """
    # Read the file first, because measuring takes long, and the file may not hold rows.
    earlier = rows.load(selection.earlier) if selection.earlier else None
    cores = use_cores()
    console = Console()
    with working("the machine's peak") as work:
        where, found = measure(selection, cores, work)
    for table in report.tables(found, where):
        console.print(table)
    for line in report.notes(found):
        console.print(line, highlight=False)
    if selection.json is not None:
        console.print(str(selection.json), highlight=False)
    if selection.plot is not None:
        picture.draw(found, where, selection.plot)
        console.print(str(selection.plot), highlight=False)
    if earlier is None:
        return True
    verdict: Verdict = compare(earlier, (where, found), selection.tolerance)
    console.print(report.comparison(verdict, selection.tolerance))
    for line in verdict.remarks:
        console.print(line, highlight=False)
    return not verdict.slower


def measure(selection: Selection, cores: int, work: Work) -> tuple[dict[str, Any], list[Row]]:
    """Measure the selected cases, and store the rows as JSON if requested.

    Args:
        selection: cases, sizes, and effort.
        cores: number of JAX's devices.
        work: receives progress, and every row.

    Returns:
        The machine from `benchmarks.machine.describe`, and the rows.
    """
    found: list[Row] = []
    with _nothing_kept():
        peak = machine.matrix_product_rate()
        where = machine.describe(cores, peak) | {"quick": selection.quick}
        call_seconds, repeats = _QUICK if selection.quick else _THOROUGH
        limit = min(selection.limit, _QUICK_LIMIT) if selection.quick else selection.limit
        plan = Plan(
            cores, selection.sizes, call_seconds, repeats, limit, selection.quick, work.doing
        )
        for name in CASES:
            if not selection.cases or name in selection.cases:
                for row in CASES[name].measure(plan, peak):
                    found.append(row)
                    work.say(report.line(row))
                    # Cases take minutes, so a failure of the next case must not lose the rows.
                    if selection.json is not None:
                        rows.save(selection.json, where, found)
    return where, found


@contextlib.contextmanager
def _nothing_kept() -> Iterator[None]:
    """Disable JAX's cache in the block, because cached code would hide the compile time."""
    before = jax.config.values["jax_enable_compilation_cache"]
    jax.config.update("jax_enable_compilation_cache", False)
    try:
        yield
    finally:
        jax.config.update("jax_enable_compilation_cache", before)
