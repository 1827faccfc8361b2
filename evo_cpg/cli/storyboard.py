"""The story of a run, for `render --story`: first generation, later ones, a race, the champion."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evo_cpg.api.display import working
from evo_cpg.api.opened import OpenedChampion
from evo_cpg.cli.champions import champion_motion
from evo_cpg.cli.errors import warn
from evo_cpg.cli.lanes import in_lanes, tank_of
from evo_cpg.cli.options import Which
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.crowd_motion import CrowdMotion, compile_crowd_motion, populations_at
from evo_cpg.training.lineage import champion_at
from evo_cpg.training.run_folder import RunFolderError
from evo_cpg.view.clip import sample
from evo_cpg.view.scene import Panel, animal_radius, panel_of
from evo_cpg.view.story import DISSOLVE, EASE, FPS, LoopPart, Take, spans
from evo_cpg.view.story_text import Words

# Lengths in the film, s: of the whole story, of the title before the first motion, of each crowd's
# motion, and of the race. The champion takes the rest.
_WHOLE, _TITLE, _CROWD, _RACE = 15.0, 1.7, 2.3, 3.2
# Times in which the camera leaves the title, and in which it comes close to the winner of the race.
_LEAVE, _CLOSE = 1.2, 1.1
# A generation runs for as long as the champion takes for this many of its own lengths, in this much
# film, s. Allowed speeds of the film.
_LENGTHS, _RUN, _SLOWEST, _FASTEST = 6.0, 3.0, 1.0, 6.0
# Speed of the film when the champion arrives, and time that is shown after it has arrived, s. The
# champion has arrived when it is this much farther away than ever, as a fraction of the way.
_SLOW, _AFTER, _ARRIVED = 0.5, 0.5, 0.03
# Distance of the camera at the start of a crowd, relative to that at its end.
_FAR = 1.06
# Lengths of the parts of the loop, s: of the title, and of the motion in each take.
_OF_TITLE, _OF_FIRST, _OF_LAST, _OF_RACE, _OF_CHAMPION = 1.2, 1.7, 1.6, 2.4, 2.3


class Material(NamedTuple):
    """Animals of a story.

    Attributes:
        opened: run with its champion.
        panel: the champion in its world.
        length: length of the animal, m.
        speed: speed of the film for the crowds.
        crowds: numbers and animals of the shown generations, without the champion's.
        earlier: generations and motion of earlier champions, if there are no crowds.
    """

    opened: OpenedChampion
    panel: Panel
    length: float
    speed: float
    crowds: list[tuple[int, CrowdMotion]]
    earlier: list[tuple[int, Recording]]


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
    crowds, earlier = _crowds(opened, which.trial, speed), []
    if not crowds:
        earlier = _earlier(opened, which.trial)
    return Material(opened, panel, length, speed, crowds, earlier)


def story_of(material: Material, title: str | None, aspect: float) -> Story:
    """Return the story of a run.

    Args:
        material: the animals.
        title: title, or None for one that fits the world.
        aspect: width of the picture over its height.
    """
    opened, panel, length, speed, crowds, earlier = material
    task, recording = opened.experiment.simulation.task, panel.recording
    root, forward = panel.creature.root_index, task.heading == "forward"
    every = [crowd for _, crowd in crowds]
    tank = tank_of(panel, every, length, speed * _RACE, forward, aspect)
    takes: list[Take] = []
    captions: list[str] = []

    def add(animal: Recording, others: CrowdMotion, names: tuple[str, ...], moves: float) -> None:
        """Add a take of the lanes, in which the animals move for some time of the film, s."""
        first = not takes
        hold = _TITLE if first else DISSOLVE
        end, appear = hold + moves, None
        views = [(0.0, tank.wide._replace(distance=_FAR)), (end, tank.wide)]
        if first:
            views = [(_TITLE - 0.2, tank.title), (_TITLE + _LEAVE, tank.wide)]
            appear = round(_TITLE * FPS), round((_TITLE + _LEAVE / 2) * FPS)
        if moves == _RACE:
            views = [*views[:-1], (end - _CLOSE, tank.wide), (end, None)]
        staging = tank.staging(others.count)._replace(names=names, appear=appear)
        seen = panel._replace(recording=animal, crowd=others, staging=staging)
        # The first take shares no frames with a take before it.
        seconds = hold + moves - DISSOLVE / 2 if first else moves
        takes.append(Take(seen, seconds, 0.0, speed, views, hold, tank.goal))

    racers = earlier
    for generation, crowd in crowds:
        leader, others = in_lanes(crowd, root, task.heading, tank.lanes)
        racers = [*racers, (generation, leader)]
        add(leader, others, ("best",), _CROWD)
        captions.append(_named(generation))
    final = opened.champion.generation
    if racers:
        names = [str(generation) for generation in (final, *(number for number, _ in racers))]
        add(recording, _together([motion for _, motion in racers]), tuple(names), _RACE)
        *some, last = *names[1:], names[0]
        captions.append(f"A race: the best after {', '.join(some)} and {last} generations")
    seconds = _WHOLE - sum(take.seconds for take in takes)
    alone = panel._replace(staging=tank.staging(0))
    start = _arrival(recording, seconds, tank.finish)
    takes.append(Take(alone, seconds, start, _SLOW, goal=tank.goal))
    captions.append(f"After {_generations(final)}, in slow motion")
    heading = title or _title(panel.world, panel.ground is not None)
    words = [Words(heading, "title", -1.0, _TITLE + 0.3)]
    if aim := _task(opened, recording):
        words.append(Words(aim, "subtitle", -1.0, _TITLE + 0.3))
    begin = _TITLE + 0.3
    for caption, end in zip(captions, np.cumsum([take.seconds for take in takes]), strict=True):
        # One caption has gone when the next one appears. The last one stays.
        last = caption == captions[-1]
        words.append(Words(caption, "caption", begin, 99.0 if last else float(end)))
        begin = float(end)
    return Story(takes, words, _loop(takes, words, captions))


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
    seconds = speed * (_RACE - EASE / 2)
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


def _earlier(opened: OpenedChampion, trial: int) -> list[tuple[int, Recording]]:
    """Return the motion of earlier champions, or nothing if none is known or can be replayed."""
    champion = opened.champion
    try:
        opened.require_configured()
        lineage = [one for one in opened.folder.load_lineage() if one.run == champion.run]
    except RunFolderError:
        return []
    wanted = generations_of(opened.folder.newest, champion.generation)
    found = {
        one.generation: one
        for one in (champion_at(lineage, generation) for generation in wanted)
        if one is not None and one.generation < champion.generation
    }
    with working("replaying earlier champions"):
        replays = opened.replay([*found.values()], trial) if found else []
    return [(number, each.recording) for number, each in zip(found, replays, strict=True)]


def _together(motions: list[Recording]) -> CrowdMotion:
    """Return the motion of several animals as a crowd, until the first of them ends."""
    count = min(len(each.time) for each in motions)
    return CrowdMotion(
        motions[0].time[:count],
        np.stack([each.position[:count] for each in motions], 1),
        np.stack([each.rotation[:count] for each in motions], 1),
        motions[0].goal,
    )


def _speed(recording: Recording, root: int, length: float) -> float:
    """Return the speed of the film for crowds, from the speed of the champion."""
    path = recording.position[:, root]
    away = np.linalg.norm(path - path[0], axis=-1)
    there = int((away >= 0.9 * away.max()).argmax())
    pace = away[there] / max(recording.time[there], 1e-9)
    # A short trial must not end before its take.
    fastest = min(_FASTEST, (recording.time[-1] - recording.time[0]) / (_RACE + DISSOLVE))
    return float(min(max(_LENGTHS * length / max(pace, 1e-9) / _RUN, _SLOWEST), fastest))


def _arrival(recording: Recording, seconds: float, crossed: float | None) -> float:
    """Return the instant at which the champion's take begins, s.

    Args:
        recording: motion of the champion.
        seconds: length of the take, s.
        crossed: instant at which the champion passes the finish, s, or None without a finish.
    """
    time, shown = recording.time, _SLOW * seconds
    end = time[-1]
    if np.isfinite(recording.goal).all():
        away = recording.distance
        near = away.min() + _ARRIVED * (away[0] - away.min())
        end = time[(away <= near).argmax()] + _AFTER
    elif crossed is not None:
        end = crossed + _AFTER
    return float(max(min(end, time[-1]) - shown, time[0]))


def _loop(takes: list[Take], words: list[Words], captions: list[str]) -> list[LoopPart]:
    """Return the parts of the film that the loop shows: title, crowds, race, and champion."""
    every, shared = spans([take.seconds for take in takes]), round(DISSOLVE * FPS)

    def part(number: int, seconds: float, of_end: bool) -> LoopPart:
        (first, end), caption = every[number], captions[number]
        hold, length = round(takes[number].hold * FPS), round(seconds * FPS)
        low, high = first + hold, end - (shared if number < len(takes) - 1 else 0)
        first = max(low, high - length) if of_end else low
        end = min(first + length, high)
        told = Words(caption, "caption", DISSOLVE, (end - first - shared) / FPS)
        return LoopPart(first, end, [told])

    opening = part(0, _OF_FIRST, False)
    title = round(_OF_TITLE * FPS)
    begin = opening.first - title
    told = [one._replace(end=_OF_TITLE + 0.3) for one in words if one.kind != "caption"]
    if len(takes) > 1:
        moved = opening.words[0]
        told.append(moved._replace(start=_OF_TITLE + 0.3, end=moved.end + _OF_TITLE))
    found = [LoopPart(begin, opening.end, told)]
    if len(takes) > 3:
        found.append(part(len(takes) - 3, _OF_LAST, False))
    if len(takes) > 2:
        found.append(part(len(takes) - 2, _OF_RACE, True))
    if len(takes) > 1:
        found.append(part(len(takes) - 1, _OF_CHAMPION, True))
    return found


def _task(opened: OpenedChampion, recording: Recording) -> str:
    """Return the animal's task in words, or nothing for a task of the user's own."""
    if np.isfinite(recording.goal).all():
        return "Its task: reach the light."
    return "" if opened.config.task.type == "custom" else "Its task: get as far as it can."


def _generations(count: int) -> str:
    return f"{count} generation" + ("s" if count != 1 else "")


def _named(generation: int) -> str:
    return f"After {_generations(generation)}" if generation else "The first generation"


def _title(world: str, grounded: bool) -> str:
    verb = "walk" if world == "land" else "move" if grounded else "swim"
    return f"Nobody taught it to {verb}."
