"""What the genes of an individual mean."""

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.simulation.genome import Genome
from trials import SineController


class _Switches(SineController):
    """Draws its genes as truth values."""

    @property
    def binary(self):
        return True

    def random_genes(self, key, batch, dtype):
        return jax.random.bernoulli(key, 0.5, (self.gene_count, *batch))


def test_bits_are_drawn_as_floats_and_have_no_bound():
    genes = Genome(_Switches()).random(jax.random.key(0), (50,))
    assert genes.dtype == jnp.float32 and set(np.asarray(genes).ravel()) == {0.0, 1.0}
    assert Genome(_Switches()).bound(8.0) is None and Genome(SineController()).bound(8.0) == 8.0


def test_a_genome_of_another_length_does_not_fit():
    genome = Genome(SineController())
    assert genome.misfit(np.zeros(2)) is None
    assert genome.misfit(np.zeros(3)) == "the genome has 3 genes, not 2"
