"""Meaning of the genes of an individual, defined here only.

A genome is a vector of numbers. At present all of them belong to the controller. Anything else that
evolves is counted, drawn, bounded and decoded here, and gets a field of `Phenotype`. Searches, run
folders, commands and the API treat a genome as a vector of `Genome.count` numbers.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from evo_cpg.control.controller import Controller


class Phenotype(NamedTuple):
    """Decoded genes of every individual.

    Attributes:
        controller: genes as `Controller.act` takes them, see `Controller.decode`.
    """

    controller: PyTree[Array]


class Genome(NamedTuple):
    """Layout of the genes of an experiment's individuals.

    Attributes:
        controller: controller that the genes belong to.
    """

    controller: Controller

    @property
    def count(self) -> int:
        """Number of genes."""
        return self.controller.gene_count

    @property
    def binary(self) -> bool:
        """Return whether genes are bits, 0 or 1."""
        return self.controller.binary

    def random(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type = jnp.float32
    ) -> Float[Array, "g *n"]:
        """Return genes of a first generation, which a controller may draw as integers or bits."""
        return jnp.asarray(self.controller.random_genes(key, batch, dtype), dtype)

    def with_controller(self, genes: Float[np.ndarray, "g *n"]) -> Float[np.ndarray, "g *n"]:
        """Return whole genomes that have these genes of the controller."""
        return genes

    def decode(self, genes: Float[Array, "g *n"]) -> Phenotype:
        """Return the decoded genes. Called once per trial."""
        return Phenotype(self.controller.decode(genes))

    def bound(self, largest: float) -> float | None:
        """Return ``largest``, the largest magnitude of a real-valued gene, or None for bits."""
        return None if self.binary else largest

    def misfit(self, genes: Float[np.ndarray, " _"]) -> str | None:
        """Return the reason why genes of one individual do not fit, or None if they fit."""
        if genes.shape == (self.count,):
            return None
        return f"the genome has {genes.size} genes, not {self.count}"
