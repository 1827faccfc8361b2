"""Islands: sub-populations that evolve apart, between which a few of the best wander now and then.

Every island has a strategy of its own, all with the same settings. After so many generations the
best of each island take the places of the worst of the next one, before that is told (a ring, as in
Cohoon et al. 1987, Punctuated equilibria: a parallel genetic algorithm). So migration works with
every strategy: to one with a distribution the migrants are individuals injected into its sample
(Hansen 2011, Injecting external solutions into CMA-ES).

Islands stand side by side on the axis of individuals, ``(g, islands x n)``.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from evo_cpg.evolution.selection import rank_order
from evo_cpg.evolution.strategy import Evaluation, Strategy


class Archipelago(NamedTuple):
    """What is known of all islands.

    Attributes:
        generation: of how many was told.
        islands: the state of each; of every array the first axis is that of the islands.
    """

    generation: Int[Array, ""]
    islands: PyTree[Array]


class Islands(Strategy):
    """The same strategy on several islands.

    Attributes:
        population: individuals on all of them.
        strategy: of one island.
        count: of the islands.
        every: so many generations the best migrate.
        migrants: from each island.
    """

    population: int = eqx.field(static=True)
    strategy: Strategy
    count: int = eqx.field(static=True)
    every: int = eqx.field(static=True)
    migrants: int = eqx.field(static=True)

    @property
    def gene_bound(self) -> float | None:
        """Largest magnitude of a gene, where the strategy has one."""
        return getattr(self.strategy, "gene_bound", None)

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Archipelago:
        """See `Strategy.init`."""
        first = jax.vmap(self.strategy.init, in_axes=(0, 1))
        return Archipelago(jnp.int32(0), first(self._keys(key), self._apart(genes)))

    def ask(self, key: Array, state: Archipelago) -> tuple[Float[Array, "g n"], Archipelago]:
        """See `Strategy.ask`."""
        ask = jax.vmap(self.strategy.ask, out_axes=(1, 0))
        genes, islands = ask(self._keys(key), state.islands)
        return genes.reshape(len(genes), -1), Archipelago(state.generation, islands)

    def tell(
        self, key: Array, state: Archipelago, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Archipelago:
        """See `Strategy.tell`."""
        done = state.generation + 1
        arrived = self._arrivals(evaluation.fitness, done % self.every == 0)
        genes, evaluation = jax.tree.map(lambda x: x[..., arrived], (genes, evaluation))
        tell = jax.vmap(self.strategy.tell, in_axes=(0, 0, 1, -2))
        apart = jax.tree.map(lambda x: x.reshape(*x.shape[:-1], self.count, -1), evaluation)
        islands = tell(self._keys(key), state.islands, self._apart(genes), apart)
        return Archipelago(done, islands)

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """See `Strategy.around`; on every island the first stays as it is."""
        about = jax.vmap(self.strategy.around, in_axes=(0, 1), out_axes=1)
        return about(self._keys(key), self._apart(genes)).reshape(len(genes), -1)

    @property
    def metric_names(self) -> tuple[str, ...]:
        """See `metrics`."""
        return self.strategy.metric_names

    def metrics(self, state: Archipelago) -> dict[str, Float[Array, ""]]:
        """Means over the islands, see `Strategy.metrics`."""
        found = jax.vmap(self.strategy.metrics, axis_size=self.count)(state.islands)
        return {name: values.mean() for name, values in found.items()}

    def _arrivals(self, fitness: Float[Array, " n"], now: Array) -> Int[Array, " n"]:
        """Whose place everybody takes: his own, or that of a migrant from the island before."""
        size = self.population // self.count
        first = size * np.arange(self.count)[:, None]
        order = first + jax.vmap(rank_order)(fitness.reshape(self.count, -1))
        best, worst = order[:, : self.migrants], order[:, size - self.migrants :]
        moved = jnp.arange(self.population).at[worst].set(jnp.roll(best, 1, axis=0))
        return jnp.where(now, moved, jnp.arange(self.population))

    def _apart(self, genes: Float[Array, "g n"]) -> Float[Array, "g islands each"]:
        return genes.reshape(len(genes), self.count, -1)

    def _keys(self, key: Array) -> Array:
        return jax.vmap(lambda island: jax.random.fold_in(key, island))(jnp.arange(self.count))
