"""Selection of parents: rank roulette, and lexicase selection for several trials.

Fukui 2003, chapter 3, draws parents by rank, not by the size of their fitness, with fixed
probabilities for ranks 1 to 8. Iwadate 2010 does not say how parents were drawn, so `draw_parents`
serves both papers. Fitness is maximised. NaN and -inf rank last. Equal fitness keeps the order of
the population, so ties are decided reproducibly.

Lexicase selection (Spector 2012) filters by one trial after another instead of by their mean. It
keeps individuals that do well in a single trial. A tolerance adapts it to real numbers (La Cava,
Spector and Danai 2016, epsilon-lexicase selection). Moore and Stanton (2017) found that virtual
creatures evolve better with it.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

# Number of parents drawn at once by lexicase selection. Each draw holds arrays as long as the
# population.
_DRAWS_AT_ONCE = 64


def rank_order(fitness: Float[Array, " n"]) -> Int[Array, " n"]:
    """Return indices from the best individual to the worst."""
    return jnp.argsort(-jnp.where(jnp.isnan(fitness), -jnp.inf, fitness), stable=True)


def linear_rank_probabilities(count: int, parent_fraction: float) -> np.ndarray:
    """Return ``(count,)`` probabilities of the ranks, falling linearly to 0 after the last parent.

    Args:
        count: individuals in the population.
        parent_fraction: fraction of the population that may become parents, 0 to 1.
    """
    parents = max(1, round(parent_fraction * count))
    weights = np.maximum(parents - np.arange(count), 0.0)
    return weights / weights.sum()


def draw_parents(
    key: Array, fitness: Float[Array, " n"], probabilities: np.ndarray, count: int
) -> Int[Array, " count"]:
    """Draw indices of parents independently by rank, with repeats allowed.

    Args:
        key: random key.
        fitness: fitness of the population.
        probabilities: probability of each rank, best first.
        count: number of parents.
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
    """Draw indices of parents, each by a random order of the trials.

    Each trial keeps those of the remaining individuals whose fitness in it is within its tolerance
    of the best of them. The tolerance is the median absolute deviation of that trial's fitness.
    After the last trial all remaining individuals are equally likely.

    Args:
        key: random key.
        fitness: fitness of the population. An individual without a finite fitness is chosen only
            if none has one.
        trial_fitness: fitness of the population in each trial.
        count: number of parents.
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
