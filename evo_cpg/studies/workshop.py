"""Where a study is made: its runs are evolved, and its parts' tables and pictures written.

    runs/NAME/         a run folder for each of the study's runs
    runs/KEY.json      what was measured of finished runs
    PART.md            tables
    PART*.png          pictures
    provenance.json    how each part was made

Everything may be stopped at any moment: runs that are finished are taken as they are, one that was
interrupted goes on to the same bits.
"""

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from evo_cpg.api.surroundings import surroundings
from evo_cpg.api.sweep import Member, groups, run_group
from evo_cpg.api.training import now
from evo_cpg.api.version import program_commit
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import dump_config, load_config
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.config.settings import Setting
from evo_cpg.config.shipped import shipped
from evo_cpg.creature.creature import length_of
from evo_cpg.files import make_folder, write_text
from evo_cpg.fusion.engine import Engine
from evo_cpg.installation import version_of
from evo_cpg.simulation.recording import Recording
from evo_cpg.studies import provenance
from evo_cpg.studies.study import Part, Study, Table
from evo_cpg.training.checkpoint import Champion, Checkpoint, genes_digest
from evo_cpg.training.experiment import Experiment
from evo_cpg.training.run_folder import RunFolder, RunFolderError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What a run is cut down to with --quick. A second of a trial, for the terms of its last second.
_QUICK_RUNS, _QUICK_GENERATIONS, _QUICK_STEPS = 2, 2, 60
# Five islands of four.
_QUICK_POPULATION, _QUICK_ELITES = 20, 2


@runtime_checkable
class Work(Protocol):
    """Making tables and pictures: what may be called to say how far it is."""

    def say(self, line: str) -> None:
        """A line that stays."""
        ...

    def doing(self, what: str) -> None:
        """From now on something else is being done."""
        ...


@runtime_checkable
class Show(Protocol):
    """Who shows how far the work is."""

    def evolving(
        self, title: str, total: int, done: int
    ) -> AbstractContextManager[Callable[[int, str, float], None]]:
        """Generations of a group of runs; what is yielded is told of each."""
        ...

    def measuring(self, title: str) -> AbstractContextManager[Work]:
        """Tables and pictures are made; what is yielded may be told of it."""
        ...


