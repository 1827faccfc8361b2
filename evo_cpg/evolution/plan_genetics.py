"""Genetic algorithm on body plans, after Sims 1994, "Evolving virtual creatures".

The best plans survive. The others are replaced by children: copies with alterations, crosses of two
plans, and plans with a grafted part of another plan. Crossed and grafted plans are altered, too, at
a lower rate.

A new body moves badly with its parent's brain, so it would lose against old bodies whose brain had
time to fit. *Protection* gives young bodies that time (Cheney et al. 2018, "Scalable
co-optimization of morphology and control in embodied machines"): an individual only competes with
bodies that are not older. The age of a body is the number of generations since it changed. Plans
are ranked by the number of plans that are fitter and not older, then by fitness.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from evo_cpg.creature.graph import OLDEST, GraphLayout
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
        same_body: fraction of the children that keep a parent's body and alter only its brain.
        evolve: genes that may change.
        protect: whether young bodies are protected.
    """

    population: int = eqx.field(static=True)
    layout: GraphLayout = eqx.field(static=True)
    elites: int = eqx.field(static=True)
    parent_fraction: float = eqx.field(static=True)
    crossed: float
    grafted: float
    alterations: float
    same_body: float = 0.0
    evolve: Altered = eqx.field(static=True, default="all")
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
        older = genes.at[-1].set(jnp.minimum(genes[-1] + 1, OLDEST))
        return keep_elites(older, standing, children, self.elites)

    @override
    def births(self, key: Array, genes: Float[Array, "g n"], evaluation: Evaluation) -> Births:
        standing = self._standing(genes, evaluation)
        first, second, (kind_keys, _) = self._drawn(key, standing)
        crosses, grafts, _ = jax.vmap(self._kind)(kind_keys)
        kind = jnp.where(crosses, 2, jnp.where(grafts, 3, 1))
        born = jnp.stack([first, jnp.where(crosses | grafts, second, -1), kind])
        number = jnp.arange(self.population)
        old = jnp.stack([number, jnp.full_like(number, -1), jnp.zeros_like(number)])
        origin = keep_elites(old, standing, born, self.elites)
        return Births(origin[0], origin[1], origin[2], self.layout.as_bytes(genes))

    def _standing(self, genes: Float[Array, "g n"], evaluation: Evaluation) -> Float[Array, " n"]:
        """Return the number by which individuals are ranked, or -inf if they diverged."""
        fitness, age = evaluation.fitness, genes[-1]
        if not self.protect:
            return fitness
        fitter, younger = fitness[None] - fitness[:, None], age[:, None] - age[None]
        ahead = (fitter >= 0) & (younger >= 0) & ((fitter > 0) | (younger > 0))
        order = jnp.lexsort((-fitness, ahead.sum(1)))
        standing = -jnp.argsort(order).astype(fitness.dtype)
        return jnp.where(jnp.isfinite(fitness), standing, -jnp.inf)

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

    def _kind(self, key: Array) -> tuple[Bool[Array, ""], Bool[Array, ""], Bool[Array, ""]]:
        """Return whether a child is crossed, has a graft, and keeps the body of its parent."""
        kind_key, same_key = jax.random.split(key)
        if self.evolve == "brain":
            return jnp.array(False), jnp.array(False), jnp.array(True)
        kind, same = jax.random.uniform(kind_key), jax.random.uniform(same_key) < self.same_body
        crosses = ~same & (kind < self.crossed)
        return crosses, ~same & ~crosses & (kind < self.crossed + self.grafted), same

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
        crosses, grafts, same = self._kind(kind_key)
        cross, graft = (layout.pack(join(join_key, *both)) for join in (crossed, grafted))
        joined = jnp.where(crosses, cross, jnp.where(grafts, graft, one))
        rate = self.alterations * jnp.where(crosses | grafts, _FEWER, 1.0)
        child = self._altered(alter_key, joined, rate)
        if self.same_body or self.evolve == "brain":
            child = jnp.where(same, self._altered(alter_key, joined, rate, "brain"), child)
        is_body = jnp.arange(len(one)) < len(one) - 1
        changed = ((child != one) & is_body & ~layout.is_control).any()
        return child.at[-1].set(jnp.where(changed, 0.0, jnp.minimum(one[-1] + 1, OLDEST)))

    def _altered(
        self,
        key: Array,
        genes: Float[Array, " g"],
        rate: Array | float,
        altered: Altered | None = None,
    ) -> Array:
        graph = self.layout.unpack(genes)
        graph = mutated(key, graph, self.layout, rate, altered or self.evolve)
        return self.layout.pack(graph, genes[-1]).astype(genes.dtype)
