"""Conversion of genomes to unbounded real numbers, for searches that require them.

A real-valued gene is its number, clipped to the bounds. A bit is 1 where its number is positive.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# Probability that a bit is flipped in a population around one individual.
_FLIPPED = 0.1


class Latent(NamedTuple):
    """Conversion between numbers and genes.

    Attributes:
        binary: True if genes are bits.
        sigma: standard deviation of the first sample. The numbers of the bits 0 and 1 are -sigma
            and sigma.
        gene_bound: largest magnitude of a gene, or None for bits.
    """

    binary: bool
    sigma: float
    gene_bound: float | None

    def genes(self, numbers: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the genes for these numbers."""
        if self.binary:
            return (numbers > 0).astype(numbers.dtype)
        bound = np.inf if self.gene_bound is None else self.gene_bound
        return jnp.clip(numbers, -bound, bound)

    def numbers(self, genes: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return numbers that `genes` converts to these genes."""
        return self.sigma * (2.0 * genes - 1.0) if self.binary else genes

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """Add normal noise, or flip each bit with probability 0.1, in all genomes but the first."""
        if self.binary:
            flipped = jax.random.bernoulli(key, _FLIPPED, genes.shape)
            changed = jnp.where(flipped, 1.0 - genes, genes)
        else:
            changed = genes + self.sigma * jax.random.normal(key, genes.shape, genes.dtype)
        return self.genes(self.numbers(changed)).at[:, 0].set(genes[:, 0])
