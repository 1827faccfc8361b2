"""From one generation to the next: elites, rank roulette, crossover, mutation.

`Genetics` is what the genetic algorithms have in common; `RealGenetics` is the one on real-valued
genomes, and `bits` has the one on bits. For the real-valued one, Iwadate 2010 (Table 4) gives the
population, the mutation rate and the crossover probability; elites and rank roulette are Fukui's
(2003). Genes come first and individuals last, ``(g, n)``.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.evolution.selection import (
    draw_by_lexicase,
    draw_parents,
    linear_rank_probabilities,
    rank_order,
)
from evo_cpg.evolution.strategy import Evaluation, Strategy
from evo_cpg.evolution.variation import gaussian_mutation, one_point_crossover


class Genetics(Strategy):
    """A genetic algorithm: what it knows is its population.

    Attributes:
        population: number of individuals.
        checks_genes: no, because it only varies the genes that the controller drew.
    """

    population: eqx.AbstractVar[int]

    checks_genes = False

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """The first population."""
        del key
        return genes

    def ask(self, key: Array, state: Float[Array, "g n"]) -> tuple[Float[Array, "g n"], tuple]:
        """The population; it will be told again with its fitness, so nothing is remembered."""
        del key
        return state, ()

    def tell(
        self, key: Array, state: tuple, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Float[Array, "g n"]:
        """The next population."""
        del state
        return self.next_generation(key, genes, evaluation.fitness, evaluation.trial_fitness)

    @abc.abstractmethod
    def next_generation(
        self,
        key: Array,
        genes: Float[Array, "g n"],
        fitness: Float[Array, " n"],
        trial_fitness: Float[Array, "trials n"] | None = None,
    ) -> Float[Array, "g n"]:
        """Genomes of the next generation: the elites, best first, then the children.

        An individual without a finite fitness never becomes an elite; a place that no finite
        individual can take is filled by a child.

        Args:
            key: random key.
            genes: the population.
            fitness: of each individual, maximised.
            trial_fitness: likewise in each trial; None where there is but one.
        """


class RealGenetics(Genetics):
    """The genetic algorithm on real-valued genomes.

    Attributes:
        population: number of individuals.
        elites: best individuals that pass on unchanged.
        selection: of parents, ``rank`` or ``lexicase``.
        parent_fraction: part of the population that may become parents by rank.
        crossover_probability: that two parents' genomes are cut and rejoined.
        mutation_rate: probability that a gene of a child changes.
        mutation_sigma: standard deviation of a change.
        gene_bound: largest magnitude of a gene.
    """

    population: int = eqx.field(static=True)
    elites: int = eqx.field(static=True)
    parent_fraction: float = eqx.field(static=True)
    crossover_probability: float
    mutation_rate: float
    mutation_sigma: float
    gene_bound: float
    selection: str = eqx.field(static=True, default="rank")

    def next_generation(
        self,
        key: Array,
        genes: Float[Array, "g n"],
        fitness: Float[Array, " n"],
        trial_fitness: Float[Array, "trials n"] | None = None,
    ) -> Float[Array, "g n"]:
        """Elites, and children whose every gene may change a little."""
        count = self.population
        parent_key, cross_key, mutate_key = jax.random.split(key, 3)
        pairs = -(-count // 2)
        if self.selection == "lexicase":
            each = fitness[None] if trial_fitness is None else trial_fitness
            parents = draw_by_lexicase(parent_key, fitness, each, 2 * pairs)
        else:
            probabilities = linear_rank_probabilities(count, self.parent_fraction)
            parents = draw_parents(parent_key, fitness, probabilities, 2 * pairs)
        children = one_point_crossover(
            cross_key, genes, parents[:pairs], parents[pairs:], self.crossover_probability
        )[:, :count]
        children = gaussian_mutation(
            mutate_key, children, self.mutation_rate, self.mutation_sigma, self.gene_bound
        )
        return keep_elites(genes, fitness, children, self.elites)

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """All but the first mutated."""
        changed = gaussian_mutation(
            key, genes, self.mutation_rate, self.mutation_sigma, self.gene_bound
        )
        return changed.at[:, 0].set(genes[:, 0])


def keep_elites(
    genes: Float[Array, "g n"],
    fitness: Float[Array, " n"],
    children: Float[Array, "g n"],
    elite_count: int,
    best_copies: int = 1,
) -> Float[Array, "g n"]:
    """Put the best individuals, unchanged and best first, in the place of the first children.

    Args:
        genes: the old population.
        fitness: of it; the place of an elite whose fitness is not finite stays a child's.
        children: one for every place.
        elite_count: places to fill.
        best_copies: how many of them go to the best individual.
    """
    if elite_count == 0:
        return children
    places = np.arange(elite_count)
    best = rank_order(fitness)[np.maximum(places - (best_copies - 1), 0)]
    alive = jnp.isfinite(fitness[best])[None]
    elites = jnp.where(alive, genes[:, best], children[:, :elite_count])
    return children.at[:, :elite_count].set(elites)
