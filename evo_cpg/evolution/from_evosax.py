"""Algorithms of evosax (Lange 2022, evosax: JAX-based evolution strategies) as a strategy.

evosax is installed with the extra ``evosax``; importing it starts JAX, so that is done when a
strategy is made. It minimises, so
fitness changes its sign; an individual that diverged gets the worst fitness of those that did not,
for many of its algorithms compute with it. Where a genome is bits the algorithm searches real
numbers, and a gene is 1 where its number is positive.

Like any other search it begins with the random genomes of the controller, on which scales are
measured. A distribution then starts about the mean of the better half of them, a population with
all of them.

Genes are kept within bounds after the algorithm drew them, and it is told the numbers that it drew
where the genes that were tried are still those. Full covariance matrices (``CMA_ES``, ``MA_ES``)
need memory and time with the square of the number of genes: for a brain of 3000 there are
``Sep_CMA_ES``, ``LM_MA_ES``, ``Open_ES`` and ``DifferentialEvolution``.
"""

import dataclasses
import functools
import importlib
import inspect
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, PyTree

from evo_cpg.evolution.latent import Latent
from evo_cpg.evolution.selection import rank_order
from evo_cpg.evolution.strategy import Evaluation, Strategy, worst_finite


class Sample(NamedTuple):
    """What goes on from one generation to the next.

    Attributes:
        numbers: that the algorithm drew, or what the first genes are in its terms.
        state: of the algorithm.
        told: number of generations that were told of; the algorithm begins after the first.
    """

    numbers: Float[Array, "g n"]
    state: PyTree[Array]
    told: Int[Array, ""]


class Evosax(Strategy):
    """An algorithm of evosax.

    Attributes:
        algorithm: the name of its class.
        population: individuals.
        gene_count: numbers in a genome.
        binary: whether they are bits.
        sigma: standard deviation of the first sample, where the algorithm has one.
        gene_bound: largest magnitude of a gene; None of bits.
        learning_rate: of Adam, where the algorithm follows a gradient.
        params: parameters of the algorithm and their values, where they are not its defaults.
        options: of its constructor.

    Raises:
        TypeError: options that its constructor does not take.
        ValueError: parameters that it does not have.
    """

    algorithm: str = eqx.field(static=True)
    population: int = eqx.field(static=True)
    gene_count: int = eqx.field(static=True)
    binary: bool = eqx.field(static=True, default=False)
    sigma: float = eqx.field(static=True, default=0.5)
    gene_bound: float | None = eqx.field(static=True, default=8.0)
    learning_rate: float = eqx.field(static=True, default=0.02)
    params: tuple[tuple[str, float | bool], ...] = eqx.field(static=True, default=())
    options: tuple[tuple[str, Any], ...] = eqx.field(static=True, default=())

    def __post_init__(self):
        known = [field.name for field in dataclasses.fields(self._built[1])]
        unknown = [name for name, _ in self.params if name not in known]
        if unknown:
            raise ValueError(
                f"it has no parameter {', '.join(unknown)}; it has {', '.join(known) or 'none'}"
            )

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Sample:
        """The genomes that come first."""
        numbers = self._latent.numbers(genes)
        fitness = jnp.zeros(numbers.shape[1], numbers.dtype)
        return Sample(numbers, self._started(key, numbers, fitness), jnp.int32(0))

    def ask(self, key: Array, state: Sample) -> tuple[Float[Array, "g n"], Sample]:
        """What comes first, then what the algorithm draws."""
        with jax.numpy_rank_promotion("allow"):
            rows, inner = self._algorithm.ask(key, state.state, self._params)
        first = state.told == 0
        numbers = jnp.where(first, state.numbers, rows.T)
        inner_state = jax.tree.map(lambda old, new: jnp.where(first, old, new), state.state, inner)
        return self._latent.genes(numbers), Sample(numbers, inner_state, state.told)

    def tell(
        self, key: Array, state: Sample, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Sample:
        """See `Strategy.tell`."""
        same = genes == self._latent.genes(state.numbers)
        numbers = jnp.where(same, state.numbers, self._latent.numbers(genes))
        fitness = worst_finite(evaluation.fitness)
        with jax.numpy_rank_promotion("allow"):
            later, _ = self._algorithm.tell(key, numbers.T, -fitness, state.state, self._params)
        first, started = state.told == 0, self._started(key, numbers, fitness)
        inner = jax.tree.map(lambda a, b: jnp.where(first, a, b), started, later)
        return Sample(numbers, inner, state.told + 1)

    def _started(
        self, key: Array, numbers: Float[Array, "g n"], fitness: Float[Array, " n"]
    ) -> PyTree[Array]:
        """The algorithm's state after the first population."""
        algorithm = self._algorithm
        with jax.numpy_rank_promotion("allow"):
            if type(algorithm) in _evosax().population_based_algorithms.values():
                return algorithm.init(key, numbers.T, -fitness, self._params)
            better = rank_order(fitness)[: -(-len(fitness) // 2)]
            return algorithm.init(key, numbers[:, better].mean(1), self._params)

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """See `Latent.around`."""
        return self._latent.around(key, genes)

    @property
    def _latent(self) -> Latent:
        return Latent(self.binary, self.sigma, self.gene_bound)

    @property
    def _algorithm(self) -> Any:
        return self._built[0]

    @property
    def _built(self) -> tuple[Any, Any]:
        return _build(
            self.algorithm,
            self.population,
            self.gene_count,
            self.sigma,
            self.learning_rate,
            self.options,
        )

    @property
    def _params(self) -> Any:
        params = self._built[1]
        given = {"std_init": self.sigma} if hasattr(params, "std_init") else {}
        given |= dict(self.params)
        return params.replace(**given)


def algorithms() -> list[str]:
    """Names of the algorithms that there are.

    Raises:
        ImportError: evosax is not installed.
    """
    evosax = _evosax()
    tables = evosax.distribution_based_algorithms, evosax.population_based_algorithms
    return sorted(kind.__name__ for table in tables for kind in table.values())


def _evosax() -> Any:
    return importlib.import_module("evosax.algorithms")


@functools.lru_cache(maxsize=16)
def _build(
    name: str,
    population: int,
    gene_count: int,
    sigma: float,
    learning_rate: float,
    options: tuple[tuple[str, Any], ...],
) -> tuple[Any, Any]:
    """The algorithm and its defaults; one object for equal settings: `jax.jit` goes by identity."""
    kind = getattr(_evosax(), name)
    taken, given = inspect.signature(kind).parameters, dict(options)
    if "std_schedule" in taken:
        given.setdefault("std_schedule", optax.constant_schedule(sigma))
    if "optimizer" in taken:
        given.setdefault("optimizer", optax.adam(learning_rate))
    # Some of them make Python numbers of what they compute, which a tracer cannot be.
    with jax.ensure_compile_time_eval():
        genome = jnp.zeros(gene_count, jnp.float32)
        algorithm = kind(population_size=population, solution=genome, **given)
        return algorithm, algorithm.default_params
