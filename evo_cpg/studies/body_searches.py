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

from typing import NamedTuple

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
    search = _Search(family, scheme, (runs, size), np.random.default_rng(seed))
    found = search.random()
    for _ in range(trials // (size * scheme.trials) - 1):
        other = search.random() if scheme.random else search.children(found)
        both = Population(*(np.concatenate(x, 1) for x in zip(found, other, strict=True)))
        found = survivors(both._replace(age=both.age + 1), size, scheme.protects)
    best = found.fitness.argmax(1)[:, None]
    body = np.take_along_axis(found.body, best[..., None], 1)[:, 0]
    return family.nearest(body), np.take_along_axis(found.fitness, best, 1)[:, 0]


class _Search(NamedTuple):
    """Several runs of a search side by side, with their shape ``(runs, individuals)``."""

    family: Family
    scheme: Scheme
    shape: tuple[int, int]
    draw: np.random.Generator

    def random(self) -> Population:
        """Return random individuals."""
        body, rhythm = self.draw.random((*self.shape, 3)), self.draw.random((*self.shape, RHYTHM))
        return self._tried(body, rhythm, np.zeros(self.shape, int))

    def children(self, parents: Population) -> Population:
        """Return a mutated child of each individual. A child that learns always has a new body."""
        changes = (self.draw.random(self.shape) < _NEW_BODY) | (self.scheme.trials > 1)
        body = np.where(changes[..., None], self._mutated(parents.body), parents.body)
        age = np.where(changes, 0, parents.age)
        return self._tried(body, self._mutated(parents.rhythm), age)

    def _mutated(self, genes: np.ndarray) -> np.ndarray:
        return np.clip(genes + _CHANGE * self.draw.standard_normal(genes.shape), 0, 1)

    def _tried(self, body: np.ndarray, rhythm: np.ndarray, age: np.ndarray) -> Population:
        """Return individuals after their trials, a climb of the rhythm by mutations."""
        bodies = self.family.nearest(body).reshape(-1)
        learned, best = rhythm, np.full(self.shape, -np.inf)
        for number in range(self.scheme.trials):
            new = self._mutated(learned) if number else rhythm
            fitness = self.family.fitness(bodies, new.reshape(-1, 1, RHYTHM)).reshape(self.shape)
            learned = np.where((fitness > best)[..., None], new, learned)
            best = np.maximum(fitness, best)
        return Population(body, learned if self.scheme.inherits else rhythm, best, age)


def survivors(both: Population, size: int, protects: bool) -> Population:
    """Return the individuals that fewest others dominate, and the fittest of these.

    An individual dominates another one if it is fitter and not older, or as fit and younger. The
    age does not count without protection.
    """
    age, fitness = both.age * protects, both.fitness
    fitter = fitness[:, None] > fitness[..., None]
    tied = (fitness[:, None] == fitness[..., None]) & (age[:, None] < age[..., None])
    dominated = ((fitter & (age[:, None] <= age[..., None])) | tied).sum(-1)
    kept = np.lexsort((-fitness, dominated), axis=-1)[:, :size]
    runs = np.arange(len(kept))[:, None]
    return Population(*(values[runs, kept] for values in both))
