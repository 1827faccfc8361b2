"""Genomes as real numbers, for searches that know nothing else and no bounds.

A real-valued gene is its number, clipped to the bounds; a bit is 1 where its number is positive.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# Of bits that are flipped in a population about one individual.
_FLIPPED = 0.1


class Latent(NamedTuple):
    """How numbers and genes go together.

    Attributes:
        binary: whether genes are bits.
        sigma: standard deviation of the first sample; half the way from a bit to its opposite.
        gene_bound: largest magnitude of a gene; None of bits.
    """

    binary: bool
    sigma: float
    gene_bound: float | None

    def genes(self, numbers: Float[Array, "..."]) -> Float[Array, "..."]:
        """Genes of any numbers."""
        if self.binary:
            return (numbers > 0).astype(numbers.dtype)
        bound = np.inf if self.gene_bound is None else self.gene_bound
        return jnp.clip(numbers, -bound, bound)

    def numbers(self, genes: Float[Array, "..."]) -> Float[Array, "..."]:
        """Numbers that give these genes."""
        return self.sigma * (2.0 * genes - 1.0) if self.binary else genes

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """Normal noise about real numbers; of bits one in ten is flipped. The first stays."""
        if self.binary:
            flipped = jax.random.bernoulli(key, _FLIPPED, genes.shape)
            changed = jnp.where(flipped, 1.0 - genes, genes)
        else:
            changed = genes + self.sigma * jax.random.normal(key, genes.shape, genes.dtype)
        return self.genes(self.numbers(changed)).at[:, 0].set(genes[:, 0])
