"""Animals of a film."""

import dataclasses
import io
import math
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from evo_cpg.analysis.gait_numbers import gait_numbers
from evo_cpg.api.progress import working
from evo_cpg.api.runs import REPLAY_TOLERANCE, motion_of, open_champion, require_generation
from evo_cpg.errors import UsageError, advise
from evo_cpg.files import write_text
from evo_cpg.io.run import Replay, Run
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.crowd import (
    CrowdMotion,
    compile_crowd_motion,
    compile_motions,
    evaluated_at,
    populations_at,
)
from evo_cpg.training.family import founders
from evo_cpg.training.lineage import champion_at, representatives
from evo_cpg.training.run_folder import RunFolderError
from evo_cpg.view.captions import legend_of
from evo_cpg.view.film import Film, picture
from evo_cpg.view.legible import terms_text
from evo_cpg.view.meshes import painted
from evo_cpg.view.output import output_path
from evo_cpg.view.run_page.document import wall_document
from evo_cpg.view.run_page.viewer_data import WALL_RATE, wall_data
from evo_cpg.view.scene import Exhibit, Panel, panel_of
from evo_cpg.view.signals import Signals, signals_of
from evo_cpg.view.wall import colors_of_lines

# Number of champions of a lineage that are shown if no generations are given.
_SHOWN = 4
# Largest number of animals on a wall, in a film and on a page.
IN_FILM, _ON_PAGE = 24, 48
# Least number of lines of descent that colours tell apart, if there have ever been so many.
_LINES = 6


def champion_panel(
    run: Path,
    number: int | None = None,
    trial: int = 0,
    cell: str | None = None,
    signals: bool = False,
) -> Panel:
    """Return a panel with the champion of a run, or with the elite of a cell of its map."""
    opened, strip = open_champion(run, number, trial, cell), None
    experiment = opened.on_course(trial).experiment
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
    # All animals are drawn with the champion's body, on the course of their generation.
    one = opened.champion._replace(generation=generation)
    drawn = dataclasses.replace(opened, individual=one).on_course(trial).experiment
    return panel_of(drawn, crowd.recording(leader, root), title)._replace(crowd=others)


def wall_panel(opened: Run, generation: int, trial: int, film: Film, most: int) -> Panel:
    """Return a panel with individuals of a generation on a wall, in the colours of their lines.

    Args:
        opened: the run with its champion, whose number of a run counts.
        generation: number of the generation.
        trial: number of the trial.
        film: settings of the film.
        most: largest number of animals.

    Raises:
        UsageError: the run has no such generation.
        RunFolderError: the generation cannot be made anew, or all of it diverges.
    """
    experiment, folder, run = opened.experiment, opened.folder, opened.champion.run
    require_generation(opened, "wall", generation)
    with working(f"evaluating generation {generation} again") as work:
        genes, fitness = evaluated_at(experiment, folder, generation)
        genes, fitness = np.split(genes, experiment.runs, axis=1)[run], fitness[run]
        born, lines = founders(folder.path, generation, run, _LINES) or (0, None)
        plans = experiment.simulation.plans
        bodies = None if plans is None else plans.developed(genes)[0]
        chosen = chosen_of_lines(fitness, lines, bodies)[:most]
        chosen = chosen[np.argsort(-fitness[chosen], kind="stable")]
        if not len(chosen):
            raise RunFolderError(f"{folder.path}: every animal of generation {generation} diverges")
        work.doing("recording the animals")
        animals = [
            Champion(genes[:, i], float(fitness[i]), generation, {}, {}, run, int(i))
            for i in chosen
        ]
        exhibits = _exhibits(opened, animals, lines, trial, film)
    since = f", lines since generation {born}" if born else ""
    title = f"{experiment.name}, generation {generation}"
    pace = f", {film.speed:g} x speed" if film.speed != 1 else ""
    shown, best = f"{len(exhibits)} of {len(fitness)} animals", fitness[chosen[0]]
    note = f"{shown}, best fitness {best:.3g}{since}{pace}"
    first = panel_of(experiment, exhibits[0].recording, title, note=note)
    return first._replace(creature=exhibits[0].creature, exhibits=exhibits)


