"""Derivatives of arrays that come out of a building, by differences, and whether there are any."""

from typing import Any, NamedTuple

import numpy as np

# What is left of differences that should cancel, as a share of the largest change in the same
# array: of derivatives of second and fourth order (which is off by the square of that), and of
# what is even in the step and goes with its square, but for a kink.
_SMOOTH, _KINK = 1e-5, 1e-3

# Differences of so many units in the last place are rounding.
_ROUNDING = 16 * np.finfo(float).eps

# Shares of a step at which is built, and the weights of a derivative of fourth order and of one of
# second order: on both sides, or on one where the other is not allowed.
CENTRAL = (
    (-1.0, -0.5, 0.5, 1.0),
    (1 / 6, -8 / 6, 8 / 6, -1 / 6),
    (-0.5, 0.0, 0.0, 0.5),
)

ONE_SIDED = (
    (0.25, 0.5, 0.75, 1.0),
    (16.0, -12.0, 16 / 3, -1.0),
    (8.0, -2.0, 0.0, 0.0),
)


class Change(NamedTuple):
    """Derivative of a leaf, and which of its elements change at all."""

    slope: np.ndarray
    moves: np.ndarray


def derivative(
    stencil: tuple[tuple[float, ...], ...], step: float, leaf: Any, others: list[Any]
) -> Change | None:
    """Of a leaf; None where it has none."""
    _, fourth, second = stencil
    finite = np.isfinite(leaf)
    centre = np.where(finite, leaf, 0.0)
    moved = np.array([np.where(finite, other, 0.0) for other in others]) - centre
    least = _ROUNDING * max(float(np.abs(centre).max(initial=0.0)), np.finfo(float).tiny)
    moved[np.abs(moved) < least] = 0.0
    slope = np.tensordot(fourth, moved, 1) / step
    rough = np.tensordot(second, moved, 1) / step
    largest = float(np.abs(moved).max(initial=0.0))
    differs = float(np.abs(slope - rough).max(initial=0.0)) * abs(step)
    if stencil is ONE_SIDED:
        smooth = differs <= _KINK * largest + 10 * least
        return Change(slope, np.asarray(moved.any(0))) if smooth else None
    bend = float(np.abs(moved[0] + moved[-1] - 4 * (moved[1] + moved[-2])).max(initial=0.0))
    smooth = differs <= _SMOOTH * largest + 10 * least and bend <= _KINK * largest + 10 * least
    return Change(slope, np.asarray(moved.any(0))) if smooth else None
