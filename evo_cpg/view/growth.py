"""Ancestors of an animal in one shot: each moves for a while, then becomes the next one.

All parts of all ancestors are the bodies of one creature. A part that continues an earlier part
(`evo_cpg.analysis.descent.matched`) is the same body. In every frame a body has its own size, which
is 0 before the part grows and after it is lost.

While an ancestor becomes the next one, both move on. Sizes of bodies, places of joints, rotations
relative to the parents, and the pose of the root are then weighted means of both. Limbs therefore
stay at their joints. The next ancestor is turned about the vertical and moved, so that its parts
lie as near as possible to those that they continue. It starts at the instant at which they are
nearest, because the strokes of both then agree best.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from evo_cpg.analysis.descent import Milestone
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.development import Plan
from evo_cpg.simulation.planned import SINK
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.crowd import CrowdMotion
from evo_cpg.view.scene import Growth, sample_at
from evo_cpg.view.story import eased

# Time for which an ancestor moves between changes, time of a change, and time in which the colour
# of a new part fades, s.
_MOVES, _CHANGE, _FADES = 2.4, 1.4, 1.8
# Instants of a trial at which an ancestor may start, s. Trials start from rest.
_STARTS = np.linspace(1.0, 1.8, 17)
RATE = 60
"""Instants per second of the motion."""
NEEDED = _STARTS[-1] + _MOVES + 2 * _CHANGE
"""Time of a trial that is shown at most, s."""
# Least size of a body, relative to its full size, because no matrix may be singular.
_LEAST = 1e-3

_LEVEL = np.eye(3)
# Centres of bodies and their rotations over some frames.
_Seen = tuple[Float[np.ndarray, "frames b 3"], Float[np.ndarray, "frames b 3 3"]]


def grown(
    steps: Sequence[Milestone], motions: Sequence[Recording], stands: bool
) -> tuple[Plan, Recording, Growth]:
    """Return a plan of all parts of some ancestors, its motion, and its growth.

    Args:
        steps: the ancestors.
        motions: their motion, with the bodies of their plans.
        stands: whether they are on the ground, so that their height must not change.
    """
    union, places = joined(steps)
    moves, change = round(_MOVES * RATE), round(_CHANGE * RATE)
    begins = (moves + change) * np.arange(1, len(steps)) - change
    frame = np.arange((moves + change) * len(steps))
    ramps = eased((frame - begins[:, None]) / change)
    weights = -np.diff(ramps, axis=0, prepend=1.0, append=0.0)
    shape = len(frame), len(union.parent)
    half, place, share, turn = (np.zeros((*shape, *x)) for x in ((3,), (3,), (1,), (3, 3)))
    root, fresh, seen = np.zeros((len(frame), 3)), np.zeros(shape), None
    for k, (step, own, motion) in enumerate(zip(steps, places, motions, strict=True)):
        shown = np.flatnonzero(weights[k])
        shown = np.arange(shown[0], shown[-1] + 1)
        if seen is None:
            seen = _seen(motion, _STARTS[0], len(shown))
        else:
            before = tuple(x[-change:] for x in seen)
            seen = _seen(motion, *_alike(before, step, motion, len(shown), stands))
            faded = 1 - (frame - begins[k - 1] - change) / (_FADES * RATE)
            fresh[:, own[step.match < 0]] = (ramps[k - 1] * faded.clip(0, 1))[:, None]
        weight, at = weights[k, shown, None, None], np.ix_(shown, own)
        half[at] += weight * step.plan.half
        place[at] += weight * step.plan.place / step.plan.half[step.plan.parent.clip(0)]
        share[at] += weight
        turns = seen[1].copy()
        turns[:, 1:] = seen[1][:, step.plan.parent[1:]].mT @ seen[1][:, 1:]
        turn[at] += weight[..., None] * turns
        root[shown] += weight[:, 0] * seen[0][:, 0]
    # The nearest rotation to a mean of rotations. Bodies that are absent have none.
    left, _, right = np.linalg.svd(turn + (share == 0)[..., None] * np.eye(3))
    left[..., -1] *= np.linalg.det(left @ right)[..., None]
    position, rotation = _posed(
        np.asarray(union.parent), root, left @ right, place / share.clip(1e-9), half
    )
    whole = CrowdMotion(frame / RATE, position[:, None], rotation[:, None], np.full(3, np.nan))
    scale = np.maximum(half / union.half, _LEAST)
    return union, whole.recording(0, 0), Growth(scale, fresh, (0.0, *begins / RATE))


def joined(steps: Sequence[Milestone]) -> tuple[Plan, list[Int[np.ndarray, " n"]]]:
    """Return a plan of all parts in their last form, and the places of each ancestor's bodies."""
    last: list[tuple[Plan, int]] = []
    parents: list[int] = []
    places: list[np.ndarray] = []
    for step in steps:
        own = np.zeros(len(step.match), int)
        for i, old in enumerate(step.match):
            own[i] = len(last) if old < 0 else places[-1][old]
            if old < 0:
                last.append((step.plan, i))
                parents.append(own[step.plan.parent[i]] if i else -1)
            last[own[i]] = step.plan, i
        places.append(own)
    fields: Any = [np.array([plan[k][i] for plan, i in last]) for k in range(len(Plan._fields))]
    return Plan(*fields)._replace(parent=np.array(parents)), places


