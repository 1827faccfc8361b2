"""Who is champion where chance has a say: candidates are tried again until luck has averaged out.

Under noise the best fitness ever measured is that of somebody lucky. So when all generations are
done, the fittest of the population that the run ends with, and the best that it ever measured, live
again in fresh draws of chance, the same draws for all of them, by sequential halving (Karnin, Koren
and Somekh 2013): whoever is not in the better half of a round drops out of the next, and those that
are left have more of its lives. A candidate that diverged, or broke a rule, comes behind all that
did so less often; otherwise the mean fitness decides.

A round is as large as a generation and uses its programs, so nothing is compiled for it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt32

from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.experiment import Experiment

CANDIDATES = 16
"""Of each run, at most."""

EVALUATIONS = 16
"""Rounds end when those that are left have lived so often."""

FIRST_ROUND = 2**30
"""The random numbers of a round are those of this generation and the ones after it, which no run
comes to."""


def is_finished(experiment: Experiment, checkpoint: Checkpoint) -> bool:
    """Whether the last generation is done, and the champion known."""
    evolved = checkpoint.generation >= experiment.generations
    return evolved and (experiment.simulation.noise.silent or bool(checkpoint.chosen))


class Places(NamedTuple):
    """Who lives where in a round.

    Attributes:
        candidates: number of the candidate in each place of a run's population.
        draws: place of the population whose random numbers it has.
    """

    candidates: Int[np.ndarray, " population"]
    draws: Int[np.ndarray, " population"]


class Contest:
    """Sequential halving among the candidates of one run.

    Args:
        candidates: the individuals; of those with the same genome the first counts.
        population: lives in a round.

    Attributes:
        candidates: those that take part.
    """

    def __init__(self, candidates: Sequence[Champion], population: int):
        different: dict[bytes, Champion] = {}
        for one in candidates:
            different.setdefault(one.genes.tobytes(), one)
        self.candidates = list(different.values())[: min(CANDIDATES, population)]
        self._population = population
        count = len(self.candidates)
        self._left = np.arange(count)
        self._evaluations, self._failures = np.zeros(count, int), np.zeros(count, int)
        self._sum = np.zeros(count)

    @property
    def done(self) -> bool:
        """Whether one is left, or those that are have lived often enough."""
        results = self._evaluations[self._left]
        return not len(results) or bool(
            results[0] and (len(results) == 1 or results[0] >= EVALUATIONS)
        )

    def places(self) -> Places:
        """Who lives where in the next round; places that are over repeat the last one's life."""
        each = self._population // len(self._left)
        candidates = np.repeat(self._left, each)
        draws = np.tile(np.arange(each), len(self._left))
        over = self._population - len(candidates)
        return Places(*(np.pad(x, (0, over), mode="edge") for x in (candidates, draws)))

    def take(self, fitness: Float[np.ndarray, " population"]) -> None:
        """What came of a round: the worse half drops out.

        Args:
            fitness: of every place; -inf where a life ended early.
        """
        each = self._population // len(self._left)
        results = fitness[: each * len(self._left)].reshape(len(self._left), each)
        self._evaluations[self._left] += each
        self._failures[self._left] += (~np.isfinite(results)).sum(1)
        self._sum[self._left] += np.where(np.isfinite(results), results, 0.0).sum(1)
        mean = self._means()[self._left]
        self._left = self._left[np.lexsort((-mean, self._failures[self._left]))]
        if not self.done:
            self._left = self._left[: -(-len(self._left) // 2)]

    def chosen(self) -> Champion | None:
        """The best of those that are left, with what it came to; None without any candidate."""
        if not len(self._left):
            return None
        return self._result(int(self._left[0]))

    def rows(self) -> list[dict[str, float]]:
        """Of candidates.csv, one for each candidate."""
        rows = []
        for number, one in enumerate(self.candidates):
            row = {"run": one.run, "generation": one.generation, "index": one.index}
            row |= {"fitness": one.fitness, "lives": int(self._evaluations[number])}
            row |= {"ended_early": int(self._failures[number])}
            row |= {"expected": float(self._means()[number])}
            rows.append(row | {"chosen": int(number == self._left[0])})
        return rows

    def _result(self, number: int) -> Champion:
        mean = float(self._means()[number])
        return self.candidates[number]._replace(
            lives=int(self._evaluations[number]),
            expected=mean if np.isfinite(mean) else None,
            ended_early=int(self._failures[number]),
        )

    def _means(self) -> Float[np.ndarray, " candidates"]:
        """Mean fitness over the lives that did not end early; -inf where all did."""
        completed = self._evaluations - self._failures
        return np.where(completed > 0, self._sum / np.maximum(completed, 1), -np.inf)


class Choice:
    """The contests of all runs, side by side as their populations are.

    Args:
        contests: of every run.

    Attributes:
        generation: whose random numbers the next round takes.
    """

    def __init__(self, contests: Sequence[Contest]):
        self.generation = FIRST_ROUND
        self._contests = tuple(contests)

    @property
    def done(self) -> bool:
        """Whether all are."""
        return all(contest.done for contest in self._contests)

    def genes(self, genes: Float[np.ndarray, "g all"]) -> Float[np.ndarray, "g all"]:
        """Who lives in the next round.

        Args:
            genes: of the populations, which a run keeps whose contest is over.
        """
        population = genes.shape[1] // len(self._contests)
        population_genes = genes.copy()
        for run, contest in enumerate(self._contests):
            if not contest.done:
                given = np.stack([one.genes for one in contest.candidates], axis=1)
                own = slice(run * population, (run + 1) * population)
                population_genes[:, own] = given[:, contest.places().candidates]
        return population_genes

    def keys(self, keys: UInt32[np.ndarray, "w n"], trials: int) -> UInt32[np.ndarray, "w n"]:
        """Those of its trials.

        Args:
            keys: of a generation of that number.
            trials: of every individual.
        """
        by_place = keys.reshape(len(keys), len(self._contests), -1, trials).copy()
        for run, contest in enumerate(self._contests):
            if not contest.done:
                by_place[:, run] = by_place[:, run, contest.places().draws]
        return by_place.reshape(keys.shape)

    def take(self, fitness: Float[np.ndarray, "runs population"]) -> None:
        """What came of a round."""
        for contest, own in zip(self._contests, fitness, strict=True):
            if not contest.done:
                contest.take(own)
        self.generation += 1

    def chosen(self) -> tuple[Champion | None, ...]:
        """The best of every run, see `Contest.chosen`."""
        return tuple(contest.chosen() for contest in self._contests)

    def rows(self) -> list[dict[str, float]]:
        """Of candidates.csv."""
        return [row for contest in self._contests for row in contest.rows()]
