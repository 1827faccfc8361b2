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

# Step size at the start, a third of the cube's edge: the children then cover the cube.
_FIRST_STEP = 0.3


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


def begun(mean: Float[np.ndarray, "n d"], step: float = _FIRST_STEP) -> Searches:
    """Return searches around given centres."""
    count, size = mean.shape
    none, eye = np.zeros_like(mean), np.tile(np.eye(size), (count, 1, 1))
    return Searches(mean, np.full(count, step), eye, none, none, 0)


def children(searches: Searches, normal: Float[np.ndarray, "n k d"]) -> Float[np.ndarray, "n k d"]:
    """Return the next children, given numbers of the standard normal distribution."""
    values, axes = np.linalg.eigh(searches.covariance)
    root = axes * np.sqrt(np.maximum(values, 0))[:, None]
    moves = normal @ np.swapaxes(root, 1, 2)
    return np.clip(searches.mean[:, None] + searches.step[:, None, None] * moves, 0, 1)


def updated(
    searches: Searches, points: Float[np.ndarray, "n k d"], fitness: Float[np.ndarray, "n k"]
) -> Searches:
    """Return the searches after a generation of children with their fitness, which is maximised."""
    mean, step, covariance, step_path, path, generation = searches
    size, count = mean.shape[1], fitness.shape[1]
    weights = np.log((count + 1) / 2) - np.log(np.arange(1, count // 2 + 1))
    weights /= weights.sum()
    mass = 1 / (weights**2).sum()
    # Names of the tutorial: c_sigma, d_sigma, c_c, c_1, c_mu.
    c_s = (mass + 2) / (size + mass + 5)
    d_s = 1 + c_s + 2 * max(0.0, math.sqrt((mass - 1) / (size + 1)) - 1)
    c_c = (4 + mass / size) / (size + 4 + 2 * mass / size)
    c_1 = 2 / ((size + 1.3) ** 2 + mass)
    c_mu = min(1 - c_1, 2 * (mass - 2 + 1 / mass) / ((size + 2) ** 2 + mass))
    expected = math.sqrt(size) * (1 - 1 / (4 * size) + 1 / (21 * size**2))

    best = np.argsort(-fitness, axis=1, kind="stable")[:, : len(weights), None]
    moves = (np.take_along_axis(points, best, 1) - mean[:, None]) / step[:, None, None]
    shift = (weights[:, None] * moves).sum(1)
    values, axes = np.linalg.eigh(covariance)
    inverse = axes / np.sqrt(np.maximum(values, 1e-14))[:, None] @ np.swapaxes(axes, 1, 2)
    whitened = (inverse @ shift[..., None])[..., 0]
    step_path = (1 - c_s) * step_path + math.sqrt(c_s * (2 - c_s) * mass) * whitened
    length = np.linalg.norm(step_path, axis=1) / math.sqrt(1 - (1 - c_s) ** (2 * generation + 2))
    steady = (length < (1.4 + 2 / (size + 1)) * expected)[:, None]
    path = (1 - c_c) * path + steady * math.sqrt(c_c * (2 - c_c) * mass) * shift
    spread = np.einsum("k,nki,nkj->nij", weights, moves, moves)
    lost = c_1 + c_mu - c_1 * (1 - steady[..., None]) * c_c * (2 - c_c)
    outer = path[:, :, None] * path[:, None]
    covariance = (1 - lost) * covariance + c_1 * outer + c_mu * spread
    grown = np.exp(c_s / d_s * (np.linalg.norm(step_path, axis=1) / expected - 1))
    return Searches(
        mean + step[:, None] * shift, step * grown, covariance, step_path, path, generation + 1
    )
