"""Evolution from Python, into a run folder that the commands can read."""

import dataclasses
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from evo_cpg.analysis.verdict import Check
from evo_cpg.api.experiment import Experiment
from evo_cpg.api.machine import machine_changes, machine_fingerprint, warn_of_gpu
from evo_cpg.api.progress import Generations, working
from evo_cpg.api.warm_start import Start
from evo_cpg.io.build import require_genes
from evo_cpg.io.fingerprint import changes, changes_of_fitness, fingerprint
from evo_cpg.io.load import dump_config
from evo_cpg.io.run import Run
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.shipped import shipped_name
from evo_cpg.simulation.measures import DISPLACEMENT
from evo_cpg.simulation.simulation import with_displacement
from evo_cpg.system import name_of, resolved
from evo_cpg.training import experiment as parts
from evo_cpg.training.checkpoint import Champion, genes_digest
from evo_cpg.training.memory import require_memory
from evo_cpg.training.run_folder import RunFolder, RunFolderError

Rows = list[dict[str, float]]


@dataclasses.dataclass(frozen=True)
class Trained:
    """Result of evolution.

    Attributes:
        folder: the run folder, for `evo-cpg render` and the other commands.
        genome: genome of the champion.
        fitness: fitness of the champion.
        expected: mean fitness of the champion with fresh noise, or None without noise.
        terms: task's terms of the champion.
        history: rows of metrics.csv.
    """

    folder: Path
    genome: np.ndarray
    fitness: float
    terms: dict[str, float]
    history: Rows
    expected: float | None = None

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
    on_generation: Callable[[Rows], None] = lambda rows: None,
    start: ArrayLike | None = None,
) -> Trained:
    """Evolve an experiment, as `evo-cpg train` does.

    Args:
        experiment: experiment to evolve.
        out: path of a new run folder.
        on_generation: called with the new rows of metrics.csv after every generation.
        start: initial genomes instead of random ones, a population for each run, run by run,
            ``(runs x population, genes)``.

    Raises:
        ValueError: the genomes have another shape, or are not finite.
        LockedError: another process evolves into the folder.
        RunFolderError: the folder holds a run or other files, or no individual has a fitness.
        TooLargeError: the experiment needs more memory than the machine has.
    """
    folder = RunFolder(out)
    given = None if start is None else Start(_genes(experiment, start), {"what": "genomes"})
    with folder.locked(new=True):
        return _train(experiment, folder, on_generation, given)


def _train(
    experiment: Experiment,
    folder: RunFolder,
    on_generation: Callable[[Rows], None],
    given: Start | None,
) -> Trained:
    import jax

    devices = len(jax.local_devices())
    run = Run(folder, experiment.config, experiment.parts)
    begin_run(run, devices, experiment.source, given)
    if experiment.replaced:
        folder.update_meta(replaced=list(experiment.replaced))
    least, seen = first_look_limit(experiment.config), Generations(experiment.parts.generations)
    compiling = ExitStack()

    def on_rows(rows: Rows) -> None:
        compiling.close()
        seen.add(max(row["champion"] for row in rows))
        on_generation(rows)

    warn_of_gpu()
    with Recorder(experiment.parts, folder, least) as recorder, compiling:
        compiling.enter_context(
            working(f"compiling the search of {experiment.name!r} (first call only)")
        )
        champion = evolve(experiment.parts, folder, on_rows, recorder)
        with working(f"recording the champion of {experiment.name!r}"):
            recorder.keep(champion)
    checkpoint = folder.load()
    history = checkpoint.history if checkpoint else []
    noted = champion.genes, champion.fitness, champion.terms
    return Trained(folder.path, *noted, history, champion.expected)


def begin_run(run: Run, devices: int, source: Path, start: Start | None = None) -> None:
    """Make a run folder, with its configuration and meta.json.

    Args:
        run: run whose folder is made.
        devices: number of devices.
        source: file of the configuration.
        start: initial genomes, or None for random ones.

    Raises:
        ConfigError: there are no genes to evolve.
        OutputError: the folder cannot be written.
        RunFolderError: the folder holds a run or other files.
        TooLargeError: the run needs more memory than the machine has.
    """
    require_genes(run.experiment, source)
    require_memory(run.experiment)
    meta = _known(run, devices, source)
    if start is not None:
        meta["start"] = start.provenance
    run.folder.create(dump_config(run.config), meta, None if start is None else start.genes)


def _known(run: Run, devices: int, source: Path) -> dict[str, Any]:
    """Return the contents of meta.json for a run that begins."""
    meta: dict[str, Any] = {
        "name": run.config.name,
        "seed": run.config.seed,
        "config": name_of(resolved(source)),
        "command": sys.argv[1:],
        "fingerprint": fingerprint(run.config),
        "started": now(),
    }
    meta |= machine_fingerprint(run.experiment.simulation.engine, devices)
    if name := shipped_name(source):
        meta["shipped_config"] = name
    return meta


