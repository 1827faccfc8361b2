"""Meaning of the genes of an individual."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.simulation.simulation import Genome, Phenotype
from evo_cpg.training.evaluate import compile_replay
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.train import train
from trials import SineController, experiment


class _Switches(SineController):
    """Controller that draws its genes as booleans."""

    @property
    def binary(self):
        return True

    def random_genes(self, key, batch, dtype):
        return jax.random.bernoulli(key, 0.5, (self.gene_count, *batch))


def test_bits_are_drawn_as_floats():
    genes = Genome(_Switches()).random(jax.random.key(0), (50,))
    assert genes.dtype == jnp.float32 and set(np.asarray(genes).ravel()) == {0.0, 1.0}


def test_a_genome_of_another_length_does_not_fit():
    genome = Genome(SineController())
    assert genome.misfit(np.zeros(2)) is None
    assert genome.misfit(np.zeros(3)) == "the genome has 3 genes, not 2"


@pytest.mark.slow
def test_genes_outside_the_controller_evolve_and_replay(tmp_path, monkeypatch):
    """Only `Genome` changes. Its last two genes do not belong to the controller."""
    alone = Genome.random

    def random(self, key, batch, dtype=jnp.float32):
        return jnp.concatenate([alone(self, key, batch, dtype), jnp.full((2, *batch), 0.5, dtype)])

    monkeypatch.setattr(Genome, "count", property(lambda self: self.controller.gene_count + 2))
    monkeypatch.setattr(Genome, "random", random)
    monkeypatch.setattr(
        Genome, "decode", lambda self, genes: Phenotype(self.controller.decode(genes[:-2]))
    )
    made, folder = experiment()._replace(generations=2), RunFolder(tmp_path / "run")
    folder.create("", {})
    champion = train(made, folder).champion
    assert champion is not None and champion.genes.shape == (4,)
    fitness = compile_replay(made, len(jax.local_devices()))(champion).fitness
    assert fitness == champion.fitness
