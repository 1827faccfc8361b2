"""Genetic algorithms: elites, selection of parents, crossover and mutation.

`RealGenetics` is for real-valued genomes. Its population, mutation rate and crossover probability
are from Iwadate 2010 (Table 4). Elites and rank roulette are from Fukui 2003.

`BitGenetics` is the algorithm on bits of Fukui 2003, chapter 3. The best 7 of 15 individuals stay
unchanged. Eight children overwrite the other 8: two children of each of 4 pairs of parents. The 8
parents are drawn independently by rank, so one may be both parents of a pair. Ranks 9 to 15 are
never parents. One-point crossover makes the children. A child mutates with probability 1/2. A
mutation changes 2 to 30 random genes.

The thesis does not say whether mutation is per child or per pair, or how a gene changes. Here each
child has its own mutation. A gene is redrawn unless ``mutation`` is "flip". Chapter 4 describes a
first attempt with 5 individuals kept and 10 replaced (``elites`` 5). The chapter proposes to keep
several copies of the best individual (``best_copies``). Differs from the thesis: an individual that
diverged is never kept, and one more child takes its place.

A bit is a gene of 0.0 or 1.0, so that one type of array serves all genomes. Genes come first and
individuals last, ``(g, n)``.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.evolution.operators import (
    MUTATIONS,
    bit_mutation,
    draw_by_lexicase,
    draw_parents,
    gaussian_mutation,
    linear_rank_probabilities,
    one_point_crossover,
    rank_order,
)
from evo_cpg.evolution.strategy import Evaluation, Strategy


class Genetics(Strategy):
    """A genetic algorithm. Its state is the next population: elites, best first, then children.

    An individual without a finite fitness never becomes an elite. A child fills any place that no
    finite individual can take.

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

    def tell(
        self, key: Array, state: tuple, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Float[Array, "g n"]:
        """Return elites, and mutated children of parents drawn by rank or lexicase selection."""
        del state
        count, fitness = self.population, evaluation.fitness
        parent_key, cross_key, mutate_key = jax.random.split(key, 3)
        pairs = -(-count // 2)
        if self.selection == "lexicase":
            each = evaluation.trial_fitness
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


# Sums of decimal probabilities such as the thesis's differ from 1 by rounding.
_SUM_TOLERANCE = 1e-6


class BitGenetics(Genetics):
    """The genetic algorithm on bits, with the defaults of Fukui 2003.

    Attributes:
        population: number of individuals.
        elites: number of places for the best individuals, unchanged, in the next generation.
            Children fill the other places.
        best_copies: number of the elites' places that copies of the best individual take.
        rank_probabilities: probability of each rank to be drawn as a parent, best first. Ranks
            after the last number have probability 0.
        mutation_probability: probability that a child mutates.
        mutated_genes: fewest and most genes that a mutation changes. All numbers in between are
            equally likely.
        mutation: change of a mutated gene, one of ``MUTATIONS``.

    Raises:
        ValueError: a value is outside its range.
    """

    population: int = eqx.field(static=True, default=15)
    elites: int = eqx.field(static=True, default=7)
    best_copies: int = eqx.field(static=True, default=1)
    rank_probabilities: tuple[float, ...] = eqx.field(
        static=True, default=(0.30, 0.20, 0.20, 0.10, 0.10, 0.05, 0.03, 0.02)
    )
    mutation_probability: float = eqx.field(static=True, default=0.5)
    mutated_genes: tuple[int, int] = eqx.field(static=True, default=(2, 30))
    mutation: str = eqx.field(static=True, default="redraw")

    def __post_init__(self):
        if self.population < 1:
            raise ValueError(f"population must be at least 1, got {self.population}")
        if not 0 <= self.elites < self.population:
            raise ValueError(
                f"elites must be at least 0 and less than the population of "
                f"{self.population}, got {self.elites}"
            )
        most_copies = max(self.elites, 1)
        if not 1 <= self.best_copies <= most_copies:
            raise ValueError(
                f"best_copies must be from 1 to {most_copies} with "
                f"{self.elites} elites, got {self.best_copies}"
            )
        if not 1 <= len(self.rank_probabilities) <= self.population:
            raise ValueError(
                f"rank_probabilities must be 1 to {self.population} numbers (at most the "
                f"population), got {len(self.rank_probabilities)}"
            )
        if not all(p >= 0 for p in self.rank_probabilities):
            raise ValueError(
                f"rank_probabilities must not be negative, got {self.rank_probabilities}"
            )
        total = sum(self.rank_probabilities)
        if not abs(total - 1) <= _SUM_TOLERANCE:
            raise ValueError(f"rank_probabilities must add up to 1, got a sum of {total:g}")
        if not 0 <= self.mutation_probability <= 1:
            raise ValueError(
                f"mutation_probability must be from 0 to 1, got {self.mutation_probability}"
            )
        fewest, most = self.mutated_genes
        if not 1 <= fewest <= most:
            raise ValueError(
                f"mutated_genes must be two numbers, 1 <= fewest <= most, got {fewest} and {most}"
            )
        if self.mutation not in MUTATIONS:
            raise ValueError(f"mutation must be {' or '.join(MUTATIONS)}, got {self.mutation!r}")

    def tell(
        self, key: Array, state: tuple, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Float[Array, "g n"]:
        """Return elites, and children of parents drawn by rank, with siblings adjacent.

        Raises:
            ValueError: genomes have fewer genes than a mutation may change.
        """
        del state
        fitness = evaluation.fitness
        parent_key, cross_key, mutate_key = jax.random.split(key, 3)
        # Make children for every place, because the number of finite elites is known only at run
        # time.
        pairs = -(-self.population // 2)
        parents = draw_parents(parent_key, fitness, np.array(self.rank_probabilities), 2 * pairs)
        children = one_point_crossover(cross_key, genes, parents[:pairs], parents[pairs:], 1.0)
        # If there is one child too many, drop the first. Elites overwrite the first children, and
        # so separate at most one pair of siblings.
        children = children[:, 2 * pairs - self.population :]
        children = bit_mutation(
            mutate_key, children, self.mutation_probability, *self.mutated_genes, self.mutation
        )
        return keep_elites(genes, fitness, children, self.elites, self.best_copies)

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """Return the genomes, with a mutation in each but the first."""
        changed = bit_mutation(key, genes, 1.0, *self.mutated_genes, self.mutation)
        return changed.at[:, 0].set(genes[:, 0])
