"""A worker's copies of populations, and the trials of some of their individuals.

Genomes do not travel, because a worker breeds every population of which it evaluates a part: from
its copy of the last generation and the fitness of all, by the random numbers of the run. All
workers make the same generation, as one process would.

A worker gets a whole population when it has no copy of the last generation: at its start, after it
took the part of a lost worker, or if its processor rounds otherwise than that of the main process.
"""

import functools
import zlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Float, PyTree, UInt8, UInt32

from evo_cpg.evolution.strategy import Evaluation
from evo_cpg.native.jax_internals import used_arguments
from evo_cpg.simulation.judge import Outcome, no_terms
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.experiment import (
    ExperimentParts,
    begin,
    champion_keys,
    evaluated,
    generation_keys,
    next_generation,
    placeholder_scales,
    situation_numbers,
)

Scales = dict[str, Float[np.ndarray, " 1"]]


class PopulationCopy(NamedTuple):
    """A population, from which a worker goes on by itself.

    Attributes:
        genes: the population.
        state: arrays of the strategy's state. The first axis has the length 1, for the run.
        scales: task's scales.
    """

    genes: Float[np.ndarray, "g n"]
    state: list[np.ndarray]
    scales: Scales


class Results(NamedTuple):
    """Results of a population's last generation, from which a worker breeds the present one.

    Attributes:
        worth: arrays of `Evaluation`, or None where the strategy does not use one.
        scales: task's scales.
    """

    worth: list[np.ndarray | None]
    scales: Scales


class Given(NamedTuple):
    """Individuals that are not the present population, with the random keys of their trials."""

    genes: Float[np.ndarray, "g k"]
    keys: UInt32[np.ndarray, "w k_trials"] | None


class Piece(NamedTuple):
    """Neighbouring individuals of one population, for one worker.

    Attributes:
        experiment: number of the experiment.
        run: number of the run.
        first: index of the first individual.
        last: index after the last individual.
        generation: number of the generation.
        judged: whether the worker judges the trials. Otherwise it returns their outcome, because
            scales are not known yet, or all terms are needed.
        news: what the worker lacks, or None if it holds the population already.
    """

    experiment: int
    run: int
    first: int
    last: int
    generation: int
    judged: bool
    news: PopulationCopy | Results | Given | None


class Judged(NamedTuple):
    """Results of a judged piece: about 4 bytes for an individual, for most strategies.

    Attributes:
        worth: arrays of `Evaluation`, or None where the strategy does not use one.
        alive: False where an individual diverged, 8 individuals in a byte.
        best: index of the fittest individual within the piece.
        terms: terms of this individual.
    """

    worth: list[np.ndarray | None]
    alive: UInt8[np.ndarray, " bytes"]
    best: int
    terms: dict[str, float]


class Found(NamedTuple):
    """Results of a piece.

    Attributes:
        digest: checksum of the genomes of the whole population, or None if they were given.
        results: results of the individuals.
    """

    digest: int | None
    results: Judged | Outcome


