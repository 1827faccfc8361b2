"""Many settings of one experiment: a run folder for each, a table of all, and one figure.

    sweep.json       what is varied, so that the sweep can be gone on with
    NAME/            a run folder for every setting, for all commands that take one
    runs.csv         a row for every run: what was set, and what its champion came to
    settings.csv     a row for every setting: median, quartiles, extremes
    tests.csv        a row for every two settings: who wins how often, and how sure that is
    sweep.png        how fitness rose, and what the runs came to

Settings with the same animal in the same trial run side by side in one program, whatever searches
(`evo_cpg.training.loop`); others in turn, each with a program of its own: numbers of a body
are constants of it, which makes an evaluation faster and lets a champion live again to the bit.
"""

import contextlib
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evo_cpg import locks
from evo_cpg.analysis.compare import Comparison, Spread, compare, spread
from evo_cpg.api.training import begin_run, reopen_run
from evo_cpg.config.build import build_experiment, require_genes
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.fingerprint import fingerprint
from evo_cpg.config.load import load_config
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.config.settings import Setting, is_folder_name
from evo_cpg.files import make_folder, write_table, write_text
from evo_cpg.system import name_of, named, resolved
from evo_cpg.training.checkpoint import Checkpoint
from evo_cpg.training.experiment import Experiment
from evo_cpg.training.memory import require_memory
from evo_cpg.training.reevaluation import is_finished
from evo_cpg.training.run_folder import RunFolder, RunFolderError

_PLAN = "sweep.json"

# What of a configuration does not change the trials.
_SEARCH = ("name", "seed", "runs", "evolution", "audit")


class Member(NamedTuple):
    """A setting of a sweep.

    Attributes:
        setting: its name, and what it sets.
        config: complete.
        experiment: built from it.
        folder: of its runs.
    """

    setting: Setting
    config: ExperimentConfig
    experiment: Experiment
    folder: RunFolder

    @property
    def checkpoint(self) -> Checkpoint | None:
        """The newest; None where there is none yet."""
        return self.folder.load() if self.folder.config.is_file() else None

    @property
    def generation(self) -> int:
        """Generations that are done."""
        found = self.checkpoint
        return found.generation if found else 0

    @property
    def finished(self) -> bool:
        """Whether its last generation is done, and its champions known."""
        if self.folder.newest < self.experiment.generations:
            return False
        found = self.checkpoint
        return found is not None and is_finished(self.experiment, found)


class Summary(NamedTuple):
    """What a sweep came to.

    Attributes:
        spreads: of every setting.
        comparisons: of every two.
        figure: path of the picture.
    """

    spreads: list[Spread]
    comparisons: list[Comparison]
    figure: Path


def new_plan(source: Path, overrides: Sequence[str], settings: Sequence[Setting]) -> dict[str, Any]:
    """What a sweep is about, for its folder.

    Raises:
        ConfigError: the configuration is wrong.
    """
    plan = {
        "config": name_of(resolved(source)),
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
                    source, key.split("."), f"{value}: a {kind}; allowed: numbers, texts, lists"
                ) from None
    # As it will be read.
    return json.loads(json.dumps(plan))


def claim(folder: Path, plan: Mapping[str, Any]) -> None:
    """Make the folder of a sweep, or check that it holds this one.

    Raises:
        RunFolderError: it holds something else, or cannot be written.
    """
    known = read_plan(folder)
    if known is not None:
        other = [key for key, value in plan.items() if known.get(key) != value]
        if other:
            raise RunFolderError(
                f"{folder} holds another sweep (its {other[0]} differ); go on with "
                f"`evo-cpg sweep {folder}` or choose another --out"
            )
        return
    if folder.is_file() or (folder.is_dir() and any(_others(folder))):
        raise RunFolderError(f"{folder} is not empty and holds no sweep; choose another --out")
    write_text(make_folder(folder) / _PLAN, json.dumps(plan, indent=2))


def _others(folder: Path) -> Iterator[Path]:
    """What a folder holds beside its lock."""
    return (path for path in folder.iterdir() if path.name != locks.FILE)


def read_plan(folder: Path) -> dict[str, Any] | None:
    """What a sweep's folder is about; None where it is none.

    Raises:
        RunFolderError: its file is damaged.
    """
    path = folder / _PLAN
    if not path.is_file():
        return None
    try:
        plan = json.loads(path.read_text(encoding="utf-8"))
        kinds = {"config": str, "config_sha256": str, "overrides": list, "settings": dict}
        sound = all(isinstance(plan[key], kind) for key, kind in kinds.items())
        sound = sound and all(isinstance(override, str) for override in plan["overrides"])
        if not sound or not all(isinstance(values, dict) for values in plan["settings"].values()):
            raise ValueError("something is of another kind")
        for name in plan["settings"]:
            # It names a folder beside the file.
            if not is_folder_name(name):
                raise ValueError(f"{name[:80]!r} is no name of a setting")
    except (KeyError, OSError, RecursionError, TypeError, ValueError) as error:
        raise RunFolderError(f"{path} is damaged ({error})") from None
    return plan


