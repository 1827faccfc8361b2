"""Crossover of any genomes and mutation of real-valued ones; genes first, individuals last."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def one_point_crossover(
    key: Array,
    first: Float[Array, "g pairs"],
    second: Float[Array, "g pairs"],
    probability: float,
) -> tuple[Float[Array, "g pairs"], Float[Array, "g pairs"]]:
    """Two children of each pair, cut and rejoined at one random place.

    Args:
        key: random key.
        first: genomes of one parent of each pair.
        second: genomes of the other.
        probability: that a pair is crossed at all; otherwise the children are the parents.
    """
    genes, pairs = first.shape
    where_key, whether_key = jax.random.split(key)
    # A cut lies between two genes, so both children take something from both parents.
    cut = jax.random.randint(where_key, (pairs,), 1, max(genes, 2))
    crossed = jax.random.bernoulli(whether_key, probability, (pairs,))
    swapped = (jnp.arange(genes)[:, None] >= cut[None]) & crossed[None]
    return jnp.where(swapped, second, first), jnp.where(swapped, first, second)


def gaussian_mutation(
    key: Array, genes: Float[Array, "g n"], rate: float, sigma: float, bound: float
) -> Float[Array, "g n"]:
    """Add normal noise to randomly chosen genes and keep them within bounds.

    Args:
        key: random key.
        genes: genomes.
        rate: probability that a gene changes.
        sigma: standard deviation of the change.
        bound: largest magnitude of a gene.
    """
    which_key, noise_key = jax.random.split(key)
    chosen = jax.random.bernoulli(which_key, rate, genes.shape)
    noise = sigma * jax.random.normal(noise_key, genes.shape, genes.dtype)
    return jnp.clip(jnp.where(chosen, genes + noise, genes), -bound, bound)
