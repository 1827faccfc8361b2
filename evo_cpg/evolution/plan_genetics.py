"""Genetic algorithm on body plans, after Sims 1994, "Evolving virtual creatures".

The best plans survive. The others are replaced by children: copies with alterations, crosses of two
plans, and plans with a grafted part of another plan. Crossed and grafted plans are altered, too, at
a lower rate.

A new topology moves badly with its parent's brain, so it would lose against old ones whose brain
had time to fit. *Protection* gives it that time, by speciation (Stanley and Miikkulainen 2002,
"Evolving neural networks through augmenting topologies"): a plan first competes with plans of its
own topology. Here the species are the topologies (`evo_cpg.creature.topology`), and the best plan
of each ranks before all others. So nearly all elites and parents have different topologies.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32
from typing_extensions import override

from evo_cpg.creature.development import PlanBounds, developed
from evo_cpg.creature.graph import GraphLayout
from evo_cpg.creature.topology import topology_number
from evo_cpg.evolution.genetics import Genetics, keep_elites
from evo_cpg.evolution.graphs import Altered, crossed, grafted, mutated
from evo_cpg.evolution.operators import draw_parents, linear_rank_probabilities
from evo_cpg.evolution.strategy import Births, Evaluation

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
        evolve: genes that may change.
        bounds: limits of the plans.
        protect: whether new topologies are protected.
    """

    population: int = eqx.field(static=True)
    layout: GraphLayout = eqx.field(static=True)
    elites: int = eqx.field(static=True)
    parent_fraction: float = eqx.field(static=True)
    crossed: float
    grafted: float
    alterations: float
    evolve: Altered = eqx.field(static=True, default="all")
    bounds: PlanBounds = eqx.field(static=True, default=PlanBounds())
    protect: bool = eqx.field(static=True, default=False)

    @override
    def tell(
        self, key: Array, state: tuple, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Float[Array, "g n"]:
        del state
        standing = self._standing(genes, evaluation)
        first, second, keys = self._drawn(key, standing)
        every = jax.vmap(self._child, (0, 0, -1, -1), -1)
        children = every(*keys, genes[:, first], genes[:, second])
        return keep_elites(genes, standing, children, self.elites)

    @override
    def births(self, key: Array, genes: Float[Array, "g n"], evaluation: Evaluation) -> Births:
        standing = self._standing(genes, evaluation)
        first, second, (kind_keys, _) = self._drawn(key, standing)
        crosses, grafts = jax.vmap(self._kind)(kind_keys)
        kind = jnp.where(crosses, 2, jnp.where(grafts, 3, 1))
        born = jnp.stack([first, jnp.where(crosses | grafts, second, -1), kind])
        number = jnp.arange(self.population)
        old = jnp.stack([number, jnp.full_like(number, -1), jnp.zeros_like(number)])
        origin = keep_elites(old, standing, born, self.elites)
        return Births(origin[0], origin[1], origin[2], self.layout.as_bytes(genes))

    def _standing(self, genes: Float[Array, "g n"], evaluation: Evaluation) -> Float[Array, " n"]:
        """Return the number by which individuals are ranked, or -inf if they diverged."""
        fitness = evaluation.fitness
        if not self.protect or self.evolve == "brain":
            return fitness
        topology = jax.vmap(self._topology, -1)(genes)
        ahead = fitness[None] > fitness[:, None]
        # The first of equals is the best.
        ahead |= (fitness[None] == fitness[:, None]) & jnp.tri(len(fitness), k=-1, dtype=bool)
        beaten = (ahead & (topology[None] == topology[:, None])).any(1)
        order = jnp.lexsort((-fitness, beaten))
        standing = -jnp.argsort(order).astype(fitness.dtype)
        return jnp.where(jnp.isfinite(fitness), standing, -jnp.inf)

    def _topology(self, genes: Float[Array, " g"]) -> UInt32[Array, ""]:
        return topology_number(developed(self.layout.unpack(genes), self.layout, self.bounds))

    def _drawn(
        self, key: Array, standing: Float[Array, " n"]
    ) -> tuple[Int[Array, " n"], Int[Array, " n"], tuple[Array, Array]]:
        """Return both parents of every child, and random keys for its kind and its genes."""
        parent_key, kind_key, child_key = jax.random.split(key, 3)
        probabilities = linear_rank_probabilities(self.population, self.parent_fraction)
        chosen = draw_parents(parent_key, standing, probabilities, 2 * self.population)
        first, second = jnp.split(chosen, 2)
        kinds, children = (jax.random.split(x, self.population) for x in (kind_key, child_key))
        return first, second, (kinds, children)

    def _kind(self, key: Array) -> tuple[Bool[Array, ""], Bool[Array, ""]]:
        """Return whether a child is crossed, and whether it has a graft."""
        kind = jax.random.uniform(key)
        crosses = kind < self.crossed
        grafts = ~crosses & (kind < self.crossed + self.grafted)
        may = self.evolve != "brain"
        return crosses & may, grafts & may

    @override
    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        keys = jax.random.split(key, genes.shape[1])
        alter = jax.vmap(lambda key, own: self._altered(key, own, self.alterations), (0, -1), -1)
        return alter(keys, genes).at[:, 0].set(genes[:, 0])

    def _child(
        self, kind_key: Array, key: Array, one: Float[Array, " g"], other: Float[Array, " g"]
    ) -> Float[Array, " g"]:
        """Return a child of two plans, of which most children use the first only."""
        join_key, alter_key = jax.random.split(key)
        both, layout = (self.layout.unpack(one), self.layout.unpack(other)), self.layout
        crosses, grafts = self._kind(kind_key)
        cross, graft = (layout.pack(join(join_key, *both)) for join in (crossed, grafted))
        joined = jnp.where(crosses, cross, jnp.where(grafts, graft, one))
        rate = self.alterations * jnp.where(crosses | grafts, _FEWER, 1.0)
        return self._altered(alter_key, joined, rate)

    def _altered(self, key: Array, genes: Float[Array, " g"], rate: Array | float) -> Array:
        graph = mutated(key, self.layout.unpack(genes), self.layout, rate, self.evolve)
        return self.layout.pack(graph).astype(genes.dtype)
