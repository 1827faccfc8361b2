"""Genetic operators: selection of parents, crossover, and mutation of numbers and of bits.

Fukui 2003, chapter 3, draws parents by rank, not by the size of their fitness, with fixed
probabilities for ranks 1 to 8. Iwadate 2010 does not say how parents were drawn, so `draw_parents`
serves both papers. Fitness is maximised. NaN and -inf rank last. Equal fitness keeps the order of
the population, so ties are decided reproducibly.

Lexicase selection (Spector 2012) filters by one trial after another instead of by their mean. It
keeps individuals that do well in a single trial. A tolerance adapts it to real numbers (La Cava,
Spector and Danai 2016, epsilon-lexicase selection). Moore and Stanton (2017) found that virtual
creatures evolve better with it.

Genes come first and individuals last. Random numbers take most of the time: to draw one for each of
600,000 genes takes longer than to rank, cross and copy the genes. So mutation of real numbers draws
them only for the distances between genes that change, and for their noise.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, ScalarLike, UInt32

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

    The probabilities are those of the ranks, best first.
    """
    ranks = jax.random.choice(
        key, len(probabilities), (count,), p=jnp.asarray(probabilities, jnp.float32)
    )
    return rank_order(fitness)[ranks]


def draw_by_lexicase(
    key: Array, fitness: Float[Array, " n"], trial_fitness: Float[Array, "trials n"], count: int
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


# Change of a mutated gene. A redrawn gene keeps its value with probability 1/2. A flipped gene
# becomes the other bit.
MUTATIONS = ("redraw", "flip")

# In one generation the array of changed genes is too short with a probability below exp(-50), about
# 2e-22. A float32 random number does not resolve such probabilities.
_LOG_CHANCE_OF_MORE = 50.0

# Largest number of genes that are mutated at once. Their positions are sums of 32-bit numbers.
_MOST_AT_ONCE = 2**30


def one_point_crossover(
    key: Array,
    genes: Float[Array, "g n"],
    first: Int[Array, " pairs"],
    second: Int[Array, " pairs"],
    probability: ScalarLike,
) -> Float[Array, "g children"]:
    """Return two adjacent children of each pair of parents, with swapped genes after a random cut.

    Args:
        key: random key.
        genes: the population.
        first: index of one parent of each pair.
        second: index of the other parent.
        probability: probability that a pair is crossed. Otherwise the children are the parents.
    """
    count, pairs = len(genes), len(first)
    where_key, whether_key = jax.random.split(key)
    # A cut lies between two genes, so both children have genes of both parents.
    cut = jax.random.randint(where_key, (pairs,), 1, max(count, 2))
    crossed = jax.random.bernoulli(whether_key, probability, (pairs,))
    cut = jnp.repeat(jnp.where(crossed, cut, count), 2)
    before = jnp.stack([first, second], axis=1).reshape(-1)
    after = jnp.stack([second, first], axis=1).reshape(-1)
    # XLA:CPU would fuse the producers of these rows (products and remainders of random bits) into
    # every gene that uses them, which takes 1.4 ms instead of 0.6 ms for 200 individuals of 3000
    # genes. XLA:CPU drops `jax.lax.optimization_barrier`, but never fuses a sort. This sort keeps
    # the order.
    rows = jnp.arange(len(cut)), cut, before, after
    _, cut, before, after = jax.lax.sort(rows, num_keys=1)
    # Read every gene once, from its parent. Reading both and selecting takes twice the time.
    parent = jnp.where(jnp.arange(count)[:, None] < cut[None], before[None], after[None])
    return jnp.take_along_axis(genes, parent, axis=1, mode="promise_in_bounds")


def gaussian_mutation(
    key: Array, genes: Float[Array, "g n"], rate: float, sigma: ScalarLike, bound: ScalarLike
) -> Float[Array, "g n"]:
    """Add normal noise to random genes, and clip all genes to the bounds.

    Args:
        key: random key.
        genes: genomes.
        rate: probability that a gene changes. A Python number, because it sets the array length.
        sigma: standard deviation of the change.
        bound: largest magnitude of a gene.
    """
    parts = -(-genes.size // _MOST_AT_ONCE)
    if parts > 1:
        some = zip(jax.random.split(key, parts), jnp.array_split(genes, parts), strict=True)
        return jnp.concatenate([gaussian_mutation(k, g, rate, sigma, bound) for k, g in some])
    which_key, noise_key = jax.random.split(key)
    places = random_places(which_key, genes.size, rate)
    noise = sigma * jax.random.normal(noise_key, places.shape, genes.dtype)
    # Index by row and column. If this were an index into the flattened genes, XLA:CPU would compute
    # the crossover gene by gene, with two divisions each. That doubles the time of a generation.
    place = places // genes.shape[1], places % genes.shape[1]
    return jnp.clip(genes.at[place].add(noise, mode="drop"), jnp.negative(bound), bound)


def random_places(key: Array, count: int, rate: float) -> UInt32[Array, " m"]:
    """Draw indices from 0 to ``count`` - 1, each independently with the same probability.

    The number of indices left out before the next drawn one is a geometric deviate, ``floor(log(u)
    / log(1 - rate))`` with ``u`` uniform between 0 and 1 (Devroye 1986, Non-Uniform Random Variate
    Generation, chapter X).

    Args:
        key: random key.
        count: number of indices to draw from.
        rate: probability that an index is drawn.

    Returns:
        The drawn indices in ascending order, then ``count`` as padding.
    """
    # Bernstein's inequality bounds the number of drawn indices.
    variance = count * rate * (1 - rate)
    third = _LOG_CHANCE_OF_MORE / 3
    margin = third + math.sqrt(third**2 + 2 * _LOG_CHANCE_OF_MORE * variance)
    room = min(count, math.ceil(count * rate + margin))
    uniform = jax.random.uniform(key, (room,), jnp.float32)
    # Shift to the middle between two possible numbers, so that neither 0 nor 1 occurs.
    uniform = uniform + jnp.finfo(jnp.float32).eps / 2
    # The factor 1 / log(1 - rate) has these limits at rates of 0 and 1.
    gap = -math.inf if rate <= 0 else 1 / math.log1p(-rate) if rate < 1 else 0.0
    left_out = jnp.floor(gap * jnp.log(uniform))
    steps = 1 + jnp.minimum(left_out, count).astype(jnp.uint32)
    # Sums are capped just beyond the last index, so they cannot overflow.
    ends = jax.lax.associative_scan(lambda a, b: jnp.minimum(a + b, count + 1), steps)
    return ends - 1


def bit_mutation(
    key: Array,
    genes: Float[Array, "g n"],
    probability: ScalarLike,
    fewest: ScalarLike,
    most: int,
    mutation: str,
) -> Float[Array, "g n"]:
    """Change a random number of different random genes in some individuals.

    Args:
        key: random key.
        genes: genomes, 0 or 1.
        probability: probability that an individual mutates.
        fewest: smallest number of changed genes in a mutation.
        most: largest number of changed genes. All numbers in between are equally likely.
        mutation: change of a mutated gene, one of ``MUTATIONS``.

    Raises:
        ValueError: genomes have fewer genes than a mutation may change.
    """
    count, individuals = genes.shape
    if most > count:
        raise ValueError(f"a mutation may change {most} genes, but a genome has only {count}")
    whether_key, number_key, which_key, value_key = jax.random.split(key, 4)
    mutates = jax.random.bernoulli(whether_key, probability, (individuals,))
    number = jax.random.randint(number_key, (individuals,), fewest, most + 1)
    places = different_places(which_key, count, jnp.where(mutates, number, 0), most)
    changed = genes.at[places, jnp.arange(individuals)[None]]
    if mutation == "flip":
        values = 1.0 - changed.get(mode="fill", fill_value=0.0)
    else:
        values = jax.random.bernoulli(value_key, 0.5, (most, individuals)).astype(genes.dtype)
    return changed.set(values, mode="drop")


def different_places(
    key: Array, count: int, number: Int[Array, " n"], most: int
) -> Int[Array, "most n"]:
    """Draw a set of indices from 0 to ``count`` - 1 for each individual, all sets equally likely.

    Floyd's algorithm (Bentley and Floyd 1987, Communications of the ACM 30, 754) extends a set of
    indices below ``j``. It adds a random index from 0 to ``j``, or ``j`` itself if that index is in
    the set. ``j`` rises to ``count`` - 1.

    Args:
        key: random key.
        count: number of indices to draw from.
        number: number of indices to draw for each individual.
        most: upper bound of these numbers.

    Returns:
        The indices of each individual in arbitrary order, then ``count`` as padding.
    """
    step = jnp.arange(most)[:, None]
    needed = step < number[None]
    last = jnp.where(needed, count - number[None] + step, 0)
    drawn = jax.random.randint(key, last.shape, 0, last + 1)
    none = jnp.full_like(drawn, count)

    def choose(places: Array, i: Array) -> tuple[Array, None]:
        taken = (places == drawn[i][None]).any(0)
        place = jnp.where(taken, last[i], drawn[i])
        return places.at[i].set(jnp.where(needed[i], place, count)), None

    return jax.lax.scan(choose, none, jnp.arange(most))[0]
