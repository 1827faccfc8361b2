"""Commands that repeat measurements: `reproduce` for the studies, `bench` for the speed."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evo_cpg.cli.errors import ExitCode
from evo_cpg.cli.options import ClusterOption, Cores, on_cluster
from evo_cpg.cli.terminal import show_table, tell
from evo_cpg.errors import UsageError

if TYPE_CHECKING:
    from evo_cpg.studies.study import Study

# Largest population that fits the memory of common machines.
_LARGEST = 1_000_000


def reproduce(
    study: Annotated[
        str | None,
        typer.Argument(
            metavar="STUDY",
            help="One of iwadate2010, fukui2003, salamander, hexapod, starfish, turtle, animals,"
            " search, benchmarks.",
        ),
    ] = None,
    parts: Annotated[
        list[str] | None, typer.Argument(metavar="PART", help="Parts of the study (default: all).")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Folder (default: docs/reproduction/STUDY in a clone, else reproduction/STUDY).",
        ),
    ] = None,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Test every step with tiny runs. The results mean nothing."),
    ] = False,
    listed: Annotated[
        bool, typer.Option("--list", help="List the studies, their parts, and when each was made.")
    ] = False,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Delete finished runs of these parts first.")
    ] = False,
    cores: Cores = None,
    cluster: ClusterOption = None,
) -> None:
    """Recompute the tables and pictures of a study."""
    from evo_cpg.io.errors import nearest
    from evo_cpg.studies import NAMES, find_study, provenance
    from evo_cpg.training.devices import use_cores

    if study is not None and study not in NAMES:
        raise UsageError(f"reproduce: there is no study {study!r}: {nearest(study, NAMES)}")
    if listed:
        rows = []
        for name in [study] if study else NAMES:
            known = provenance.read(out or default_folder(name, quick=False))
            for part, declared in find_study(name).parts.items():
                record = known.get(part, {})
                made = f"{record['date'][:10]}, {record['commit']}" if "date" in record else "never"
                rows.append((name, part, declared.title, made))
        show_table(("study", "part", "contents", "made"), rows, left=4)
        return
    if study is None:
        raise UsageError(f"reproduce: name a study: {', '.join(NAMES)}. --list shows their parts")
    chosen = find_study(study)
    for part in parts or []:
        if part not in chosen.parts:
            raise UsageError(
                f"reproduce: {study} has no part {part!r}: {nearest(part, list(chosen.parts))}"
            )
    place = out or default_folder(study, quick)
    devices = use_cores(cores)
    with on_cluster(cluster):
        make(chosen, parts or list(chosen.parts), place, quick, fresh, devices)


def make(
    chosen: "Study", parts: Sequence[str], folder: Path, quick: bool, fresh: bool, devices: int
) -> None:
    """Make parts of a study one after the other, and write each part when it is done."""
    from evo_cpg.locks import locked
    from evo_cpg.studies.workshop import Workshop

    workshop = Workshop(chosen, folder, quick, devices)
    with locked(folder, make=True):
        workshop.claim()
        for part in parts if fresh else ():
            workshop.forget(part)
        for number, part in enumerate(parts):
            if len(parts) > 1:
                tell(f"part {number + 1} of {len(parts)}: {part}")
            try:
                for path in workshop.make(part):
                    print(path)
            except KeyboardInterrupt:
                # With --fresh, the command would delete the finished runs.
                without = ", without --fresh" if fresh else ""
                left = " ".join(parts[number:])
                tell(f"interrupted. Continue with the parts {left}{without}")
                raise


def default_folder(name: str, quick: bool) -> Path:
    """Return the folder of a study: next to its page in a checkout, else in the working folder."""
    if quick:
        return Path("reproduction") / f"{name}_quick"
    from evo_cpg.api.machine import checkout

    here = checkout()
    if here is None:
        return Path("reproduction") / name
    return here / "docs" / "reproduction" / name


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
    from evo_cpg.io.errors import nearest
    from evo_cpg.studies.benchmarks import bench_suite
    from evo_cpg.view.output import output_path

    words = [] if sizes is None else [word.strip() for word in sizes.split(",")]
    for word in words:
        if not word.isascii() or not word.isdigit() or not 1 <= int(word) <= _LARGEST:
            raise UsageError(
                f"--sizes: {word!r} is not a number of individuals. "
                f"Allowed: whole numbers from 1 to {_LARGEST} with commas between, such as 1,15,200"
            )
    numbers = None if sizes is None else tuple(dict.fromkeys(map(int, words)))
    suite = bench_suite()
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
    request: Any = suite.Selection(
        cases or [], numbers, quick, limit, json, plot, compare, tolerance
    )
    try:
        fine = suite.main(request)
    except suite.rows.RowsError as error:
        raise UsageError(f"--compare: {error}") from None
    if not fine:
        raise typer.Exit(ExitCode.NOT_PASSED)
