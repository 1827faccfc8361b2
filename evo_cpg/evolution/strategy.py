"""Interface of all searches, their map of behaviour, and random search as the baseline.

A *strategy* is structure and settings, like a controller or a task. Its *state* is any pytree of
arrays, which the checkpoint stores with the population. Every generation calls `ask` for genomes
and `tell` with their evaluation:

    init ---> ask ---> (trials) ---> tell ---> ask ---> (trials) ---> ...

Both are pure JAX functions. One compiled program per generation contains both. Genes come first and
individuals last, ``(g, n)``. Fitness is maximised.

A search may fill a map of behaviour: axes divided into cells, with the fittest individual of each
cell.
"""

import abc
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree, UInt8


class Axis(NamedTuple):
    """A descriptor, and how its range is divided into cells.

    Attributes:
        name: name of the descriptor.
        low: lower edge of the first cell.
        high: upper edge of the last cell.
        cells: number of cells.
    """

    name: str
    low: float
    high: float
    cells: int

    @property
    def edges(self) -> Float[np.ndarray, " edges"]:
        """Edges of all cells."""
        return np.linspace(self.low, self.high, self.cells + 1)


class Archive(NamedTuple):
    """Elites: the fittest individual so far of each cell. Checkpoints use the names of the arrays.

    Attributes:
        genes: genome of each elite.
        fitness: fitness of each elite, or -inf if the cell is empty.
        descriptors: descriptors of each elite, in the order of the axes.
        generation: generation in which each elite was found, from 0, or -1 if the cell is empty.
        index: index of each elite in the population of that generation. Generation and index select
            the random numbers of the elite's trials.
        told: number of generations whose individuals were entered into the archive.
    """

    genes: Float[Array, "g cells"]
    fitness: Float[Array, " cells"]
    descriptors: Float[Array, "k cells"]
    generation: Int[Array, " cells"]
    index: Int[Array, " cells"]
    told: Int[Array, ""]


class Births(NamedTuple):
    """Origin of every individual of the next generation, and the present genomes as bytes.

    Attributes:
        first: index of the parent, of which an individual without a second parent is a copy.
        second: index of the second parent, or -1.
        kind: kind of the birth, an index of `BIRTH_KINDS`.
        genome: genomes of the present generation, ``b`` bytes each.
    """

    first: Int[Array, " n"]
    second: Int[Array, " n"]
    kind: Int[Array, " n"]
    genome: UInt8[Array, "b n"]


BIRTH_KINDS = ("kept", "copied", "crossed", "grafted")
"""Kinds of births. All but the first may also alter genes."""


class Evaluation(eqx.Module):
    """Evaluation of a population.

    Attributes:
        fitness: fitness of every individual, to be maximised. It is the mean over the trials, or
            -inf if the individual diverged in any.
        terms: the task's terms and measures by name, averaged over the trials.
        descriptors: numbers that describe the behaviour of an individual: `Task.descriptors` and
            the measures of gait.
        trial_fitness: fitness in each trial. By default there is one trial.
    """

    fitness: Float[Any, " n"]
    terms: dict[str, Float[Any, " n"]]
    descriptors: dict[str, Float[Any, " n"]]
    trial_fitness: Float[Any, "trials n"] = None

    def __post_init__(self):
        if self.trial_fitness is None:
            self.trial_fitness = self.fitness[None]

    def __repr__(self) -> str:
        shape = f"of shape {list(jnp.shape(self.fitness))}"
        if isinstance(self.fitness, np.ndarray) and self.fitness.size:
            shape = f"of {self.fitness.size} individuals, best {self.fitness.max():.4g}"
        return f"Evaluation(fitness {shape}; terms: {', '.join(self.terms)})"


