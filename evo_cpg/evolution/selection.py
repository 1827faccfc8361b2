"""Rank roulette: parents are drawn by rank, not by the size of their fitness.

Fukui 2003, chapter 3, draws parents with fixed probabilities for ranks 1 to 8; Iwadate 2010 does
not say how parents were drawn, so the same operator serves both. Fitness is maximised. NaN and
-inf rank last; equal fitness keeps the order of the population, so ties are decided the same way
every time.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


def rank_order(fitness: Float[Array, " n"]) -> Int[Array, " n"]:
    """Indices from the best individual to the worst."""
    return jnp.argsort(-jnp.where(jnp.isnan(fitness), -jnp.inf, fitness), stable=True)


def linear_rank_probabilities(count: int, parent_fraction: float) -> np.ndarray:
    """Probability ``(count,)`` of each rank as a parent: falls linearly to 0 below the last parent.

    Args:
        count: individuals in the population.
        parent_fraction: part of the population that may become parents, 0 to 1.
    """
    parents = max(1, round(parent_fraction * count))
    weights = np.maximum(parents - np.arange(count), 0.0)
    return weights / weights.sum()


def draw_parents(
    key: Array, fitness: Float[Array, " n"], probabilities: np.ndarray, count: int
) -> Int[Array, " count"]:
    """Indices of parents, drawn independently (repeats allowed) by rank.

    Args:
        key: random key.
        fitness: of the population.
        probabilities: of each rank, best first.
        count: parents wanted.
    """
    ranks = jax.random.choice(
        key, len(probabilities), (count,), p=jnp.asarray(probabilities, jnp.float32)
    )
    return rank_order(fitness)[ranks]
