"""Ancestors of an animal in one shot: each swims for a while, then becomes the next one.

All parts of all ancestors are the bodies of one creature. A part that continues an earlier part
(`evo_cpg.analysis.descent.matched`) is the same body. In every frame a body has its own size, which
is 0 before the part grows and after it is lost.

While an ancestor becomes the next one, both move on. Sizes of bodies, places of joints, rotations
relative to the parents, and the pose of the root are then means of both with changing weights.
Limbs therefore stay at their joints. The next ancestor is turned about the vertical and moved, so
that its parts lie as near as possible to those that they continue. It starts at the instant at
which they are nearest, because the strokes of both then agree best.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from evo_cpg.analysis.descent import Step
from evo_cpg.creature.development import Plan
from evo_cpg.simulation.planned import SINK
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.crowd import CrowdMotion
from evo_cpg.view.scene import Growth, sample_at
from evo_cpg.view.story import eased

# Time for which an ancestor moves between changes, time of a change, and time in which the colour
# of a new part fades, s.
_MOVES, _CHANGE, _FADES = 2.4, 1.4, 1.8
# Instant of a trial from which on an ancestor is shown, because trials start from rest, and time by
# which it may be later, s. Number of instants that are tried.
_START, _LATER, _TRIED = 1.0, 0.8, 17
NEEDED = _START + _LATER + _MOVES + 2 * _CHANGE
"""Time of a trial that is shown at most, s. All times are shorter if trials are shorter."""
RATE = 60
"""Instants per second of the motion."""
# Least size of a body, relative to its full size, because no matrix may be singular.
_LEAST = 1e-3

# Centres of bodies and their rotations over some frames.
_Seen = tuple[Float[np.ndarray, "frames b 3"], Float[np.ndarray, "frames b 3 3"]]


class _Pose(NamedTuple):
    """An ancestor over some frames, among the bodies of all ancestors.

    Attributes:
        present: whether the ancestor has the body.
        half: half extents, m, or 0.
        place: joint on the parent, relative to the parent's half extents.
        turn: rotation relative to the parent, and of the root in the world.
        root: centre of the root, m.
    """

    present: np.ndarray
    half: np.ndarray
    place: np.ndarray
    turn: np.ndarray
    root: np.ndarray


class _Move(NamedTuple):
    """A turn about a centre, which then comes to another place, m."""

    turn: np.ndarray = np.eye(3)
    centre: np.ndarray = np.zeros(3)
    place: np.ndarray = np.zeros(3)


def grown(
    steps: Sequence[Step], motions: Sequence[Recording], stands: bool
) -> tuple[Plan, Recording, Growth]:
    """Return a plan of all parts of some ancestors, its motion, and its growth.

    Args:
        steps: the ancestors.
        motions: their motion, with the bodies of their plans.
        stands: whether they are on the ground, so that their height must not change.
    """
    union, places = joined(steps)
    count, unit = len(union.parent), RATE * min(1.0, motions[0].time[-1] / NEEDED)
    change, start, move = round(_CHANGE * unit), _START * unit / RATE, _Move()
    frames, fresh, begins = [], [], [0.0]
    for number, (step, own, motion) in enumerate(zip(steps, places, motions, strict=True)):
        last = number + 1 == len(steps)
        moves = round(_MOVES * unit * (1 + last))
        seen = _seen(motion, start, moves + change * (not last), move)
        pose, weight = _pose(step, own, seen, count), np.zeros(len(seen[0]))
        new = np.zeros((len(weight), count))
        if number:
            faded = 1 - np.arange(len(weight)) / (_FADES * unit)
            new[:, own[step.match < 0]] = faded.clip(0)[:, None]
        other = pose
        if not last:
            weight[moves:] = eased(np.arange(change) / change)
            start, move = _alike(seen, change, steps[number + 1], motions[number + 1], stands, unit)
            after = _seen(motions[number + 1], start, change, move)
            # The next ancestor waits until it appears.
            waits = tuple(np.concatenate([x[:1].repeat(moves, 0), x]) for x in after)
            other = _pose(steps[number + 1], places[number + 1], waits, count)
            new[:, other.present & ~pose.present] = weight[:, None]
            start += change / RATE
            begins.append(begins[-1] + (moves + change * (number > 0)) / RATE)
        frames.append(_between(pose, other, weight, union.parent))
        fresh.append(new)
    position, rotation, half = (np.concatenate(x) for x in zip(*frames, strict=True))
    time, full = np.arange(len(position)) / RATE, CrowdMotion
    motion = full(time, position[:, None], rotation[:, None], np.full(3, np.nan)).recording(0, 0)
    scale = np.maximum(half / union.half, _LEAST)
    return union, motion, Growth(scale, np.concatenate(fresh), tuple(begins))


def joined(steps: Sequence[Step]) -> tuple[Plan, list[Int[np.ndarray, " n"]]]:
    """Return a plan of all parts in their last form, and the places of each ancestor's bodies."""
    last: list[tuple[Plan, int]] = []
    parents: list[int] = []
    places: list[np.ndarray] = []
    for plan, match in ((step.plan, step.match) for step in steps):
        own: list[int] = []
        for i, old in enumerate(match):
            own.append(len(last) if old < 0 else int(places[-1][old]))
            if old < 0:
                last.append((plan, i))
                parents.append(own[plan.parent[i]] if i else -1)
            last[own[-1]] = plan, i
        places.append(np.array(own))
    fields = [np.array([getattr(plan, name)[i] for plan, i in last]) for name in Plan._fields]
    return Plan(*fields)._replace(parent=np.array(parents)), places


