"""From one generation to the next: elites, rank roulette, crossover, mutation.

Iwadate 2010 (Table 4) gives the population, the mutation rate and the crossover probability;
elites and rank roulette are Fukui's (2003). Genes come first and individuals last, ``(g, n)``.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.evolution.selection import draw_parents, linear_rank_probabilities, rank_order
from evo_cpg.evolution.variation import gaussian_mutation, one_point_crossover


class RealGenetics(eqx.Module):
    """Settings of the genetic algorithm on real-valued genomes.

    Attributes:
        population: number of individuals.
        elite_count: best individuals that pass on unchanged.
        parent_fraction: part of the population that may become parents.
        crossover_probability: that two parents' genomes are cut and rejoined.
        mutation_rate: probability that a gene of a child changes.
        mutation_sigma: standard deviation of a change.
        gene_bound: largest magnitude of a gene.
    """

    population: int = eqx.field(static=True)
    elite_count: int = eqx.field(static=True)
    parent_fraction: float = eqx.field(static=True)
    crossover_probability: float
    mutation_rate: float
    mutation_sigma: float
    gene_bound: float


def next_generation(
    key: Array,
    genetics: RealGenetics,
    genes: Float[Array, "g n"],
    fitness: Float[Array, " n"],
) -> Float[Array, "g n"]:
    """Genomes of the next generation: the elites, best first, then the children.

    An individual without a finite fitness never becomes an elite while finite ones are left;
    a place that no finite individual can take is filled by a child.
    """
    count = genetics.population
    parent_key, cross_key, mutate_key = jax.random.split(key, 3)
    pairs = -(-count // 2)
    probabilities = linear_rank_probabilities(count, genetics.parent_fraction)
    parents = draw_parents(parent_key, fitness, probabilities, 2 * pairs)
    children = jnp.concatenate(
        one_point_crossover(
            cross_key,
            genes[:, parents[:pairs]],
            genes[:, parents[pairs:]],
            genetics.crossover_probability,
        ),
        axis=1,
    )[:, :count]
    children = gaussian_mutation(
        mutate_key, children, genetics.mutation_rate, genetics.mutation_sigma, genetics.gene_bound
    )
    order = rank_order(fitness)
    elite = (jnp.arange(count) < genetics.elite_count) & jnp.isfinite(fitness[order])
    return jnp.where(elite[None], genes[:, order], children)