def _seen(
    motion: Recording, start: float, count: int, turn: np.ndarray = _LEVEL, shift: Any = 0.0
) -> _Seen:
    """Return the bodies of an ancestor over some frames from an instant (s) on, moved."""
    clip = sample_at(motion, start + np.arange(count) / RATE, RATE)
    return clip.position @ turn.T + shift, turn @ clip.rotation


def _alike(
    before: _Seen, step: Milestone, motion: Recording, count: int, stands: bool
) -> tuple[float, int, np.ndarray, np.ndarray]:
    """Return the arguments of `_seen` with which an ancestor is nearest to the one before."""
    kept, reach = np.flatnonzero(step.match >= 0), step.plan.half[0].max()
    found = []

    def points(seen: _Seen, bodies: np.ndarray) -> np.ndarray:
        # The axes of the root show its attitude if few parts are left.
        axes = seen[0][:, :1] + reach * seen[1][:, 0].mT
        return np.concatenate([seen[0][:, bodies], axes], axis=1)

    here = points(before, step.match[kept])
    for start in _STARTS:
        there = points(_seen(motion, start, len(here)), kept)
        middle, centre = here.mean((0, 1)), there.mean((0, 1))
        a, b = here - middle, there - centre
        across = (b[..., 0] * a[..., 1] - b[..., 1] * a[..., 0]).sum()
        angle = np.arctan2(across, (a[..., :2] * b[..., :2]).sum())
        turn = np.asarray(euler_to_matrix(0.0, 0.0, angle))
        shift = (middle - turn @ centre) * (1, 1, not stands)
        found.append((((a - b @ turn.T) ** 2).sum(), (start, count, turn, shift)))
    return min(found, key=lambda one: one[0])[1]


def _posed(
    parent: Int[np.ndarray, " b"],
    root: Float[np.ndarray, "t 3"],
    turn: Float[np.ndarray, "t b 3 3"],
    place: Float[np.ndarray, "t b 3"],
    half: Float[np.ndarray, "t b 3"],
) -> _Seen:
    """Return the bodies with some sizes, rotations relative to parents, and relative places."""
    position, rotation = np.zeros_like(half), turn.copy()
    position[:, 0] = root
    for i in range(1, len(parent)):
        above = parent[i]
        rotation[:, i] = rotation[:, above] @ turn[:, i]
        on = SINK * (place[:, i] * half[:, above])[..., None]
        position[:, i] = position[:, above] + (rotation[:, above] @ on)[..., 0]
        position[:, i] += SINK * half[:, i, :1] * rotation[:, i, :, 0]
    return position, rotation
