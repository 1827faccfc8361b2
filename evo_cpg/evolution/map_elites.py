"""MAP-Elites: the best individual of every kind of behaviour (Mouret and Clune 2015).

Descriptors measure behaviour, such as the speed of a gait and the fraction of time that feet are on
the ground. Their ranges are cut into cells. Each cell of the map keeps the fittest individual with
descriptors in it. Children of individuals from the map compete for the cells of their own
descriptors. The result is not one gait but a map of gaits.

Children of real-valued genomes vary along the line to another individual (Vassiliades and Mouret
2018, Discovering the elite hypervolume by leveraging interspecies correlation, "Iso+LineDD"),

    child = a + iso_sigma N(0, I) + line_sigma N(0, 1) (b - a),

with a and b drawn from the map. For bits a child is a one-point crossover of a and b, mutated as in
`evo_cpg.evolution.genetics`. The archive is a pytree of arrays, with cells along the last axis.
Individuals beyond the ranges belong to the nearest cell. Individuals without finite descriptors
belong to none.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int, PyTree

from evo_cpg.evolution.operators import bit_mutation, one_point_crossover
from evo_cpg.evolution.strategy import Archive, Axis, Evaluation, Strategy

# Metrics of every map.
METRICS = ("coverage", "mean_elite")


class Beginning(NamedTuple):
    """An empty map, and the first genomes."""

    archive: Archive
    genes: Float[Array, "g n"]


class AlongTheLine(eqx.Module):
    """Variation of real-valued genomes: noise, and a step along the line to the other parent.

    Attributes:
        iso_sigma: standard deviation of the noise on every gene.
        line_sigma: standard deviation of the step, relative to the distance between the parents.
        gene_bound: largest magnitude of a gene.
    """

    iso_sigma: float = 0.05
    line_sigma: float = 0.2
    gene_bound: float = 8.0

    def __call__(
        self, key: Array, genes: Float[Array, "g cells"], parents: Int[Array, "2 n"]
    ) -> Float[Array, "g n"]:
        """Return children of the genomes on the map, one child of each pair of parents."""
        iso_key, line_key = jax.random.split(key)
        a, b = genes[:, parents[0]], genes[:, parents[1]]
        along = self.line_sigma * jax.random.normal(line_key, (1, a.shape[1]), a.dtype)
        return self.copies(iso_key, a + along * (b - a))

    def copies(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """Return the genomes, each with a small random change."""
        noise = self.iso_sigma * jax.random.normal(key, genes.shape, genes.dtype)
        return jnp.clip(genes + noise, -self.gene_bound, self.gene_bound)


class OfBits(eqx.Module):
    """Variation of genomes of bits: crossover of the two parents, and mutation.

    Attributes:
        crossover: probability that the parents are crossed. Otherwise a child copies the first
            parent.
        mutation_probability: probability that a child mutates.
        mutated_genes: fewest and most genes that a mutation changes.
        mutation: change of a mutated gene, one of ``operators.MUTATIONS``.
        gene_bound: None, because bits have no bound.
    """

    crossover: float = 1.0
    mutation_probability: float = 0.5
    mutated_genes: tuple[int, int] = eqx.field(static=True, default=(2, 30))
    mutation: str = eqx.field(static=True, default="redraw")

    gene_bound = None

    def __call__(
        self, key: Array, genes: Float[Array, "g cells"], parents: Int[Array, "2 n"]
    ) -> Float[Array, "g n"]:
        """Return children of the genomes on the map, one child of each pair of parents."""
        cross_key, mutate_key = jax.random.split(key)
        first, second = parents
        # Take the child of each pair that begins as the first parent.
        children = one_point_crossover(cross_key, genes, first, second, self.crossover)[:, ::2]
        return bit_mutation(
            mutate_key, children, self.mutation_probability, *self.mutated_genes, self.mutation
        )

    def copies(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """Return the genomes, each with a small random change."""
        return bit_mutation(key, genes, 1.0, *self.mutated_genes, self.mutation)


class MapStrategy(Strategy):
    """A search that fills a map of behaviour.

    Attributes:
        population: number of individuals in every generation.
        axes: axes of the map.
    """

    axes: eqx.AbstractVar[tuple[Axis, ...]]

    metric_names = METRICS

    @property
    def map_axes(self) -> tuple[Axis, ...]:
        """See `Strategy.map_axes`."""
        return self.axes

    @property
    def cells(self) -> int:
        """Number of cells of the map."""
        return math.prod(axis.cells for axis in self.axes)

    def metrics(self, state: PyTree[Array]) -> dict[str, Float[Array, ""]]:
        """Return ``coverage`` (fraction of filled cells) and ``mean_elite``.

        ``mean_elite`` is the mean fitness of the elites.
        """
        archive = self.map_of(state)
        assert archive is not None
        fitness = archive.fitness
        filled = jnp.isfinite(fitness)
        count = filled.sum()
        total = jnp.where(filled, fitness, 0.0).sum()
        return {"coverage": count / self.cells, "mean_elite": total / count}

    def empty(self, genes: Float[Array, "g n"]) -> Archive:
        """Return an empty map for genomes like these."""
        none = jnp.full(self.cells, -1, jnp.int32)
        return Archive(
            jnp.zeros((len(genes), self.cells), genes.dtype),
            jnp.full(self.cells, -jnp.inf, genes.dtype),
            jnp.zeros((len(self.axes), self.cells), genes.dtype),
            none,
            none,
            jnp.int32(0),
        )

    def entered(
        self, archive: Archive, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Archive:
        """Return the map in which individuals have replaced the elites with less fitness."""
        known: dict[str, ArrayLike] = {**evaluation.terms, **evaluation.descriptors}
        found = jnp.stack([jnp.asarray(known[axis.name]) for axis in self.axes])
        fitness = jnp.where(jnp.isfinite(found).all(0), evaluation.fitness, -jnp.inf)
        cell = jnp.zeros(found.shape[1:], jnp.int32)
        for axis, value in zip(self.axes, found, strict=True):
            # A descriptor that is not finite counts as ``low``.
            place = (value - axis.low) / (axis.high - axis.low) * axis.cells
            place = jnp.where(jnp.isfinite(place), place, 0.0)
            inside = jnp.clip(jnp.floor(place), 0, axis.cells - 1).astype(jnp.int32)
            cell = cell * axis.cells + inside
        # Best individual for each cell, the first among equals.
        best = jnp.full(self.cells, -jnp.inf, fitness.dtype).at[cell].max(fitness)
        wins = (fitness == best[cell]) & (fitness > archive.fitness[cell])
        count = len(fitness)
        places = jnp.where(wins, jnp.arange(count), count)
        first = jnp.full(self.cells, count).at[cell].min(places)
        taken, winner = first < count, jnp.minimum(first, count - 1)
        genes, fitness, found = jax.tree.map(
            lambda old, new: jnp.where(taken, new[..., winner], old),
            (archive.genes, archive.fitness, archive.descriptors),
            (genes, fitness, found),
        )
        return Archive(
            genes,
            fitness,
            found,
            jnp.where(taken, archive.told, archive.generation),
            jnp.where(taken, winner, archive.index),
            archive.told + 1,
        )


class MapElites(MapStrategy):
    """MAP-Elites.

    Attributes:
        population: number of children in every generation.
        axes: axes of the map.
        vary: variation of parents to children.
    """

    population: int = eqx.field(static=True)
    axes: tuple[Axis, ...] = eqx.field(static=True)
    vary: AlongTheLine | OfBits = AlongTheLine()

    @property
    def gene_bound(self) -> float | None:
        """Largest magnitude of a gene, or None for bits."""
        return self.vary.gene_bound

    def map_of(self, state: Archive) -> Archive:
        """Return the state, which is the map."""
        return state

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Beginning:
        """See `Strategy.init`."""
        del key
        return Beginning(self.empty(genes), genes)

    def ask(self, key: Array, state: Archive | Beginning) -> tuple[Float[Array, "g n"], Archive]:
        """Return the first genomes, then children of individuals from the map."""
        if isinstance(state, Beginning):
            return state.genes, state.archive
        draw_key, vary_key = jax.random.split(key)
        filled = jnp.isfinite(state.fitness)
        # If the map is empty, all parents are genomes of zeros. The search then starts again there.
        (occupied,) = jnp.nonzero(filled, size=self.cells, fill_value=0)
        number = jnp.maximum(filled.sum(), 1)
        parents = occupied[jax.random.randint(draw_key, (2, self.population), 0, number)]
        return self.vary(vary_key, state.genes, parents), state

    def tell(
        self, key: Array, state: Archive, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Archive:
        """See `MapStrategy.entered`."""
        del key
        return self.entered(state, genes, evaluation)

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """See `Strategy.around`."""
        return self.vary.copies(key, genes).at[:, 0].set(genes[:, 0])


class Charted(NamedTuple):
    """State of a strategy, and map of all its individuals."""

    archive: Archive
    state: PyTree[Array]


class Mapped(MapStrategy):
    """Any strategy, with a map of all its individuals that does not influence it.

    Attributes:
        population: number of individuals in every generation.
        axes: axes of the map.
        strategy: strategy that searches.
    """

    population: int = eqx.field(static=True)
    axes: tuple[Axis, ...] = eqx.field(static=True)
    strategy: Strategy

    @property
    def gene_bound(self) -> float | None:
        """Largest magnitude of a gene, or None if the strategy has no bound."""
        return getattr(self.strategy, "gene_bound", None)

    def map_of(self, state: Charted) -> Archive:
        """See `Strategy.map_of`."""
        return state.archive

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Charted:
        """See `Strategy.init`."""
        return Charted(self.empty(genes), self.strategy.init(key, genes))

    def ask(self, key: Array, state: Charted) -> tuple[Float[Array, "g n"], Charted]:
        """See `Strategy.ask`."""
        genes, inner = self.strategy.ask(key, state.state)
        return genes, Charted(state.archive, inner)

    def tell(
        self, key: Array, state: Charted, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Charted:
        """See `Strategy.tell`."""
        inner = self.strategy.tell(key, state.state, genes, evaluation)
        return Charted(self.entered(state.archive, genes, evaluation), inner)

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """See `Strategy.around`."""
        return self.strategy.around(key, genes)

    @property
    def metric_names(self) -> tuple[str, ...]:
        """See `metrics`."""
        return (*self.strategy.metric_names, *METRICS)

    def metrics(self, state: Charted) -> dict[str, Float[Array, ""]]:
        """Return the metrics of the strategy and the metrics of the map."""
        return {**self.strategy.metrics(state.state), **super().metrics(state)}
