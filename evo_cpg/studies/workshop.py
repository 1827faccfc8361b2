"""Make a study: evolve its runs, and write the tables and pictures of its parts.

    runs/NAME/         run folder for each of the study's runs
    runs/KEY.json      measurements of finished runs
    runs/PART.npz      map of bodies of a part
    PART.md            tables
    PART*.png          pictures
    provenance.json    provenance of each part

The work may be interrupted at any moment. Finished runs are reused, and an interrupted run
continues to bitwise equal results.
"""

import contextlib
import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from evo_cpg.api.machine import machine_fingerprint, program_commit
from evo_cpg.api.progress import Work, working
from evo_cpg.api.run_start import now
from evo_cpg.api.sweep import Member, evolve
from evo_cpg.creature.creature import length_of
from evo_cpg.files import make_folder, read_json, write_text
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import dump_config, load_config
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.settings import Setting
from evo_cpg.io.shipped import shipped
from evo_cpg.native.engine import Engine
from evo_cpg.simulation.recording import Recording
from evo_cpg.studies import provenance
from evo_cpg.studies.study import Part, Study, Table
from evo_cpg.system import version_of
from evo_cpg.training.checkpoint import Champion, Checkpoint, genes_digest
from evo_cpg.training.run_folder import RunFolder, RunFolderError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Number of runs and generations, and duration of a trial (s), with --quick. Terms of the last
# second need a trial of at least one second.
_QUICK_RUNS, _QUICK_GENERATIONS, _QUICK_SECONDS = 2, 2, 1
# The population allows five islands of four individuals.
_QUICK_POPULATION, _QUICK_ELITES = 20, 2


