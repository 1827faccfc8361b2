"""Who become parents: rank roulette, and lexicase selection where there are several trials.

Fukui 2003, chapter 3, draws parents by rank, not by the size of their fitness, with fixed
probabilities for ranks 1 to 8; Iwadate 2010 does not say how parents were drawn, so the same
operator serves both. Fitness is maximised. NaN and -inf rank last; equal fitness keeps the order of
the population, so ties are decided the same way every time.

Lexicase selection (Spector 2012) looks at one trial after the other instead of at their mean, so it
keeps those who do well in one of them only. With a tolerance it suits real numbers (La Cava,
Spector and Danai 2016, epsilon-lexicase selection); Moore and Stanton (2017) found that virtual
creatures evolve better with it.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

# Each holds a row as long as the population.
_DRAWS_AT_ONCE = 64


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


def draw_by_lexicase(
    key: Array,
    fitness: Float[Array, " n"],
    trial_fitness: Float[Array, "trials n"],
    count: int,
) -> Int[Array, " count"]:
    """Indices of parents, each found by going through the trials in an order of its own.

    Of those that are left, all stay whose fitness in a trial is within its tolerance of the best
    among them: the median absolute deviation of that trial's fitness. Of those that are left after
    the last trial any is as likely.

    Args:
        key: random key.
        fitness: of the population; who has no finite one is chosen only where nobody has.
        trial_fitness: of it, in each trial.
        count: parents wanted.
    """
    alive = jnp.isfinite(fitness)
    known = jnp.where(alive, trial_fitness, jnp.nan)
    deviation = jnp.abs(known - jnp.nanmedian(known, 1, keepdims=True))
    tolerance = jnp.nan_to_num(jnp.nanmedian(deviation, 1))
    values = jnp.where(alive, trial_fitness, -jnp.inf)

    def narrow(left: Array, trial: Array) -> tuple[Array, None]:
        rivals = jnp.where(left, values[trial], -jnp.inf)
        return left & (rivals >= rivals.max() - tolerance[trial]), None

    def draw(key: Array) -> Array:
        order_key, choice_key = jax.random.split(key)
        order = jax.random.permutation(order_key, len(trial_fitness))
        left, _ = jax.lax.scan(narrow, jnp.ones_like(alive), order)
        lots = jax.random.uniform(choice_key, alive.shape)
        return jnp.argmax(jnp.where(left, lots, -1.0))

    return jax.lax.map(draw, jax.random.split(key, count), batch_size=_DRAWS_AT_ONCE)
