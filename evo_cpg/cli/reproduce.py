"""The command that makes the tables and pictures of a study anew: reproduce."""

import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from evo_cpg.api.commit import checkout
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.progress import progress, working
from evo_cpg.config.errors import nearest
from evo_cpg.locks import locked
from evo_cpg.studies import provenance
from evo_cpg.studies.catalogue import NAMES, study
from evo_cpg.studies.study import Study
from evo_cpg.studies.workshop import Work, Workshop
from evo_cpg.training.devices import use_cores


def reproduce_study(
    name: str | None,
    parts: Sequence[str],
    out: Path | None,
    quick: bool,
    listed: bool,
    fresh: bool,
    cores: int | None,
) -> None:
    """`evo-cpg reproduce`.

    Raises:
        UsageError: there is no such study or part.
    """
    if name is not None and name not in NAMES:
        raise UsageError(f"reproduce: there is no study {name!r}; {nearest(name, NAMES)}")
    if listed:
        _list([name] if name else NAMES, out)
        return
    if name is None:
        raise UsageError(f"reproduce: name a study: {', '.join(NAMES)}; --list tells their parts")
    chosen = study(name)
    for part in parts:
        if part not in chosen.parts:
            raise UsageError(
                f"reproduce: {name} has no part {part!r}; {nearest(part, list(chosen.parts))}"
            )
    make(chosen, parts or list(chosen.parts), out or default_folder(name, quick), quick, fresh,
         use_cores(cores))  # fmt: skip


def make(
    chosen: Study, parts: Sequence[str], folder: Path, quick: bool, fresh: bool, devices: int
) -> None:
    """Make some parts of a study, one after the other, each written when it is done."""
    workshop = Workshop(chosen, folder, quick, devices)
    with locked(folder, make=True):
        _make(workshop, parts, fresh)


def _make(workshop: Workshop, parts: Sequence[str], fresh: bool) -> None:
    workshop.claim()
    chosen, folder, quick = workshop.study, workshop.folder, workshop.quick
    if fresh:
        for part in parts:
            workshop.forget(part)
    for number, part in enumerate(parts):
        if len(parts) > 1:
            print(f"part {number + 1} of {len(parts)}: {part}", file=sys.stderr)
        try:
            for path in workshop.make(part, _Shown()):
                print(path)
        except KeyboardInterrupt:
            left = f"evo-cpg reproduce {chosen.name} {' '.join(parts[number:])}"
            if folder != default_folder(chosen.name, quick):
                left += f" --out {folder}"
            left += " --quick" if quick else ""
            again = f"`{left}` makes the rest"
            if chosen.runs:
                # With --fresh the same command would throw away what is done.
                again = f"`{left}` goes on" if fresh else "the same command goes on"
            print(f"interrupted; {again}", file=sys.stderr)
            raise


def default_folder(name: str, quick: bool) -> Path:
    """Where a study's files go: in a checkout beside its page, else into the working folder."""
    if quick:
        return Path("reproduction") / f"{name}_quick"
    here = checkout()
    if here is None:
        return Path("reproduction") / name
    return here / "docs" / "reproduction" / name


class _Shown:
    """How far the work is, on the terminal."""

    def evolving(
        self, title: str, total: int, done: int
    ) -> AbstractContextManager[Callable[[int, str, float], None]]:
        """A bar with the time that is left, or lines."""
        print(title, file=sys.stderr)
        return progress(title.partition(",")[0], "generations", total, done)

    def measuring(self, title: str) -> AbstractContextManager[Work]:
        """A line that moves."""
        return working(title)


def _list(names: Sequence[str], out: Path | None) -> None:
    table = Table("study", "part", "about", "made", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in names:
        known = provenance.read(out or default_folder(name, quick=False))
        for part, declared in study(name).parts.items():
            told = known.get(part, {})
            made = f"{told['date'][:10]}, {told['commit']}" if "date" in told else "never"
            table.add_row(name, part, declared.title, made)
    Console().print(table)