def reopen_run(run: Run, devices: int, source: Path | None = None) -> list[str]:
    """Record the configuration and machine that a run continues with.

    Args:
        run: run with the configuration to continue with.
        devices: number of devices.
        source: file of the configuration, if known.

    Returns:
        A sentence about changes of the configuration, and one for each difference from the earlier
        machine.

    Raises:
        ConfigError: there are no genes to evolve.
        OutputError: the folder cannot be written.
        RunFolderError: after a change, earlier individuals would have another fitness.
        TooLargeError: the run needs more memory than the machine has.
    """
    folder = run.folder
    before = folder.read_meta()
    changed = changes(before.get("fingerprint"), fingerprint(run.config))
    changed = [each for each in changed if each != "evolution.generations"]
    spoilt = changes_of_fitness(before.get("fingerprint"), run.config) if folder.newest else []
    if spoilt:
        raise RunFolderError(
            f"{folder.path}: changed since the run was last started: {', '.join(spoilt)}. Its "
            "champion was evaluated without the change, so new individuals cannot be compared with "
            "it. Undo the change, or start a new run from this population with `evo-cpg train "
            f"{folder.config} --from {folder.path} --start population --out ...`"
        )
    require_genes(run.experiment, folder.config)
    require_memory(run.experiment)
    # Call this before writing anything: it starts JAX, which may find no device.
    here = machine_fingerprint(run.experiment.simulation.engine, devices)
    folder.reopen(dump_config(run.config))
    noted = {"resumed": now(), "fingerprint": fingerprint(run.config)} | here
    if not before and source is not None:
        # The run was killed before meta.json was written.
        noted = _known(run, devices, source)
    folder.update_meta(**noted)
    found = [f"{difference}. Bits may differ" for difference in machine_changes(before, here)]
    if changed:
        words = f"changed since the run was last started: {', '.join(changed)}"
        found.insert(0, f"{words}. The run continues with the changes")
    return [f"{folder.path}: {difference}" for difference in found]


def _genes(experiment: Experiment, start: ArrayLike) -> np.ndarray:
    """Check initial genomes and return them transposed, ``(genes, individuals)``."""
    rows, parts = np.asarray(start, np.float32), experiment.parts
    shape = parts.runs * parts.strategy.population, experiment.gene_count
    if rows.shape != shape:
        raise ValueError(
            f"start must have the shape {shape}, a row for each of {shape[0]} individuals, got "
            f"{rows.shape}"
        )
    if not np.isfinite(rows).all():
        raise ValueError("start must be finite")
    return np.ascontiguousarray(rows.T)


class Recorder:
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
        checks: whether the champion is to be checked.
        skipped: whether the check was skipped.
    """

    def __init__(
        self,
        experiment: parts.ExperimentParts,
        folder: RunFolder,
        least: float | None = None,
    ):
        self.seen: Check | None = None
        self.checks, self.skipped = least is not None, False
        self._experiment, self._folder, self._least = experiment, folder, least
        # Without noise, the recording also measures the displacement at the original step.
        self._measures_displacement = self.checks and experiment.simulation.noise.silent
        self._displacement: float | None = None
        self._thread = ThreadPoolExecutor(1, "recording")
        self._program: Future[Callable] | None = None
        self._look: Future[Callable] | None = None

    def __enter__(self) -> "Recorder":
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
        """Record the champion, check it, and finish the run."""
        self.record(champion)
        self.look(champion)
        self.finish()

    def record(self, champion: Champion) -> None:
        """Write the champion and its motion into the run folder."""
        if self._program is None:
            self.compile()
        assert self._program is not None
        replay = self._program.result()(champion)
        if self._measures_displacement:
            self._displacement = float(np.nan_to_num(replay.terms[DISPLACEMENT]))
        self._folder.save_champion(champion, replay.recording)

    def look(self, champion: Champion) -> None:
        """Check a recorded champion at half the step, if a check is configured."""
        if self._look is None:
            return
        self.seen = seen = self._look.result()(champion, self._displacement)
        noted: dict[str, Any] | None = None
        if seen.passed is not None:
            noted = {"measured": seen.measured, "least": seen.limit, "passed": seen.passed}
            noted["genes_sha256"] = genes_digest(champion.genes)
        self._folder.update_meta(half_step=noted)

    def skip(self) -> None:
        """Skip the first check, and do not wait for programs that still compile."""
        self.skipped = True
        self._folder.update_meta(half_step=None)

    def finish(self) -> None:
        """Record the time at which the run finished."""
        self._folder.update_meta(finished=now())


def first_look_limit(config: ExperimentConfig) -> float | None:
    """Return the limit of the first check of a champion, or None without a check."""
    return config.audit.half_step if config.audit.after_training else None


def evolve(
    experiment: parts.ExperimentParts,
    folder: RunFolder,
    on_generation: Callable[[Rows], None],
    recorder: Recorder,
) -> Champion:
    """Evolve from the folder's newest checkpoint.

    Args:
        experiment: experiment to evolve.
        folder: run folder.
        on_generation: called with the new rows of metrics.csv after every generation.
        recorder: recorder that compiles meanwhile.

    Raises:
        RunFolderError: no individual of any generation has a finite fitness.
    """
    # Importing the loop takes a second, because it imports JAX.
    from evo_cpg.training.train import train as train_generations

    done = train_generations(experiment, folder, on_generation, on_compiled=recorder.compile)
    if done.champion is None:
        count = experiment.strategy.population
        if any(row["diverged"] < count for row in done.history):
            task = type(experiment.simulation.task).__name__
            raise RunFolderError(
                f"{folder.path}: no individual has a finite fitness, so there is no champion. "
                f"Check `fitness` and `scales` of {task}"
            )
        raise RunFolderError(
            f"{folder.path}: every individual of every generation diverged, so there is no "
            "champion. Try more substeps or weaker motors"
        )
    return done.champion


def now() -> str:
    """Return date and time, with the zone."""
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")
