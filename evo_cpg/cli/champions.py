"""The champion of a run, as commands take it: opened, chosen among several, lived again."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from evo_cpg.api.load import class_folders
from evo_cpg.cli.building import build
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.progress import working
from evo_cpg.config.load import load_config
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.devices import use_cores
from evo_cpg.training.experiment import Experiment
from evo_cpg.training.run_folder import RunFolder, RunFolderError

if TYPE_CHECKING:
    from evo_cpg.api.record import Record

# The replayed fitness and terms must agree with those recorded to this relative accuracy. On the
# machine of the training run they are equal; another processor rounds differently.
REPLAY_TOLERANCE = 1e-3


def open_run(run: Path) -> tuple[RunFolder, ExperimentConfig, Experiment]:
    """A run folder with its configuration, built.

    Raises:
        RunFolderError: there is no run.
        ConfigError: its configuration is wrong.
    """
    folder = RunFolder(run)
    folder.require()
    config = load_config(folder.config)
    return folder, config, build(config, folder.config, class_folders(folder))


def open_champion(
    run: Path, number: int | None = None, cell: str | None = None
) -> tuple[Experiment, Champion, Any, RunFolder]:
    """The champion of a run, with its motion in its first trial where the folder has that.

    Args:
        run: the run folder.
        number: whose champion, where the folder holds several runs; None for the best.
        cell: of the run's map, whose elite is wanted instead, as ``3,0,7``; None for the champion.
    """
    use_cores_of(run)
    folder, _, experiment = open_run(run)
    champion, recording, digests = folder.load_champion()
    if cell is not None:
        of_run = champion.run if number is None else number
        champion, recording = _elite_of(folder, experiment, cell, of_run), None
    elif number is not None and number != champion.run:
        champion, recording = champion_of(folder, number), None
    wrong = experiment.simulation.genome.misfit(champion.genes)
    if wrong:
        raise RunFolderError(f"{folder.config} was changed after training: {wrong}")
    if digests["config_sha256"] != folder.config_digest():
        recording = None
    return experiment, champion, recording, folder


def champion_motion(
    run: Path, number: int | None = None, trial: int = 0, cell: str | None = None
) -> tuple[Experiment, Champion, Any, RunFolder]:
    """The champion of a run with its motion, which is replayed where it was not recorded.

    Args:
        run: the run folder.
        number: whose champion, where the folder holds several runs; None for the best.
        trial: in which of its trials, from 0.
        cell: see `open_champion`.
    """
    experiment, champion, recording, folder = open_champion(run, number, cell)
    require_trial(experiment, folder, trial)
    # The folder keeps the motion in the first.
    if recording is None or trial > 0:
        devices = folder.read_meta().get("devices", 1)
        _, _, recording = live_again(experiment, champion, devices, trial)
    return experiment, champion, recording, folder


def champion_record(
    run: Path, number: int | None = None, trial: int = 0, cell: str | None = None
) -> "Record":
    """All that can be told of the champion's trial, lived again; see `champion_motion`."""
    experiment, champion, _, folder = open_champion(run, number, cell)
    require_trial(experiment, folder, trial)
    from evo_cpg.api.record import as_record, lives_again

    with working("replaying the champion"):
        ((_, frames, motion),) = lives_again(experiment, [champion], folder, trial, full=True)
    return as_record(experiment.simulation, frames, motion)


def require_trial(experiment: Experiment, folder: RunFolder, trial: int) -> None:
    """Check that an individual has a trial of that number, from 0.

    Raises:
        UsageError: it has not.
    """
    if trial >= experiment.trials:
        raise UsageError(
            f"--trial: an individual of {folder.path} has {experiment.trials} trial(s), counted "
            "from 0"
        )


def champion_of(folder: RunFolder, number: int) -> Champion:
    """The champion of one of several runs, as the newest checkpoint knows it."""
    checkpoint = folder.load()
    champions = checkpoint.champions if checkpoint else ()
    if number >= len(champions):
        raise UsageError(f"--run: {folder.path} holds {len(champions)} run(s), counted from 0")
    champion = champions[number]
    if champion is None:
        raise UsageError(f"--run: every individual of run {number} diverged: it has no champion")
    return champion


def use_cores_of(run: Path, cores: int | None = None) -> int:
    """As many cores as the run was trained on, unless told otherwise.

    Before it is built: finding a place to stand on uneven ground starts JAX.
    """
    meta = RunFolder(run).read_meta()
    # Of several processes those of one say nothing.
    noted = meta.get("devices") if meta.get("processes", 1) == 1 else None
    return use_cores(cores or noted)


def live_again(experiment: Experiment, champion: Champion, devices: int, trial: int = 0) -> Any:
    """The champion's fitness, terms and motion, lived again; says so where it takes long."""
    # Importing the loop starts nothing, but it takes JAX a second.
    from evo_cpg.training.replay import replay_champion

    with working("replaying the champion"):
        return replay_champion(experiment, champion, devices, trial)


def _elite_of(folder: RunFolder, experiment: Experiment, cell: str, number: int) -> Champion:
    """The elite of a cell, as the newest checkpoint knows it."""
    from evo_cpg.training.elites import elite

    try:
        place = tuple(int(part) for part in cell.split(","))
    except ValueError:
        raise UsageError(
            f"--cell: {cell!r} is not a list of whole numbers, such as 3,0,7"
        ) from None
    champion_of(folder, number)
    checkpoint = folder.load()
    assert checkpoint is not None
    return elite(experiment, checkpoint, place, number)
