"""`python -m benchmarks`: measure the speed of this program and its peers."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.errors import ExitCode
from evo_cpg.cli.main import PLAIN, main
from evo_cpg.errors import UsageError

# Largest population that fits the memory of common machines.
_LARGEST = 1_000_000

app = typer.Typer(add_completion=False, **PLAIN)


@app.command()
def bench(
    cases: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="CASE",
            help="swimmer, salamander-water, salamander-land, quadruped, half_cheetah, ant, "
            "humanoid, cpg, brain, ga, generation, gradient, bodies, loop, large-creatures, "
            "engines, scaling or startup (default: all).",
        ),
    ] = None,
    sizes: Annotated[
        str | None,
        typer.Option(
            help="Numbers of individuals, such as 1,15,200 (default: depends on the case)."
        ),
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", help="Also write the rows to this file.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Draw the rates: a .png, .svg or .pdf file.")
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option(
            "--compare", help="Compare with an earlier --json file. If any case is slower, exit 3."
        ),
    ] = None,
    tolerance: Annotated[
        float, typer.Option(min=0, max=1, help="Largest allowed loss of speed, a fraction.")
    ] = 0.1,
    limit: Annotated[
        float, typer.Option(min=1, help="Longest time to compile a peer written in JAX, s.")
    ] = 120.0,
    quick: Annotated[
        bool, typer.Option("--quick", help="Measure one size with short calls and few repeats.")
    ] = False,
) -> None:
    """Measure the speed of this program and its peers."""
    # JAX reads the environment when it is imported, so these imports follow `main`.
    from benchmarks import suite
    from evo_cpg.api.progress import all_lines
    from evo_cpg.io.errors import nearest
    from evo_cpg.view.output import output_path

    words = [] if sizes is None else [word.strip() for word in sizes.split(",")]
    for word in words:
        if not word.isascii() or not word.isdigit() or not 1 <= int(word) <= _LARGEST:
            raise UsageError(
                f"--sizes: {word!r} is not a number of individuals. "
                f"Allowed: whole numbers from 1 to {_LARGEST} with commas between, such as 1,15,200"
            )
    numbers = None if sizes is None else tuple(dict.fromkeys(map(int, words)))
    for case in cases or []:
        if case not in suite.CASES:
            raise UsageError(f"there is no case {case!r}: {nearest(case, suite.CASES)}")
    chosen = cases or list(suite.CASES)
    if numbers and not any(suite.CASES[case].sized for case in chosen):
        raise UsageError(
            f"--sizes: {', '.join(chosen)} has a fixed number of individuals. Leave --sizes out"
        )
    if json is not None:
        # Measuring takes minutes, so check first that the path can be written.
        try:
            json.parent.mkdir(parents=True, exist_ok=True)
            json.open("a").close()
        except OSError as error:
            raise UsageError(f"--json: {json} cannot be written ({error.strerror})") from None
    if plot is not None:
        output_path(plot, suite.picture.SUFFIXES)
    request = suite.Selection(cases or [], numbers, quick, limit, json, plot, compare, tolerance)
    try:
        with all_lines():
            fine = suite.main(request)
    except suite.rows.RowsError as error:
        raise UsageError(f"--compare: {error}") from None
    if not fine:
        raise typer.Exit(ExitCode.NOT_PASSED)


if __name__ == "__main__":
    main(app, "python -m benchmarks")
