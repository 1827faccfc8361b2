"""Searches on the map of bodies (`evo_cpg.studies.body_map`): which end near the best bodies?

A search changes the body and the rhythm together. Its final body is near the best if the map knows
at most 1 % better bodies. The searches differ in three switches, and all have equally many trials:

- *Protection.* Individuals survive by the Pareto front of fitness and age, so that a new body need
  not compete with bodies whose rhythm had longer to adapt (Schmidt and Lipson 2011, "Age-fitness
  Pareto optimization"). Differs from them: the age counts the generations since the body changed.
- *Learning.* A new individual first improves its rhythm in a few trials. Its children inherit the
  improved rhythm (Lamarck) or the rhythm from before (Baldwin).
- *Random.* All individuals are random.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from evo_cpg.studies.body_map import RHYTHM, Family

# Standard deviation of mutations and of learning. Probability that a child's body mutates.
_CHANGE, _NEW_BODY = 0.1, 0.5


class Scheme(NamedTuple):
    """Switches of a search.

    Attributes:
        name: name in the table.
        trials: number of trials of a new individual. It learns if there are several.
        inherits: whether children inherit what their parent has learned.
        protects: whether young bodies are protected.
        random: whether all individuals are random.
    """

    name: str
    trials: int = 1
    inherits: bool = False
    protects: bool = False
    random: bool = False


SCHEMES = (
    Scheme("body and rhythm together"),
    Scheme("young bodies protected", protects=True),
    Scheme("learning, inherited", trials=10, inherits=True),
    Scheme("learning, not inherited", trials=10),
    Scheme("random search", random=True),
)


class Population(NamedTuple):
    """Individuals of several runs, ``(runs, individuals)`` first.

    Attributes:
        body: genes of the body, 0 to 1.
        rhythm: genes of the rhythm that children inherit.
        fitness: fitness after learning.
        age: number of generations since the body changed.
    """

    body: Float[np.ndarray, "r p 3"]
    rhythm: Float[np.ndarray, "r p 5"]
    fitness: Float[np.ndarray, "r p"]
    age: Int[np.ndarray, "r p"]


def final_bodies(
    family: Family, scheme: Scheme, runs: int, size: int, trials: int, seed: int
) -> tuple[Int[np.ndarray, " r"], Float[np.ndarray, " r"]]:
    """Return the best individual's body and fitness at the end of each run.

    Args:
        family: bodies of the map. A search uses the nearest of them.
        scheme: switches of the search.
        runs: number of runs.
        size: number of individuals.
        trials: number of trials in a run.
        seed: seed of the runs.
    """
    draw = np.random.default_rng(seed)
    found = _random(draw, family, scheme, (runs, size))
    for _ in range(trials // (size * scheme.trials) - 1):
        new = _random if scheme.random else _children
        other = new(draw, family, scheme, (runs, size), found)
        both = Population(*(np.concatenate(x, 1) for x in zip(found, other, strict=True)))
        found = _survivors(both._replace(age=both.age + 1), size, scheme.protects)
    best = found.fitness.argmax(1)[:, None]
    body = np.take_along_axis(found.body, best[..., None], 1)[:, 0]
    return family.nearest(body), np.take_along_axis(found.fitness, best, 1)[:, 0]


def _random(
    draw: np.random.Generator, family: Family, scheme: Scheme, shape: tuple[int, int], *_: Any
) -> Population:
    """Return random individuals."""
    body, rhythm = draw.random((*shape, 3)), draw.random((*shape, RHYTHM))
    return _tried(draw, family, scheme, body, rhythm, np.zeros(shape, int))


def _children(
    draw: np.random.Generator,
    family: Family,
    scheme: Scheme,
    shape: tuple[int, int],
    parents: Population,
) -> Population:
    """Return a mutated child of each individual."""
    changes = (draw.random(shape) < _NEW_BODY) | (scheme.trials > 1)
    body = np.where(changes[..., None], _mutated(draw, parents.body), parents.body)
    age = np.where(changes, 0, parents.age)
    return _tried(draw, family, scheme, body, _mutated(draw, parents.rhythm), age)


def _mutated(draw: np.random.Generator, genes: np.ndarray) -> np.ndarray:
    return np.clip(genes + _CHANGE * draw.standard_normal(genes.shape), 0, 1)


def _tried(
    draw: np.random.Generator,
    family: Family,
    scheme: Scheme,
    body: Float[np.ndarray, "r p 3"],
    rhythm: Float[np.ndarray, "r p 5"],
    age: Int[np.ndarray, "r p"],
) -> Population:
    """Return individuals after their trials: a climb of the rhythm by mutations."""
    bodies = family.nearest(body).reshape(-1)

    def fitness_of(rhythm: np.ndarray) -> np.ndarray:
        return family.fitness(bodies, rhythm.reshape(-1, 1, RHYTHM)).reshape(age.shape)

    learned, fitness = rhythm, fitness_of(rhythm)
    for _ in range(scheme.trials - 1):
        other = _mutated(draw, learned)
        found = fitness_of(other)
        learned = np.where((found > fitness)[..., None], other, learned)
        fitness = np.maximum(found, fitness)
    return Population(body, learned if scheme.inherits else rhythm, fitness, age)


def _survivors(both: Population, size: int, protects: bool) -> Population:
    """Return the individuals with the least better ones: fitter, and younger if protected."""
    fitter = both.fitness[:, None] > both.fitness[..., None]
    better = fitter
    if protects:
        younger, older = (
            both.age[:, None] < both.age[..., None],
            both.age[:, None] > both.age[..., None],
        )
        equal = both.fitness[:, None] == both.fitness[..., None]
        better = (fitter & ~older) | (equal & younger)
    order = np.lexsort((-both.fitness, better.sum(-1)), axis=-1)[:, :size]
    return Population(
        *(np.take_along_axis(x, order.reshape(*order.shape, *(1,) * (x.ndim - 2)), 1) for x in both)
    )
