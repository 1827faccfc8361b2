"""Configurations and runs as the operations open them, with warnings and progress for the user."""

import contextlib
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evo_cpg.api.machine import machine_changes, machine_fingerprint
from evo_cpg.api.progress import working
from evo_cpg.errors import UsageError, advise
from evo_cpg.io.build import build_experiment
from evo_cpg.io.lint import lint
from evo_cpg.io.load import load_config
from evo_cpg.io.run import Run, open_run
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.trust import trusting
from evo_cpg.simulation.recording import Recording
from evo_cpg.training import devices
from evo_cpg.training.checkpoint import Champion, genes_digest, outcome_digest
from evo_cpg.training.evaluate import Replay
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.training.run_folder import RunFolder

# The replayed fitness and terms must agree with the recorded values to this tolerance. They are
# equal on the machine of the training run. Another processor rounds differently.
REPLAY_TOLERANCE = 1e-3


def read_config(
    path: Path, overrides: Sequence[str] = (), strict: bool = False
) -> ExperimentConfig:
    """Read a configuration, and warn of unlikely values, or refuse them if `strict`.

    Raises:
        ConfigError: the configuration is wrong.
        UsageError: a value is unlikely, and `strict` is set.
    """
    config = load_config(path, overrides)
    found = [f"{path}: {warning}" for warning in lint(config, path)]
    if found and strict:
        raise UsageError("\n".join(found))
    for line in found:
        advise(line)
    return config


def build(config: ExperimentConfig, source: Path, folders: Iterable[Path] = ()) -> ExperimentParts:
    """Build an experiment, with a progress line if the build takes long.

    Raises:
        ConfigError: parts of the configuration do not fit together.
    """
    what = f"building {config.name}"
    if config.simulation.start_pose == "settled":
        what = f"{what}: letting the creature settle"
    with working(what):
        return build_experiment(config, source, folders)


def open_and_build(run: Path | str, cores: int | None = None) -> Run:
    """Open a run and build its experiment, on as many cores as trained the run by default.

    Raises:
        RunFolderError: there is no run.
        ConfigError: the configuration of the run is wrong.
    """
    # The number of cores is set first: finding a place to stand on uneven ground starts JAX.
    devices.use_cores(cores or RunFolder(run).read_meta().get("devices"))
    return open_run(run, build)


def open_champion(
    run: Path | str,
    number: int | None = None,
    trial: int = 0,
    cell: str | None = None,
    cores: int | None = None,
) -> Run:
    """Open a run with a champion or elite.

    Args:
        run: run folder.
        number: number of one of several runs side by side, or None for the best.
        trial: number of the trial, from 0, which must exist.
        cell: cell of the run's map, such as ``3,0,7``, or None for the champion.
        cores: number of cores, or None for those that trained the run.

    Raises:
        RunFolderError: there is no run, or it has no champion.
        UsageError: the run has no such trial, champion or cell.
    """
    opened = open_and_build(run, cores)
    found = opened.with_champion()
    own = found.champion.run if number is None else number
    if cell is not None:
        # This import takes a second, because it imports JAX.
        from evo_cpg.io.run import elite

        try:
            place = tuple(int(part) for part in cell.split(","))
        except ValueError:
            raise UsageError(
                f"cell: {cell!r} is not a list of whole numbers, such as 3,0,7"
            ) from None
        champion_of(opened.folder, own)
        checkpoint = opened.folder.load()
        assert checkpoint is not None
        found = opened.with_champion(elite(opened.experiment, checkpoint, place, own))
    elif own != found.champion.run:
        found = opened.with_champion(champion_of(opened.folder, own))
    trials = opened.experiment.trials
    if not 0 <= trial < trials:
        raise UsageError(f"trial {trial}: {run} has {trials} trial(s) per individual, from 0")
    return found


def require_generation(opened: Run, word: str, generation: int) -> None:
    """Check that a generation of a run can be shown.

    Args:
        opened: the run.
        word: first word of the message.
        generation: number of the generation. The one that is evaluated next counts, too.

    Raises:
        UsageError: the run has no such generation.
        RunFolderError: the run's configuration does not describe it.
    """
    done = opened.folder.newest
    if generation > done:
        raise UsageError(
            f"{word}: {opened.folder.path} has {done} generations. The next one is {done}"
        )
    opened.require_configured()


def champion_of(folder: RunFolder, number: int) -> Champion:
    """Return the champion of one of several runs, from the newest checkpoint.

    Raises:
        UsageError: there is no such run, or it has no champion.
    """
    checkpoint = folder.load()
    champions = checkpoint.champions if checkpoint else ()
    if not 0 <= number < len(champions):
        raise UsageError(f"run {number}: {folder.path} has {len(champions)} run(s), from 0")
    champion = champions[number]
    if champion is None:
        raise UsageError(f"run {number} has no champion: every individual diverged")
    return champion


