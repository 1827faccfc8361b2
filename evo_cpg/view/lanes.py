"""Lanes for the animals of a story, the views that show them, and the goal.

All animals of a generation start at the same place and would hide each other. In the film, each has
a lane of its own, and a light of its own if there is one. Only the drawing is moved.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.simulation.recording import Recording
from evo_cpg.training.crowd import CrowdMotion
from evo_cpg.view.camera import BodyBoxes, course
from evo_cpg.view.scene import Panel, Staging, Track, mark_spacing, sample
from evo_cpg.view.scenery import LAMP
from evo_cpg.view.story import FPS, GLIDE, Overview
from evo_cpg.view.terrain import heights

# Number of lanes. Least width of a lane in the animal's length, its width and its height. Distance
# of the borders from the outer animals, in lengths.
_LANES, _LANE, _ROOMY, _HIGH, _NEARER = 7, 0.75, 1.25, 2.8, 0.2
# Largest factor by which lanes of few animals are wider. Number of other animals without lanes.
_WIDEST, _PILED = 2.0, 4
# A goal is in the view of the lanes if it is at most this many lengths away. Otherwise the view
# shows the path of the champion in the time of a crowd, or at least this many lengths.
_IN_VIEW, _LEAST = 5.0, 1.5
# Borders of the view around the lanes, in lengths: behind the start, beyond a goal, at the sides
# and, for swimmers, below and above.
_BEHIND, _BEYOND, _BESIDE, _UPRIGHT = 0.25, 0.3, 0.45, 0.3
# Elevation of the view of the lanes, rad: in water, and on land, where it shows a sky.
_IN_WATER, _ON_LAND = np.radians(24.0), np.radians(12.0)
# Elevation of a view of the whole path, rad.
_WHOLE = np.radians(40.0)
# Room ahead of the animal for an arrow, in lengths.
_AHEAD = 0.6
# Lengths behind the first animal of a race that its last view shows, before it, to its right, and
# above animals.
_TRAILING, _BEFORE, _RIGHT, _AROUND = 4.5, 1.4, 0.8, 0.2
# The finish stands on the last line that the champion passes this long before the end, s.
_BEFORE_END = GLIDE
# Distance of a body from the light that counts as reaching it, in lengths of the animal.
_REACHED = 0.15
# The floor under swimmers lies this far below them, and at most so far below the start, in lengths.
# Fraction of the bodies of a crowd that may be lower.
_FLOOR, _DEEPEST, _BELOW = 0.3, 1.2, 0.02
# Lanes have the same height if the difference is below this part of their width.
_LEVEL = 0.02


class Course(NamedTuple):
    """Path of the champion from the start to its goal.

    Attributes:
        start: place of the root at the start, m.
        bearing: direction of the course from the x axis, rad.
        ahead: the same as a level unit vector.
        aside: level unit vector to its left.
        corners: corners of the bodies at the start, m.
        length: length of the animal, m.
        lane: width of a lane, m. It is 0 among obstacles, where nothing can be moved aside.
        spacing: distance between the lines, m, or 0 on uneven ground, which has no lines.
        target: place of the light or of the finish, m, or None.
        finish: distance of the finish from the start, m. None with a light, or without lines.
        arrival: instant at which the champion touches the light or passes the finish, s, or None.
    """

    start: Float[np.ndarray, "3"]
    bearing: float
    ahead: Float[np.ndarray, "3"]
    aside: Float[np.ndarray, "3"]
    corners: Float[np.ndarray, "n 3"]
    length: float
    lane: float
    spacing: float
    target: Float[np.ndarray, "3"] | None
    finish: float | None
    arrival: float | None


class Tank(NamedTuple):
    """Lanes side by side, and the views that show them.

    Attributes:
        course: path of the first animal.
        lane: width of a lane, m.
        others: number of animals beside the first one.
        track: lines across the lanes, or None.
        floor: height of the floor under swimmers, m, or None.
        wide: view of all lanes.
        near: whether this view shows the goal.
        goal: place of the last line that the champion passes, m, and its name, or None.
    """

    course: Course
    lane: float
    others: int
    track: Track | None
    floor: float | None
    wide: Overview
    near: bool
    goal: tuple[Float[np.ndarray, "3"], str] | None

    def behind(self, first: Recording, others: CrowdMotion, time: float) -> Overview:
        """Return a view of the first animal and those close behind it, at a time (s)."""
        course, staging = self.course, self.staging(others.count)
        own = first.position[np.abs(first.time - time).argmin()]
        rest = others.position[np.abs(others.time - time).argmin()] + staging.lanes[:, None]
        bodies = np.concatenate([own, rest.reshape(-1, 3)])
        along = (bodies - course.start) @ course.ahead
        front = along[: len(own)].max()
        seen = bodies[along >= front - _TRAILING * course.length]
        room = course.length * np.array([_BEFORE * course.ahead, -_RIGHT * course.aside])
        upright = [0.0, 0.0, _AROUND * course.length]
        ahead = own[along[: len(own)].argmax()] + room[0]
        points = [*seen, *(seen + upright), ahead, ahead + room[1]]
        return self.wide._replace(points=np.array(points), follows=not self.near)

    def whole(self, animal: Recording, begin: float, end: float) -> Overview | None:
        """Return a view of an animal's path and of the lights between two instants (s).

        It is None for a light at rest, for which the camera follows the animal.
        """
        if not animal.moves_light:
            return None
        shown = (animal.time >= begin) & (animal.time <= end)
        points = np.concatenate([animal.position[shown].reshape(-1, 3), animal.light[shown]])
        # The longest side of the path lies across the picture.
        sides = np.linalg.svd(points[:, :2] - points[:, :2].mean(0), full_matrices=False)[2]
        along = sides[0] * np.sign(sides[0] @ (animal.light[-1] - animal.light[0])[:2] or 1.0)
        return Overview(points, float(np.arctan2(along[1], along[0])), _WHOLE)

    def staging(self, others: int) -> Staging:
        """Return the arrangement of some animals beside the first one. Few have wide lanes."""
        wide = min(self.others / max(others, 1), _WIDEST)
        lanes = wide * self.lane * np.arange(1, others + 1)[:, None] * self.course.aside
        return Staging(lanes, self.track, self.floor)


def course_of(panel: Panel, length: float, forward: bool) -> Course:
    """Return the course of a champion.

    Args:
        panel: the champion.
        length: length of the animal, m.
        forward: whether only displacement along x counts.
    """
    creature, recording = panel.creature, panel.recording
    path, goal = recording.position[:, creature.root_index], recording.goal
    lit, start = bool(np.isfinite(goal).all()), path[0]
    bearing = course(path, goal, length / 20) if lit or not forward else 0.0
    ahead = np.array([np.cos(bearing), np.sin(bearing), 0.0])
    aside = np.array([-ahead[1], ahead[0], 0.0])
    clip = sample(recording, FPS)
    box = np.array([body.shape.half_extents for body in creature.bodies])
    corners = BodyBoxes(clip.position[:1], clip.rotation[:1], box).corners()[0]
    across = (corners - start) @ aside
    lane = max(_LANE * length, _ROOMY * np.ptp(across), _HIGH * np.ptp(corners[:, 2]))
    progress, spacing = (path - start) @ ahead, mark_spacing(length)
    if (ground := panel.ground) is not None:
        if ground.obstacles:
            lane = spacing = 0.0
        elif ground.level is None:
            # Lines need the same height in all lanes, as far as the champion comes.
            along, across = np.linspace(0.0, progress.max(), 12), lane * np.arange(_LANES)
            place = start + along[:, None, None] * ahead + across[:, None] * aside
            rise = np.ptp(heights(ground.floor, place[..., :2]), axis=1).max()
            spacing = spacing if rise <= _LEVEL * lane else 0.0
    target, finish, arrival = None, None, None
    if lit:
        target = goal
        own = np.einsum("tbij,tbi->tbj", recording.rotation, goal - recording.position)
        away = np.linalg.norm(np.maximum(np.abs(own) - box, 0.0), axis=-1).min(1)
        # A light that moves is never reached for good.
        if away.min() <= _REACHED * length and not recording.moves_light:
            touching = away <= away.min() + LAMP * length / 2
            arrival = float(recording.time[touching.argmax()])
    elif spacing:
        passed = progress[recording.time <= recording.time[-1] - _BEFORE_END].max(initial=0.0)
        if passed >= spacing:
            finish = float(np.floor(passed / spacing) * spacing)
            arrival = float(recording.time[(progress >= finish).argmax()])
            target = start + finish * ahead
    path_ahead, goal_ahead = (start, bearing, ahead, aside), (target, finish, arrival)
    return Course(*path_ahead, corners, length, float(lane), spacing, *goal_ahead)


def tank_of(panel: Panel, course: Course, crowds: Sequence[CrowdMotion], seconds: float) -> Tank:
    """Return the lanes for a champion and its earlier generations.

    Args:
        panel: the champion.
        course: its course.
        crowds: the generations.
        seconds: length of a crowd's motion, s.
    """
    start, ahead, corners = course.start, course.ahead, course.corners
    length, target, finish = course.length, course.target, course.finish
    recording, land, lane = panel.recording, panel.ground is not None, course.lane
    path = recording.position[:, panel.creature.root_index]
    early = recording.time <= recording.time[0] + seconds
    shown = max(float(((path[early] - start) @ ahead).max()), _LEAST * length)
    away = np.inf if target is None else float((target - start) @ ahead)
    near = target is not None and away <= _IN_VIEW * length
    end = away + _BEYOND * length if near else shown + _AHEAD * length
    along = (corners - start) @ ahead
    low, high = corners[:, 2].min(), corners[:, 2].max()
    if not land:
        low, high = low - _UPRIGHT * length, high + _UPRIGHT * length
    rise = target[2] - start[2] if target is not None and near and finish is None else 0.0
    points = [
        [*(start + to_end * ahead + to_left * course.aside)[:2], height]
        for to_end, up in ((along.min() - _BEHIND * length, 0.0), (end, rise))
        for to_left in (-_BESIDE * length, _BESIDE * length + lane * (_LANES - 1))
        for height in (low + up, high + up)
    ]
    wide = Overview(np.array(points), course.bearing, _ON_LAND if land else _IN_WATER)
    track = None
    # Near lights are the only goal. Otherwise lines show how far the animals come.
    if course.spacing and not (near and finish is None):
        lines = int(np.ceil((finish or end) / course.spacing))
        # On the viewer's side, captions are below.
        sides = _NEARER * length, lane * (_LANES - 1) + _NEARER * length
        track = Track(start, course.bearing, course.spacing, lines, *sides, finish)
    floor = None
    if not land:
        # The floor is below the champion, its goal and most of the crowds.
        depths = [recording.position[..., 2].min()]
        depths += [target[2]] if target is not None else []
        depths += [np.quantile(crowd.position[..., 2], _BELOW) for crowd in crowds]
        lowest = max(min(depths), start[2] - _DEEPEST * length)
        reach = max(body.shape.reach for body in panel.creature.bodies)
        floor = float(lowest - reach - _FLOOR * length)
    goal = None if target is None or finish is None else (target, f"{finish:g} m")
    others = _LANES - 1 if lane else _PILED
    return Tank(course, lane, others, track, floor, wide, near, goal)


def in_lanes(
    crowd: CrowdMotion, root: int, heading: str, count: int
) -> tuple[Recording, CrowdMotion]:
    """Return the first animal of a crowd, and the animals of the other lanes.

    The others are those at even ranks of progress, so that they show the whole crowd as it is. The
    first animals of a population would not, because these are the elites.

    Args:
        crowd: the animals, the leader first.
        root: number of the root body.
        heading: ``forward`` if only displacement along x counts.
        count: number of other animals.
    """
    ranked = 1 + np.argsort(-crowd.advance(root, heading)[1:])
    count = min(count, len(ranked))
    chosen = ranked[((np.arange(count) + 0.5) / max(count, 1) * len(ranked)).astype(int)]
    # Neighbours differ, as in the population.
    return crowd.recording(0, root), crowd.of(np.sort(chosen))
