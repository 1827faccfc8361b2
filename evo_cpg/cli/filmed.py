"""The animals of a film, for the command `render`."""

import math
from collections.abc import Sequence
from pathlib import Path

from evo_cpg.analysis.gait_numbers import gait_numbers
from evo_cpg.api.record import Life, lives_again
from evo_cpg.cli.champions import (
    REPLAY_TOLERANCE,
    champion_motion,
    open_champion,
    require_trial,
)
from evo_cpg.cli.errors import UsageError, warn
from evo_cpg.cli.progress import working
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.experiment import Experiment
from evo_cpg.training.lineage import champion_at, representatives
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from evo_cpg.view.scene import Panel, panel_of
from evo_cpg.view.signals import Signals, signals_of
from evo_cpg.view.units import terms_text

# Champions of a lineage that are shown if no generations are given.
_SHOWN = 4


def champion_panel(
    run: Path, number: int | None, trial: int, cell: str | None, signals: bool
) -> Panel:
    """The champion of a run, or the elite of a cell."""
    strip = None
    if signals:
        experiment, champion, _, folder = open_champion(run, number, cell)
        require_trial(experiment, folder, trial)
        (life,) = _replayed(experiment, [champion], folder, trial)
        recording, strip = life.recording, _signals(experiment, life)
    else:
        experiment, champion, recording, _ = champion_motion(run, number, trial, cell)
    if cell is None:
        return panel_of(experiment, recording, experiment.name, strip)
    # Of an elite the map keeps what it is told apart by, and nothing else.
    title = f"{experiment.name}, cell {cell}"
    return panel_of(experiment, recording, title, strip, terms_text(champion.terms))


def lineage_panels(
    run: Path, wanted: list[int] | None, number: int | None, trial: int, signals: bool
) -> list[Panel]:
    """Those who were champion on the way, each with its generation and fitness."""
    experiment, champion, _, folder = open_champion(run, number)
    require_trial(experiment, folder, trial)
    chosen, panels = _chosen(folder, champion, wanted), []
    for one in chosen:
        wrong = experiment.simulation.genome.misfit(one.genes)
        if wrong:
            raise RunFolderError(f"{folder.lineage}: generation {one.generation}: {wrong}")
    for one, life in zip(chosen, _replayed(experiment, chosen, folder, trial), strict=True):
        if not math.isclose(
            life.fitness, one.fitness, rel_tol=REPLAY_TOLERANCE, abs_tol=REPLAY_TOLERANCE
        ):
            warn(
                f"{run}: the champion of generation {one.generation} comes to "
                f"{life.fitness:.4f} and not to {one.fitness:.4f} as recorded: {folder.config} or "
                "the machine is another one than it evolved with"
            )
        title = f"generation {one.generation}: fitness {one.fitness:.3g}"
        if one.expected is not None:
            title = f"champion: fitness {one.expected:.3g} in fresh draws"
        shown = _signals(experiment, life) if signals else None
        panels.append(panel_of(experiment, life.recording, title, shown))
    return panels


def _chosen(folder: RunFolder, champion: Champion, wanted: list[int] | None) -> list[Champion]:
    """Champions of a run, in the order of generations, nobody twice.

    Args:
        folder: of the run.
        champion: in the end.
        wanted: generations; None for some that tell how it came to the champion.
    """
    run = champion.run
    lineage = [each for each in folder.load_lineage() if each.run == run]
    if not lineage:
        raise RunFolderError(f"{folder.lineage} knows no champion of run {run}")
    if wanted is None:
        if champion.expected is None:
            return representatives(lineage, _SHOWN)
        # Who had the best score on the way need not be who was chosen in the end.
        places = (champion.generation, champion.index)
        others = [each for each in lineage if (each.generation, each.index) != places]
        return [*representatives(others, _SHOWN - 1), champion]
    done = folder.newest
    found: list[Champion] = []
    for generation in sorted(set(wanted)):
        one = champion_at(lineage, generation)
        if generation >= max(done, lineage[-1].generation + 1):
            raise UsageError(
                f"--lineage: {folder.path} has done {done} generations; {done - 1} is the last"
            )
        if one is None:
            raise UsageError(
                f"--lineage: the first champion that {folder.path} knows is that of generation "
                f"{lineage[0].generation}"
            )
        if all(one is not other for other in found):
            found.append(one)
    return found


def _replayed(
    experiment: Experiment, champions: Sequence[Champion], folder: RunFolder, trial: int
) -> list[Life]:
    with working("replaying the champion"):
        return lives_again(experiment, champions, folder, trial)


def _signals(experiment: Experiment, life: Life) -> Signals:
    """What the controller of an individual did, and its feet."""
    simulation = experiment.simulation
    word, _, unit = simulation.controller.signal_label.partition(" (")
    feet = gait_numbers(simulation, experiment.creature, life.frames, life.recording).feet
    names, touched = ((), None) if feet is None else (feet.names, feet.steady)
    return signals_of(life.recording, word, unit == "rad)", names, touched)
