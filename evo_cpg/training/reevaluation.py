"""Choice of the champion under noise: re-evaluate candidates until luck averages out.

Under noise the best fitness ever measured is a lucky one. After the last generation, candidates are
re-evaluated with fresh noise: the record and the fittest of the final population. All candidates of
a round share the same noise. Sequential halving (Karnin, Koren and Somekh 2013) drops the worse
half of every round, and gives the rest more evaluations. Candidates are ranked first by how often
they diverged or broke a rule, then by mean fitness.

A round has the size of a generation and uses its programs, so nothing is compiled for a round.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int, UInt32

from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.experiment import FIRST_ROUND, ExperimentParts

CANDIDATES = 16
"""Largest number of candidates of each run."""

EVALUATIONS = 16
"""Number of evaluations of each remaining candidate that ends the rounds."""


def is_finished(experiment: ExperimentParts, checkpoint: Checkpoint) -> bool:
    """Return whether the last generation is done and the champion is known."""
    evolved = checkpoint.generation >= experiment.generations
    return evolved and (experiment.simulation.silent or bool(checkpoint.chosen))


class Contest:
    """Sequential halving among the candidates of one run.

    Args:
        candidates: individuals. Only the first of equal genomes counts.
        population: number of evaluations in a round.

    Attributes:
        candidates: individuals that take part.
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
        """Return whether one candidate is left, or each of those left had enough evaluations."""
        results = self._evaluations[self._left]
        return not len(results) or bool(
            results[0] and (len(results) == 1 or results[0] >= EVALUATIONS)
        )

    def places(self) -> Int[np.ndarray, "2 population"]:
        """Return the number of the candidate in each place of a run's population.

        The second row has the place of the population whose random numbers are used there. Spare
        places repeat the last evaluation.
        """
        each = self._population // len(self._left)
        rows = np.stack([np.repeat(self._left, each), np.tile(np.arange(each), len(self._left))])
        return np.pad(rows, ((0, 0), (0, self._population - rows.shape[1])), mode="edge")

    def take(self, fitness: Float[np.ndarray, " population"]) -> None:
        """Take the results of a round and drop the worse half.

        Fitness is -inf in places whose evaluation ended early.
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
        """Return the best candidate with its results, or None without any candidate."""
        if not len(self._left):
            return None
        number = int(self._left[0])
        mean = float(self._means()[number])
        return self.candidates[number]._replace(
            lives=int(self._evaluations[number]),
            expected=mean if np.isfinite(mean) else None,
            ended_early=int(self._failures[number]),
        )

    def rows(self) -> list[dict[str, float]]:
        """Return the rows of candidates.csv, one for each candidate."""
        rows = []
        for number, one in enumerate(self.candidates):
            row = {"run": one.run, "generation": one.generation, "index": one.index}
            row |= {"fitness": one.fitness, "lives": int(self._evaluations[number])}
            row |= {"ended_early": int(self._failures[number])}
            row |= {"expected": float(self._means()[number])}
            rows.append(row | {"chosen": int(number == self._left[0])})
        return rows

    def _means(self) -> Float[np.ndarray, " candidates"]:
        """Return the mean fitness of evaluations that did not end early, or -inf if all did."""
        completed = self._evaluations - self._failures
        return np.where(completed > 0, self._sum / np.maximum(completed, 1), -np.inf)


class Choice:
    """Contests of all runs, in the order of the runs' populations.

    Attributes:
        generation: generation number that selects the random numbers of the next round.
        contests: contest of each run.
    """

    def __init__(self, contests: Sequence[Contest]):
        self.generation = FIRST_ROUND
        self.contests = tuple(contests)

    @property
    def done(self) -> bool:
        """Return whether all contests are done."""
        return all(contest.done for contest in self.contests)

    def genes(self, genes: Float[np.ndarray, "g all"]) -> Float[np.ndarray, "g all"]:
        """Return the genomes of the next round. Runs with a finished contest keep theirs."""
        population = genes.shape[1] // len(self.contests)
        population_genes = genes.copy()
        for run, contest in enumerate(self.contests):
            if not contest.done:
                given = np.stack([one.genes for one in contest.candidates], axis=1)
                own = slice(run * population, (run + 1) * population)
                population_genes[:, own] = given[:, contest.places()[0]]
        return population_genes

    def keys(self, keys: UInt32[np.ndarray, "w n"], trials: int) -> UInt32[np.ndarray, "w n"]:
        """Return the random keys of the next round's trials, given those of `generation`."""
        by_place = keys.reshape(len(keys), len(self.contests), -1, trials).copy()
        for run, contest in enumerate(self.contests):
            if not contest.done:
                by_place[:, run] = by_place[:, run, contest.places()[1]]
        return by_place.reshape(keys.shape)

    def take(self, fitness: Float[np.ndarray, "runs population"]) -> None:
        """Take the results of a round."""
        for contest, own in zip(self.contests, fitness, strict=True):
            if not contest.done:
                contest.take(own)
        self.generation += 1
