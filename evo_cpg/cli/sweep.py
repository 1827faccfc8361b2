"""The command that compares settings: sweep."""

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table

from evo_cpg.analysis.compare import Comparison, Spread
from evo_cpg.api.sweep import (
    Member,
    claim,
    groups,
    members_of,
    new_plan,
    read_plan,
    run_group,
    summarise,
)
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.jobs import Jobs, claimed, read_jobs, run_jobs
from evo_cpg.cli.progress import progress, working
from evo_cpg.config.settings import Setting, combine, read_settings
from evo_cpg.config.yaml_text import parse_yaml
from evo_cpg.system import as_utf8, named
from evo_cpg.training.devices import use_cores

# More rows of a table than anybody reads on a terminal; the file has all.
_MOST_ROWS = 30

# Of the words of a test that is passed.
_SURE = 0.05


def run_sweep(
    path: Path,
    overrides: Sequence[str],
    grid: Sequence[str],
    settings: Path | None,
    out: Path | None,
    cores: int | None,
    only: Sequence[str] = (),
    jobs: str | None = None,
    job_options: Sequence[str] = (),
) -> bool:
    """`evo-cpg sweep`.

    Returns:
        Whether all came to their ends; a job may have failed.
    """
    asked = read_jobs(jobs, job_options)
    overrides, grid = [as_utf8(word) for word in overrides], [as_utf8(word) for word in grid]
    folder, plan = path, read_plan(path)
    if plan is None:
        folder = out or Path("runs") / f"{path.stem}_sweep"
        plan = new_plan(path, overrides, _varied(grid, settings))
    elif overrides or grid or settings or out:
        raise UsageError(
            f"sweep: {path} is a sweep, which is gone on with as it is; give no other settings"
        )
    devices = use_cores(cores)
    with working("building every setting"):
        members = members_of(folder, plan)
    chosen = _chosen(members, only)
    with claimed(folder, asked):
        claim(folder, plan)
        failed = _evolve(folder, named(plan["config"]), chosen, devices, asked, cores)
        if any(member.generation for member in members) or not failed:
            _tell(folder, members)
    if failed:
        print(
            f"{len(failed)} of {len(chosen)} settings did not come to their ends: "
            f"{', '.join(failed)}; go on with `evo-cpg sweep {folder}`",
            file=sys.stderr,
        )
    return not failed


def _varied(grid: Sequence[str], settings: Path | None) -> list[Setting]:
    axes = dict(_axis(word) for word in grid)
    if not axes and settings is None:
        raise UsageError(
            "sweep: nothing is varied; name keys and values, such as "
            "--grid evolution.mutation_rate=0.02,0.05, or a file of --settings"
        )
    named = {} if settings is None else read_settings(settings)
    try:
        return combine(axes, named)
    except ValueError as error:
        raise UsageError(f"sweep: {error}") from None


def _axis(word: str) -> tuple[str, list[Any]]:
    """A key and its values, of ``key=a,b,c``."""
    key, equals, text = word.partition("=")
    if not (key and equals and text):
        raise UsageError(f"--grid: {word!r} is not KEY=VALUE,VALUE,...")
    listed = text if text.startswith("[") else f"[{text}]"
    try:
        values = parse_yaml(listed)
    except yaml.YAMLError:
        values = None
    if not isinstance(values, list) or not values:
        raise UsageError(f"--grid: {text!r} is not a list of values, such as 1,2,3")
    return key, values


def _chosen(members: Sequence[Member], only: Sequence[str]) -> list[Member]:
    known = {member.setting.name: member for member in members}
    for name in only:
        if name not in known:
            raise UsageError(f"--only: there is no setting {name!r}; there are {', '.join(known)}")
    return [known[name] for name in only] or list(members)


def _evolve(
    folder: Path,
    source: Path,
    members: Sequence[Member],
    devices: int,
    jobs: Jobs | None,
    cores: int | None,
) -> list[str]:
    """Names of settings that did not come to their ends."""
    found = groups(members)
    if jobs is not None:
        try:
            return run_jobs(folder, found, jobs, cores)
        except KeyboardInterrupt:
            if jobs.count is not None:
                _say_interrupted(folder)
            raise
    for number, group in enumerate(found):
        names = ", ".join(member.setting.name for member in group)
        head = f"{number + 1} of {len(found)}: {names}" if len(found) > 1 else names
        if all(member.finished for member in group):
            continue
        total = sum(member.experiment.generations for member in group)
        done = sum(member.generation for member in group)
        print(f"{folder}: {head}", file=sys.stderr)
        with progress(folder.name, "generations", total, done, "compiling") as show:
            watch = _Watch(show, done)
            try:
                run_group(group, source, devices, watch.tell, _warn)
            except KeyboardInterrupt:
                _say_interrupted(folder)
                raise
    return []


def _warn(words: str) -> None:
    print(f"evo-cpg: warning: {words}", file=sys.stderr)


def _say_interrupted(folder: Path) -> None:
    print(f"interrupted; go on with `evo-cpg sweep {folder}`", file=sys.stderr)


class _Watch:
    """Shows the generations of a group as they come.

    Args:
        show: from `progress`.
        done: generations that are done before.
    """

    def __init__(self, show: Callable[[int, str, float], None], done: int):
        self._show, self._done, self._clock = show, done, time.perf_counter()
        self._latest: dict[str, float] = {}

    def tell(self, member: Member, rows: list[dict[str, float]]) -> None:
        """A generation of a setting is done."""
        self._latest[member.setting.name] = float(np.median([row["champion"] for row in rows]))
        before, self._clock = self._clock, time.perf_counter()
        self._show(self._done, self._standing(), self._clock - before)
        self._done += 1

    def _standing(self) -> str:
        known = {name: value for name, value in self._latest.items() if np.isfinite(value)}
        if not known:
            return "nobody lives yet"
        best = max(known, key=lambda name: known[name])
        return f"ahead: {best}, median champion {known[best]:.4f}"


def _tell(folder: Path, members: Sequence[Member]) -> None:
    with working("tables and figure"):
        found = summarise(folder, members)
    console = Console()
    console.print(_spreads(found.spreads))
    if found.comparisons:
        console.print(_tests(found.comparisons))
    print(found.figure)
    print(folder)


def _spreads(spreads: Sequence[Spread]) -> Table:
    table = Table(title="fitness of the champions", title_justify="left")
    table.add_column("setting", overflow="fold")
    for head in ("runs", "median", "quartiles", "worst", "best"):
        table.add_column(head, justify="right")
    for one in spreads[:_MOST_ROWS]:
        quartiles = f"{one.low:.4g} to {one.high:.4g}"
        ends = f"{one.worst:.4g}", f"{one.best:.4g}"
        table.add_row(one.name, str(one.runs), f"{one.median:.4g}", quartiles, *ends)
    return table


def _tests(comparisons: Sequence[Comparison]) -> Table:
    table = Table(
        title="who wins (Mann and Whitney's test, Holm's correction)", title_justify="left"
    )
    for head in ("setting", "against"):
        table.add_column(head, overflow="fold")
    for head in ("wins", "p", "p of all tests"):
        table.add_column(head, justify="right")
    shown = sorted(comparisons, key=lambda one: one.adjusted)[:_MOST_ROWS]
    for one in shown:
        sure = f"{one.adjusted:.3g}" + (" *" if one.adjusted < _SURE else "")
        table.add_row(one.first, one.second, f"{one.wins:.0%}", f"{one.p_value:.3g}", sure)
    return table
