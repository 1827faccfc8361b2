"""CMA-MAE of pyribs (Tjanaka et al. 2023; Fontaine and Nikolaidis 2023) as a strategy.

Like any other search it begins with the random genomes of the controller, on which scales are
measured. From then on several evolution strategies, the *emitters*, each adapt a normal
distribution, first about the mean of the better half of those, and put what they draw into one map.
A cell of it has a threshold, the fitness that has to be exceeded to enter, and with each that
enters it rises a little,

    threshold <- (1 - a) threshold + a fitness,

from ``threshold_min`` on, with the learning rate ``a``. (Where none is given it is the median of
those who live through the emitters' first generation: who is worse is not worth a cell.) An emitter
ranks what it drew by how far that lies above the thresholds: as they rise where it has been, it
moves on to where they are low.
``a = 0`` optimises alone, as CMA-ES does, ``a = 1`` is CMA-ME. The settings are those of Fontaine
and Nikolaidis: the better half of a sample are parents, and an emitter begins anew at an elite of
the map when its sample has converged.

pyribs is installed with the extra ``pyribs``, and imported when a strategy is made. Emitters and
their map run on the host, in a callback of `Ribs.ask` and `Ribs.tell`. Between calls they are a
pytree of arrays (see `evo_cpg.evolution.pyribs_host`).

The emitters' map drops the fittest of a cell where a threshold allows a worse one, so the map that
a run shows is another one, `evo_cpg.evolution.map_elites.Archive`, which everybody enters.

An individual that diverged, has descriptors that are not finite, or is not the one that the emitter
drew (a migrant) does not enter the emitters' map, and ranks below all others of its emitter. While
that map is empty, because none exceeded ``threshold_min``, there is nothing to begin anew from:
then no emitter adapts, and all continue to draw where they began.

Genes are clipped to their bounds after they were drawn (pyribs itself would draw again, at 3000
genes forever); bits are as in `evo_cpg.evolution.latent`. A full covariance matrix (``cma_es``)
takes memory and time with the square and the cube of the number of genes, and is hopeless for a
brain of 3000: that is 72 MB a matrix, of which every emitter holds three.
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

# Arrays by name; of those of emitters the first axis is that of the emitters.
Arrays = dict[str, Array]


class State(NamedTuple):
    """State of the search.

    Attributes:
        archive: everybody's map.
        cells: the emitters' map.
        emitters: their distributions.
        drawn: the last sample: the numbers of each individual, and what they were made of.
    """

    archive: Archive
    cells: Arrays
    emitters: Arrays
    drawn: Arrays


class Ribs(MapStrategy):
    """CMA-MAE.

    Attributes:
        population: individuals, shared equally by the emitters.
        gene_count: numbers in a genome.
        axes: of the map.
        binary: whether genes are bits.
        emitters: how many.
        es: the evolution strategy of each, by pyribs' name: one of `ALGORITHMS`.
        sigma: standard deviation of the first sample.
        learning_rate: of thresholds, 0 to 1.
        threshold_min: where they begin; None for the median of their first sample.
        gene_bound: largest magnitude of a gene; None of bits.
        options: of the evolution strategy's constructor, such as ``lr`` of ``openai_es``.

    Raises:
        ImportError: pyribs is not installed.
        UnknownPyribsError: pyribs is of an unknown version.
        TypeError: options that the constructor does not take.
        ValueError: settings that do not go together.
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
                f"a population of {self.population} cannot be shared equally by {self.emitters} "
                "emitters"
            )
        if self.population < 2 * self.emitters:
            raise ValueError(
                f"each of {self.emitters} emitters needs two individuals or more, and the "
                f"population is {self.population}"
            )
        optimiser(self._settings)
        layout(self._settings)

    def map_of(self, state: State) -> Archive:
        """Everybody's map."""
        return state.archive

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Beginning:
        """See `Strategy.init`."""
        del key
        return Beginning(self.empty(genes), genes)

    def ask(self, key: Array, state: State | Beginning) -> tuple[Float[Array, "g n"], State]:
        """What comes first; then what the emitters draw, with random numbers of their own."""
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
        """What is told; after the first population the emitters begin.

        They do so about the mean of its better half, in numbers.
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
        """Also ``restarts``: how often emitters began anew, all together."""
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
        """The numbers of every individual."""
        return drawn[SAMPLE].reshape(self.population, self.gene_count)


def _on_host(function: Any, like: PyTree, *given: PyTree) -> Any:
    """A function of NumPy arrays within a program of JAX; under `jax.vmap` one after the other."""
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
