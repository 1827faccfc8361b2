"""The story of a run, for `render --story`: first generation, later ones, champion."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evo_cpg.api.display import working
from evo_cpg.api.opened import OpenedChampion
from evo_cpg.cli.champions import champion_motion
from evo_cpg.cli.errors import warn
from evo_cpg.cli.options import Which
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.crowd_motion import CrowdMotion, compile_crowd_motion, populations_at
from evo_cpg.training.run_folder import RunFolderError
from evo_cpg.view.camera import course, overview, project
from evo_cpg.view.clip import sample
from evo_cpg.view.scene import Panel, animal_radius, panel_of
from evo_cpg.view.story import DISSOLVE, EASE, FPS, LoopPart, Overview, Take, spans
from evo_cpg.view.story_text import Words

# Lengths in the film, s: of the whole story, of the title before the first motion, and of each
# later generation. The first generation moves for as long as the others. The champion takes the
# rest.
_WHOLE, _TITLE, _LATER = 15.0, 1.9, 2.9
# A generation runs for as long as the champion takes for this many of its own lengths, in this much
# film, s. Allowed speeds of the film.
_LENGTHS, _RUN, _SLOWEST, _FASTEST = 6.0, 3.0, 1.0, 6.0
# Speed of the film when the champion arrives, and time that is shown after it has arrived, s. The
# champion has arrived when it is this much farther away than ever, as a fraction of the way.
_SLOW, _AFTER, _ARRIVED = 0.5, 0.5, 0.03
# Without a light, the champion's take ends at this part of the trial.
_STEADY = 0.7
# Parts of a crowd that the camera shows: all but the farthest.
_SHOWN = 0.04
# Least fraction of the picture's width that an animal has next to its light. Otherwise an arrow
# points to the light.
_SMALLEST = 0.06
# Room ahead of the animals for this arrow, relative to the length of their way.
_ROOM_AHEAD = 0.15
# Distance of the camera at the start and at the end of all crowds, relative to the least.
_FAR, _NEAR = 1.18, 1.06
# Animals that walk without a light stand side by side. Number of lanes, and width in lengths.
_LANES, _LANE = 24, 0.4
# Lengths of the parts of the loop, s.
_OF_FIRST, _OF_LAST, _OF_CHAMPION = 2.3, 2.2, 2.8


class Material(NamedTuple):
    """Animals of a story.

    Attributes:
        opened: run with its champion.
        panel: the champion in its world.
        length: length of the animal, m.
        speed: speed of the film for the crowds.
        crowds: numbers and animals of the shown generations, without the champion's.
    """

    opened: OpenedChampion
    panel: Panel
    length: float
    speed: float
    crowds: list[tuple[int, CrowdMotion]]


class Story(NamedTuple):
    """A story that can be filmed.

    Attributes:
        takes: the takes.
        words: title and captions.
        loop: parts of the film that the loop shows.
    """

    takes: list[Take]
    words: list[Words]
    loop: list[LoopPart]


def material_of(run: Path, which: Which) -> Material:
    """Return the champion of a run, and the populations that can be made anew.

    Args:
        run: run folder.
        which: one of several runs in the folder, and trial.
    """
    opened, recording = champion_motion(run, which)
    creature = opened.experiment.creature
    panel = panel_of(opened.experiment, recording, creature.name)._replace(numbers=False)
    length = 2 * animal_radius(creature, sample(recording, FPS))
    speed = _speed(recording, creature.root_index, length)
    return Material(opened, panel, length, speed, _crowds(opened, which.trial, speed))


def story_of(material: Material, title: str | None, aspect: float) -> Story:
    """Return the story of a run.

    Args:
        material: the animals.
        title: title, or None for one that fits the world.
        aspect: width of the picture over its height.
    """
    opened, panel, length, speed, crowds = material
    experiment, recording, creature = opened.experiment, panel.recording, panel.creature
    task = experiment.simulation.task
    if panel.ground is not None and not np.isfinite(recording.goal).all():
        lanes = creature.root_index, task.heading, _LANE * length
        crowds = [(generation, _in_lanes(crowd, *lanes)) for generation, crowd in crowds]
    heading = title or _title(panel.world, panel.ground is not None)
    wide = _overview(
        recording, creature.root_index, task.heading, [crowd for _, crowd in crowds], length, aspect
    )
    times = _lengths(len(crowds))
    total = sum(times[:-1]) or 1.0
    takes, done = [], 0.0
    for number, ((_, crowd), seconds) in enumerate(zip(crowds, times, strict=False)):
        leader, others = crowd.led(creature.root_index, task.heading)
        seen = panel._replace(recording=leader, crowd=others)
        start, end = (_FAR + (_NEAR - _FAR) * part / total for part in (done, done + seconds))
        camera = wide._replace(nearness=(start, end))
        # All generations move for the same time, once they are fully seen.
        hold = _TITLE if number == 0 else DISSOLVE
        takes.append(Take(seen, seconds, 0.0, speed, camera, hold))
        done += seconds
    takes.append(Take(panel, times[-1], _arrival(recording, times[-1]), _SLOW))
    captions = [
        f"{_named(generation)}: {advanced(crowd, creature.root_index, task.heading, length)}"
        for generation, crowd in crowds
    ]
    captions.append(f"After {_generations(opened.champion.generation)}, in slow motion")
    animals = f"{experiment.strategy.population} random nervous systems."
    if np.isfinite(recording.goal).all():
        animals += " One light."
    words = [Words(heading, "title", -1.0, _TITLE + 0.5)]
    if crowds:
        words.append(Words(animals, "subtitle", 0.3, _TITLE + 0.5))
    start = _TITLE
    for caption, end in zip(captions, np.cumsum(times), strict=True):
        # One caption has gone when the next one appears. The last one stays.
        words.append(
            Words(caption, "caption", start, float(end) if caption != captions[-1] else 99)
        )
        start = float(end)
    return Story(takes, words, _loop(takes, captions))


def generations_of(done: int, champion: int) -> list[int]:
    """Return the generations that a story shows before its champion.

    These are 0, 2 and 7 of 50 generations: the fourth root and the square root of their number.

    Args:
        done: number of finished generations.
        champion: generation of the champion.
    """
    found = {math.isqrt(math.isqrt(done)), math.isqrt(done)}
    return [0, *sorted(each for each in found if 0 < each < champion)]


def _crowds(opened: OpenedChampion, trial: int, speed: float) -> list[tuple[int, CrowdMotion]]:
    """Return the crowds of some generations. Warn about those that cannot be made anew."""
    experiment, folder, run = opened.experiment, opened.folder, opened.champion.run
    chosen = generations_of(folder.newest, opened.champion.generation)
    seconds = speed * (_LATER - EASE / 2)
    try:
        opened.require_configured()
        with working("breeding the first generations again"):
            every = populations_at(experiment, folder, chosen)
    except RunFolderError as error:
        warn(f"the story leaves out the first generations: {error}")
        return []
    motion = compile_crowd_motion(experiment, seconds, 2 * FPS / speed, run, trial)
    with working("replaying the first generations"):
        crowds = [
            motion(np.split(genes, experiment.runs, axis=1)[run], generation)
            for genes, generation in zip(every, chosen, strict=True)
        ]
    return [(number, one) for number, one in zip(chosen, crowds, strict=True) if one.count]


def _speed(recording: Recording, root: int, length: float) -> float:
    """Return the speed of the film for crowds, from the speed of the champion."""
    path = recording.position[:, root]
    away = np.linalg.norm(path - path[0], axis=-1)
    there = int((away >= 0.9 * away.max()).argmax())
    pace = away[there] / max(recording.time[there], 1e-9)
    # A short trial must not end before its take.
    fastest = min(_FASTEST, (recording.time[-1] - recording.time[0]) / (_RUN + DISSOLVE))
    return float(min(max(_LENGTHS * length / max(pace, 1e-9) / _RUN, _SLOWEST), fastest))


def _lengths(crowds: int) -> list[float]:
    """Return the lengths of all takes, s: crowds, then the champion."""
    # The first crowd shares no frames with a take before it.
    shown = [_TITLE + _LATER - DISSOLVE / 2, *[_LATER] * (crowds - 1)] if crowds else []
    return [*shown, _WHOLE - sum(shown)]


def _overview(
    recording: Recording,
    root: int,
    heading: str,
    crowds: Sequence[CrowdMotion],
    length: float,
    aspect: float,
) -> Overview:
    """Return the camera of the crowds, which shows their start, most of them, and the light."""
    start = recording.position[0]
    places = [start]
    for crowd in crowds:
        leader = crowd.leader(root, heading)
        places.append(crowd.position[::10, leader].reshape(-1, 3))
        middles = crowd.position.mean(2)[:: max(len(crowd.time) // 10, 1)].reshape(-1, 3)
        low, high = np.quantile(middles, (_SHOWN, 1 - _SHOWN), axis=0)
        places.append(middles[((middles >= low) & (middles <= high)).all(1)])
    every = np.concatenate(places)
    goal = recording.goal
    bearing = course(recording.position[:, root], goal, length / 20)
    lit = np.concatenate([every, goal[None]]) if np.isfinite(goal).all() else every
    # An arrow to the light needs room ahead of the animals.
    ahead = np.array([np.cos(bearing), np.sin(bearing), 0.0])
    along = every @ ahead
    beyond = every[along.argmax()] + _ROOM_AHEAD * float(np.ptp(along)) * ahead
    for points in (lit, np.concatenate([every, beyond[None]])):
        path = overview(points, bearing, np.radians(20), aspect, np.ones(1))
        seen = np.ptp(project(path, start[None], aspect)[0, :, 0]) / 2
        if seen >= _SMALLEST:
            break
    return Overview(points, bearing, (1.0, 1.0))


def _in_lanes(crowd: CrowdMotion, root: int, heading: str, width: float) -> CrowdMotion:
    """Return some animals of a crowd side by side in lanes, with the leader in front.

    The others are those at even ranks of progress, so that they show the whole crowd as it is. The
    first animals of a population would not, because these are the elites.
    """
    ranked = np.argsort(-crowd.advance(root, heading))
    lanes = min(_LANES, crowd.count)
    chosen = ranked[np.linspace(0, crowd.count - 1, lanes).round().astype(int)]
    # Neighbours differ, as in the population.
    chosen = crowd.of(np.concatenate([chosen[:1], np.sort(chosen[1:])]))
    aside = np.zeros((chosen.count, 1, 3), np.float32)
    aside[:, 0, 1] = width * np.arange(chosen.count)
    return chosen._replace(position=chosen.position + aside)


def _arrival(recording: Recording, seconds: float) -> float:
    """Return the instant at which the champion's take begins, s."""
    time, shown = recording.time, _SLOW * seconds
    if np.isfinite(recording.goal).all():
        away = recording.distance
        near = away.min() + _ARRIVED * (away[0] - away.min())
        end = time[(away <= near).argmax()] + _AFTER
    else:
        end = time[0] + _STEADY * (time[-1] - time[0])
    return float(max(min(end, time[-1]) - shown, time[0]))


