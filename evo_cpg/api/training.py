"""Evolution into a run folder: start a run, or continue it."""

import dataclasses
import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from evo_cpg.analysis.verdict import Check
from evo_cpg.api.advice import about_courses, about_step
from evo_cpg.api.experiment import Experiment
from evo_cpg.api.machine import warn_of_gpu
from evo_cpg.api.progress import progress, working
from evo_cpg.api.run_start import (
    Start,
    What,
    begin_run,
    is_complete,
    now,
    reopen_run,
    require_alike,
    warm_start,
)
from evo_cpg.api.runs import open_and_build
from evo_cpg.errors import UsageError, advise
from evo_cpg.io.load import load_config
from evo_cpg.io.run import Run
from evo_cpg.io.trust import trusting
from evo_cpg.simulation.measures import DISPLACEMENT
from evo_cpg.simulation.simulation import with_displacement
from evo_cpg.training.checkpoint import Champion, genes_digest
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from evo_cpg.training.team import current_cluster, device_count

Rows = list[dict[str, float]]


@dataclasses.dataclass(frozen=True)
class Trained:
    """Result of evolution.

    Attributes:
        folder: the run folder, for `evo-cpg render` and the other commands.
        genome: genome of the champion.
        fitness: fitness of the champion.
        terms: task's terms of the champion.
        history: rows of metrics.csv.
        expected: mean fitness of the champion with fresh noise, or None without noise.
        draws: number of draws of the noise behind `expected`.
        generation: generation of the champion, from 0.
        run: number of the champion's run, from 0.
        half_step: check of the champion at half the physics step, or None without a check.
        skipped: whether Control-C skipped this check.
        was_finished: whether the run was finished before, so that nothing was evolved.
    """

    folder: Path
    genome: np.ndarray
    fitness: float
    terms: dict[str, float]
    history: Rows
    expected: float | None = None
    draws: int = 0
    generation: int = 0
    run: int = 0
    half_step: Check | None = None
    skipped: bool = False
    was_finished: bool = False

    def __repr__(self) -> str:
        terms = ", ".join(f"{name} {value:.4g}" for name, value in self.terms.items())
        expected = "" if self.expected is None else f", expected {self.expected:.4g}"
        return (
            f"Trained({str(self.folder)!r}: fitness {self.fitness:.4g}{expected} ({terms}), "
            f"{self.genome.size} genes, {len(self.history)} rows of history)"
        )


def train(
    experiment: Experiment,
    out: Path | str,
    on_generation: Callable[[Rows], object] = lambda rows: None,
    start: ArrayLike | Path | str | None = None,
    what: What = "champion",
) -> Trained:
    """Evolve an experiment into a new run folder.

    Control-C while the champion is tested at half the physics step skips this test.

    Args:
        experiment: experiment to evolve.
        out: path of a new run folder.
        on_generation: called with the new rows of metrics.csv after every generation.
        start: initial genomes instead of random ones: a population for each run, run by run,
            ``(runs x population, genes)``, or the folder of an earlier run of the same creature
            and controller.
        what: genomes to take from an earlier run: those around its ``champion``, or its whole
            ``population``.

    Raises:
        ValueError: the genomes have another shape, or are not finite.
        LockedError: another process evolves into the folder.
        RunFolderError: the folder holds a run or other files, no individual has a fitness, or the
            earlier run does not fit.
        TooLargeError: the experiment needs more memory than the machine has.
        UsageError: parts that the configuration does not name cannot go to a cluster.
    """
    if experiment.replaced and current_cluster():
        lacking = ", ".join(experiment.replaced)
        raise UsageError(f"cluster: workers build the configuration, which lacks your {lacking}")
    folder, parts = RunFolder(out), experiment.parts
    given = None
    if start is not None and not isinstance(start, str | Path):
        rows = np.asarray(start, np.float32)
        shape = parts.runs * parts.strategy.population, experiment.gene_count
        if rows.shape != shape:
            raise ValueError(
                f"start must have the shape {shape}, a row for each of {shape[0]} individuals, got "
                f"{rows.shape}"
            )
        if not np.isfinite(rows).all():
            raise ValueError("start must be finite")
        given = Start(np.ascontiguousarray(rows.T), {"what": "genomes"})
    with folder.locked(new=True):
        if isinstance(start, str | Path):
            with working("reading the earlier run"):
                given = warm_start(parts, Path(start), what)
        run = Run(folder, experiment.config, parts)
        begin_run(run, device_count(), experiment.source, given)
        if experiment.replaced:
            folder.update_meta(replaced=list(experiment.replaced))
        warn_of_gpu()
        return evolve_run(run, on_generation)