class Workshop:
    """Maker of the parts of a study.

    Args:
        study: study to make.
        folder: folder for tables, pictures and runs.
        quick: scale all runs down, as a test.
        devices: number of devices that share the populations.

    Attributes:
        work: progress display of the current part.
    """

    work: Work

    def __init__(self, study: Study, folder: Path, quick: bool, devices: int):
        self.study, self.folder, self.quick, self.devices = study, folder, quick, devices
        self._members: dict[str, Member] = {}
        self._loaded: dict[str, Checkpoint] = {}
        self._pictures: list[Path] = []
        self._part = ""

    def claim(self) -> None:
        """Check that the folder does not mix quick and full results, and make the folder of runs.

        Raises:
            OutputError: the folder cannot be made.
            RunFolderError: the folder holds quick results and full ones are requested, or the
                reverse.
        """
        other = [
            name
            for name, record in provenance.read(self.folder).items()
            if bool(record.get("quick")) != self.quick
        ]
        if other:
            kind = "full" if self.quick else "quick"
            raise RunFolderError(
                f"{self.folder} holds {kind} results of part {other[0]!r}. Choose another --out"
            )
        make_folder(self.folder / "runs")

    def forget(self, part: str) -> None:
        """Delete the runs and the map of a part, to make them again."""
        self.map_file(part).unlink(missing_ok=True)
        for name in self.study.parts[part].runs:
            self._members.pop(name, None)
            self._loaded.pop(name, None)
            shutil.rmtree(self._run(name).path, ignore_errors=True)

    def map_file(self, part: str) -> Path:
        """Return the path of the map of bodies that a part makes, if it does."""
        return self.folder / "runs" / f"{part}.npz"

    def make(self, part: str) -> list[Path]:
        """Make a part: evolve its unfinished runs, and write its files.

        Returns:
            Paths of the page of tables and of the pictures.

        Raises:
            RunFolderError: a run was made with another configuration, or all its individuals
                diverged.
        """
        began = time.perf_counter()
        declared = self.study.parts[part]
        self._evolve(part, declared)
        self._pictures, self._part = [], part
        with working(f"{self.study.name} {part}: tables and pictures") as self.work:
            tables = declared.report(self)
        seconds = time.perf_counter() - began
        experiments = [self.member(name).experiment for name in declared.runs]
        engine = experiments[0].simulation.engine if experiments else Engine()
        folders = {name: self._run(name) for name in declared.runs}
        commits = [each for run in folders.values() for each in run.read_meta().get("commits", [])]
        # Every row has the duration of all runs side by side.
        trained = sum(float(self.column(name, "seconds")[:, 0].sum()) for name in declared.runs)
        record: dict[str, Any] = {
            "study": self.study.name,
            "quick": self.quick,
            "commit": program_commit(),
            "run_commits": list(dict.fromkeys(commits)),
            "date": now(),
            "seconds": round(seconds, 1),
            "training_seconds": round(trained, 1),
            "runs": {
                name: {
                    "config": self.study.runs[name].config,
                    "overrides": self.study.runs[name].overrides,
                    "config_sha256": run.config_digest(),
                    "seeds": [experiment.seed + i for i in range(experiment.runs)],
                    "generations": self.checkpoint(name).generation,
                }
                for (name, run), experiment in zip(folders.items(), experiments, strict=True)
            },
        } | machine_fingerprint(engine, self.devices)
        line = provenance.caption(self.study.name, part, record)
        text = "\n".join(f"{markdown(table)}\n\n{line}\n" for table in tables)
        page = self.folder / f"{part}.md"
        write_text(page, text)
        files = [page, *self._pictures]
        record["files"] = {path.name: provenance.digest(path) for path in files}
        provenance.note(self.folder, part, record)
        return files

    def member(self, name: str) -> Member:
        """Build a run from its declaration, once, and return it."""
        if name not in self._members:
            source = shipped(self.study.runs[name].config).path
            config = configuration(self.study, name, self.quick)
            experiment = build_experiment(config, source)
            self._members[name] = Member(
                self._run(name), config, experiment, Setting(name, {}), source
            )
        return self._members[name]

    def checkpoint(self, name: str) -> Checkpoint:
        """Return the last checkpoint of a run.

        Raises:
            RunFolderError: the run has no finished generation.
        """
        if name not in self._loaded:
            found = self._run(name).load()
            if found is None:
                raise RunFolderError(f"{self._run(name).path} has no finished generation")
            self._loaded[name] = found
        return self._loaded[name]

    def champions(self, name: str) -> list[Champion]:
        """Return the champions of all runs that have a champion."""
        return [champion for champion in self.checkpoint(name).champions if champion is not None]

    def column(self, name: str, column: str) -> Float[np.ndarray, "generations runs"]:
        """Return a column of metrics.csv, for all generations and runs."""
        found = self.checkpoint(name)
        values = np.array([row[column] for row in found.history], float)
        return values.reshape(found.generation, len(found.champions))

    def recordings(self, name: str) -> Iterator[tuple[Champion, Recording]]:
        """Replay the champions, and yield each with its recording."""
        from evo_cpg.training.evaluate import compile_replay

        live = compile_replay(self.member(name).experiment, self.devices)
        for champion in self.champions(name):
            yield champion, live(champion).recording

    def picture(self, name: str = "") -> Path:
        """Return the path of a picture of the current part, and note it for the provenance."""
        path = self.folder / f"{self._part}{f'_{name}' if name else ''}.png"
        self._pictures.append(path)
        return path

    def draw(self, figure: "Figure", name: str = "") -> None:
        """Save a figure of the current part."""
        from evo_cpg.view.figure import save_figure

        save_figure(figure, self.picture(name))

    def kept(self, key: str, names: Sequence[str], measure: Callable[[], Any]) -> Any:
        """Measure champions of runs once, keep the result as JSON, and return it.

        A program with uncommitted changes always measures again, because its next change would have
        the same name.

        Args:
            key: name of the file.
            names: names of the runs. A change of their champions causes a new measurement.
            measure: function that returns the measurements.
        """
        genes = "".join(genes_digest(each.genes) for name in names for each in self.champions(name))
        program = program_commit() or version_of("evo-cpg")
        made_of = hashlib.sha256(f"{program} {genes}".encode()).hexdigest()
        path = self.folder / "runs" / f"{key}.json"
        with contextlib.suppress(KeyError, OSError, ValueError):
            known = read_json(path, dict[str, Any])
            if known["of"] == made_of and not program.endswith("-dirty"):
                return known["found"]
        record = json.loads(json.dumps(measure()))
        text = json.dumps({"of": made_of, "found": record})
        write_text(path, text)
        return record

    def _run(self, name: str) -> RunFolder:
        return RunFolder(self.folder / "runs" / name)

    def _evolve(self, part: str, declared: Part) -> None:
        """Evolve the runs of a part.

        Raises:
            RunFolderError: an existing run was evolved with another configuration.
        """
        members = [self.member(name) for name in declared.runs]
        for member in members:
            folder, config = member.folder, dump_config(member.config)
            if not folder.config.is_file() or folder.config.read_text("utf-8") == config:
                continue
            # Only the audit limits that disqualify affect evolution.
            evolving = []
            for each in (load_config(folder.config), member.config):
                limits = each.audit.limits().of_length(length_of(each.creature.build()))
                rules = {rule: float(getattr(limits, rule)) for rule in each.audit.disqualify}
                evolving.append((each.model_dump(mode="json", exclude={"audit"}), rules))
            if evolving[0] != evolving[1]:
                raise RunFolderError(
                    f"{folder.path} was made with another configuration. Choose another --out, or "
                    "--fresh to delete and repeat it"
                )
        here = program_commit()

        def note_program(member: Member) -> None:
            commits = member.folder.read_meta().get("commits", [])
            if here not in commits:
                member.folder.update_meta(commits=[*commits, here])

        if members:
            evolve(members, f"{self.study.name} {part}", note_program)


def configuration(study: Study, name: str, quick: bool = False) -> ExperimentConfig:
    """Return the configuration of a study's run, scaled down if `quick`."""
    declared = study.runs[name]
    source = shipped(declared.config).path
    overrides = [*declared.overrides, f"runs={declared.count}"]
    if quick:
        full = load_config(source, overrides)
        evolution, settling = full.evolution.model_dump(), getattr(full.task, "settle_seconds", 0)
        overrides += [
            f"runs={min(declared.count, _QUICK_RUNS)}",
            f"simulation.seconds={_QUICK_SECONDS}",
            f"evolution.generations={_QUICK_GENERATIONS}",
        ]
        if settling:
            fraction = settling / full.simulation.seconds
            overrides.append(f"task.settle_seconds={fraction * _QUICK_SECONDS}")
        if evolution["population"] > _QUICK_POPULATION:
            overrides.append(f"evolution.population={_QUICK_POPULATION}")
            if "elites" in evolution:
                overrides.append(f"evolution.elites={min(evolution['elites'], _QUICK_ELITES)}")
    return load_config(source, overrides).model_copy(update={"name": name})


def markdown(table: Table) -> str:
    """Return a table in Markdown."""
    lines = [table.head, ["---"] * len(table.head), *table.rows] if table.rows else []
    body = "\n".join("| " + " | ".join(map(str, row)) + " |" for row in lines)
    return f"{table.title}\n\n{body}" if table.title else body
