"""Sweep over many settings of one experiment: run folders, tables and one figure.

    sweep.json       settings, to continue the sweep
    NAME/            run folder of a setting, for all commands that take a run
    runs.csv         row for every run: its setting and its champion
    settings.csv     row for every setting: median, quartiles, extremes
    tests.csv        row for every two settings: how often the first wins, with a p value
    sweep.png        fitness over generations, and final fitness

Settings with equal trials run together in one program, with any searches
(`evo_cpg.training.train`). Others run in turn, each with its own program. The numbers of a body
are constants of the program, so that evaluations are fast and replays exact to the bit.
"""

import contextlib
import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from evo_cpg import locks
from evo_cpg.analysis.compare import Comparison, Spread, compare, spread
from evo_cpg.api.progress import progress, working
from evo_cpg.api.run_start import begin_run, reopen_run
from evo_cpg.errors import UsageError, advise
from evo_cpg.files import make_folder, write_table, write_text
from evo_cpg.io.build import build_experiment, require_genes
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.keys import parts_of, replaces
from evo_cpg.io.load import as_overrides, load_config
from evo_cpg.io.run import Run, fingerprint
from evo_cpg.io.settings import Setting, combine, is_folder_name
from evo_cpg.io.shipped import find_config
from evo_cpg.io.trust import trusting
from evo_cpg.system import resolved
from evo_cpg.training import devices
from evo_cpg.training.checkpoint import Checkpoint
from evo_cpg.training.memory import require_memory
from evo_cpg.training.reevaluation import is_finished
from evo_cpg.training.run_folder import RunFolder, RunFolderError, read_checked
from evo_cpg.training.team import device_count

_PLAN = "sweep.json"

# Sections of a configuration that do not change the trials.
_SEARCH = ("name", "seed", "runs", "evolution", "audit")


@dataclasses.dataclass(frozen=True)
class Member(Run):
    """Setting of a sweep, with its run folder and experiment.

    Attributes:
        setting: name and values of the setting.
        source: file of the configuration.
    """

    setting: Setting
    source: Path

    @property
    def checkpoint(self) -> Checkpoint | None:
        """Newest checkpoint, or None if there is none yet."""
        return self.folder.load() if self.folder.config.is_file() else None

    @property
    def generation(self) -> int:
        """Number of finished generations."""
        found = self.checkpoint
        return found.generation if found else 0

    @property
    def finished(self) -> bool:
        """Return whether the last generation is done and the champions are known."""
        if self.folder.newest < self.experiment.generations:
            return False
        found = self.checkpoint
        return found is not None and is_finished(self.experiment, found)


class Summary(NamedTuple):
    """Result of a sweep.

    Attributes:
        folder: folder of the sweep.
        spreads: spread of the fitness of every setting.
        comparisons: comparison of every two settings.
        figure: path of the figure.
    """

    folder: Path
    spreads: list[Spread]
    comparisons: list[Comparison]
    figure: Path


def sweep(
    config: Path | str,
    overrides: Sequence[str] = (),
    grid: Mapping[str, Sequence[Any]] = MappingProxyType({}),
    settings: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    out: Path | str | None = None,
    only: Sequence[str] = (),
    cores: int | None = None,
    trust: bool = False,
) -> Summary:
    """Evolve an experiment with many settings, and compare the results.

    Args:
        config: file or name of a configuration, or the folder of a sweep to continue unchanged.
        overrides: settings that all share, ``key=value``.
        grid: values of each key. Several keys give all combinations.
        settings: named settings, values by key. The grid varies each of them.
        out: folder, or None for ``runs/CONFIG_sweep``.
        only: names of the settings to evolve now, or empty for all.
        cores: number of cores, or None for all.
        trust: whether to trust the configuration, see `load`.

    Raises:
        ConfigError: the configuration or a value of a setting is wrong.
        LockedError: another process evolves one of the settings.
        RunFolderError: the folder holds something else, or the configuration has changed.
        UsageError: nothing is varied, or there is no such setting.
    """
    with trusting(trust):
        source = find_config(config, folders=True)
        folder, plan = source, read_plan(source)
        if plan is None:
            folder = Path(out or Path("runs") / f"{source.stem}_sweep")
            given = [override.partition("=")[0] for override in overrides]
            for i, key in enumerate(grid):
                for other in [*given, *list(grid)[:i]]:
                    if replaces(key, other):
                        twice = "is given twice" if key == other else f"would replace {other}"
                        raise UsageError(f"sweep: {key} {twice}. Give all its values at once")
            if not grid and not settings:
                raise UsageError("sweep: nothing is varied. Name keys and values, or settings")
            try:
                varied = combine(grid, settings)
            except ValueError as error:
                raise UsageError(f"sweep: {error}") from None
            plan = new_plan(source, overrides, varied)
        elif overrides or grid or settings or out:
            raise UsageError(
                f"sweep: {config} is a sweep, which can only be continued unchanged. Leave out "
                "other settings"
            )
        devices.use_cores(cores)
        with working("building every setting"):
            members = members_of(folder, plan)
    known = {member.setting.name: member for member in members}
    for name in only:
        if name not in known:
            raise UsageError(f"sweep: there is no setting {name!r}. Allowed: {', '.join(known)}")
    chosen = [known[name] for name in dict.fromkeys(only)] or members
    # Several processes may evolve different settings of a sweep, because each locks its runs.
    with contextlib.nullcontext() if only else locks.locked(folder, make=True):
        claim(folder, plan)
        evolve(chosen, folder.name)
        with working("making tables and figure"):
            return summarise(folder, members)