def resume(
    run: Path | str,
    generations: int | None = None,
    on_generation: Callable[[Rows], object] = lambda rows: None,
    cores: int | None = None,
    trust: bool = False,
) -> Trained:
    """Continue a run from its newest checkpoint, to bitwise equal results on the same machine.

    Args:
        run: run folder.
        generations: total number of generations, or None for that of the configuration.
        on_generation: called with the new rows of metrics.csv after every generation.
        cores: number of cores, or None for those that trained the run.
        trust: whether to trust the configuration, see `load`.

    Raises:
        LockedError: another process evolves into the folder.
        RunFolderError: there is no run, or its checkpoint does not fit its configuration.
        UsageError: the run has more generations than requested.
    """
    folder = RunFolder(run)
    with trusting(trust), folder.locked():
        opened = open_and_build(run, cores)
        opened.require_configured()
        if generations is not None:
            config = load_config(folder.config, [f"evolution.generations={generations}"])
            experiment = opened.experiment._replace(generations=generations)
            opened = Run(folder, config, experiment)
        done = require_alike(opened)
        if is_complete(opened, done):
            champion, _, _ = folder.load_champion()
            return dataclasses.replace(_trained(folder, champion), was_finished=True)
        for words in reopen_run(opened, device_count()):
            advise(words)
        return evolve_run(opened, on_generation)


def evolve_run(run: Run, on_generation: Callable[[Rows], object]) -> Trained:
    """Evolve from the folder's newest checkpoint, and record the champion.

    Raises:
        RunFolderError: no individual of any generation has a finite fitness.
    """
    folder, experiment = run.folder, run.experiment
    with working("starting JAX"):
        # Importing the loop takes a second.
        from evo_cpg.training.train import train as train_generations

    done, silent = folder.load(), experiment.simulation.silent
    size, start = experiment.strategy.population, done.generation if done else 0
    last = "" if silent else "choosing the champion"
    limit = run.config.audit.half_step if run.config.audit.after_training else None
    warned = False
    with ChampionRecorder(experiment, folder, limit) as recorder:
        with progress("generations", experiment.generations, start, last=last) as show:

            def report(rows: Rows) -> None:
                nonlocal warned
                # A run in which every individual diverged has no best.
                best = [row["best"] for row in rows if math.isfinite(row["best"])] or [math.nan]
                fitness = f"best {best[0]:8.4f}  mean {rows[0]['mean']:8.4f}"
                if len(rows) > 1:
                    middle = np.median(best)
                    fitness = f"best of {len(rows)} runs {max(best):8.4f}  median {middle:8.4f}"
                diverged = sum(row["diverged"] for row in rows)
                speed = rows[0]["steps_per_second"] / 1e3
                show(
                    f"{fitness}  diverged {diverged:3d}  {speed:6.0f} k steps/s", rows[0]["seconds"]
                )
                if not warned and all(row["diverged"] == size for row in rows):
                    warned, number = True, rows[0]["generation"]
                    why = about_courses(experiment.simulation) or about_step(experiment.simulation)
                    advise(f"{folder.path}: all of generation {number} diverged. {why}".rstrip())
                on_generation(rows)

            found = train_generations(experiment, folder, report, on_compiled=recorder.compile)
        if found.champion is None:
            alive = any(row["diverged"] < size for row in found.history)
            task = type(experiment.simulation.task).__name__
            raise RunFolderError(
                f"{folder.path}: no individual has a finite fitness, so there is no champion. "
                f"Check `fitness` and `scales` of {task}"
                if alive
                else f"{folder.path}: every individual of every generation diverged, so there is "
                "no champion. Try more substeps or weaker motors"
            )
        recorder.keep(found.champion)
    trained = _trained(folder, found.champion)
    return dataclasses.replace(trained, half_step=recorder.seen, skipped=recorder.skipped)


