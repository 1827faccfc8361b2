"""Lanes for the animals of a story, the views that show them, and the goal.

All animals of a generation start at the same place and would hide each other. In the film, each has
a lane of its own, and a light of its own if there is one. Only the drawing is moved.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.physics.contact_model import Ground
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.crowd_motion import CrowdMotion
from evo_cpg.view.camera import Bodies, course, overview, project
from evo_cpg.view.clip import sample
from evo_cpg.view.look import STYLES
from evo_cpg.view.scene import Panel, Staging, Track, animal_reach, mark_spacing
from evo_cpg.view.story import FPS, Overview
from evo_cpg.view.terrain import heights

# Number of lanes in a wide and in a tall picture. Width of a lane, in lengths of the animal and in
# its own width.
_WIDE, _TALL, _LANE, _ROOMY = 7, 5, 0.75, 1.25
# A goal is in the view of the lanes if it is at most this many lengths away. Otherwise the view
# shows this part of the champion's way in the race, and room for an arrow.
_IN_VIEW, _PART = 7.0, 0.9
# Borders of the view around the lanes, in lengths: behind the start, beyond the end, at the sides
# and, for swimmers, below and above.
_BEHIND, _BEYOND, _BESIDE, _UPRIGHT = 0.55, 0.2, 0.45, 0.3
# Elevation of the view of the lanes, rad: in water, and on land, where it shows a sky.
_IN_WATER, _ON_LAND = np.radians(24.0), np.radians(12.0)
# Least part of the picture's width for the animal next to its goal, in the view of the title. Room
# ahead of the animal for an arrow, in lengths.
_SMALLEST, _AHEAD = 0.16, 0.9
# The finish stands on the last line that the champion passes this long before the end, s.
_BEFORE_END = 0.7
# The floor under swimmers lies this far below them, and at most so far below the start, in lengths.
_FLOOR, _DEEPEST = 0.3, 1.2
# Two places have the same height if the difference is below this part of the animal's length.
_LEVEL = 0.01


class Tank(NamedTuple):
    """Lanes side by side with their goal, and the views that show them.

    Attributes:
        lanes: number of lanes.
        lane: width of a lane, m. It is 0 on uneven ground, where nothing can be moved aside.
        aside: direction from the first lane to the others.
        track: lines across the lanes, or None.
        floor: height of the floor under swimmers, m, or None.
        title: view of the first animal, and of its goal if it is near.
        wide: view of all lanes.
        goal: place of the finish, m, and its name, or None.
        finish: instant at which the champion passes the finish, s, or None.
    """

    lanes: int
    lane: float
    aside: Float[np.ndarray, "3"]
    track: Track | None
    floor: float | None
    title: Overview
    wide: Overview
    goal: tuple[Float[np.ndarray, "3"], str] | None
    finish: float | None

    def staging(self, others: int) -> Staging:
        """Return the arrangement of some animals beside the first one."""
        lanes = self.lane * np.arange(1, others + 1)[:, None] * self.aside
        return Staging(lanes, self.track, self.floor)


def tank_of(
    panel: Panel, crowds: Sequence[CrowdMotion], length: float, seconds: float, forward: bool,
    aspect: float,
) -> Tank:  # fmt: skip
    """Return the lanes for a champion and its earlier generations.

    Args:
        panel: the champion.
        crowds: the generations.
        length: length of the animal, m.
        seconds: length of the race, s.
        forward: whether only displacement along x counts.
        aspect: width of the picture over its height.
    """
    creature, recording, land = panel.creature, panel.recording, panel.ground is not None
    path, goal = recording.position[:, creature.root_index], recording.goal
    lit, start = bool(np.isfinite(goal).all()), path[0]
    bearing = course(path, goal, length / 20) if lit or not forward else 0.0
    ahead = np.array([np.cos(bearing), np.sin(bearing), 0.0])
    aside = np.array([-ahead[1], ahead[0], 0.0])
    clip = sample(recording, FPS)
    box = np.array([body.shape.half_extents for body in creature.bodies])
    corners = Bodies(clip.position[:1], clip.rotation[:1], box).corners()[0]
    across = (corners - start) @ aside
    count = _WIDE if aspect >= 1 else _TALL
    lane = max(_LANE * length, _ROOMY * float(np.ptp(across)))
    way = (path - start) @ ahead
    shown = max(_PART * float(way[recording.time <= recording.time[0] + seconds].max()), length)
    spacing = mark_spacing(length)
    if panel.ground is not None and not _flat(
        panel.ground, start, ahead, aside, shown, lane * count
    ):
        lane, spacing = 0.0, 0.0
    finish = None
    if not lit and spacing:
        passed = way[recording.time <= recording.time[-1] - _BEFORE_END].max(initial=0.0)
        finish = float(np.floor(passed / spacing) * spacing) or None
    target = goal if lit else None if finish is None else start + finish * ahead
    away = np.inf if target is None else float((target - start) @ ahead)
    near = target is not None and away <= _IN_VIEW * length
    end = away if near else shown
    rise = (target[2] - start[2]) if near and lit else 0.0
    border = _BESIDE * length + lane * (count - 1)
    low, high = corners[:, 2].min(), corners[:, 2].max()
    if not land:
        low, high = low - _UPRIGHT * length, high + _UPRIGHT * length

    def place(along: float, to_left: float, height: float) -> np.ndarray:
        return start + along * ahead + to_left * aside + [0.0, 0.0, height - start[2]]

    beyond = end + (_BEYOND if near else _AHEAD) * length
    points = [
        place(along, to_left, height + up)
        for along, up in ((-_BEHIND * length, 0.0), (beyond, rise))
        for to_left in (-_BESIDE * length, border)
        for height in (low, high)
    ]
    elevation = _ON_LAND if land else _IN_WATER
    wide = Overview(np.array(points), bearing, elevation)
    look = STYLES[panel.world]
    first = [*corners, start + _AHEAD * length * ahead]
    title = Overview(np.array(first), bearing, look.side_elevation, titled=True)
    if near:
        both = title._replace(points=np.concatenate([corners, target[None]]))
        seen = overview(both.points, bearing, both.elevation, aspect, titled=True)
        if np.ptp(project(seen, corners[None], aspect)[0, :, 0]) / 2 >= _SMALLEST:
            title = both
    track = None
    if spacing and not (lit and near):
        lines = int(np.ceil((finish or beyond) / spacing))
        track = Track(start, bearing, spacing, lines, 0.7 * lane, lane * (count - 0.3), finish)
    floor = None
    if not land:
        reach = animal_reach(creature)
        depths = [recording.position[..., 2].min(), *([goal[2]] if lit else [])]
        depths += [float(np.quantile(crowd.position[..., 2], 0.02)) for crowd in crowds]
        floor = max(min(depths), start[2] - _DEEPEST * length) - reach - _FLOOR * length
    named = None if finish is None or lit else (target, "finish")
    crossed = None if finish is None else float(recording.time[(way >= finish).argmax()])
    return Tank(count, lane, aside, track, floor, title, wide, named, crossed)


def in_lanes(
    crowd: CrowdMotion, root: int, heading: str, count: int
) -> tuple[Recording, CrowdMotion]:
    """Return the leader of a crowd, and the animals of the other lanes.

    The others are those at even ranks of progress, so that they show the whole crowd as it is. The
    first animals of a population would not, because these are the elites.
    """
    ranked = np.argsort(-crowd.advance(root, heading))
    chosen = ranked[np.linspace(0, crowd.count - 1, min(count, crowd.count)).round().astype(int)]
    # Neighbours differ, as in the population.
    return crowd.recording(int(chosen[0]), root), crowd.of(np.sort(chosen[1:]))


def _flat(
    ground: Ground,
    start: np.ndarray,
    ahead: np.ndarray,
    aside: np.ndarray,
    along: float,
    wide: float,
) -> bool:
    """Return whether ground has no obstacles, and the same height in all lanes."""
    if ground.obstacles:
        return False
    if ground.level is not None:
        return True
    s, w = np.meshgrid(np.linspace(0, along, 12), np.linspace(0, wide, 6), indexing="ij")
    place = start[:2] + s[..., None] * ahead[:2] + w[..., None] * aside[:2]
    found = heights(ground.floor, place)
    return bool(np.ptp(found, axis=1).max() <= _LEVEL * max(along, wide))
