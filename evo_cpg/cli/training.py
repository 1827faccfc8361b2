"""Evolve a run, for the commands `train` and `resume`."""

import math
import sys
from pathlib import Path

import numpy as np

from evo_cpg.analysis.verdict import Check, shown
from evo_cpg.api.display import progress, working
from evo_cpg.api.training import (
    Recorder,
    begin_run,
    evolve,
    first_look_limit,
    reopen_run,
)
from evo_cpg.api.warm_start import What, warm_start
from evo_cpg.cli.advice import about_step, advise
from evo_cpg.cli.building import build
from evo_cpg.cli.champions import open_and_build
from evo_cpg.cli.errors import UsageError, tell, warn
from evo_cpg.cli.interrupts import wait_for_no_thread
from evo_cpg.io.load import load_config
from evo_cpg.io.run import Run
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.simulation.task import term_names
from evo_cpg.training.checkpoint import Champion, Checkpoint, genes_digest
from evo_cpg.training.experiment import TABLE_COLUMNS, ExperimentParts
from evo_cpg.training.reevaluation import is_finished
from evo_cpg.training.run_folder import RunFolder, RunFolderError


def train_run(
    source: Path,
    config: ExperimentConfig,
    run: Path,
    devices: int,
    earlier: tuple[Path, What] | None,
) -> None:
    """Start a run.

    Args:
        source: file that the configuration came from.
        config: configuration of the run.
        run: folder of the run.
        devices: number of devices.
        earlier: run folder to start from, and the genomes to take, or None for random genomes.
    """
    folder = RunFolder(run)
    experiment = build(config, source)
    opened = Run(folder, config, experiment)
    with folder.locked(new=True):
        start = None
        if earlier is not None:
            with working("reading the earlier run"):
                start = warm_start(experiment, *earlier)
        begin_run(opened, devices, source, start)
        advise(source, experiment.simulation)
        evolve_run(opened)


def resume_run(run: Path, generations: int | None, devices: int) -> None:
    """Continue a run."""
    opened = open_and_build(run)
    opened.require_configured()
    folder, config, experiment = opened.folder, opened.config, opened.experiment
    if generations is not None:
        config = load_config(folder.config, [f"evolution.generations={generations}"])
        experiment = experiment._replace(generations=generations)
        opened = Run(folder, config, experiment)
    done = _require_alike(opened)
    if _finished(folder, done, experiment):
        _say_finished(folder, experiment.generations)
        return
    for words in reopen_run(opened, devices):
        warn(words)
    evolve_run(opened)


def _require_alike(opened: Run) -> Checkpoint | None:
    """Check that a run fits its configuration, and return the newest checkpoint, if any.

    Raises:
        UsageError: more generations are done than requested.
        RunFolderError: the checkpoint does not fit the configuration.
    """
    folder, config, experiment = opened.folder, opened.config, opened.experiment
    run, done = folder.path, folder.load()
    if done is not None and done.generation > config.evolution.generations:
        raise UsageError(
            f"{run}: already has {done.generation} generations, more than "
            f"--generations {config.evolution.generations}. Give at least {done.generation}"
        )
    if done is not None:
        runs, population = experiment.runs, experiment.strategy.population
        expected = experiment.simulation.genome.count, runs * population, runs
        found = *done.genes.shape, len(done.champions)
        if expected != found:
            raise RunFolderError(
                f"{folder.config} was changed: it now has {expected[0]} genes and {expected[1]} "
                f"individuals in {expected[2]} run(s), but the checkpoint has {found[0]}, "
                f"{found[1]} and {found[2]}. Start a new run instead"
            )
        _require_same_columns(folder, done, experiment)
    return done


def _require_same_columns(folder: RunFolder, done: Checkpoint, experiment: ExperimentParts) -> None:
    """Check that the next rows of metrics.csv will have the columns of the earlier rows.

    Raises:
        RunFolderError: task, measures or strategy give other columns than before.
    """
    simulation = experiment.simulation
    measured = term_names(simulation.task) + simulation.measures.names
    terms = [f"best_{name}" for name in measured]
    expected, found = [*experiment.strategy.metric_names, *terms], done.history[-1]
    added = [name for name in expected if name not in found]
    lost = [name for name in found if name not in (*expected, *TABLE_COLUMNS)]
    if added or lost:
        parts = [("add", added), ("drop", lost)]
        changed = " and ".join(f"{verb} {', '.join(names)}" for verb, names in parts if names)
        raise RunFolderError(
            f"{folder.config} or its task was changed: metrics.csv would {changed}, but all its "
            "rows must have the same columns. Restore task, measures and evolution. Or start a new "
            f"run with `evo-cpg train {folder.config} --from {folder.path} --out ...`"
        )