def _trained(folder: RunFolder, champion: Champion) -> Trained:
    checkpoint = folder.load()
    return Trained(
        folder=folder.path,
        genome=champion.genes,
        fitness=champion.fitness,
        terms=champion.terms,
        history=checkpoint.history if checkpoint else [],
        expected=champion.expected,
        draws=champion.lives,
        generation=champion.generation,
        run=champion.run,
    )


class ChampionRecorder:
    """Recorder of the champion's motion, with a first check of the champion.

    Its programs compile in a thread while the population evolves. One core is busy meanwhile, but
    the end of a long run is not delayed.

    Args:
        experiment: experiment that evolves.
        folder: run folder.
        least: smallest allowed fraction of its displacement that the champion keeps at half the
            physics step, or None for no check.

    Attributes:
        seen: result of the first check, or None without one.
        skipped: whether the check was skipped.
    """

    def __init__(self, experiment: ExperimentParts, folder: RunFolder, least: float | None = None):
        self.seen: Check | None = None
        self.skipped = False
        self._experiment, self._folder, self._least = experiment, folder, least
        # Without noise, the recording also measures the displacement at the original step.
        self._measures_displacement = least is not None and experiment.simulation.silent
        self._thread = ThreadPoolExecutor(1, "recording")
        self._program: Future[Callable] | None = None
        self._look: Future[Callable] | None = None

    def __enter__(self) -> "ChampionRecorder":
        return self

    def __exit__(self, error: type[BaseException] | None, *rest: object) -> None:
        # An interrupt ends the run at once, without waiting for the compiler.
        self._thread.shutdown(wait=error is None and not self.skipped, cancel_futures=True)

    def compile(self) -> None:
        """Start to compile the programs, one after the other."""
        from evo_cpg.training.evaluate import compile_replay

        devices = self._folder.read_meta()["devices"]
        recorded = self._experiment
        if self._measures_displacement:
            recorded = recorded._replace(simulation=with_displacement(recorded.simulation))
        self._program = self._thread.submit(compile_replay, recorded, devices)
        if self._least is not None:
            from evo_cpg.api.audit import compile_first_look

            self._look = self._thread.submit(compile_first_look, self._experiment, self._least)

    def keep(self, champion: Champion) -> None:
        """Record the champion, check it, and note that the run is finished.

        An interrupt during the check skips it, and does not wait for programs that still compile.
        """
        with working("recording the champion's motion"):
            displacement = self.record(champion)
        if self._least is not None:
            try:
                with working("half-step test (Ctrl-C skips it)"):
                    self.look(champion, displacement)
            except KeyboardInterrupt:
                self.skipped = True
                self._folder.update_meta(half_step=None)
        self._folder.update_meta(finished=now())

    def record(self, champion: Champion) -> float | None:
        """Write the champion and its motion into the run folder.

        Returns:
            Displacement of the champion (m), or None if it was not measured.
        """
        if self._program is None:
            self.compile()
        assert self._program is not None
        replay = self._program.result()(champion)
        self._folder.save_champion(champion, replay.recording)
        return (
            float(np.nan_to_num(replay.terms[DISPLACEMENT]))
            if self._measures_displacement
            else None
        )

    def look(self, champion: Champion, displacement: float | None) -> None:
        """Check a recorded champion at half the step."""
        assert self._look is not None
        self.seen = seen = self._look.result()(champion, displacement)
        noted: dict[str, Any] | None = None
        if seen.passed is not None:
            noted = {"measured": seen.measured, "least": seen.limit, "passed": seen.passed}
            noted["genes_sha256"] = genes_digest(champion.genes)
        self._folder.update_meta(half_step=noted)
