"""Footfalls: which foot is on the ground when, for how long, and whether it stays where it stands.

| word | meaning | source |
|---|---|---|
| stance | a time in which a foot touches the ground | |
| duty factor | share of the time that a foot spends in stance | Alexander and Jayes 1983 |
| phase of a foot | where in a reference foot's stride it touches down, 0 to 1 | Hildebrand 1965 |
| airborne share | share of the time in which nothing touches | |
| slip | speed over the ground of what stays on it | |

A *foot* is whatever touches: nothing here knows a leg from a belly.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

# Contacts and breaks that last less are chatter, s, but at most so much of a stride.
_CHATTER, _CHATTER_FRACTION = 0.05, 0.1
# Coefficients of variation that differ by less are the same: the grid of the samples makes some.
_AS_REGULAR = 0.05


class Phases(NamedTuple):
    """When feet touch down in the stride of one of them.

    Attributes:
        reference: number of the foot whose touch-downs begin the strides; None where no foot
            touches down twice.
        phase: mean of each foot, shares of a stride from 0 to 1; NaN where it does not touch down.
        regularity: length of the mean vector, from 0 (at any time) to 1 (always at the same);
            likewise.
    """

    reference: int | None
    phase: Float[np.ndarray, " f"]
    regularity: Float[np.ndarray, " f"]


def touching(
    force: Float[np.ndarray, "t 3 p"], owners: Int[np.ndarray, " p"], bodies: Sequence[int]
) -> Bool[np.ndarray, "t f"]:
    """Whether bodies touch the ground in each sample, as the measure ``duty_factor`` has it.

    Args:
        force: of the ground on every contact point, N.
        owners: number of the body that each point is on.
        bodies: numbers of those that are asked for.
    """
    touched = (force != 0).any(1)
    return np.stack([touched[:, owners == body].any(1) for body in bodies], -1)


def settled(
    touched: Bool[np.ndarray, "t f"], step: float, shortest: float
) -> Bool[np.ndarray, "t f"]:
    """The same without chatter: breaks are closed and then touches dropped that are too short.

    What is cut by the edges of the record stays.

    Args:
        touched: whether each foot touches in each sample.
        step: between samples, s.
        shortest: breaks and touches that last less are none, s.
    """
    found = touched.copy()
    for foot in found.T:
        for state in (False, True):
            for first, last in _runs(foot == state):
                inner = first > 0 and last < len(foot)
                if inner and (last - first) * step < shortest * (1 - 1e-9):
                    foot[first:last] = not state
    return found


def chatter(frequency: float) -> float:
    """What a contact or a break must last not to be chatter, s.

    Args:
        frequency: strides a second; NaN where there is no stride.
    """
    return min(_CHATTER, _CHATTER_FRACTION / frequency) if frequency > 0 else _CHATTER


def stances(touched: Bool[np.ndarray, " t"], step: float) -> Float[np.ndarray, "n 2"]:
    """Beginning and end of every stance of a foot, s from the first sample.

    Those that the record cuts begin with it at 0 or end with it.

    Args:
        touched: whether the foot touches in each sample.
        step: between samples, s.
    """
    return step * np.array(_runs(touched), float).reshape(-1, 2)


def touch_downs(touched: Bool[np.ndarray, " t"], step: float) -> Float[np.ndarray, " n"]:
    """Instants at which a foot comes to the ground, s; one that stands at the start does not."""
    return step * (1 + np.flatnonzero(~touched[:-1] & touched[1:]))


def duty_factors(touched: Bool[np.ndarray, "t f"]) -> Float[np.ndarray, " f"]:
    """Share of the time on the ground of each foot; NaN of one that never touches it."""
    fraction = touched.mean(0)
    return np.where(fraction > 0, fraction, np.nan)


def airborne_fraction(touched: Bool[np.ndarray, "t f"]) -> float:
    """Share of the time in which nothing touches."""
    return float((~touched.any(1)).mean())


def phases(touched: Bool[np.ndarray, "t f"], step: float) -> Phases:
    """When in its stride each foot touches down, by the touch-downs of a reference foot.

    A touch-down at t between two of the reference, a and b, has the phase (t - a) / (b - a)
    (Hildebrand 1965). The means are those of directions (Fisher 1993). The reference is
    the first of the feet that touch down most regularly: whose times between touch-downs have the
    smallest coefficient of variation, but for 0.05, of those with half as many as any or more.

    Args:
        touched: whether each foot touches in each sample, without chatter.
        step: between samples, s.
    """
    downs = [touch_downs(foot, step) for foot in touched.T]
    count = len(downs)
    nothing = np.full(count, np.nan)
    strides = [np.diff(down) for down in downs]
    most = max((len(stride) for stride in strides), default=0)
    if not most:
        return Phases(None, nothing, nothing.copy())
    spread = np.array(
        [
            stride.std() / stride.mean() if len(stride) >= max(1, most / 2) else np.inf
            for stride in strides
        ]
    )
    reference = int(np.argmax(spread <= spread.min() + _AS_REGULAR))
    begin = downs[reference]
    phase, regularity = nothing, nothing.copy()
    for i, down in enumerate(downs):
        inside = down[(down >= begin[0]) & (down < begin[-1])]
        if not len(inside):
            continue
        stride = np.searchsorted(begin, inside, "right") - 1
        fraction = (inside - begin[stride]) / (begin[stride + 1] - begin[stride])
        mean = np.exp(2j * np.pi * fraction).mean()
        # A rounding error below 0 is 0 and not 1.
        phase[i] = round(float(np.angle(mean) / (2 * np.pi)), 9) % 1.0
        regularity[i] = abs(mean)
    return Phases(reference, phase, regularity)


def slip_speeds(
    position: Float[np.ndarray, "t f 3"],
    rotation: Float[np.ndarray, "t f 3 3"],
    lowest: Float[np.ndarray, "t f 3"],
    touched: Bool[np.ndarray, "t f"],
    step: float,
) -> Float[np.ndarray, " f"]:
    """Mean horizontal speed of each foot's lowest point while it touches, m/s.

    It is the speed of the point of the foot that is lowest at the moment, and not that of the
    lowest place: a wheel that rolls does not slip. A sample in which it touches may begin before it
    touches down, or end after it lifts off: those count whose neighbours touch, too. NaN of a foot
    that never touches in three in a row.

    Args:
        position: of the origin of each foot's frame, m.
        rotation: foot to world.
        lowest: the lowest point of each foot in its own frame, m.
        touched: whether it touches at any time between a sample and the next.
        step: between samples, s.
    """
    here = position[:-1] + np.einsum("tfij,tfj->tfi", rotation[:-1], lowest[:-1])
    there = position[1:] + np.einsum("tfij,tfj->tfi", rotation[1:], lowest[:-1])
    speed = np.linalg.norm((there - here)[..., :2], axis=-1) / step
    beside = np.pad(touched, ((1, 1), (0, 0)), constant_values=True)
    on = (beside[:-2] & touched & beside[2:])[:-1]
    time = on.sum(0)
    return np.where(time > 0, (speed * on).sum(0) / np.maximum(time, 1), np.nan)


def _runs(state: Bool[np.ndarray, " t"]) -> list[tuple[int, int]]:
    """First sample of each stretch in which it holds, and the one after its last."""
    edges = np.diff(np.concatenate([[False], state, [False]]).astype(int))
    begin, end = (np.flatnonzero(sign * edges > 0).tolist() for sign in (1, -1))
    return list(zip(begin, end, strict=True))
