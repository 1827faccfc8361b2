"""Footfalls: instants and durations of contact of each foot.

| word | meaning | source |
|---|---|---|
| stance | interval in which a foot touches the ground | |
| duty factor | fraction of the time that a foot spends in stance | Alexander and Jayes 1983 |
| phase of a foot | its touch-down in the stride of a reference foot, 0 to 1 | Hildebrand 1965 |
| airborne fraction | fraction of the time in which nothing touches the ground | |

A *foot* is any body that touches the ground, even a belly.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

# Duration (s) below which contacts and breaks are chatter, and its limit as a fraction of a stride.
_CHATTER, _CHATTER_FRACTION = 0.05, 0.1
# Difference below which coefficients of variation count as equal. Sampling alone causes a
# difference.
_AS_REGULAR = 0.05


class Phases(NamedTuple):
    """Touch-downs of all feet in the stride of a reference foot.

    Attributes:
        reference: index of the foot whose touch-downs begin the strides, or None if no foot touches
            down twice.
        phase: mean phase of each foot, a fraction of a stride from 0 to 1. NaN without touch-down
            in these strides.
        regularity: length of each foot's mean vector, from 0 (random phases) to 1 (equal phases).
            NaN without touch-down in these strides.
    """

    reference: int | None
    phase: Float[np.ndarray, " f"]
    regularity: Float[np.ndarray, " f"]


def touching(
    force: Float[np.ndarray, "t 3 p"], owners: Int[np.ndarray, " p"], bodies: Sequence[int]
) -> Bool[np.ndarray, "t f"]:
    """Return whether bodies touch the ground in each sample, as in the measure ``duty_factor``.

    Args:
        force: force of the ground on every contact point, N.
        owners: index of the body with each point.
        bodies: indices of the requested bodies.
    """
    touched = (force != 0).any(1)
    return np.stack([touched[:, owners == body].any(1) for body in bodies], -1)


def settled(
    touched: Bool[np.ndarray, "t f"], step: float, shortest: float
) -> Bool[np.ndarray, "t f"]:
    """Remove chatter: close short breaks, then drop short contacts.

    Contacts and breaks at the edges of the record stay.

    Args:
        touched: whether each foot touches in each sample.
        step: time between samples, s.
        shortest: duration below which breaks and contacts are removed, s.
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
    """Return the duration below which a contact or a break is chatter, s.

    Args:
        frequency: stride frequency, Hz, or NaN without a stride.
    """
    return min(_CHATTER, _CHATTER_FRACTION / frequency) if frequency > 0 else _CHATTER


def stances(touched: Bool[np.ndarray, " t"], step: float) -> Float[np.ndarray, "n 2"]:
    """Return the beginning and end of every stance of a foot, s from the first sample.

    A stance at an edge of the record begins or ends at this edge.

    Args:
        touched: whether the foot touches in each sample.
        step: time between samples, s.
    """
    return step * np.array(_runs(touched), float).reshape(-1, 2)


def touch_downs(touched: Bool[np.ndarray, " t"], step: float) -> Float[np.ndarray, " n"]:
    """Return the instants at which a foot touches down, s. An initial stance has none."""
    return step * (1 + np.flatnonzero(~touched[:-1] & touched[1:]))


def duty_factors(touched: Bool[np.ndarray, "t f"]) -> Float[np.ndarray, " f"]:
    """Return each foot's fraction of the time on the ground. NaN without contact."""
    fraction = touched.mean(0)
    return np.where(fraction > 0, fraction, np.nan)


def airborne_fraction(touched: Bool[np.ndarray, "t f"]) -> float:
    """Return the fraction of the time in which no foot touches the ground."""
    return float((~touched.any(1)).mean())


def phases(touched: Bool[np.ndarray, "t f"], step: float) -> Phases:
    """Return the phase of each foot's touch-downs in the stride of a reference foot.

    A touch-down at t between two of the reference, a and b, has the phase (t - a) / (b - a)
    (Hildebrand 1965). Means are circular (Fisher 1993).

    Candidates for the reference have at least half the largest number of strides. The reference is
    the first of them that touches down most regularly. The measure is the coefficient of variation
    of the stride times, in which differences up to 0.05 do not count.

    Args:
        touched: whether each foot touches in each sample, without chatter.
        step: time between samples, s.
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
        # Rounding keeps a tiny negative phase at 0 instead of 1.
        phase[i] = round(float(np.angle(mean) / (2 * np.pi)), 9) % 1.0
        regularity[i] = abs(mean)
    return Phases(reference, phase, regularity)


def _runs(state: Bool[np.ndarray, " t"]) -> list[tuple[int, int]]:
    """Return the first sample of each interval with a true state, and the sample after it."""
    edges = np.diff(np.concatenate([[False], state, [False]]).astype(int))
    begin, end = (np.flatnonzero(sign * edges > 0).tolist() for sign in (1, -1))
    return list(zip(begin, end, strict=True))
