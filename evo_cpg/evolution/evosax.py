"""Algorithms of evosax (Lange 2022, evosax: JAX-based evolution strategies) as a strategy.

evosax is installed with the extra ``evosax``. Importing it starts JAX, so the import waits until a
strategy is built. evosax minimises, so fitness changes its sign. An individual that diverged gets
the worst fitness of the others, because many algorithms compute with the fitness values. For
genomes of bits the algorithm searches real numbers, and a gene is 1 where its number is positive.

Like any other search it begins with the random genomes of the controller, on which the task's
scales are measured. An algorithm with a distribution then starts at the mean of the better half of
these genomes. An algorithm with a population starts with all of them.

Genes are clipped to bounds after the draw. The algorithm gets back the numbers that it drew, before
clipping, where they still give the evaluated genes. Full covariance matrices (``CMA_ES``,
``MA_ES``) need memory and time with the square of the number of genes. Alternatives for a brain of
3000 are ``Sep_CMA_ES``, ``LM_MA_ES``, ``Open_ES`` and ``DifferentialEvolution``.
"""

import dataclasses
import functools
import importlib
import inspect
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int, PyTree

from evo_cpg.evolution.operators import rank_order
from evo_cpg.evolution.strategy import Evaluation, Strategy, worst_finite

# Probability that a bit is flipped in a population around one individual.
_FLIPPED = 0.1


class Sample(NamedTuple):
    """State of the search between generations.

    Attributes:
        numbers: numbers that the algorithm drew, or numbers of the first genes.
        state: state of the algorithm.
        told: number of evaluated generations. The algorithm starts after the first.
    """

    numbers: Float[Array, "g n"]
    state: PyTree[Array]
    told: Int[Array, ""]


class Evosax(Strategy):
    """An algorithm of evosax.

    Attributes:
        algorithm: name of the algorithm's class.
        population: number of individuals.
        gene_count: numbers in a genome.
        binary: True if genes are bits.
        sigma: standard deviation of the first sample, if the algorithm has one.
        gene_bound: largest magnitude of a gene, or None for bits.
        learning_rate: learning rate of Adam, if the algorithm follows a gradient.
        params: parameters of the algorithm that differ from its defaults, with their values.
        options: options of the algorithm's constructor.

    Raises:
        TypeError: the constructor does not take an option.
        ValueError: the algorithm does not have a parameter.
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
        # Build it now, so that wrong parameters are reported.
        _ = self._tuned

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Sample:
        """Return a state with the first genomes."""
        numbers = self._numbers(genes)
        fitness = jnp.zeros(numbers.shape[1], numbers.dtype)
        return Sample(numbers, self._started(key, numbers, fitness), jnp.int32(0))

    def ask(self, key: Array, state: Sample) -> tuple[Float[Array, "g n"], Sample]:
        """Return the first genomes in generation 0, later genomes that the algorithm draws."""
        algorithm, params = self._tuned
        with jax.numpy_rank_promotion("allow"):
            rows, inner = algorithm.ask(key, state.state, params)
        first = state.told == 0
        numbers = jnp.where(first, state.numbers, rows.T)
        inner_state = jax.tree.map(lambda old, new: jnp.where(first, old, new), state.state, inner)
        return self._genes(numbers), Sample(numbers, inner_state, state.told)

    def tell(
        self, key: Array, state: Sample, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Sample:
        """See `Strategy.tell`."""
        same = genes == self._genes(state.numbers)
        numbers = jnp.where(same, state.numbers, self._numbers(genes))
        fitness = worst_finite(evaluation.fitness)
        algorithm, params = self._tuned
        with jax.numpy_rank_promotion("allow"):
            later, _ = algorithm.tell(key, numbers.T, -fitness, state.state, params)
        first, started = state.told == 0, self._started(key, numbers, fitness)
        inner = jax.tree.map(lambda a, b: jnp.where(first, a, b), started, later)
        return Sample(numbers, inner, state.told + 1)

    def _started(
        self, key: Array, numbers: Float[Array, "g n"], fitness: Float[Array, " n"]
    ) -> PyTree[Array]:
        """Return the algorithm's state after the first population."""
        algorithm, params = self._tuned
        with jax.numpy_rank_promotion("allow"):
            evosax: Any = importlib.import_module("evosax.algorithms")
            if type(algorithm) in evosax.population_based_algorithms.values():
                return algorithm.init(key, numbers.T, -fitness, params)
            better = rank_order(fitness)[: -(-len(fitness) // 2)]
            return algorithm.init(key, numbers[:, better].mean(1), params)

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """Add normal noise, or flip each bit with probability 0.1, in all genomes but the first."""
        if self.binary:
            flipped = jax.random.bernoulli(key, _FLIPPED, genes.shape)
            changed = jnp.where(flipped, 1.0 - genes, genes)
        else:
            changed = genes + self.sigma * jax.random.normal(key, genes.shape, genes.dtype)
        return self._genes(self._numbers(changed)).at[:, 0].set(genes[:, 0])

    def _genes(self, numbers: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the genes for the unbounded real numbers that the algorithm searches."""
        if self.binary:
            return (numbers > 0).astype(numbers.dtype)
        bound = np.inf if self.gene_bound is None else self.gene_bound
        return jnp.clip(numbers, -bound, bound)

    def _numbers(self, genes: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return numbers that `_genes` converts to these genes: -sigma and sigma for bits."""
        return self.sigma * (2.0 * genes - 1.0) if self.binary else genes

    @property
    def _tuned(self) -> tuple[Any, Any]:
        """The algorithm, and its parameters with the changes in `params`."""
        numbers = self.population, self.gene_count, self.sigma, self.learning_rate
        return _build(self.algorithm, *numbers, self.options, self.params)


def algorithms() -> list[str]:
    """Return the names of the available algorithms.

    Raises:
        ImportError: evosax is not installed.
    """
    evosax = importlib.import_module("evosax.algorithms")
    tables = evosax.distribution_based_algorithms, evosax.population_based_algorithms
    return sorted(kind.__name__ for table in tables for kind in table.values())


@functools.lru_cache(maxsize=16)
def _build(
    name: str,
    population: int,
    gene_count: int,
    sigma: float,
    learning_rate: float,
    options: tuple[tuple[str, Any], ...],
    changes: tuple[tuple[str, float | bool], ...],
) -> tuple[Any, Any]:
    """Build the algorithm and its parameters, once for equal settings.

    `jax.jit` compares algorithms by identity, and would compile again for a new object.

    Raises:
        ValueError: the algorithm does not have a parameter.
    """
    kind = getattr(importlib.import_module("evosax.algorithms"), name)
    taken, given = inspect.signature(kind).parameters, dict(options)
    if "std_schedule" in taken:
        given.setdefault("std_schedule", optax.constant_schedule(sigma))
    if "optimizer" in taken:
        given.setdefault("optimizer", optax.adam(learning_rate))
    # Some algorithms convert computed values to Python numbers, which fails for tracers.
    with jax.ensure_compile_time_eval():
        genome = jnp.zeros(gene_count, jnp.float32)
        algorithm = kind(population_size=population, solution=genome, **given)
        params = algorithm.default_params
    known = [field.name for field in dataclasses.fields(params)]
    unknown = [name for name, _ in changes if name not in known]
    if unknown:
        raise ValueError(
            f"it has no parameter {', '.join(unknown)} (valid: {', '.join(known) or 'none'})"
        )
    first = {"std_init": sigma} if hasattr(params, "std_init") else {}
    return algorithm, params.replace(**first | dict(changes))