def members_of(
    folder: Path, plan: Mapping[str, Any], names: Sequence[str] | None = None
) -> list[Member]:
    """The settings of a sweep, built.

    Args:
        folder: of the sweep.
        plan: what it is about.
        names: of the settings that are wanted; None for all.

    Raises:
        RunFolderError: its configuration has changed since it began.
        ConfigError: a setting is wrong.
        TooLargeError: the machine has not the memory for one.
    """
    source = named(plan["config"])
    if _digest(source, plan["overrides"]) != plan["config_sha256"]:
        raise RunFolderError(
            f"{folder}: {source} has changed since the sweep began; put it back as it was, or "
            "begin another sweep"
        )
    members = []
    for name, values in plan["settings"].items():
        if names is not None and name not in names:
            continue
        setting = Setting(name, values)
        config = load_config(source, [*plan["overrides"], *setting.overrides])
        config = config.model_copy(update={"name": f"{config.name} {name}"})
        experiment = build_experiment(config, source)
        require_genes(experiment, source)
        require_memory(experiment)
        members.append(Member(setting, config, experiment, RunFolder(folder / named(name))))
    return members


def _digest(source: Path, overrides: Sequence[str]) -> str:
    """Of what all settings change something of."""
    config = load_config(source, overrides)
    told = json.dumps(fingerprint(config)["config"], sort_keys=True)
    return hashlib.sha256(told.encode()).hexdigest()


def groups(members: Sequence[Member]) -> list[list[Member]]:
    """Settings that share a program of trials, in the order in which they first come."""
    found: dict[str, list[Member]] = {}
    for member in members:
        config = member.config.model_dump(mode="json", exclude=set(_SEARCH))
        audit = member.config.audit.model_dump(mode="json")
        rules = {name: audit[name] for name in audit["disqualify"]}
        names = member.experiment.simulation.measures.names
        key = json.dumps([config, rules, names, member.experiment.trials], sort_keys=True)
        found.setdefault(key, []).append(member)
    return list(found.values())


def run_group(
    group: Sequence[Member],
    source: Path,
    devices: int,
    on_generation: Callable[[Member, list[dict[str, float]]], object],
    warn: Callable[[str], object] = lambda words: None,
) -> None:
    """Evolve settings side by side, from where they stand.

    Args:
        group: from `groups`.
        source: file that the configuration came from.
        devices: that share the population.
        on_generation: called after every generation of each.
        warn: called with what is otherwise than before, in words for the user.

    Raises:
        LockedError: another process evolves one of them.
        OutputError: a folder cannot be written.
    """
    from evo_cpg.training.loop import train_together

    with contextlib.ExitStack() as stack:
        for member in group:
            stack.enter_context(member.folder.locked(new=True))
        _reopen(group, source, devices, warn)
        train_together(
            [member.experiment for member in group],
            [member.folder for member in group],
            lambda number, rows: on_generation(group[number], rows),
        )


def _reopen(
    group: Sequence[Member], source: Path, devices: int, warn: Callable[[str], object]
) -> None:
    """Make the run folders, or put those that are there in order."""
    for member in group:
        if not member.folder.config.is_file():
            begin_run(member.folder, member.config, member.experiment, devices, source)
            continue
        member.folder.require()
        if not member.finished:
            run = member.folder, member.config, member.experiment
            for words in reopen_run(*run, devices, source=source):
                warn(words)


def summarise(folder: Path, members: Sequence[Member]) -> Summary:
    """Write the tables and the figure of what there is.

    Raises:
        RunFolderError: nothing has been evolved yet, or the folder cannot be written.
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
        # Every run's row has the time that all of them took.
        seconds = sum(row["seconds"] for row in checkpoint.history) / runs
        for run, champion in enumerate(checkpoint.champions):
            found = {} if champion is None else champion.terms
            row = {"setting": name, "run": run, "seed": experiment.seed + run}
            row |= {key: _told(member.setting.values.get(key)) for key in keys}
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
    return Summary(spreads, comparisons, picture)


def _told(value: Any) -> Any:
    """A value in a cell of a table."""
    return json.dumps(value) if isinstance(value, dict | list) else "" if value is None else value