class Workshop:
    """Where the parts of a study are made.

    Args:
        study: which.
        folder: where its tables and pictures go.
        quick: scaled down, to see that everything runs.
        devices: that share the populations.

    Attributes:
        work: where a part that is being made says what it does.
    """

    work: Work

    def __init__(self, study: Study, folder: Path, quick: bool, devices: int):
        self.study, self.folder, self.quick, self.devices = study, folder, quick, devices
        self._members: dict[str, Member] = {}
        self._loaded: dict[str, Checkpoint] = {}
        self._pictures: list[Path] = []
        self._part = ""

    def claim(self) -> None:
        """Check that the folder holds nothing else.

        Raises:
            OutputError: it cannot be made.
            RunFolderError: it holds quick results where others are asked for or the other way
                round.
        """
        other = [
            name
            for name, told in provenance.read(self.folder).items()
            if bool(told.get("quick")) != self.quick
        ]
        if other:
            kind = "full" if self.quick else "quick"
            raise RunFolderError(
                f"{self.folder} holds {kind} results ({other[0]}); choose another --out"
            )
        make_folder(self.folder / "runs")

    def forget(self, part: str) -> None:
        """Throw the runs of a part away, so that they are evolved anew."""
        for name in self.study.parts[part].runs:
            self._members.pop(name, None)
            self._loaded.pop(name, None)
            shutil.rmtree(self._run(name).path, ignore_errors=True)

    def make(self, part: str, show: Show) -> list[Path]:
        """Make a part: evolve what is missing of its runs, and write its files.

        Returns:
            What was written.

        Raises:
            RunFolderError: a run was made with another configuration, or nobody of it lives.
        """
        began = time.perf_counter()
        declared = self.study.parts[part]
        self._evolve(part, declared, show)
        self._pictures, self._part = [], part
        with show.measuring(f"{self.study.name} {part}: tables and pictures") as self.work:
            tables = declared.report(self)
        return self._write(part, declared, tables, time.perf_counter() - began)

    def member(self, name: str) -> Member:
        """A run as it is declared, built."""
        if name not in self._members:
            declared = self.study.runs[name]
            source = shipped(declared.config).path
            overrides = [*declared.overrides, f"runs={declared.count}"]
            if self.quick:
                overrides += _smaller(source, overrides, declared.count)
            config = load_config(source, overrides)
            config = config.model_copy(update={"name": name})
            experiment = build_experiment(config, source)
            self._members[name] = Member(Setting(name, {}), config, experiment, self._run(name))
        return self._members[name]

    def source(self, name: str) -> Path:
        """The file that a run's configuration came from."""
        return shipped(self.study.runs[name].config).path

    def experiment(self, name: str) -> Experiment:
        """What a run evolved in."""
        return self.member(name).experiment

    def checkpoint(self, name: str) -> Checkpoint:
        """How a run ended.

        Raises:
            RunFolderError: it has not.
        """
        if name not in self._loaded:
            found = self._run(name).load()
            if found is None:
                raise RunFolderError(f"{self._run(name).path} has no finished generation")
            self._loaded[name] = found
        return self._loaded[name]

    def champions(self, name: str) -> list[Champion]:
        """Of the runs in which anybody lives."""
        return [champion for champion in self.checkpoint(name).champions if champion is not None]

    def column(self, name: str, column: str) -> Float[np.ndarray, "generations runs"]:
        """A column of metrics.csv of all runs."""
        found = self.checkpoint(name)
        values = np.array([row[column] for row in found.history], float)
        return values.reshape(found.generation, len(found.champions))

    def recordings(self, name: str) -> Iterator[tuple[Champion, Recording]]:
        """The champions, living once more."""
        from evo_cpg.training.replay import compile_replay

        live = compile_replay(self.experiment(name), self.devices)
        for champion in self.champions(name):
            yield champion, live(champion)[2]

    def picture(self, name: str = "") -> Path:
        """Where a picture of the part that is being made goes."""
        path = self.folder / f"{self._part}{f'_{name}' if name else ''}.png"
        self._pictures.append(path)
        return path

    def draw(self, figure: "Figure", name: str = "") -> None:
        """Save a figure of the part that is being made."""
        from evo_cpg.view.figure import save_figure

        save_figure(figure, self.picture(name))

    def kept(self, key: str, names: Sequence[str], measure: Callable[[], Any]) -> Any:
        """What was measured of the champions of runs; measured once, and kept as JSON.

        Of a program that was changed since its commit nothing is kept: the next change has no other
        name.

        Args:
            key: name of the file.
            names: of the runs; where their champions have changed it is measured anew.
            measure: how.
        """
        genes = "".join(genes_digest(each.genes) for name in names for each in self.champions(name))
        program = program_commit() or version_of("evo-cpg")
        made_of = hashlib.sha256(f"{program} {genes}".encode()).hexdigest()
        path = self.folder / "runs" / f"{key}.json"
        try:
            known = json.loads(path.read_text(encoding="utf-8"))
            if known["of"] == made_of and not program.endswith("-dirty"):
                return known["found"]
        except (KeyError, OSError, TypeError, ValueError):
            pass
        told = json.loads(json.dumps(measure()))
        text = json.dumps({"of": made_of, "found": told})
        write_text(path, text)
        return told

    def _run(self, name: str) -> RunFolder:
        return RunFolder(self.folder / "runs" / name)

    def _evolve(self, part: str, declared: Part, show: Show) -> None:
        members = [self.member(name) for name in declared.runs]
        for member in members:
            _require_same(member)
        found = groups([member for member in members if not member.finished])
        for number, group in enumerate(found):
            total = sum(member.experiment.generations for member in group)
            done = sum(member.generation for member in group)
            names = ", ".join(member.setting.name for member in group)
            title = f"{self.study.name} {part}, {number + 1} of {len(found)}: {names}"
            with show.evolving(title, total, done) as tell:
                watch = _Watch(tell, done)
                self._run_group(group, watch)

    def _run_group(self, group: Sequence[Member], watch: "_Watch") -> None:
        # All were built from files of one folder, which is all that is noted of the source.
        source = self.source(group[0].setting.name)
        here, noted = program_commit(), set()

        def tell(member: Member, rows: list[dict[str, float]]) -> None:
            if member.setting.name not in noted:
                noted.add(member.setting.name)
                known = member.folder.read_meta().get("commits", [])
                member.folder.update_meta(commits=list(dict.fromkeys([*known, here])))
            watch.tell(member, rows)

        run_group(group, source, self.devices, tell)

    def _write(self, part: str, declared: Part, tables: list[Table], seconds: float) -> list[Path]:
        runs = declared.runs
        engine = self.experiment(runs[0]).simulation.engine if runs else Engine()
        folders = {name: self._run(name) for name in runs}
        commits = [each for run in folders.values() for each in run.read_meta().get("commits", [])]
        told: dict[str, Any] = {
            "study": self.study.name,
            "quick": self.quick,
            "commit": program_commit(),
            "run_commits": list(dict.fromkeys(commits)),
            "date": now(),
            "seconds": round(seconds, 1),
            "training_seconds": round(sum(map(self._seconds, runs)), 1),
            "runs": {
                name: {
                    "config": self.study.runs[name].config,
                    "overrides": self.study.runs[name].overrides,
                    "config_sha256": run.config_digest(),
                    "seeds": [
                        self.experiment(name).seed + i for i in range(self.experiment(name).runs)
                    ],
                    "generations": self.checkpoint(name).generation,
                }
                for name, run in folders.items()
            },
        } | surroundings(engine, self.devices)
        line = provenance.caption(self.study.name, part, told)
        text = "\n".join(f"{markdown(table)}\n\n{line}\n" for table in tables)
        page = self.folder / f"{part}.md"
        write_text(page, text)
        files = [page, *self._pictures]
        told["files"] = {path.name: provenance.digest(path) for path in files}
        provenance.note(self.folder, part, told)
        return files

    def _seconds(self, name: str) -> float:
        """That a run took; every run's row has the time that all of them took."""
        return float(self.column(name, "seconds")[:, 0].sum())


