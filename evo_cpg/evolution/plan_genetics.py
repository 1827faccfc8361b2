"""Genetic algorithm on body plans, after Sims 1994, "Evolving virtual creatures".

The best plans survive. The others are replaced by children: copies with alterations, crosses of two
plans, and plans with a grafted part of another plan. Crossed and grafted plans are altered, too, at
a lower rate.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from evo_cpg.creature.graph import GraphLayout
from evo_cpg.evolution.genetics import Genetics, keep_elites
from evo_cpg.evolution.graphs import crossed, grafted, mutated
from evo_cpg.evolution.operators import draw_parents, linear_rank_probabilities
from evo_cpg.evolution.strategy import Evaluation

# Alterations of a crossed or grafted plan, as a fraction of those of a copy.
_FEWER = 0.25


class PlanGenetics(Genetics):
    """The genetic algorithm on body plans.

    Attributes:
        population: number of individuals.
        layout: sizes of a genome.
        elites: number of best individuals that stay unchanged.
        parent_fraction: fraction of the population that may become parents by rank.
        crossed: fraction of the children that have two parents.
        grafted: fraction of the children with a grafted part.
        alterations: mean number of alterations of a copied plan.
    """

    population: int = eqx.field(static=True)
    layout: GraphLayout = eqx.field(static=True)
    elites: int = eqx.field(static=True)
    parent_fraction: float = eqx.field(static=True)
    crossed: float
    grafted: float
    alterations: float

    @override
    def tell(
        self, key: Array, state: tuple, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Float[Array, "g n"]:
        del state
        parent_key, child_key = jax.random.split(key)
        probabilities = linear_rank_probabilities(self.population, self.parent_fraction)
        chosen = draw_parents(parent_key, evaluation.fitness, probabilities, 2 * self.population)
        first, second = jnp.split(chosen, 2)
        keys = jax.random.split(child_key, self.population)
        every = jax.vmap(self._child, (0, -1, -1), -1)
        children = every(keys, genes[:, first], genes[:, second])
        return keep_elites(genes, evaluation.fitness, children, self.elites)

    @override
    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        keys = jax.random.split(key, genes.shape[1])
        changed = jax.vmap(lambda key, own: self._altered(key, own, self.alterations), (0, -1), -1)
        return changed(keys, genes).at[:, 0].set(genes[:, 0])

    def _child(
        self, key: Array, one: Float[Array, " g"], other: Float[Array, " g"]
    ) -> Float[Array, " g"]:
        """Return a child of two plans, of which most children use the first only."""
        kind_key, join_key, alter_key = jax.random.split(key, 3)
        both, layout = (self.layout.unpack(one), self.layout.unpack(other)), self.layout
        kind = jax.random.uniform(kind_key)
        crosses, grafts = kind < self.crossed, kind < self.crossed + self.grafted
        cross, graft = (layout.pack(join(join_key, *both)) for join in (crossed, grafted))
        joined = jnp.where(crosses, cross, jnp.where(grafts, graft, one))
        return self._altered(alter_key, joined, self.alterations * jnp.where(grafts, _FEWER, 1.0))

    def _altered(self, key: Array, genes: Float[Array, " g"], rate: Array | float) -> Array:
        graph = mutated(key, self.layout.unpack(genes), self.layout, rate)
        return self.layout.pack(graph).astype(genes.dtype)