class Strategy(eqx.Module):
    """A search for good genomes. Subclass it to write your own.

    The methods must be pure JAX functions. `jax.vmap` batches several runs side by side. The state
    from `ask` may differ in structure from the state from `tell`. Only the former is kept from one
    generation to the next.

    A strategy is built with the keyword arguments in the config's ``evolution.options``. It also
    gets ``population``, ``gene_count`` and ``binary`` (whether genes are bits, 0 or 1) if its
    constructor takes them.

    Attributes:
        population: number of individuals in every generation.
        checks_genes: True if a run stops when `ask` returns genes that are not finite.
        map_axes: axes of the map of behaviour that the search fills, or () for no map.
        metric_names: names of the `metrics`, distinct from the other columns of metrics.csv.

    Example:
        A hill climber, with normal noise about the best genome so far::

            class Climber(Strategy):
                population: int = eqx.field(static=True)
                sigma: float = 0.1

                def init(self, key, genes):
                    return genes[:, 0], -jnp.inf

                def ask(self, key, state):
                    best, fitness = state
                    noise = jax.random.normal(key, (len(best), self.population), best.dtype)
                    return best[:, None] + self.sigma * noise, state

                def tell(self, key, state, genes, evaluation):
                    best, fitness = state
                    i = jnp.argmax(evaluation.fitness)
                    better = evaluation.fitness[i] > fitness
                    best = jnp.where(better, genes[:, i], best)
                    return best, jnp.where(better, evaluation.fitness[i], fitness)
    """

    population: eqx.AbstractVar[int]

    checks_genes = True
    map_axes: ClassVar[tuple[Axis, ...]] = ()
    metric_names: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def init(self, key: Array, genes: Float[Array, "g n"]) -> PyTree[Array]:
        """Return the state before the first generation.

        Args:
            key: random key.
            genes: random genomes from the controller, or the initial genomes of a warm start. The
                first genomes from `ask` determine a task's scales. A strategy that returns these
                genomes first has the scales of other searches.
        """

    @abc.abstractmethod
    def ask(self, key: Array, state: PyTree[Array]) -> tuple[Float[Array, "g n"], PyTree[Array]]:
        """Return genomes to evaluate, all finite, and the state for `tell`.

        Args:
            key: random key.
            state: state from `init` or `tell`.
        """

    @abc.abstractmethod
    def tell(
        self, key: Array, state: PyTree[Array], genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> PyTree[Array]:
        """Return the state after the trials.

        Args:
            key: random key.
            state: state from `ask`.
            genes: evaluated genomes: the genomes from `ask`, of which some may have been replaced
                (by migrants from another island, for example).
            evaluation: results of the genomes. No fitness is NaN. An individual that diverged has
                -inf.
        """

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """Return a first population around one individual: its copies with small changes.

        The first copy stays unchanged. Unless overridden, all do.
        """
        del key
        return genes

    def births(
        self, key: Array, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> Births | None:
        """Return the origin of the individuals that `tell` makes with these arguments.

        None if the search keeps no family tree (`evo_cpg.training.family`), unless overridden.
        """
        del key, genes, evaluation
        return None

    def map_of(self, state: PyTree[Array]) -> Archive | None:
        """Return the map of behaviour in a state from `ask`, or None without `map_axes`."""
        del state
        return None

    def metrics(self, state: PyTree[Array]) -> dict[str, Float[Array, ""]]:
        """Return numbers of a state from `ask` for metrics.csv, by name.

        There are none unless overridden.
        """
        del state
        return {}


def worst_finite(fitness: Float[Array, " n"]) -> Float[Array, " n"]:
    """Replace fitness that is not finite by the worst finite fitness, or 0 if there is none.

    Strategies that compute with fitness values use this.
    """
    alive = jnp.isfinite(fitness)
    worst = jnp.where(alive, fitness, jnp.inf).min()
    return jnp.where(alive, fitness, jnp.where(jnp.isfinite(worst), worst, 0.0))


class RandomSearch(Strategy):
    """Random genomes in every generation.

    Attributes:
        population: individuals in every generation.
        draw: random genomes ``(g, n)`` from a key.
    """

    population: int = eqx.field(static=True)
    draw: Callable[[Array], Float[Array, "g n"]]

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """Return the first genomes."""
        del key
        return genes

    def ask(
        self, key: Array, state: Float[Array, "g n"] | None
    ) -> tuple[Float[Array, "g n"], None]:
        """Return the first genomes in the first generation, later new random genomes."""
        return self.draw(key) if state is None else state, None

    def tell(
        self, key: Array, state: None, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> None:
        """Return None: random search ignores the results."""
