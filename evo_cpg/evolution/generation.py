"""Step from one generation to the next: elites, rank roulette, crossover, mutation.

`Genetics` is the common part of the genetic algorithms. `RealGenetics` is for real-valued genomes,
and the module `bits` has the algorithm on bits. Population, mutation rate and crossover probability
of `RealGenetics` are from Iwadate 2010 (Table 4). Elites and rank roulette are from Fukui 2003.
Genes come first and individuals last, ``(g, n)``.
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
    """A genetic algorithm. Its state is the next population to evaluate.

    Attributes:
        population: number of individuals.
        checks_genes: False, because mutation and crossover of finite genes are finite.
    """

    population: eqx.AbstractVar[int]

    checks_genes = False

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """Return the first population."""
        del key
        return genes

    def ask(self, key: Array, state: Float[Array, "g n"]) -> tuple[Float[Array, "g n"], tuple]:
        """Return the population.

        `tell` receives these genes as an argument, so the state is empty.
        """
        del key
        return state, ()

    def tell(
        self, key: Array, state: tuple, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Float[Array, "g n"]:
        """Return the next population."""
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
        """Return genomes of the next generation: the elites, best first, then the children.

        An individual without a finite fitness never becomes an elite. A child fills any place that
        no finite individual can take.

        Args:
            key: random key.
            genes: the population.
            fitness: fitness of each individual, maximised.
            trial_fitness: fitness of each individual in each trial, or None for a single trial.
        """


class RealGenetics(Genetics):
    """The genetic algorithm on real-valued genomes.

    Attributes:
        population: number of individuals.
        elites: number of best individuals that stay unchanged.
        selection: selection of parents, ``rank`` or ``lexicase``.
        parent_fraction: fraction of the population that may become parents by rank.
        crossover_probability: probability that two parents are crossed.
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
        """Return elites, and mutated children of parents drawn by rank or lexicase selection."""
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
        """Mutate all individuals but the first."""
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
    """Replace the first children by the best individuals of the old population, best first.

    Args:
        genes: the old population.
        fitness: fitness of the old population. A child stays in the place of an elite whose fitness
            is not finite.
        children: one child for every place.
        elite_count: number of places for elites.
        best_copies: number of the elites' places that copies of the best individual take.
    """
    if elite_count == 0:
        return children
    places = np.arange(elite_count)
    best = rank_order(fitness)[np.maximum(places - (best_copies - 1), 0)]
    alive = jnp.isfinite(fitness[best])[None]
    elites = jnp.where(alive, genes[:, best], children[:, :elite_count])
    return children.at[:, :elite_count].set(elites)
