"""CMA-MAE of pyribs (Tjanaka et al. 2023, Fontaine and Nikolaidis 2023) as a strategy.

Like any other search it begins with the random genomes of the controller, on which the task's
scales are measured. After that several evolution strategies, the *emitters*, put their samples into
one map. Each adapts a normal distribution, which starts at the mean of the better half of the first
genomes. A cell of the map has a threshold that fitness must exceed to enter. The threshold rises at
each entry,

    threshold <- (1 - a) threshold + a fitness,

from ``threshold_min`` on, with the learning rate ``a``. The default threshold is the median of the
valid individuals in the emitters' first generation. An emitter ranks its sample by the excess of
fitness over the threshold. Thresholds rise in explored regions, so the emitter moves to regions
with lower thresholds. ``a = 0`` only optimises the fitness, as CMA-ES does. ``a = 1`` is CMA-ME.
Other settings follow Fontaine and Nikolaidis. The better half of a sample are the parents of the
next distribution. When its sample has converged, an emitter restarts at a random elite of the
emitters' map.

pyribs is installed with the extra ``pyribs``, and imported when a strategy is built. Emitters and
their map run on the host, in a callback of `Ribs.ask` and `Ribs.tell`. Between calls they are a
pytree of arrays (see `evo_cpg.evolution.pyribs_host`).

The emitters' map may replace the fittest individual of a cell by a worse one above the threshold.
So a run shows another map, `evo_cpg.evolution.archive.Archive`, which keeps the fittest of all
individuals in each cell.

Some individuals do not enter the emitters' map, and rank below all others of their emitter. They
have diverged, have a descriptor that is not finite, or are migrants. While no
individual exceeds ``threshold_min``, that map is empty. Then no emitter adapts, and all continue to
draw from their initial distributions.

Genes are clipped to their bounds after the draw (pyribs itself would draw again, at 3000 genes
forever). Bits are as in `evo_cpg.evolution.latent`. A full covariance matrix (``cma_es``) takes
memory and time with the square and the cube of the number of genes. It is unsuitable for a brain of
3000: a matrix has 72 MB, and every emitter holds three.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from evo_cpg.evolution.archive import Archive, Axis
from evo_cpg.evolution.latent import Latent
from evo_cpg.evolution.map_elites import Beginning, MapStrategy
from evo_cpg.evolution.pyribs_host import (
    ALGORITHMS,
    SAMPLE,
    SEED_WORDS,
    RibsSettings,
    adapt,
    draw,
    layout,
    optimiser,
    shapes,
    start_emitters,
)
from evo_cpg.evolution.selection import rank_order
from evo_cpg.evolution.strategy import Evaluation, descriptor_rows

# Arrays by name. Arrays of emitters have the emitters on the first axis.
Arrays = dict[str, Array]


class State(NamedTuple):
    """State of the search.

    Attributes:
        archive: map with the fittest of all individuals in each cell.
        cells: map of the emitters.
        emitters: distributions of the emitters.
        drawn: last sample: the latent numbers of each individual, and other arrays of the draw.
    """

    archive: Archive
    cells: Arrays
    emitters: Arrays
    drawn: Arrays


class Ribs(MapStrategy):
    """CMA-MAE as a strategy.

    Attributes:
        population: number of individuals, divided equally among the emitters.
        gene_count: numbers in a genome.
        axes: axes of the map.
        binary: True if genes are bits.
        emitters: number of emitters.
        es: evolution strategy of each emitter, by pyribs' name, one of `ALGORITHMS`.
        sigma: standard deviation of the first sample.
        learning_rate: learning rate of thresholds, 0 to 1.
        threshold_min: initial threshold, or None for the median of the emitters' first sample.
        gene_bound: largest magnitude of a gene, or None for bits.
        options: options of the evolution strategy's constructor, such as ``lr`` of ``openai_es``.

    Raises:
        ImportError: pyribs is not installed.
        UnknownPyribsError: the version of pyribs is unknown.
        TypeError: the constructor does not take an option.
        ValueError: the settings do not go together.
    """

    population: int = eqx.field(static=True)
    gene_count: int = eqx.field(static=True)
    axes: tuple[Axis, ...] = eqx.field(static=True)
    binary: bool = eqx.field(static=True, default=False)
    emitters: int = eqx.field(static=True, default=5)
    es: str = eqx.field(static=True, default="sep_cma_es")
    sigma: float = eqx.field(static=True, default=0.5)
    learning_rate: float = eqx.field(static=True, default=0.01)
    threshold_min: float | None = eqx.field(static=True, default=None)
    gene_bound: float | None = eqx.field(static=True, default=8.0)
    options: tuple[tuple[str, float], ...] = eqx.field(static=True, default=())

    def __post_init__(self):
        if self.es not in ALGORITHMS:
            raise ValueError(f"es must be one of {', '.join(ALGORITHMS)}, got {self.es!r}")
        if self.population % self.emitters:
            raise ValueError(
                f"a population of {self.population} cannot be divided equally among "
                f"{self.emitters} emitters"
            )
        if self.population < 2 * self.emitters:
            raise ValueError(
                f"each of {self.emitters} emitters needs at least two individuals, but the "
                f"population is {self.population}"
            )
        optimiser(self._settings)
        layout(self._settings)

    def map_of(self, state: State) -> Archive:
        """Return the map with the fittest of all individuals in each cell."""
        return state.archive

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Beginning:
        """See `Strategy.init`."""
        del key
        return Beginning(self.empty(genes), genes)

    def ask(self, key: Array, state: State | Beginning) -> tuple[Float[Array, "g n"], State]:
        """Return the first genomes in generation 0, later samples of the emitters.

        The emitters have their own random numbers, so ``key`` is unused.
        """
        del key
        if isinstance(state, Beginning):
            nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes(self._settings))
            return state.genes, State(state.archive, *nothing)
        _, *like = shapes(self._settings)
        draw = functools.partial(_draw, self._settings)
        emitters, drawn = _on_host(draw, tuple(like), state.emitters)
        genes = self._latent.genes(self._rows(drawn).T)
        return genes, state._replace(emitters=emitters, drawn=drawn)

    def tell(
        self, key: Array, state: State, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> State:
        """Return the state after the results.

        The emitters start after the first population, at the mean of the latent numbers of its
        better half.
        """
        found = descriptor_rows(evaluation, self.measured())
        numbers, better = self._latent.numbers(genes), rank_order(evaluation.fitness)
        start = numbers[:, better[: -(-self.population // 2)]].mean(1).astype(jnp.float32)
        seeds = jax.random.bits(key, (1 + self.emitters, SEED_WORDS), jnp.uint32)
        own = (genes == self._latent.genes(self._rows(state.drawn).T)).all(0)
        counts = own & jnp.isfinite(evaluation.fitness) & jnp.isfinite(found).all(0)
        fitness = jnp.where(counts, evaluation.fitness, 0.0).astype(jnp.float32)
        measures = jnp.where(counts, found, 0.0).astype(jnp.float32).T
        cells, emitters, _ = shapes(self._settings)
        known = state.cells, state.emitters, state.drawn
        worth = fitness, measures, counts
        adapt = functools.partial(_adapt, self._settings)
        first = state.archive.told == 0
        cells, emitters = _on_host(adapt, (cells, emitters), first, start, seeds, *known, *worth)
        return State(self.entered(state.archive, genes, evaluation), cells, emitters, state.drawn)

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """See `Latent.around`."""
        return self._latent.around(key, genes)

    @property
    def metric_names(self) -> tuple[str, ...]:
        """See `metrics`."""
        return (*super().metric_names, "restarts")

    def metrics(self, state: State) -> dict[str, Float[Array, ""]]:
        """Return the map's metrics and ``restarts``, the total number of the emitters' restarts."""
        restarts = state.emitters["counters"][:, -1].sum().astype(jnp.float32)
        return {**super().metrics(state), "restarts": restarts}

    @property
    def _latent(self) -> Latent:
        return Latent(self.binary, self.sigma, self.gene_bound)

    @property
    def _settings(self) -> RibsSettings:
        return RibsSettings(
            self.axes,
            self.gene_count,
            self.emitters,
            self.population // self.emitters,
            self.es,
            self.sigma,
            self.learning_rate,
            self.threshold_min,
            self.options,
        )

    def _rows(self, drawn: Arrays) -> Float[Array, "n g"]:
        """Return the latent numbers of every individual of a sample."""
        return drawn[SAMPLE].reshape(self.population, self.gene_count)


def _on_host(function: Any, like: PyTree, *given: PyTree) -> Any:
    """Call a NumPy function from a JAX program, sequentially under `jax.vmap`."""
    return jax.pure_callback(function, like, *given, vmap_method="sequential")


def _draw(settings: RibsSettings, emitters: Arrays) -> tuple[PyTree, PyTree]:
    return draw(settings, _numpy(emitters))


def _adapt(
    settings: RibsSettings, first: Array, start: Array, seeds: Array, *known: PyTree
) -> tuple[PyTree, PyTree]:
    if first:
        return start_emitters(settings, np.asarray(start), np.asarray(seeds))
    return adapt(settings, *_numpy(known))


def _numpy(tree: PyTree) -> Any:
    return jax.tree.map(np.asarray, tree)