def wall_page(
    opened: Run, generation: int, trial: int, film: Film, path: Path, title: str | None = None
) -> Path:
    """Write a page with a wall, and return its path. See `wall_panel`."""
    output_path(path, (".html",))
    film = dataclasses.replace(film, fps=WALL_RATE, speed=1.0)
    panel, still = wall_panel(opened, generation, trial, film, _ON_PAGE), io.BytesIO()
    with working("drawing"):
        panel = panel if title is None else panel._replace(title=title)
        picture([panel], dataclasses.replace(film, seconds=None)).save(still, "JPEG", quality=88)
        scene, name = wall_data(panel, film.size[0] / film.size[1]), panel.title or ""
        made = wall_document(name, panel.note, legend_of(panel), scene, still.getvalue())
        write_text(path, made)
    return path


def chosen_of_lines(
    fitness: Float[np.ndarray, " n"],
    lines: Int[np.ndarray, " n"] | None,
    bodies: Int[np.ndarray, " n"] | None,
) -> Int[np.ndarray, " k"]:
    """Return individuals: the fittest of each kind, then the second of each kind, and so on.

    A kind has one line of descent and one number of bodies, so that late generations of few lines
    show more than one shape. Equal fitness means copies, or mutations without effect. Only the
    first of them is shown. Individuals that diverge are left out.

    Args:
        fitness: fitness of all individuals.
        lines: ancestor of each, or None if unknown.
        bodies: number of bodies of each, or None if equal.
    """
    _, first = np.unique(fitness, return_index=True)
    ranked = first[::-1][np.isfinite(fitness[first[::-1]])]
    none = np.zeros(len(fitness), int)
    kinds = np.stack([none if x is None else x for x in (lines, bodies)], axis=1)[ranked]
    _, kind, count = np.unique(kinds, axis=0, return_inverse=True, return_counts=True)
    # Number of fitter individuals of the same kind.
    place = np.empty(len(ranked), int)
    earlier = np.repeat(np.cumsum(count) - count, count)
    place[np.argsort(kind.reshape(-1), kind="stable")] = np.arange(len(ranked)) - earlier
    return ranked[np.argsort(place, kind="stable")]


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
        own = dataclasses.replace(opened, individual=one).on_course(trial)
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


def _exhibits(
    opened: Run,
    animals: list[Champion],
    lines: Int[np.ndarray, " n"] | None,
    trial: int,
    film: Film,
) -> tuple[Exhibit, ...]:
    """Return individuals with their own bodies and motion."""
    simulation = opened.experiment.simulation
    seconds = min(film.seconds or simulation.duration, simulation.duration)
    record = compile_motions(opened.experiment, seconds, film.fps / film.speed)
    genes, places = np.stack([one.genes for one in animals], 1), [one.index for one in animals]
    time, found = record(genes, animals[0].generation, animals[0].run, np.array(places), trial)
    of_line = [None if lines is None else int(lines[one.index]) for one in animals]
    colors = colors_of_lines(of_line, "land" if simulation.world.water is None else "water")
    exhibits = []
    for i, (one, line, color) in enumerate(zip(animals, of_line, colors, strict=True)):
        own = opened.of_body(one).experiment
        frames = {name: values[..., i : i + 1] for name, values in found.items()}
        if simulation.plans is not None:
            frames = simulation.plans.frames_of(own.simulation, frames)
        names = own.simulation.world.tree.names
        order = [names.index(body.name) for body in own.creature.bodies]
        position = np.moveaxis(frames["position"], (3, 2), (1, 2))[:, :, order]
        rotation = np.moveaxis(frames["rotation"], (4, 3), (1, 2))[:, :, order]
        motion = CrowdMotion(time, position, rotation, np.full(3, np.nan))
        recording = motion.recording(0, own.creature.root_index)
        creature = painted(own.creature, color)
        exhibits.append(Exhibit(creature, recording, color, one.index, one.fitness, line))
    return tuple(exhibits)
