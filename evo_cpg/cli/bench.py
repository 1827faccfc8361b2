"""The command that measures: bench. The suite itself lies in the checkout's benchmarks/."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.exit_codes import ExitCode
from evo_cpg.config.errors import nearest
from evo_cpg.studies.benchmarks import bench_suite
from evo_cpg.view.output import output_path

# Individuals beyond which a population does not fit a machine that people have.
_LARGEST = 1_000_000


def run_suite(
    cases: Sequence[str],
    sizes: str | None,
    json: Path | None,
    plot: Path | None,
    compare: Path | None,
    tolerance: float,
    limit: float,
    quick: bool,
) -> None:
    """`evo-cpg bench`.

    Raises:
        UsageError: something is wrong with the input.
        SuiteError: there is no suite.
        Exit: with 1, where something became slower.
    """
    numbers = _sizes(sizes) if sizes is not None else None
    suite = bench_suite()
    for case in cases:
        if case not in suite.CASES:
            raise UsageError(f"there is no case {case!r}; {nearest(case, suite.CASES)}")
    chosen = cases or list(suite.CASES)
    if numbers and not any(suite.CASES[case].sized for case in chosen):
        raise UsageError(f"--sizes: {', '.join(chosen)} has a size of its own")
    if json is not None:
        # Measuring takes minutes; a path that cannot be written is better known before.
        try:
            json.parent.mkdir(parents=True, exist_ok=True)
            json.open("a").close()
        except OSError as error:
            raise UsageError(f"--json: {json} cannot be written ({error.strerror})") from None
    if plot is not None:
        output_path(plot, suite.picture.SUFFIXES)
    wanted: Any = suite.Wanted(cases, numbers, quick, limit, json, plot, compare, tolerance)
    try:
        fine = suite.main(wanted)
    except suite.rows.RowsError as error:
        raise UsageError(f"--compare: {error}") from None
    if not fine:
        raise typer.Exit(ExitCode.NOT_PASSED)


def _sizes(text: str) -> tuple[int, ...]:
    """Population sizes from a list such as 1,15,200."""
    words = [word.strip() for word in text.split(",")]
    for word in words:
        if not word.isascii() or not word.isdigit() or not 1 <= int(word) <= _LARGEST:
            raise UsageError(
                f"--sizes: {word!r} is no number of individuals; "
                f"allowed: whole numbers from 1 to {_LARGEST} with commas between, such as 1,15,200"
            )
    return tuple(dict.fromkeys(map(int, words)))