class _Watch:
    """Tells of every generation of a group, with the time since the one before."""

    def __init__(self, tell: Callable[[int, str, float], None], done: int):
        self._tell, self._done, self._clock = tell, done, time.perf_counter()

    def tell(self, member: Member, rows: list[dict[str, float]]) -> None:
        before, self._clock = self._clock, time.perf_counter()
        best = float(np.median([row["champion"] for row in rows]))
        state = f"{member.setting.name}: median champion {best:.3f}"
        self._tell(self._done, state, self._clock - before)
        self._done += 1


def markdown(table: Table) -> str:
    """A table as it stands in a page."""
    lines = [table.head, ["---"] * len(table.head), *table.rows]
    body = "\n".join("| " + " | ".join(map(str, row)) + " |" for row in lines)
    return f"{table.title}\n\n{body}" if table.title else body


def _smaller(source: Path, overrides: Sequence[str], count: int) -> list[str]:
    """What makes a run small."""
    evolution = load_config(source, overrides).evolution.model_dump()
    small = [f"runs={min(count, _QUICK_RUNS)}", f"simulation.steps={_QUICK_STEPS}"]
    small.append(f"evolution.generations={_QUICK_GENERATIONS}")
    if evolution["population"] > _QUICK_POPULATION:
        small.append(f"evolution.population={_QUICK_POPULATION}")
        if "elites" in evolution:
            small.append(f"evolution.elites={min(evolution['elites'], _QUICK_ELITES)}")
    return small


def _require_same(member: Member) -> None:
    """Check that what there is of a run was evolved with its configuration.

    Raises:
        RunFolderError: with another one.
    """
    folder, config = member.folder, dump_config(member.config)
    if not folder.config.is_file() or folder.config.read_text("utf-8") == config:
        return
    if _what_evolves(load_config(folder.config)) != _what_evolves(member.config):
        raise RunFolderError(
            f"{folder.path} was made with another configuration; choose another --out, or --fresh "
            "to evolve it anew"
        )


def _what_evolves(config: ExperimentConfig) -> dict[str, Any]:
    """A configuration, of whose limits of an audit only those stand that are rules."""
    limits = config.audit.limits().of_length(length_of(config.creature.build()))
    rules = {name: float(getattr(limits, name)) for name in config.audit.disqualify}
    return config.model_dump(mode="json", exclude={"audit"}) | {"audit": rules}