def new_plan(source: Path, overrides: Sequence[str], settings: Sequence[Setting]) -> dict[str, Any]:
    """Return the plan of a sweep, which is the contents of ``sweep.json``.

    Raises:
        ConfigError: the configuration or a value of a setting is wrong.
    """
    plan = {
        "config": str(resolved(source)),
        "config_sha256": _digest(source, overrides),
        "overrides": list(overrides),
        "settings": {setting.name: setting.values for setting in settings},
    }
    for setting in settings:
        for key, value in setting.values.items():
            try:
                json.dumps(value)
            except TypeError:
                kind = type(value).__name__
                raise ConfigError(
                    source, parts_of(key), f"{value}: a {kind}. Allowed: numbers, texts, lists"
                ) from None
    # Return the plan in the form in which it will be read.
    return json.loads(json.dumps(plan))


def claim(folder: Path, plan: Mapping[str, Any]) -> None:
    """Make the folder of a sweep, or check that it holds this sweep.

    Raises:
        OutputError: the folder cannot be written.
        RunFolderError: the folder holds something else.
    """
    known = read_plan(folder)
    if known is not None:
        other = [key for key, value in plan.items() if known.get(key) != value]
        if other:
            raise RunFolderError(
                f"{folder} holds a sweep with other `{other[0]}`. Continue it with "
                f"`evo-cpg sweep {folder}`, or choose another --out"
            )
        return
    if folder.is_file() or (
        folder.is_dir()
        and any(not path.name.startswith((locks.FILE, f".{_PLAN}.")) for path in folder.iterdir())
    ):
        raise RunFolderError(f"{folder} is not empty and holds no sweep. Choose another --out")
    write_text(make_folder(folder) / _PLAN, json.dumps(plan, indent=2))


def read_plan(folder: Path) -> dict[str, Any] | None:
    """Read the plan of a sweep, or None if the folder holds no sweep.

    Raises:
        RunFolderError: the file of the plan is damaged.
    """

    def is_plan(plan: Any) -> bool:
        for name in plan["settings"]:
            # The run folder of the setting, next to sweep.json, gets this name.
            if not is_folder_name(name):
                raise ValueError(f"{name[:80]!r} is not allowed as the name of a setting")
        kinds = {"config": str, "config_sha256": str, "overrides": list, "settings": dict}
        return (
            all(isinstance(plan[key], kind) for key, kind in kinds.items())
            and all(isinstance(override, str) for override in plan["overrides"])
            and all(isinstance(values, dict) for values in plan["settings"].values())
        )

    return read_checked(folder / _PLAN, is_plan)


def members_of(folder: Path, plan: Mapping[str, Any]) -> list[Member]:
    """Build the settings of a sweep.

    Raises:
        RunFolderError: the configuration has changed since the sweep began.
        ConfigError: a setting is wrong.
        TooLargeError: a setting needs more memory than the machine has.
    """
    source = Path(plan["config"])
    if _digest(source, plan["overrides"]) != plan["config_sha256"]:
        raise RunFolderError(
            f"{folder}: {source} has changed since the sweep began. Restore it, or begin "
            "another sweep"
        )
    members = []
    for name, values in plan["settings"].items():
        setting = Setting(name, values)
        config = load_config(source, [*plan["overrides"], *as_overrides(values)])
        config = config.model_copy(update={"name": f"{config.name} {name}"})
        experiment = build_experiment(config, source)
        require_genes(experiment, source)
        require_memory(experiment)
        members.append(Member(RunFolder(folder / name), config, experiment, setting, source))
    return members