def replayed(opened: Run, champion: Champion, trial: int = 0) -> Replay:
    """Replay a champion."""
    with working("replaying the champion"):
        (found,) = opened.replay([champion], trial)
    return found


def motion_of(opened: Run, trial: int = 0) -> Recording:
    """Return the motion of a champion's trial, which is replayed if the folder lacks it."""
    # The folder keeps only the motion of the first trial.
    if opened.recording is None or trial > 0:
        return replayed(opened, opened.champion, trial).recording
    return opened.recording


def suffix(number: int | None = None, trial: int = 0, cell: str | None = None) -> str:
    """Return the suffix for names of files about an individual, such as ``_run1_trial2``."""
    return (
        ("" if cell is None else f"_cell_{cell.replace(',', '_')}")
        + ("" if number is None else f"_run{number}")
        + (f"_trial{trial}" if trial else "")
    )


@contextlib.contextmanager
def writing(run: Path, output: Path | None = None) -> Iterator[None]:
    """Lock a run folder against other processes, unless the output goes elsewhere.

    Raises:
        LockedError: another process writes to the folder.
        OutputError: the folder is read-only.
    """
    folder = RunFolder(run)
    elsewhere = output is not None and not Path(os.path.abspath(output)).is_relative_to(
        os.path.abspath(run)
    )
    # The operation itself reports a missing run, after errors in its arguments.
    locks = not elsewhere and folder.config.is_file()
    with folder.locked() if locks else contextlib.nullcontext():
        yield


class Verification(NamedTuple):
    """Result of `verify`.

    Attributes:
        fitness: recorded fitness of the champion.
        differences: a sentence for each difference between the record and the replay.
        machine: a sentence for each difference of the machine, which may change the last digits.
        exact: whether the replay is equal to the last bit.
        tolerance: relative and absolute tolerance of the comparison.
    """

    fitness: float
    differences: list[str]
    machine: list[str]
    exact: bool
    tolerance: float = REPLAY_TOLERANCE


def verify(run: Path | str, cores: int | None = None, trust: bool = False) -> Verification:
    """Check that a run's champion is unchanged, and that it replays as recorded.

    Args:
        run: run folder.
        cores: number of cores, or None for those that trained the run.
        trust: whether to trust the configuration, see `load`.

    Raises:
        RunFolderError: there is no run, or it has no champion.
        ConfigError: the configuration of the run is wrong.
    """
    with trusting(trust):
        opened = open_and_build(run, cores)
    opened.require_configured()
    folder, experiment = opened.folder, opened.experiment
    champion, _, digests = folder.load_champion()
    checkpoint = folder.load()
    kept = checkpoint.champion if checkpoint else None
    if kept and kept.generation != champion.generation:
        kept = None
    wrong = (
        ("the genome differs from the evolved genome", genes_digest(champion.genes)
         != digests["genes_sha256"]),
        ("fitness or terms differ from the recorded values", outcome_digest(champion)
         != digests["outcome_sha256"]),
        ("the genome differs from the newest checkpoint",
         kept and not np.array_equal(kept.genes, champion.genes)),
        ("fitness or terms differ from the newest checkpoint",
         kept and outcome_digest(kept) != outcome_digest(champion)),
    )  # fmt: skip
    differences = [f"champion.npz: {words}" for words, differs in wrong if differs]
    differences += [opened.changed] if opened.changed else []
    misfit = experiment.simulation.genome.misfit(champion.genes)
    if misfit:
        return Verification(champion.fitness, [*differences, misfit], [], False)
    replay = replayed(opened, champion)
    recorded = {"fitness": champion.fitness, **champion.terms}
    found = {"fitness": replay.fitness, **replay.terms}
    for name, value in recorded.items():
        now = found.get(name)
        if now is None:
            differences.append(f"{name}: recorded {value:.6g}, but missing in the replay")
        elif not np.isclose(now, value, REPLAY_TOLERANCE, REPLAY_TOLERANCE, equal_nan=True):
            differences.append(f"{name}: recorded {value:.6g}, replayed {now:.6g}")
    here = machine_fingerprint(experiment.simulation.engine, opened.devices)
    exact = not differences and all(
        np.array_equal(found[name], recorded[name], True) for name in recorded
    )
    machine = machine_changes(folder.read_meta(), here)
    return Verification(champion.fitness, differences, machine, exact)
