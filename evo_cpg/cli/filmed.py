"""Animals of a film, for the command `render`."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evo_cpg.analysis.gait_numbers import gait_numbers
from evo_cpg.api.display import working
from evo_cpg.cli.champions import REPLAY_TOLERANCE, champion_motion, open_champion
from evo_cpg.cli.errors import UsageError, warn
from evo_cpg.cli.options import Which
from evo_cpg.io.opened import OpenedChampion, Replay
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.crowd_motion import compile_crowd_motion, populations_at
from evo_cpg.training.lineage import champion_at, representatives
from evo_cpg.training.run_folder import RunFolderError
from evo_cpg.view.film import Film
from evo_cpg.view.legible import terms_text
from evo_cpg.view.scene import Panel, panel_of
from evo_cpg.view.signals import Signals, signals_of

# Number of champions of a lineage that are shown if no generations are given.
_SHOWN = 4


def champion_panel(run: Path, which: Which, signals: bool) -> Panel:
    """Return a panel with the champion of a run, or with the elite of a cell of its map.

    Args:
        run: run folder.
        which: champion or elite, and trial.
        signals: whether the panel has a strip of signals.
    """
    strip = None
    if signals:
        opened = open_champion(run, which)
        (replay,) = _replayed(opened, [opened.champion], which.trial)
        recording, strip = replay.recording, _signals(opened, replay)
    else:
        opened, recording = champion_motion(run, which)
    experiment = opened.experiment
    if which.cell is None:
        return panel_of(experiment, recording, experiment.name, strip)
    # The map keeps only those terms of an elite that are axes of the map. The panel shows them all.
    title = f"{experiment.name}, cell {which.cell}"
    return panel_of(experiment, recording, title, strip, terms_text(opened.champion.terms))


def crowd_panel(opened: OpenedChampion, generation: int, trial: int, film: Film) -> Panel:
    """Return a panel with all animals of a generation: the leader, and the others as ghosts.

    Args:
        opened: the run.
        generation: number of the generation, from 0.
        trial: number of the trial.
        film: frames per second, speed and length.

    Raises:
        UsageError: the run has no such generation.
        RunFolderError: the generation cannot be made anew.
    """
    experiment, number, run = opened.experiment, opened.champion.run, opened.folder.path
    done = opened.folder.newest
    if generation > done:
        raise UsageError(f"--crowd: {run} has {done} generations. The next one is {done}")
    opened.require_configured()
    simulation = experiment.simulation
    seconds = min(film.seconds or simulation.duration, simulation.duration)
    with working(f"breeding generation {generation} again"):
        (genes,) = populations_at(experiment, opened.folder, [generation])
        rate = film.fps / film.speed
        motion = compile_crowd_motion(experiment, seconds, rate, number, trial)
        crowd = motion(np.split(genes, experiment.runs, axis=1)[number], generation)
    if not crowd.count:
        raise RunFolderError(f"{run}: every animal of generation {generation} diverges")
    leader, others = crowd.led(experiment.creature.root_index, simulation.task.heading)
    title = f"generation {generation}: {crowd.count} animals"
    return panel_of(experiment, leader, title)._replace(crowd=others)


def lineage_panels(
    run: Path, generations: list[int] | None, which: Which, signals: bool
) -> list[Panel]:
    """Return panels with champions of a lineage, each with its generation and fitness."""
    opened = open_champion(run, which)
    chosen, panels = _chosen(opened, generations), []
    for one in chosen:
        wrong = opened.experiment.simulation.genome.misfit(one.genes)
        if wrong:
            raise RunFolderError(f"{opened.folder.lineage}: generation {one.generation}: {wrong}")
    for one, replay in zip(chosen, _replayed(opened, chosen, which.trial), strict=True):
        if not math.isclose(
            replay.fitness, one.fitness, rel_tol=REPLAY_TOLERANCE, abs_tol=REPLAY_TOLERANCE
        ):
            warn(
                f"{run}: the champion of generation {one.generation} replays with fitness "
                f"{replay.fitness:.4f}, not {one.fitness:.4f} as recorded. "
                f"{opened.folder.config} or the machine has changed since the evolution"
            )
        title = f"generation {one.generation}: fitness {one.fitness:.3g}"
        if one.expected is not None:
            title = f"champion: fitness {one.expected:.3g} with new noise"
        shown = _signals(opened, replay) if signals else None
        panels.append(panel_of(opened.experiment, replay.recording, title, shown))
    return panels


def _chosen(opened: OpenedChampion, generations: list[int] | None) -> list[Champion]:
    """Return champions of a run in the order of generations, each once.

    Args:
        opened: run with its final champion.
        generations: chosen generations, or None for a selection of the lineage.
    """
    folder, champion, run = opened.folder, opened.champion, opened.champion.run
    lineage = [each for each in folder.load_lineage() if each.run == run]
    if not lineage:
        raise RunFolderError(f"{folder.lineage} has no champion of run {run}")
    if generations is None:
        if champion.expected is None:
            return representatives(lineage, _SHOWN)
        # Under noise, the newest of the lineage may differ from the final champion, which is shown
        # last.
        places = (champion.generation, champion.index)
        others = [each for each in lineage if (each.generation, each.index) != places]
        return [*representatives(others, _SHOWN - 1), champion]
    done = folder.newest
    found: list[Champion] = []
    for generation in sorted(set(generations)):
        one = champion_at(lineage, generation)
        if generation >= max(done, lineage[-1].generation + 1):
            raise UsageError(
                f"--lineage: {folder.path} has {done} generations. The last is {done - 1}"
            )
        if one is None:
            raise UsageError(
                f"--lineage: the first recorded champion of {folder.path} is from generation "
                f"{lineage[0].generation}"
            )
        if all(one is not other for other in found):
            found.append(one)
    return found


def _replayed(opened: OpenedChampion, champions: Sequence[Champion], trial: int) -> list[Replay]:
    with working("replaying the champion"):
        return opened.replay(champions, trial)


def _signals(opened: OpenedChampion, replay: Replay) -> Signals:
    """Return the controller signals of an individual, and the contacts of its feet."""
    experiment, simulation = opened.experiment, opened.experiment.simulation
    word, _, unit = simulation.controller.signal_label.partition(" (")
    feet = gait_numbers(simulation, experiment.creature, replay.frames, replay.recording).feet
    names, touched = ((), None) if feet is None else (feet.names, feet.steady)
    return signals_of(replay.recording, word, unit == "rad)", names, touched)
