"""Animals of a film."""

import math
from pathlib import Path

import numpy as np

from evo_cpg.analysis.gait_numbers import gait_numbers
from evo_cpg.api.progress import working
from evo_cpg.api.runs import REPLAY_TOLERANCE, motion_of, open_champion, require_generation
from evo_cpg.errors import UsageError, advise
from evo_cpg.io.run import Replay, Run
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.crowd import compile_crowd_motion, populations_at
from evo_cpg.training.lineage import champion_at, representatives
from evo_cpg.training.run_folder import RunFolderError
from evo_cpg.view.film import Film
from evo_cpg.view.legible import terms_text
from evo_cpg.view.scene import Panel, panel_of
from evo_cpg.view.signals import Signals, signals_of

# Number of champions of a lineage that are shown if no generations are given.
_SHOWN = 4


def champion_panel(
    run: Path,
    number: int | None = None,
    trial: int = 0,
    cell: str | None = None,
    signals: bool = False,
) -> Panel:
    """Return a panel with the champion of a run, or with the elite of a cell of its map."""
    opened, strip = open_champion(run, number, trial, cell), None
    experiment = opened.own.experiment
    if signals:
        with working("replaying the champion"):
            (replay,) = opened.replay([opened.champion], trial)
        recording, strip = replay.recording, _signals(opened.own, replay)
    else:
        recording = motion_of(opened, trial)
    if cell is None:
        return panel_of(experiment, recording, experiment.name, strip)
    # The map keeps only those terms of an elite that are axes of the map. The panel shows them all.
    title = f"{experiment.name}, cell {cell}"
    return panel_of(experiment, recording, title, strip, terms_text(opened.champion.terms))


def crowd_panel(opened: Run, generation: int, trial: int, film: Film) -> Panel:
    """Return a panel with all animals of a generation: the leader, and the others as ghosts.

    Raises:
        UsageError: the run has no such generation.
        RunFolderError: the generation cannot be made anew.
    """
    experiment, number, run = opened.experiment, opened.champion.run, opened.folder.path
    require_generation(opened, "crowd", generation)
    simulation = experiment.simulation
    seconds = min(film.seconds or simulation.duration, simulation.duration)
    with working(f"breeding generation {generation} again"):
        (genes,) = populations_at(experiment, opened.folder, [generation])
        rate = film.fps / film.speed
        motion = compile_crowd_motion(experiment, seconds, rate, number, trial)
        crowd = motion(np.split(genes, experiment.runs, axis=1)[number], generation)
    if not crowd.count:
        raise RunFolderError(f"{run}: every animal of generation {generation} diverges")
    root = experiment.creature.root_index
    leader = int(crowd.advance(root, simulation.task.heading).argmax())
    others = crowd.of(np.delete(np.arange(crowd.count), leader))
    title = f"generation {generation}: {crowd.count} animals"
    # All animals are drawn with the champion's body.
    drawn = opened.own.experiment
    return panel_of(drawn, crowd.recording(leader, root), title)._replace(crowd=others)


def lineage_panels(
    run: Path,
    generations: list[int] | None,
    number: int | None = None,
    trial: int = 0,
    signals: bool = False,
) -> list[Panel]:
    """Return panels with champions of a lineage, each with its generation and fitness."""
    opened, panels = open_champion(run, number, trial), []
    folder, champion, own = opened.folder, opened.champion, opened.champion.run
    lineage = [each for each in folder.load_lineage() if each.run == own]
    if not lineage:
        raise RunFolderError(f"{folder.lineage} has no champion of run {own}")
    chosen: list[Champion] = []
    if generations is None and champion.expected is None:
        chosen = representatives(lineage, _SHOWN)
    elif generations is None:
        # Under noise, the newest of the lineage may differ from the final champion, which is shown
        # last.
        places = (champion.generation, champion.index)
        others = [each for each in lineage if (each.generation, each.index) != places]
        chosen = [*representatives(others, _SHOWN - 1), champion]
    for generation in sorted(set(generations or ())):
        one, done = champion_at(lineage, generation), folder.newest
        if generation >= max(done, lineage[-1].generation + 1):
            raise UsageError(
                f"lineage: {folder.path} has {done} generations. The last is {done - 1}"
            )
        if one is None:
            raise UsageError(
                f"lineage: the first recorded champion of {folder.path} is from generation "
                f"{lineage[0].generation}"
            )
        if all(one is not other for other in chosen):
            chosen.append(one)
    for one in chosen:
        wrong = opened.experiment.simulation.genome.misfit(one.genes)
        if wrong:
            raise RunFolderError(f"{folder.lineage}: generation {one.generation}: {wrong}")
    with working("replaying the champion"):
        replays = opened.replay(chosen, trial)
    for one, replay in zip(chosen, replays, strict=True):
        if not math.isclose(
            replay.fitness, one.fitness, rel_tol=REPLAY_TOLERANCE, abs_tol=REPLAY_TOLERANCE
        ):
            advise(
                f"{run}: the champion of generation {one.generation} replays with fitness "
                f"{replay.fitness:.4f}, not {one.fitness:.4f} as recorded. "
                f"{folder.config} or the machine has changed since the evolution"
            )
        title = f"generation {one.generation}: fitness {one.fitness:.3g}"
        if one.expected is not None:
            title = f"champion: fitness {one.expected:.3g} with new noise"
        own = opened.of_body(one)
        shown = _signals(own, replay) if signals else None
        panels.append(panel_of(own.experiment, replay.recording, title, shown))
    return panels


def _signals(opened: Run, replay: Replay) -> Signals:
    """Return the controller signals of an individual, and the contacts of its feet."""
    experiment, simulation = opened.experiment, opened.experiment.simulation
    word, _, unit = simulation.controller.signal_label.partition(" (")
    feet = gait_numbers(simulation, experiment.creature, replay.frames, replay.recording).feet
    names, touched = ((), None) if feet is None else (feet.names, feet.steady)
    return signals_of(replay.recording, word, unit == "rad)", names, touched)