def _finished(folder: RunFolder, done: Checkpoint | None, experiment: ExperimentParts) -> bool:
    """Return whether a run is finished, and none of its files was lost or changed since."""
    if done is None or not is_finished(experiment, done):
        return False
    try:
        champion, recording, digests = folder.load_champion()
    except RunFolderError:
        return False
    best = done.champion
    return (
        "finished" in folder.read_meta()
        and folder.metrics.is_file()
        and recording is not None
        and digests["config_sha256"] == folder.config_digest()
        and best is not None
        and genes_digest(champion.genes) == genes_digest(best.genes)
    )


def _say_finished(folder: RunFolder, done: int) -> None:
    print(
        f"{folder.path} is finished: all {done} generations are done, and the champion is in "
        f"{folder.champion}. To continue, give a larger total, such as "
        f"`evo-cpg resume {folder.path} --generations {2 * done}`",
        file=sys.stderr,
    )
    print(folder.path)


def evolve_run(opened: Run) -> None:
    """Evolve, show the progress, record the champion and report it."""
    experiment, folder = opened.experiment, opened.folder
    with working("starting JAX"):
        import evo_cpg.training.train  # noqa: F401

    done = folder.load()
    least, start = first_look_limit(opened.config), done.generation if done else 0
    try:
        with Recorder(experiment, folder, least) as recorder:
            with progress(
                "generations",
                experiment.generations,
                start,
                "compiling",
                "" if experiment.simulation.noise.silent else "choosing the champion",
            ) as show:

                def report(rows: list[dict[str, float]]) -> None:
                    show(_standing(rows), rows[0]["seconds"])
                    lost = all(row["diverged"] == experiment.strategy.population for row in rows)
                    if lost and rows[0]["generation"] == 0:
                        step = about_step(experiment.simulation)
                        warn(f"{folder.path}: all of generation 0 diverged. {step}".rstrip())

                champion = evolve(experiment, folder, report, recorder)
            _record(recorder, champion, folder)
    except KeyboardInterrupt:
        tell(f"interrupted. Continue with `evo-cpg resume {folder.path}`")
        raise
    terms = ", ".join(f"{name} {value:.3g}" for name, value in champion.terms.items())
    # The progress line counts generations that are done. Their numbers begin with 0.
    origin = f"generation {champion.generation} (the first is 0)"
    if experiment.runs > 1:
        origin += f" of run {champion.run}"
    fitness = f"fitness {champion.fitness:.4f}"
    if champion.expected is not None:
        fitness += f" in training, mean {champion.expected:.4f} over {champion.lives} new draws"
    tell(f"champion of {origin}: {fitness} ({terms})")
    if recorder.seen is not None:
        _say_first_look(recorder.seen, folder, not experiment.simulation.noise.silent)
    print(folder.path)


def _record(recorder: Recorder, champion: Champion, folder: RunFolder) -> None:
    """Record the champion, and test it at half the physics step unless interrupted."""
    with working("recording the champion's motion"):
        recorder.record(champion)
    if recorder.checks:
        try:
            with working("half-step test (Ctrl-C skips it)"):
                recorder.look(champion)
        except KeyboardInterrupt:
            recorder.skip()
            wait_for_no_thread()
            tell(
                "skipped: the champion was not tested at half the step. "
                f"`evo-cpg audit {folder.path}` tests it"
            )
    recorder.finish()


def _say_first_look(seen: Check, folder: RunFolder, noisy: bool) -> None:
    if seen.passed is None:
        return
    kept = f"at half the physics step it keeps {shown(seen.measured, '%')} of its displacement"
    if not seen.passed:
        causes = "the step length or the noise" if noisy else "the step length"
        kept = f"warning: {kept} ({seen.detail}). It may exploit {causes}"
    tell(f"{kept}. For a full test, run `evo-cpg audit {folder.path}`")


def _standing(rows: list[dict[str, float]]) -> str:
    """Return a progress line about the runs after a generation."""
    # A run in which every individual diverged has no best.
    best = [row["best"] for row in rows if math.isfinite(row["best"])] or [math.nan]
    if len(rows) > 1:
        fitness = f"best of {len(rows)} runs {max(best):8.4f}  median {np.median(best):8.4f}"
    else:
        fitness = f"best {best[0]:8.4f}  mean {rows[0]['mean']:8.4f}"
    diverged = sum(row["diverged"] for row in rows)
    speed = rows[0]["steps_per_second"] / 1e3
    return f"{fitness}  diverged {diverged:3d}  {speed:6.0f} k steps/s"
