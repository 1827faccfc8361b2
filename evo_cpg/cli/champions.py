"""Open a run and choose one of its champions or elites by the options of a command."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from evo_cpg.api.display import working
from evo_cpg.cli.building import build
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.options import BEST, Which
from evo_cpg.io.run import Run, open_run
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.devices import use_cores
from evo_cpg.training.evaluate import Replay
from evo_cpg.training.run_folder import RunFolder

if TYPE_CHECKING:
    from evo_cpg.api.record import Record

# The replayed fitness and terms must agree with the recorded values to this tolerance. They are
# equal on the machine of the training run. Another processor rounds differently.
REPLAY_TOLERANCE = 1e-3


def open_and_build(run: Path) -> Run:
    """Open a run and build its experiment, with a progress line if the build takes long."""
    return open_run(run, build)


def open_champion(run: Path, which: Which = BEST) -> Run:
    """Open a run with a champion or elite.

    Raises:
        UsageError: the run has no such trial, champion or cell.
    """
    use_cores_of(run)
    opened = open_and_build(run)
    found = opened.with_champion()
    own = found.champion.run if which.number is None else which.number
    if which.cell is not None:
        found = opened.with_champion(_elite_of(opened, which.cell, own))
    elif own != found.champion.run:
        found = opened.with_champion(champion_of(opened.folder, own))
    trials = opened.experiment.trials
    if which.trial >= trials:
        raise UsageError(f"--trial: {run} has {trials} trial(s) per individual, counted from 0")
    return found


def champion_motion(run: Path, which: Which = BEST) -> tuple[Run, Any]:
    """Open a run with a champion and the motion of a trial, which is replayed if not recorded."""
    opened = open_champion(run, which)
    # The folder keeps only the motion of the first trial.
    if opened.recording is None or which.trial > 0:
        return opened, replayed(opened, opened.champion, which.trial).recording
    return opened, opened.recording


def champion_record(run: Path, which: Which = BEST) -> "Record":
    """Replay a champion's trial and return its full record."""
    opened = open_champion(run, which)
    from evo_cpg.api.record import as_record

    with working("replaying the champion"):
        (replay,) = opened.replay([opened.champion], which.trial, full=True)
    return as_record(opened.experiment.simulation, replay.frames, replay.recording)


def champion_of(folder: RunFolder, number: int) -> Champion:
    """Return the champion of one of several runs, from the newest checkpoint."""
    checkpoint = folder.load()
    champions = checkpoint.champions if checkpoint else ()
    if number >= len(champions):
        raise UsageError(f"--run: {folder.path} has {len(champions)} run(s), counted from 0")
    champion = champions[number]
    if champion is None:
        raise UsageError(f"--run: run {number} has no champion: every individual diverged")
    return champion


def use_cores_of(run: Path, cores: int | None = None) -> int:
    """Set the number of cores (default: those that trained the run), and return the number.

    Call this before the run is built: finding a place to stand on uneven ground starts JAX.
    """
    return use_cores(cores or RunFolder(run).read_meta().get("devices"))


def replayed(opened: Run, champion: Champion, trial: int = 0) -> Replay:
    """Replay a champion, with a progress line."""
    with working("replaying the champion"):
        (replay,) = opened.replay([champion], trial)
    return replay


def _elite_of(opened: Run, cell: str, number: int) -> Champion:
    """Return the elite of a cell, from the newest checkpoint."""
    from evo_cpg.io.run import elite

    try:
        place = tuple(int(part) for part in cell.split(","))
    except ValueError:
        raise UsageError(
            f"--cell: {cell!r} is not a list of whole numbers, such as 3,0,7"
        ) from None
    champion_of(opened.folder, number)
    checkpoint = opened.folder.load()
    assert checkpoint is not None
    return elite(opened.experiment, checkpoint, place, number)