def _seen(motion: Recording, start: float, count: int, move: _Move = _Move()) -> _Seen:
    """Return the bodies of an ancestor over some frames from an instant on, s."""
    clip = sample_at(motion, start + np.arange(count) / RATE, RATE)
    return (clip.position - move.centre) @ move.turn.T + move.place, move.turn @ clip.rotation


def _pose(step: Step, own: np.ndarray, seen: _Seen, count: int) -> _Pose:
    """Return the pose of an ancestor among some bodies, of which it has its own."""
    position, rotation = seen
    present, turn = np.zeros(count, bool), np.tile(np.eye(3), (len(position), count, 1, 1))
    half, place = np.zeros((2, count, 3))
    present[own], half[own] = True, step.plan.half
    place[own] = step.plan.place / step.plan.half[step.plan.parent.clip(0)]
    turn[:, own] = np.concatenate(
        [rotation[:, :1], rotation[:, step.plan.parent[1:]].mT @ rotation[:, 1:]], axis=1
    )
    return _Pose(present, half, place, turn, position[:, 0])


def _alike(
    seen: _Seen, change: int, step: Step, motion: Recording, stands: bool, unit: float
) -> tuple[float, _Move]:
    """Return the instant at which an ancestor starts, s, and its move to the one before.

    The last frames of the one before and the first ones of the ancestor are compared.
    """
    reach, kept = step.plan.half[0].max(), np.flatnonzero(step.match >= 0)

    def points(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        # The axes of the root show its attitude if few parts are left.
        return np.concatenate([position, position[:, :1] + reach * rotation[:, 0].mT], axis=1)

    here = points(seen[0][-change:, step.match[kept]], seen[1][-change:])
    found = []
    for start in (_START + np.linspace(0, _LATER, _TRIED)) * unit / RATE:
        own, turns = _seen(motion, start, change)
        there = points(own[:, kept], turns)
        a, b = (x - x.mean((0, 1)) for x in (here, there))
        across = (b[..., 0] * a[..., 1] - b[..., 1] * a[..., 0]).sum()
        angle = np.arctan2(across, (a[..., :2] * b[..., :2]).sum())
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        centre, place = there.mean((0, 1)), here.mean((0, 1))
        place[2] = centre[2] if stands else place[2]
        found.append((float(((a - b @ turn.T) ** 2).sum()), float(start), _Move(turn, centre, place)))
    _, start, move = min(found, key=lambda one: one[0])
    return start, move


def _between(
    one: _Pose, other: _Pose, weight: Float[np.ndarray, " frames"], parent: Int[np.ndarray, " b"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return centres, rotations and half extents of bodies between two ancestors.

    A body that only one of them has keeps its joint's place and rotation, and only its size changes.
    """
    # SciPy takes long to import.
    from scipy.spatial.transform import Rotation

    count, w = len(parent), weight[:, None, None]
    only, others = one.present[:, None], other.present[:, None]
    pairs = [(one.half, other.half)]
    pairs.append((np.where(only, one.place, other.place), np.where(others, other.place, one.place)))
    half, place = (a * (1 - w) + b * w for a, b in pairs)
    turns = np.where(only[..., None], one.turn, other.turn), np.where(others[..., None], other.turn, one.turn)
    first, second = (Rotation.from_matrix(turn.reshape(-1, 3, 3)) for turn in turns)
    part = Rotation.from_rotvec(weight.repeat(count)[:, None] * (first.inv() * second).as_rotvec())
    turn = (first * part).as_matrix().reshape(len(weight), count, 3, 3)
    position = np.zeros_like(half)
    position[:, 0] = one.root * (1 - w[:, 0]) + other.root * w[:, 0]
    for i in range(1, count):
        on = SINK * place[:, i] * half[:, parent[i]]
        near = position[:, parent[i]] + np.einsum("fij,fj->fi", turn[:, parent[i]], on)
        turn[:, i] = turn[:, parent[i]] @ turn[:, i]
        position[:, i] = near + SINK * half[:, i, :1] * turn[:, i, :, 0]
    return position, turn, half
