"""Film of a run's story: its champion, the first generation, later ones, a race, the champion.

Takes of generations have equal lengths, because only then does their distance show progress. A race
is between champions of the run. Each is clearly behind the next one.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.api.progress import working
from evo_cpg.api.runs import motion_of, open_champion, suffix
from evo_cpg.errors import advise
from evo_cpg.evolution.strategy import RandomSearch
from evo_cpg.files import make_folder
from evo_cpg.io.run import Run
from evo_cpg.io.trust import trusting
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.crowd import CrowdMotion, compile_crowd_motion, populations_at
from evo_cpg.training.devices import available_cores
from evo_cpg.training.lineage import representatives
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from evo_cpg.view.captions import Words
from evo_cpg.view.lanes import Course, course_of, in_lanes, tank_of
from evo_cpg.view.output import check_size, output_path
from evo_cpg.view.scene import Panel, Track, animal_radius, panel_of, sample
from evo_cpg.view.story import DISSOLVE, EASE, FPS, Take, story_film

# Seconds for the whole story, the champion under the title, each crowd's motion, and the race. The
# champion takes the rest.
_WHOLE, _TITLE, _CROWD, _RACE = 15.0, 1.9, 2.3, 3.2
# Time without words after the title, s.
_PAUSE = 0.1
# Time before the camera turns to the winner of the race, and time in which it does, s.
_STAY, _FOLLOW = 0.2, 1.2
# A generation runs for as long as the champion takes for this many of its own lengths, because in
# less time luck at the start decides who is ahead. Allowed speeds of the film.
_LENGTHS, _SLOWEST, _FASTEST = 5.5, 1.0, 6.0
# Speed of the film when the champion arrives, and time that is shown after it has arrived, s.
_SLOW, _AFTER = 0.5, 1.8
# Largest speed of the film with a champion that has to reach more than one place.
_QUICK = 6.0
# Time in the race after the winner's arrival and before the next take appears, s. Least distance
# between two animals of the race, in their length.
_WON, _APART = 0.1, 0.45
# Fraction of the bodies, over the champion's take, for a camera below the surface of the water.
_SUBMERGED = 0.9
# Number of earlier champions that are replayed, and largest number of animals in a race.
_REPLAYED, _RACING = 7, 4
# Aims of tasks whose light moves, in words.
_AIMS = {"waypoints": "reach one light after the other", "follow": "stay near the light"}


class Cast(NamedTuple):
    """Animals of a story.

    Attributes:
        panel: the champion in its world.
        generation: generation of the champion.
        heading: direction that counts as progress without a light, see `Task.heading`.
        aim: the animal's task in words, or empty for a task of the user's own.
        course: way of the champion.
        speed: speed of the film for the crowds.
        random: whether the first generation is random.
        selects: whether only the best have children.
        crowds: numbers and animals of the shown generations, the leader first.
        racers: generations and motion of earlier champions in the race.
    """

    panel: Panel
    generation: int
    heading: str
    aim: str
    course: Course
    speed: float
    random: bool
    selects: bool
    crowds: list[tuple[int, CrowdMotion]]
    racers: list[tuple[int, Recording]]

    @property
    def end(self) -> float:
        """Instant at which the champion is at its goal, or the end of its trial, s."""
        arrival = self.course.arrival
        return float(self.panel.recording.time[-1]) if arrival is None else arrival


def story(
    run: Path | str,
    path: Path | str | None = None,
    size: tuple[int, int] = (1920, 1080),
    title: str | None = None,
    number: int | None = None,
    trial: int = 0,
    cores: int | None = None,
    trust: bool = False,
) -> Path:
    """Film the story of a run in 15 s, and return the path of the film.

    Args:
        run: run folder.
        path: path of the .mp4 file, or None for one in the run folder's ``videos``.
        size: width and height, pixels.
        title: title, or None for one that fits the world.
        number: number of one of several runs side by side, or None for the best.
        trial: number of the trial, from 0.
        cores: number of processes that draw, or None for all cores.
        trust: whether to trust the configuration, see `load`.

    Raises:
        OutputError: the film cannot be written.
        RunFolderError: there is no run, or it has no champion.
        SettingError: the size is out of range.
        UsageError: the run has no such champion or trial.
    """
    folder = RunFolder(run)
    folder.require()
    check_size(size)
    output = Path(path) if path else folder.path / "videos" / f"story{suffix(number, trial)}.mp4"
    output = output_path(output, (".mp4",))
    with trusting(trust):
        opened = open_champion(run, number, trial)
    # The champion of the run, and the populations that can be made anew.
    recording = motion_of(opened, trial)
    shown, task = opened.on_course(trial).experiment, opened.experiment.simulation.task
    creature = shown.creature
    panel = panel_of(shown, recording, creature.name)._replace(numbers=False)
    length = 2 * animal_radius(creature, sample(recording, FPS))
    course = course_of(panel, length, task.heading == "forward")
    # The speed of the film for crowds follows from the champion's time over some of its lengths.
    track = recording.position[:, creature.root_index]
    away = np.linalg.norm(track - track[0], axis=-1)
    there = int((away >= min(_LENGTHS * length, 0.9 * away.max())).argmax())
    # A short trial must not end before its take.
    fastest = min(_FASTEST, (recording.time[-1] - recording.time[0]) / (_CROWD + DISSOLVE))
    speed = float(min(max(recording.time[there] / _CROWD, _SLOWEST), fastest))
    chosen = generations_of(opened.folder.newest, opened.champion.generation)
    if recording.moves_light:
        # The champion needs the time for its lights.
        chosen = chosen[::2]
    crowds = _crowds(opened, trial, chosen, speed * _CROWD)
    random = opened.folder.load_start() is None
    selects = not isinstance(opened.experiment.strategy, RandomSearch)
    aim = ""
    if np.isfinite(recording.goal).all():
        aim = f"Its task: {_AIMS.get(opened.config.task.type, 'reach the light')}."
    elif ":" not in opened.config.task.type:
        aim = "Its task: get as far as it can."
        if course.finish is not None:
            aim += f" Can it reach {course.finish:g} m?"
    told = opened.champion.generation, task.heading, aim
    cast = Cast(panel, *told, course, speed, random, selects, crowds, [])
    # Animals that turn to other lights would leave their lanes in a race.
    if not recording.moves_light:
        cast = cast._replace(racers=_racers(opened, recording, trial, cast.end, _APART * length))
    takes, words = story_of(cast, title, size[0] / size[1])
    make_folder(output.parent)
    processes = cores or available_cores()
    with working("rendering", counted=True) as work:
        return story_film(takes, words, output, size, processes=processes, progress=work.reached)


def story_of(cast: Cast, title: str | None, aspect: float) -> tuple[list[Take], list[Words]]:
    """Return the takes of a story, and its title and captions."""
    panel, course, speed, final = (
        cast.panel, cast.course, cast.speed, cast.generation,
    )  # fmt: skip
    recording, root = panel.recording, panel.creature.root_index
    every = [crowd for _, crowd in cast.crowds]
    tank = tank_of(panel, course, every, speed * _CROWD)

    def alone(start: float, seconds: float, track: Track | None) -> Panel:
        """Return the champion alone, seen from below the surface if it dives in this time."""
        shown = (recording.time >= start) & (recording.time <= start + seconds)
        below = recording.position[shown, ..., 2] < (panel.surface or 0.0)
        under = panel.surface is not None and bool(below.mean() > _SUBMERGED)
        return panel._replace(staging=tank.staging(0)._replace(track=track, under=under))

    # The film opens with the champion at full speed, half of the time to its goal.
    middle = float(recording.time[0] + max(0.5 * (cast.end - recording.time[0]) - _TITLE / 2, 0.0))
    takes = [Take(alone(middle, _TITLE, None), _TITLE, middle, 1.0, goal=tank.goal)]
    captions: list[str] = []

    def add(animal: Recording, others: CrowdMotion, names: tuple[str, ...], race: bool) -> None:
        """Add a take of the lanes."""
        seconds = _RACE if race else _CROWD
        views = [(0.0, tank.wide)]
        if race:
            begin, last = DISSOLVE + _STAY, tank.behind(animal, others, cast.end)
            turned = DISSOLVE + seconds if tank.near else begin + _FOLLOW
            views = [(begin, tank.wide), (turned, last)]
        staging = tank.staging(others.count)._replace(names=names)
        crowd = others if others.count else None
        seen = panel._replace(recording=animal, crowd=crowd, staging=staging)
        # The winner is at the goal before the next take appears.
        pace = cast.end / (seconds - EASE / 2 - DISSOLVE - _WON) if race else speed
        stop = cast.end if race else None
        takes.append(Take(seen, seconds, 0.0, pace, views, DISSOLVE, tank.goal, stop))

    for generation, animals in cast.crowds:
        leader, others = in_lanes(animals, root, cast.heading, tank.others)
        add(leader, others, ("ahead",), race=False)
        words = "The first generation" + (" moves at random" if cast.random else "")
        plural = "s" if generation != 1 else ""
        captions.append(f"After {generation} generation{plural}" if generation else words)
    if racers := cast.racers:
        names = [str(generation) for generation in (final, *(number for number, _ in racers))]
        add(recording, _together([motion for _, motion in racers]), tuple(names), race=True)
        *some, last = *names[1:], names[0]
        captions.append(f"A race of generations {', '.join(some)} and {last}")
    seconds = _WHOLE - sum(take.seconds for take in takes)
    plural, arrival = "s" if final != 1 else "", course.arrival
    last = f"After {final} generation{plural}"
    first, duration = float(recording.time[0]), float(np.ptp(recording.time))
    if recording.moves_light:
        pace = min(max(duration / seconds, 1.0), _QUICK)
        start = first
        last += f", {pace:.3g} times as fast" if pace > 1 else ""
    else:
        # The animal never stops in the picture.
        pace, before = _SLOW, seconds if arrival is None else seconds - _AFTER
        start = max(min(cast.end - pace * before, first + duration - pace * seconds), first)
        last += ", in slow motion"
    captions.append(last)
    views = [(0.0, tank.whole(recording, start, start + pace * seconds))]
    own = alone(start, pace * seconds, tank.track)
    takes.append(Take(own, seconds, start, pace, views, goal=tank.goal))
    ends = [float(end) for end in np.cumsum([take.seconds for take in takes[1:]]) + _TITLE]
    if len(cast.crowds) > 1 and cast.selects:
        ends.insert(0, _TITLE + _CROWD / 2)
        captions.insert(1, "Only the best have children")
    if arrival is not None:
        there = (arrival - start) / _SLOW
        ends.insert(-1, _WHOLE - seconds + max(there, DISSOLVE + 1.0))
        place = "the light" if course.finish is None else f"{course.finish:g} m"
        captions.append(f"It reaches {place}.")
    verb = "walk" if panel.world == "land" else "move" if panel.ground is not None else "swim"
    # A task of the user's own may be another one.
    taught = f"Nobody taught it to {verb if cast.aim else 'move'}."
    words = [Words(title or taught, "title", -1.0, _TITLE)]
    if cast.aim:
        words.append(Words(cast.aim, "subtitle", -1.0, _TITLE))
    # One caption has gone when the next one appears. The last one stays.
    begins, ends = [_TITLE + _PAUSE, *ends[:-1]], [*ends[:-1], 2 * _WHOLE]
    words += [
        Words(caption, "caption", begin, end)
        for caption, begin, end in zip(captions, begins, ends, strict=True)
    ]
    return takes, words


def generations_of(done: int, champion: int) -> list[int]:
    """Return the generations that a story shows before its champion.

    These are 0, 2 and 7 of 50 generations: the fourth root and the square root of their number.
    """
    found = {math.isqrt(math.isqrt(done)), math.isqrt(done)}
    return [0, *sorted(each for each in found if 0 < each < champion)]


def _crowds(
    opened: Run, trial: int, chosen: list[int], seconds: float
) -> list[tuple[int, CrowdMotion]]:
    """Return the crowds of some generations. Warn about those that cannot be made anew."""
    experiment, folder, run = opened.experiment, opened.folder, opened.champion.run
    try:
        opened.require_configured()
        with working("breeding the first generations again"):
            every = populations_at(experiment, folder, chosen)
    except RunFolderError as error:
        advise(f"the story leaves out the first generations: {error}")
        return []
    motion = compile_crowd_motion(experiment, seconds, 2 * FPS * _CROWD / seconds, run, trial)
    crowds, root = [], experiment.creature.root_index
    with working("replaying the first generations"):
        for genes, generation in zip(every, chosen, strict=True):
            # All move on the champion's course.
            own = np.split(genes, experiment.runs, axis=1)[run]
            crowd = motion(own, opened.champion.generation)
            if crowd.count:
                # The first is the one ahead when the take ends, because viewers see nothing else.
                leader = crowd.advance(root, experiment.simulation.task.heading).argmax()
                others = np.delete(np.arange(crowd.count), leader)
                crowds.append((generation, crowd.of(np.append(leader, others))))
    return crowds


def _racers(
    opened: Run, recording: Recording, trial: int, end: float, least: float
) -> list[tuple[int, Recording]]:
    """Return generations and motion of at most three earlier champions, for a race.

    Each is at least `least` (m) behind the next one at the instant `end` (s). There are none if
    none is known or can be replayed.
    """
    try:
        opened.require_configured()
    except RunFolderError:
        return []
    found = representatives(_earlier_champions(opened), _REPLAYED)
    if not found:
        return []
    with working("replaying earlier champions"):
        motions = [each.recording for each in opened.replay(found, trial)]
    experiment = opened.experiment
    every = _together([*motions, recording])
    shown = max(int((every.time <= end).sum()), 1)
    race = every._replace(time=every.time[:shown], position=every.position[:shown])
    progress = race.advance(experiment.creature.root_index, experiment.simulation.task.heading)
    *chosen, _ = apart(progress, least, _RACING)
    return [(found[i].generation, motions[i]) for i in chosen]


def _earlier_champions(opened: Run) -> list[Champion]:
    """Return the champions of the run that came before its final one, the first one first."""
    final = opened.champion
    try:
        lineage = opened.folder.load_lineage()
    except RunFolderError:
        return []
    return [one for one in lineage if one.run == final.run and one.generation < final.generation]


def apart(progress: Float[np.ndarray, " n"], least: float, most: int) -> list[int]:
    """Return animals, in order, each of which is clearly ahead of the one before.

    Args:
        progress: distance that each animal has come, m. The last animal is always chosen.
        least: least distance between two chosen animals, m.
        most: largest number of chosen animals. If more are apart, those at even distances stay.
    """
    chosen: list[int] = []
    for number, own in enumerate(progress[:-1]):
        ahead = not chosen or own >= progress[chosen[-1]] + least
        if ahead and own <= progress[-1] - least:
            chosen.append(number)
    chosen.append(len(progress) - 1)
    if len(chosen) <= most:
        return chosen
    places = np.linspace(progress[chosen[0]], progress[chosen[-1]], most)
    return sorted({min(chosen, key=lambda i: abs(progress[i] - place)) for place in places})


def _together(motions: Sequence[Recording]) -> CrowdMotion:
    """Return the motion of several animals as a crowd, until the first of them ends."""
    count = min(len(each.time) for each in motions)
    return CrowdMotion(
        motions[0].time[:count],
        np.stack([each.position[:count] for each in motions], 1),
        np.stack([each.rotation[:count] for each in motions], 1),
        motions[0].goal,
        np.stack([each.light[:count] for each in motions], 1) if motions[0].moves_light else None,
    )