def _loop(takes: Sequence[Take], captions: Sequence[str]) -> list[LoopPart]:
    """Return the parts of the film that the loop shows: first and last crowd, and champion."""
    every, shared = spans([take.seconds for take in takes]), round(DISSOLVE * FPS)
    first, end = every[-1]
    first = max(first + shared, end - round(_OF_CHAMPION * FPS))
    parts = [LoopPart(first, end, captions[-1])]
    if len(takes) > 2:
        first = every[-2][0] + shared
        end = min(first + round(_OF_LAST * FPS), every[-2][1] - shared)
        parts.insert(0, LoopPart(first, end, captions[-2]))
    if len(takes) > 1:
        first = round(_TITLE * FPS)
        end = min(first + round(_OF_FIRST * FPS), every[0][1] - shared)
        parts.insert(0, LoopPart(first, end, captions[0]))
    return parts


def _generations(count: int) -> str:
    return f"{count} generation" + ("s" if count != 1 else "")


def advanced(crowd: CrowdMotion, root: int, heading: str, length: float) -> str:
    """Return in words how many animals of a crowd have come at least one length ahead."""
    count = int((crowd.advance(root, heading) >= length).sum())
    return f"{count or 'none'} of {crowd.count} get{'s' if count == 1 else ''} ahead"


def _named(generation: int) -> str:
    return "The first generation" if generation == 0 else f"After {_generations(generation)}"


def _title(world: str, grounded: bool) -> str:
    verb = "walk" if world == "land" else "move" if grounded else "swim"
    return f"Nobody taught it to {verb}."
