"""What every search takes and gives: genomes to be tried, and what came of them.

A *strategy* is structure and settings, like a controller or a task; what it learns is its *state*,
any pytree of arrays, which the checkpoint holds beside the population. In every generation it is
asked for genomes and told what they are worth:

    init ---> ask ---> (trials) ---> tell ---> ask ---> (trials) ---> ...

Asking and telling are pure JAX functions and part of one compiled generation step. Genes come first
and individuals last, ``(g, n)``; fitness is maximised.
"""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, PyTree

from evo_cpg.evolution.archive import Archive, Axis


class Evaluation(eqx.Module):
    """What a population is worth.

    Attributes:
        fitness: of every individual, to be maximised: the mean over its trials; -inf where it
            diverged in any.
        terms: the task's terms by name, likewise averaged.
        descriptors: those terms that say how an individual behaves, see `Task.descriptors`.
        trial_fitness: fitness in each trial, of which `fitness` is the mean.
    """

    fitness: Float[Any, " n"]
    terms: dict[str, Float[Any, " n"]]
    descriptors: dict[str, Float[Any, " n"]]
    trial_fitness: Float[Any, "trials n"]

    def __repr__(self) -> str:
        shape = f"of shape {list(jnp.shape(self.fitness))}"
        if isinstance(self.fitness, np.ndarray) and self.fitness.size:
            shape = f"of {self.fitness.size} individuals, best {self.fitness.max():.4g}"
        return f"Evaluation(fitness {shape}; terms: {', '.join(self.terms)})"


class Strategy(eqx.Module):
    """A search for good genomes. Subclass it to write one of your own.

    The methods must be pure JAX functions; several runs side by side are batched by `jax.vmap`.
    What `ask` hands back as the state may differ in structure from what `tell` gives: only the
    former is kept from one generation to the next. A strategy is built with the keyword arguments
    in the config's ``evolution.options`` and, where its constructor takes them, ``population``,
    ``gene_count`` and ``binary`` (whether genes are bits, 0 or 1).

    Attributes:
        population: individuals that are asked for in every generation.
        checks_genes: whether a run stops if `ask` returns genes that are not finite.

    Example:
        A hill climber: normal noise about the best genome ever tried::

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

    @abc.abstractmethod
    def init(self, key: Array, genes: Float[Array, "g n"]) -> PyTree[Array]:
        """The state before the first generation.

        Args:
            key: random key.
            genes: random genomes as the controller draws them, or those that a run begins with
                (a warm start). A task's scales are measured on what is asked for first, so
                whoever asks for these first has the same ones as other searches.
        """

    @abc.abstractmethod
    def ask(self, key: Array, state: PyTree[Array]) -> tuple[Float[Array, "g n"], PyTree[Array]]:
        """Genomes to be tried, all finite, and what is to be remembered.

        Args:
            key: random key.
            state: as `init` or `tell` left it.
        """

    @abc.abstractmethod
    def tell(
        self,
        key: Array,
        state: PyTree[Array],
        genes: Float[Array, "g n"],
        evaluation: Evaluation,
    ) -> PyTree[Array]:
        """The state after the trials.

        Args:
            key: random key.
            state: as `ask` left it.
            genes: that were tried: those asked for, unless something else has taken the place of
                some (migrants from another island, say).
            evaluation: what they are worth; no fitness is NaN, that of who diverged is -inf.
        """

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """A first population about one individual: its copies, changed a little.

        Unless overridden, all but the first are as they are given.

        Args:
            key: random key.
            genes: copies of the individual. The first stays as it is.
        """
        del key
        return genes

    @property
    def map_axes(self) -> tuple[Axis, ...]:
        """Axes of the map of behaviour that the search fills; none unless overridden."""
        return ()

    def map_of(self, state: PyTree[Array]) -> Archive | None:
        """Return the map of behaviour in a state that `ask` left; None without `map_axes`."""
        del state
        return None

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the `metrics`; none that metrics.csv has already."""
        return ()

    def metrics(self, state: PyTree[Array]) -> dict[str, Float[Array, ""]]:
        """Numbers for metrics.csv, by name; none unless overridden.

        Args:
            state: as `ask` left it.
        """
        del state
        return {}


def worst_finite(fitness: Float[Array, " n"]) -> Float[Array, " n"]:
    """Fitness with that of the worst survivor where it is not finite; 0 where nobody survived.

    For strategies that compute with it.
    """
    alive = jnp.isfinite(fitness)
    worst = jnp.where(alive, fitness, jnp.inf).min()
    return jnp.where(alive, fitness, jnp.where(jnp.isfinite(worst), worst, 0.0))


def descriptor_rows(evaluation: Evaluation, names: tuple[str, ...]) -> Float[Array, "k n"]:
    """Descriptors, or else terms, by name."""
    known: dict[str, ArrayLike] = {**evaluation.terms, **evaluation.descriptors}
    return jnp.stack([jnp.asarray(known[name]) for name in names])