def _digest(source: Path, overrides: Sequence[str]) -> str:
    """Return a digest of the base configuration, before settings change it."""
    config = load_config(source, overrides)
    text = json.dumps(fingerprint(config)["config"], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def groups(members: Sequence[Member]) -> list[list[Member]]:
    """Group the settings that share a program of trials, in order of first appearance."""
    found: dict[str, list[Member]] = {}
    for member in members:
        config = member.config.model_dump(mode="json", exclude=set(_SEARCH))
        audit = member.config.audit.model_dump(mode="json")
        rules = {name: audit[name] for name in audit["disqualify"]}
        names = member.experiment.simulation.measures.names
        body = member.config.evolution.model_dump(mode="json").get("body")
        key = json.dumps([config, rules, names, member.experiment.trials, body], sort_keys=True)
        found.setdefault(key, []).append(member)
    return list(found.values())


def run_group(
    group: Sequence[Member], on_generation: Callable[[Member, list[dict[str, float]]], object]
) -> None:
    """Evolve the settings of one of the `groups` together, from their newest checkpoints.

    Raises:
        LockedError: another process evolves one of the settings.
        OutputError: a folder cannot be written.
    """
    from evo_cpg.training.train import train_together

    count = device_count()
    with contextlib.ExitStack() as stack:
        for member in group:
            stack.enter_context(member.folder.locked(new=True))
        for member in group:
            if not member.folder.config.is_file():
                begin_run(member, count, member.source)
                continue
            member.folder.require()
            if not member.finished:
                for words in reopen_run(member, count, source=member.source):
                    advise(words)
        train_together(
            [member.experiment for member in group],
            [member.folder for member in group],
            lambda number, rows: on_generation(group[number], rows),
        )


def evolve(
    members: Sequence[Member],
    title: str,
    on_generation: Callable[[Member], object] = lambda member: None,
) -> None:
    """Evolve settings to the last generation, group by group, and show the progress."""
    found = groups(members)
    for number, group in enumerate(found, 1):
        if all(member.finished for member in group):
            continue
        total = sum(member.experiment.generations for member in group)
        done = sum(member.generation for member in group)
        which = f"{number} of {len(found)}: " if len(found) > 1 else ""
        names = ", ".join(member.setting.name for member in group)
        latest: dict[str, float] = {}
        with progress("generations", total, done, f"{title}: {which}{names}: compiling") as show:

            def tell(
                member: Member, rows: list[dict[str, float]], latest: dict = latest, show=show
            ) -> None:
                latest[member.setting.name] = float(np.median([row["champion"] for row in rows]))
                known = {name: value for name, value in latest.items() if math.isfinite(value)}
                best = max(known, key=lambda name: known[name], default=None)
                show(
                    "no finite fitness yet"
                    if best is None
                    else f"best so far: {best}, median champion {known[best]:.4f}"
                )
                on_generation(member)

            run_group(group, tell)


def summarise(folder: Path, members: Sequence[Member]) -> Summary:
    """Write the tables and the figure of all results so far.

    Raises:
        OutputError: the folder cannot be written.
        RunFolderError: nothing has been evolved yet.
    """
    from evo_cpg.view.figure import save_figure
    from evo_cpg.view.search_plots import Curves, sweep_figure

    rows: list[dict[str, Any]] = []
    curves, fitness = [], {}
    keys = list(dict.fromkeys(key for member in members for key in member.setting.values))
    for member in members:
        name, checkpoint = member.setting.name, member.folder.load()
        if checkpoint is None or not checkpoint.history:
            continue
        experiment, runs = member.experiment, len(checkpoint.champions)
        evaluated = experiment.strategy.population * np.arange(1, checkpoint.generation + 1)
        best = np.array([row["champion"] for row in checkpoint.history]).reshape(-1, runs).T
        worth = [math.nan if one is None else one.worth for one in checkpoint.champions]
        curves.append(Curves(name, evaluated, best, np.array(worth)))
        fitness[name] = worth
        # Every row holds the time of all runs together, so the sum counts each generation once for
        # each run.
        seconds = sum(row["seconds"] for row in checkpoint.history) / runs
        for run, champion in enumerate(checkpoint.champions):
            found = {} if champion is None else champion.terms
            row = {"setting": name, "run": run, "seed": experiment.seed + run}
            values = {key: member.setting.values.get(key, "") for key in keys}
            row |= {
                key: json.dumps(value) if isinstance(value, dict | list) else value
                for key, value in values.items()
            }
            row |= {
                "generations": checkpoint.generation,
                "evaluations": int(evaluated[-1]),
                "seconds": round(seconds / runs, 2),
                "fitness": worth[run],
                "found_in": "" if champion is None else champion.generation,
            }
            last = checkpoint.history[run - runs]
            row |= {name: last[name] for name in experiment.strategy.metric_names}
            rows.append(row | {f"best_{term}": value for term, value in found.items()})
    if not rows:
        raise RunFolderError(f"{folder}: nothing has been evolved yet")
    spreads = [spread(name, values) for name, values in fitness.items()]
    comparisons = compare(fitness)
    write_table(folder / "runs.csv", rows)
    write_table(folder / "settings.csv", [one._asdict() for one in spreads])
    if comparisons:
        write_table(folder / "tests.csv", [one._asdict() for one in comparisons])
    runs = sorted({one.runs for one in spreads})
    many = f"{runs[0]}" if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"
    title = f"{folder.name}: {len(spreads)} settings, {many} runs of each"
    picture = save_figure(sweep_figure(curves, title), folder / "sweep.png")
    return Summary(folder, spreads, comparisons, picture)
