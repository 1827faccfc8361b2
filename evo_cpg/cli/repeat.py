"""The command `reproduce`, which repeats the measurements of a study."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evo_cpg.cli.options import ClusterOption, Cores, on_cluster
from evo_cpg.cli.terminal import show_table, tell
from evo_cpg.errors import UsageError

if TYPE_CHECKING:
    from evo_cpg.studies.study import Study


def reproduce(
    study: Annotated[
        str | None,
        typer.Argument(
            metavar="STUDY",
            help="One of iwadate2010, fukui2003, salamander, hexapod, starfish, turtle, animals,"
            " bodies, search, benchmarks.",
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