class Replica:
    """Copies of the populations of some experiments, all with equal trials.

    Args:
        experiments: the experiments.
        width: number of trials in a chunk, as in the main process.
        mesh: the devices.
    """

    def __init__(self, experiments: Sequence[ExperimentParts], width: int, mesh: Mesh) -> None:
        self._experiments, first = experiments, experiments[0]
        # Compile now, because the other workers would wait for the first trials of a new one.
        genes = np.zeros((first.simulation.genome.count, 1), np.float32)
        keys = jax.device_get(champion_keys(first, Champion(genes[:, 0], 0.0, 0, {}, {}, 0, 0)))
        self._run_trials = compile_trials(
            first.simulation,
            mesh,
            width,
            ahead=(genes, keys, situation_numbers(first), first.trials),
        )
        self._programs = [_compile(each) for each in experiments]
        self._copies: dict[tuple[int, int], tuple[int, np.ndarray, PyTree, Scales]] = {}

    def evaluate(self, pieces: Sequence[Piece]) -> list[Found]:
        """Run the trials of the individuals of some pieces, all in one call."""
        given = [self._trials(piece) for piece in pieces]
        joined = jax.tree.map(lambda *arrays: np.concatenate(arrays, axis=-1), *given)
        trials, found, end = self._experiments[0].trials, [], 0
        outcome = self._run_trials(*joined, trials)
        for piece in pieces:
            first, end = end, end + trials * (piece.last - piece.first)
            own = jax.tree.map(lambda x, own=slice(first, end): np.asarray(x[..., own]), outcome)
            found.append(self._found(piece, own))
        return found

    def _trials(self, piece: Piece) -> tuple:
        experiment, programs = self._experiments[piece.experiment], self._programs[piece.experiment]
        if isinstance(piece.news, Given):
            genes, keys = piece.news
        else:
            self._bring(piece)
            genes = self._copies[piece.experiment, piece.run][1][:, piece.first : piece.last]
            keys = jax.device_get(programs.keys(piece.run, np.int32(piece.generation)))
            own = slice(experiment.trials * piece.first, experiment.trials * piece.last)
            keys = None if keys is None else keys[:, own]
        numbers = situation_numbers(experiment)
        return genes, keys, None if numbers is None else np.tile(numbers, genes.shape[1])

    def _bring(self, piece: Piece) -> None:
        """Bring the copy of a population to the generation of a piece."""
        place, programs = (piece.experiment, piece.run), self._programs[piece.experiment]
        if isinstance(piece.news, PopulationCopy):
            genes, leaves, scales = piece.news
            state = jax.tree.unflatten(programs.state, leaves)
            self._copies[place] = piece.generation, genes, state, scales
        elif isinstance(piece.news, Results):
            last, genes, state, _ = self._copies[place]
            worth = jax.tree.unflatten(
                jax.tree.structure(programs.worth),
                [
                    np.zeros(like.shape, like.dtype) if given is None else given[None]
                    for given, like in zip(
                        piece.news.worth, jax.tree.leaves(programs.worth), strict=True
                    )
                ],
            )
            bred = jax.device_get(programs.breed(piece.run, genes, worth, np.int32(last), state))
            self._copies[place] = last + 1, bred.next_genes, bred.state, piece.news.scales
        assert self._copies[place][0] == piece.generation

    def _found(self, piece: Piece, outcome: Outcome) -> Found:
        if isinstance(piece.news, Given):
            return Found(None, outcome)
        _, genes, _, scales = self._copies[piece.experiment, piece.run]
        digest = checksum(genes)
        if not piece.judged:
            return Found(digest, outcome)
        experiment, programs = self._experiments[piece.experiment], self._programs[piece.experiment]
        trials, size = experiment.trials, experiment.strategy.population
        start = trials * (piece.run * size + piece.first)

        # Judge the individuals at their places among all, because rounding may depend on the place.
        def among_all(own: np.ndarray) -> np.ndarray:
            every = np.zeros(experiment.runs * size * trials, own.dtype)
            every[start : start + own.size] = own
            return every

        scales = {name: np.repeat(value, experiment.runs) for name, value in scales.items()}
        number = np.int32(piece.generation)
        worth, alive, _ = jax.device_get(
            programs.evaluated(jax.tree.map(among_all, outcome), number, scales)
        )
        own = slice(piece.first, piece.last)
        best = int(np.argmax(worth.fitness[piece.run, own]))
        leaves = [
            leaf[piece.run, ..., own] if used else None
            for leaf, used in zip(jax.tree.leaves(worth), programs.used, strict=True)
        ]
        terms = {name: float(values[piece.run, own][best]) for name, values in worth.terms.items()}
        return Found(digest, Judged(leaves, np.packbits(alive[piece.run, own]), best, terms))


def checksum(genes: Float[np.ndarray, "g n"]) -> int:
    """Return a checksum of a population, by the sum of each individual's bits."""
    sums = np.ascontiguousarray(genes).view(np.uint32).sum(0, np.uint64)
    return zlib.crc32(sums.tobytes())


class RunPrograms(NamedTuple):
    """Functions of one run of an experiment, compiled at their first call.

    Attributes:
        keys: `generation_keys` of a run and a generation.
        evaluated: see `evo_cpg.training.experiment.evaluated`.
        breed: `next_generation` of a run.
        state: structure of the strategy's state.
        worth: shapes of `Evaluation`.
        used: whether the strategy uses each array of `Evaluation`, and True for the fitness.
    """

    keys: Callable
    evaluated: Callable
    breed: Callable
    state: Any
    worth: Evaluation
    used: list[bool]


def _compile(experiment: ExperimentParts) -> RunPrograms:
    """Return the functions of a single run, because run r equals a single run of seed + r."""
    alone = experiment._replace(runs=1)

    def of_run(function: Callable) -> Callable:
        if experiment.runs == 1:
            # The very program of the main process, because another might round otherwise.
            whole = jax.jit(functools.partial(function, experiment))
            return lambda run, *given: whole(*given)
        return jax.jit(lambda run, *given: function(alone._replace(seed=alone.seed + run), *given))

    worth, used = used_results(alone)
    state = jax.tree.structure(jax.eval_shape(lambda: begin(alone))[1])
    judge = jax.jit(functools.partial(evaluated, experiment))
    return RunPrograms(of_run(generation_keys), judge, of_run(next_generation), state, worth, used)


def used_results(experiment: ExperimentParts) -> tuple[Evaluation, list[bool]]:
    """Return the shapes of `Evaluation`, and whether the next generation depends on each array."""
    count, trials = experiment.strategy.population, experiment.trials
    scales: dict[str, Any] = {
        name: np.ones(experiment.runs, np.float32) for name in placeholder_scales(experiment)
    }

    def results() -> Evaluation:
        terms = no_terms(experiment.simulation, (experiment.runs * count * trials,))
        alive = jnp.ones(experiment.runs * count * trials, bool)
        return evaluated(experiment, Outcome(terms, alive), 1, scales).worth

    worth = jax.eval_shape(results)
    genes, state = jax.eval_shape(lambda: begin(experiment))

    def breed(worth: Evaluation, genes: jax.Array, state: PyTree) -> tuple:
        bred = next_generation(experiment, genes, worth, 1, state)
        return bred.next_genes, bred.state, bred.metrics

    used = used_arguments(breed, worth, genes, state)[: len(jax.tree.leaves(worth))]
    fitness = [leaf is worth.fitness for leaf in jax.tree.leaves(worth)]
    return worth, [a or b for a, b in zip(used, fitness, strict=True)]
