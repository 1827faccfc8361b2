"""Crossover of any genomes and mutation of real-valued ones; genes first, individuals last.

The random numbers cost more than all else here: one for each of 600,000 genes takes longer than to
rank, cross and copy them. So mutation draws which genes change as the gaps between them, and noise
for these alone.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, ScalarLike, UInt32

# Room is kept for so many changed genes that more come up with a chance below exp(-50), about
# 2e-22 a generation; any float32 random number is coarser.
_LOG_CHANCE_OF_MORE = 50.0

# Genes that are mutated at once: their places are added as 32-bit numbers.
_MOST_AT_ONCE = 2**30


def one_point_crossover(
    key: Array,
    genes: Float[Array, "g n"],
    first: Int[Array, " pairs"],
    second: Int[Array, " pairs"],
    probability: ScalarLike,
) -> Float[Array, "g children"]:
    """Two children of each pair, side by side, cut and rejoined at one random place.

    Args:
        key: random key.
        genes: the population.
        first: index of one parent of each pair.
        second: index of the other.
        probability: that a pair is crossed at all; otherwise the children are the parents.
    """
    count, pairs = len(genes), len(first)
    where_key, whether_key = jax.random.split(key)
    # A cut lies between two genes, so both children take something from both parents.
    cut = jax.random.randint(where_key, (pairs,), 1, max(count, 2))
    crossed = jax.random.bernoulli(whether_key, probability, (pairs,))
    cut = jnp.repeat(jnp.where(crossed, cut, count), 2)
    before = jnp.stack([first, second], axis=1).reshape(-1)
    after = jnp.stack([second, first], axis=1).reshape(-1)
    cut, before, after = _computed_once(cut, before, after)
    # Every gene is read once, from the right parent: half the time of reading both and choosing.
    parent = jnp.where(jnp.arange(count)[:, None] < cut[None], before[None], after[None])
    return jnp.take_along_axis(genes, parent, axis=1, mode="promise_in_bounds")


def gaussian_mutation(
    key: Array, genes: Float[Array, "g n"], rate: float, sigma: ScalarLike, bound: ScalarLike
) -> Float[Array, "g n"]:
    """Add normal noise to randomly chosen genes and keep all within bounds.

    Args:
        key: random key.
        genes: genomes.
        rate: probability that a gene changes; a number, as it decides how many are drawn.
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
    # By row and column: with the genes in one row, XLA:CPU would cross them gene by gene with two
    # divisions each, which doubles the time of a generation.
    place = places // genes.shape[1], places % genes.shape[1]
    return jnp.clip(genes.at[place].add(noise, mode="drop"), jnp.negative(bound), bound)


def random_places(key: Array, count: int, rate: float) -> UInt32[Array, " m"]:
    """Places of 0 to ``count`` - 1, each there or not with the same chance, independently.

    How many places are left out before the next one is a geometric deviate,
    ``floor(log(u) / log(1 - rate))`` with ``u`` uniform between 0 and 1 (Devroye 1986, Non-Uniform
    Random Variate Generation, chapter X).

    Args:
        key: random key.
        count: of the places.
        rate: probability that a place is there.

    Returns:
        The places, ascending, and behind them ``count`` as often as there is room left.
    """
    # Bernstein's inequality for the number of places.
    variance = count * rate * (1 - rate)
    third = _LOG_CHANCE_OF_MORE / 3
    margin = third + math.sqrt(third**2 + 2 * _LOG_CHANCE_OF_MORE * variance)
    room = min(count, math.ceil(count * rate + margin))
    uniform = jax.random.uniform(key, (room,), jnp.float32)
    # In the middle between two numbers that are drawn, so neither 0 nor 1.
    uniform = uniform + jnp.finfo(jnp.float32).eps / 2
    left_out = jnp.floor(_gap_per_log(rate) * jnp.log(uniform))
    steps = 1 + jnp.minimum(left_out, count).astype(jnp.uint32)
    # A sum that ends at the first place beyond the last cannot overflow.
    ends = jax.lax.associative_scan(lambda a, b: jnp.minimum(a + b, count + 1), steps)
    return ends - 1


def _gap_per_log(rate: float) -> float:
    """``1 / log(1 - rate)``, the limits included."""
    if rate <= 0:
        return -math.inf
    return 1 / math.log1p(-rate) if rate < 1 else 0.0


def _computed_once(*rows: Int[Array, " n"]) -> tuple[Int[Array, " n"], ...]:
    """The arrays themselves, behind a sort that leaves them in order.

    XLA:CPU would fuse their producers (products and remainders of random bits) into every gene that
    uses them, 1.4 ms instead of 0.6 ms for 200 individuals of 3000 genes, and drops
    `jax.lax.optimization_barrier`. It never fuses a sort.
    """
    order = jnp.arange(len(rows[0]))
    return tuple(jax.lax.sort((order, *rows), num_keys=1)[1:])
