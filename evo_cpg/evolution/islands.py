"""Islands: sub-populations that evolve separately and exchange their best individuals.

Every island has its own strategy, all with equal settings. At regular intervals copies of the best
individuals of each island replace the worst of the next island. The next island's strategy then
gets the migrants' genes and results as its own, so migration works with every strategy. The islands
form a ring, as in Cohoon et al. 1987, Punctuated equilibria: a parallel genetic algorithm. For a
strategy with a distribution the migrants are individuals injected into its sample (Hansen 2011,
Injecting external solutions into CMA-ES).

Islands stand side by side on the axis of individuals, ``(g, islands x n)``.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from evo_cpg.evolution.operators import rank_order
from evo_cpg.evolution.strategy import Evaluation, Strategy


class Archipelago(NamedTuple):
    """State of all islands.

    Attributes:
        generation: number of completed generations.
        islands: state of each island, with the islands on the first axis of every array.
    """

    generation: Int[Array, ""]
    islands: PyTree[Array]


class Islands(Strategy):
    """Strategy on several islands.

    Attributes:
        population: number of individuals on all islands together.
        strategy: strategy of one island.
        count: number of islands.
        every: number of generations between migrations.
        migrants: number of migrants from each island.
    """

    population: int = eqx.field(static=True)
    strategy: Strategy
    count: int = eqx.field(static=True)
    every: int = eqx.field(static=True)
    migrants: int = eqx.field(static=True)

    @property
    def gene_bound(self) -> float | None:
        """Largest magnitude of a gene, or None if the strategy has no bound."""
        return getattr(self.strategy, "gene_bound", None)

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Archipelago:
        """See `Strategy.init`."""
        first = jax.vmap(self.strategy.init, in_axes=(0, 1))
        apart = genes.reshape(len(genes), self.count, -1)
        return Archipelago(jnp.int32(0), first(self._keys(key), apart))

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
        size = self.population // self.count
        first = size * np.arange(self.count)[:, None]
        order = first + jax.vmap(rank_order)(evaluation.fitness.reshape(self.count, -1))
        best, worst = order[:, : self.migrants], order[:, size - self.migrants :]
        # Index of the individual to copy to every place: itself, or a migrant.
        own = jnp.arange(self.population)
        moved = own.at[worst].set(jnp.roll(best, 1, axis=0))
        arrived = jnp.where(done % self.every == 0, moved, own)
        genes, evaluation = jax.tree.map(lambda x: x[..., arrived], (genes, evaluation))
        tell = jax.vmap(self.strategy.tell, in_axes=(0, 0, -2, -2))
        given = genes, evaluation
        apart = jax.tree.map(lambda x: x.reshape(*x.shape[:-1], self.count, -1), given)
        return Archipelago(done, tell(self._keys(key), state.islands, *apart))

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """See `Strategy.around`. The first individual of every island stays unchanged."""
        about = jax.vmap(self.strategy.around, in_axes=(0, 1), out_axes=1)
        apart = genes.reshape(len(genes), self.count, -1)
        return about(self._keys(key), apart).reshape(len(genes), -1)

    @property
    def metric_names(self) -> tuple[str, ...]:
        """See `metrics`."""
        return self.strategy.metric_names

    def metrics(self, state: Archipelago) -> dict[str, Float[Array, ""]]:
        """Return means over the islands, see `Strategy.metrics`."""
        found = jax.vmap(self.strategy.metrics, axis_size=self.count)(state.islands)
        return {name: values.mean() for name, values in found.items()}

    def _keys(self, key: Array) -> Array:
        return jax.vmap(lambda island: jax.random.fold_in(key, island))(jnp.arange(self.count))
