"""CMA-ES of many independent searches at once.

The equations are those of Hansen 2016 ("The CMA evolution strategy: a tutorial", arXiv 1604.00772,
Fig. 6) without negative weights. All searches have equally many children, so that a generation of
all searches is a few NumPy operations. Points lie in the unit cube: a child outside moves to the
nearest point inside.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Least eigenvalue of a covariance matrix, relative to which rounding errors are small.
_LEAST = 1e-14


class Searches(NamedTuple):
    """Distributions of ``n`` searches in ``d`` dimensions.

    Attributes:
        mean: centres.
        step: step sizes sigma.
        covariance: covariance matrices C.
        step_path: evolution paths of the step sizes, p_sigma.
        path: evolution paths of the covariances, p_c.
        generation: number of finished generations.
    """

    mean: Float[np.ndarray, "n d"]
    step: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "n d d"]
    step_path: Float[np.ndarray, "n d"]
    path: Float[np.ndarray, "n d"]
    generation: int


def started(mean: Float[np.ndarray, "n d"], step: float) -> Searches:
    """Return searches around given centres."""
    count, size = mean.shape
    none, eye = np.zeros_like(mean), np.tile(np.eye(size), (count, 1, 1))
    return Searches(mean, np.full(count, step), eye, none, none, 0)


def children(searches: Searches, normal: Float[np.ndarray, "n k d"]) -> Float[np.ndarray, "n k d"]:
    """Return the next children, given numbers of the standard normal distribution."""
    moves = normal @ _power(searches.covariance, 0.5)
    return np.clip(searches.mean[:, None] + searches.step[:, None, None] * moves, 0, 1)


def updated(
    searches: Searches, points: Float[np.ndarray, "n k d"], fitness: Float[np.ndarray, "n k"]
) -> Searches:
    """Return the searches after a generation of children with their fitness, which is maximised."""
    mean, step, covariance, step_path, path, generation = searches
    size, parents = mean.shape[1], fitness.shape[1] // 2
    weights = math.log((fitness.shape[1] + 1) / 2) - np.log(np.arange(1, parents + 1))
    weights /= weights.sum()
    mass = 1 / (weights**2).sum()
    # In the tutorial: c_sigma, d_sigma, c_c, c_1, c_mu and E|N(0, I)|.
    c_s = (mass + 2) / (size + mass + 5)
    d_s = 1 + c_s + 2 * max(0.0, math.sqrt((mass - 1) / (size + 1)) - 1)
    c_c = (4 + mass / size) / (size + 4 + 2 * mass / size)
    c_1 = 2 / ((size + 1.3) ** 2 + mass)
    c_mu = min(1 - c_1, 2 * (mass - 2 + 1 / mass) / ((size + 2) ** 2 + mass))
    normal = math.sqrt(size) * (1 - 1 / (4 * size) + 1 / (21 * size**2))

    best = np.argsort(-fitness, axis=1, kind="stable")[:, :parents, None]
    moves = (np.take_along_axis(points, best, 1) - mean[:, None]) / step[:, None, None]
    shift = (weights[:, None] * moves).sum(1)
    whitened = (_power(covariance, -0.5) @ shift[..., None])[..., 0]
    step_path = (1 - c_s) * step_path + math.sqrt(c_s * (2 - c_s) * mass) * whitened
    length = np.linalg.norm(step_path, axis=1)[:, None] / normal
    expected = math.sqrt(1 - (1 - c_s) ** (2 * generation + 2)) * (1.4 + 2 / (size + 1))
    short = length < expected
    path = (1 - c_c) * path + short * math.sqrt(c_c * (2 - c_c) * mass) * shift
    lost = (c_1 + c_mu - c_1 * c_c * (2 - c_c) * ~short)[..., None]
    spread = c_1 * path[:, :, None] * path[:, None]
    spread += c_mu * np.swapaxes(moves, 1, 2) @ (weights[:, None] * moves)
    step = step * np.exp(c_s / d_s * (length[:, 0] - 1))
    covariance = (1 - lost) * covariance + spread
    return Searches(
        mean + searches.step[:, None] * shift, step, covariance, step_path, path, generation + 1
    )


def _power(matrices: Float[np.ndarray, "n d d"], power: float) -> Float[np.ndarray, "n d d"]:
    """Return a power of symmetric positive definite matrices."""
    values, axes = np.linalg.eigh(matrices)
    return axes * np.maximum(values, _LEAST)[:, None] ** power @ np.swapaxes(axes, 1, 2)
