"""Training: generation after generation of one experiment, or of several together.

Experiments evolve together if their animals have equal trials. Their populations are concatenated
on the population axis. So a machine's vectors and cores are full however small each population is,
and the program compiles once.
"""

import contextlib
import functools
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int, PyTree, UInt32

from evo_cpg.evolution.strategy import Evaluation
from evo_cpg.files import write_table
from evo_cpg.simulation.judge import Outcome
from evo_cpg.training.checkpoint import (
    Champion,
    Checkpoint,
    StrategyError,
    state_arrays,
    state_from,
)
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.experiment import (
    Evaluated,
    ExperimentParts,
    Generation,
    begin,
    evaluated,
    generation_keys,
    next_generation,
    placeholder_scales,
    situation_numbers,
)
from evo_cpg.training.family import cut_family, extend_family
from evo_cpg.training.learning import compile_learning
from evo_cpg.training.lineage import extended
from evo_cpg.training.reevaluation import CANDIDATES, Choice, Contest, is_finished
from evo_cpg.training.run_folder import CANDIDATES_FILE, RunFolder, RunFolderError
from evo_cpg.training.team import Team, current_cluster

Trials = tuple[
    Float[np.ndarray, "g individuals"],
    UInt32[np.ndarray, "w n"] | None,
    Int[np.ndarray, " n"] | None,
]
"""Genomes, random keys of all trials or None without noise, and numbers of their situations."""


class Evolution(NamedTuple):
    """Functions of one experiment, compiled at their first call.

    Attributes:
        begin: compiled `evo_cpg.training.experiment.begin`.
        keys: compiled `evo_cpg.training.experiment.generation_keys`.
        evaluated: compiled `evo_cpg.training.experiment.evaluated`.
        next_generation: compiled `evo_cpg.training.experiment.next_generation`.
    """

    begin: Callable[..., tuple[Array, PyTree[Array]]]
    keys: Callable[..., Array | None]
    evaluated: Callable[..., Evaluated]
    next_generation: Callable[..., Generation]


class Running:
    """Run that continues from the newest checkpoint of its folder.

    Under noise, rounds of trials follow the last generation to choose the champion
    (`evo_cpg.training.reevaluation`). The first round evaluates the final population.

    Attributes:
        experiment: experiment that evolves.
        folder: its run folder.
        checkpoint: present state.
        state: strategy's state.
        worth: results that led from the last generation to the present one, or None if they are
            unknown here or do not suffice.
        choosing: whether the last generation is done, and a round chooses the champion.

    Raises:
        StrategyError: genomes are not finite, or the checkpoint is of another strategy.
    """

    checkpoint: Checkpoint
    worth: Evaluation | None = None

    def __init__(self, experiment: ExperimentParts, folder: RunFolder, mesh: Mesh) -> None:
        self.experiment, self.folder = experiment, folder
        self._programs = compile_evolution(experiment)
        self._learn = compile_learning(experiment, mesh) if experiment.learning else None
        checkpoint = folder.load()
        if checkpoint is None:
            genes, self.state = jax.device_get(self._programs.begin(folder.load_start()))
            _require_finite(experiment, genes, 0)
            none = (None,) * experiment.runs
            checkpoint = Checkpoint(0, genes, none, [], placeholder_scales(experiment))
        else:
            like = jax.eval_shape(lambda: begin(experiment))[1]
            self.state = state_from(checkpoint.state, like)
            if checkpoint.history:
                # A kill may have prevented the writing of metrics.csv, so write it again.
                folder.write_metrics(checkpoint.history)
        self.checkpoint = checkpoint
        self._lineage = _lineage_until(folder, checkpoint)
        self._has_family = cut_family(folder.path, checkpoint.generation)
        self._choice: Choice | None = None
        # Genomes of the last `trials`, and the generation number that selects their random numbers.
        self._given = checkpoint.genes, checkpoint.generation

    @property
    def choosing(self) -> bool:
        """See the class."""
        return self.checkpoint.generation >= self.experiment.generations

    def trials(self) -> Trials:
        """Return the trials of the next generation or round."""
        genes, number = self.checkpoint.genes, self.checkpoint.generation
        if self._choice:
            genes, number = self._choice.genes(genes), self._choice.generation
        self._given = genes, number
        keys = jax.device_get(self._programs.keys(np.int32(number)))
        if self._choice:
            keys = self._choice.keys(keys, self.experiment.trials)
        numbers = situation_numbers(self.experiment)
        if numbers is not None:
            numbers = np.tile(numbers, genes.shape[1])
        return genes, keys, numbers

    def evaluated(self, outcome: Outcome) -> Evaluated:
        """Judge the outcome of the last `trials`."""
        scales = {
            name: np.array(values, np.float32) for name, values in self.checkpoint.scales.items()
        }
        number = np.int32(self._given[1])
        return jax.device_get(self._programs.evaluated(outcome, number, scales))

    def tell(self, found: Evaluated, start: float) -> list[dict[str, float]]:
        """Take the results of the last `trials`, make the next generation, write a checkpoint.

        ``start`` is the time at which the generation started, by `time.perf_counter` (s).

        Returns:
            The new rows of metrics.csv. There are none after a round that chooses champions.
        """
        experiment, before = self.experiment, self.checkpoint
        genes, number = self._given
        if self.choosing:
            self._choose(genes, number, found)
            return []
        parents = genes if before.inherited is None else before.inherited
        result = jax.device_get(
            self._programs.next_generation(parents, found.worth, np.int32(number), self.state)
        )
        done, self.state = before.generation + 1, result.state
        scales = {name: tuple(values.tolist()) for name, values in found.scales.items()}
        population, inherited = np.asarray(result.next_genes), None
        # Workers of a cluster breed the next generation from the results, unless some have learned.
        self.worth = found.worth if before.inherited is None else None
        _require_finite(experiment, population, done)
        learning = experiment.learning
        if self._learn and learning and done % learning.every == 0:
            learned, self.worth = self._learn(population, done, scales), None
            population, inherited = learned, None if learning.inherited else population
        seconds = time.perf_counter() - start
        records, new, rows = list(before.records), [], []
        for run, champion in enumerate(before.records):
            best = int(result.best[run])
            best_genes = genes[:, run * experiment.strategy.population + best]
            fitness = float(found.worth.fitness[run, best])
            if np.isfinite(fitness) and (champion is None or fitness > champion.fitness):
                champion = _individual(best_genes, found, before.generation, run, best)
                records[run] = champion
                new.append(champion)
            sizes = experiment.simulation.genome.sizes_of(best_genes)
            rows.append(_metrics(experiment, before, found, result, run, champion, seconds, sizes))
        history = [*before.history, *rows]
        self.checkpoint = Checkpoint(
            done,
            population,
            tuple(records),
            history,
            scales,
            state_arrays(self.state),
            inherited=inherited,
        )
        if result.births is not None and self._has_family:
            extend_family(self.folder.path, np.asarray(found.worth.fitness), result.births)
        # Save the lineage first: after a kill between the two writes it is ahead of the
        # checkpoint, and `_lineage_until` drops the newer champions. The same holds for the
        # family tree.
        if new:
            self._lineage = extended(self._lineage, new)
            self.folder.save_lineage(self._lineage)
        if before.chosen and self.checkpoint.champion is not None:
            # The run was extended after a choice of champions. Replace the chosen champion in
            # champion.npz by the record.
            self.folder.save_champion(self.checkpoint.champion)
        self.folder.save(self.checkpoint)
        return rows

    def _choose(self, genes: np.ndarray, number: int, found: Evaluated) -> None:
        """Evaluate a round in which champions are chosen, and save them when all are chosen."""
        experiment, checkpoint = self.experiment, self.checkpoint
        if self._choice is None:
            contests, by_run = [], np.split(genes, experiment.runs, axis=1)
            for run, own in enumerate(by_run):
                # The record, and the fittest of the last population.
                fittest = np.argsort(-found.worth.fitness[run], kind="stable")[:CANDIDATES]
                tried = [_individual(own[:, i], found, number, run, int(i)) for i in fittest]
                every = (checkpoint.records[run], *tried)
                candidates = [one for one in every if one is not None and np.isfinite(one.fitness)]
                contests.append(Contest(candidates, experiment.strategy.population))
            self._choice = Choice(contests)
        else:
            self._choice.take(np.asarray(found.worth.fitness))
        if self._choice.done:
            contests = self._choice.contests
            chosen = tuple(contest.chosen() for contest in contests)
            self.checkpoint = checkpoint._replace(chosen=chosen)
            rows = [row for contest in contests for row in contest.rows()]
            if rows:
                write_table(self.folder.path / CANDIDATES_FILE, rows)
            self.folder.save(self.checkpoint)


def compile_evolution(experiment: ExperimentParts) -> Evolution:
    """Return the functions that a run needs besides its trials, for any number of generations."""
    functions = begin, generation_keys, evaluated, next_generation
    return Evolution(*(jax.jit(functools.partial(one, experiment)) for one in functions))


def _lineage_until(folder: RunFolder, checkpoint: Checkpoint) -> list[Champion]:
    """Return the champions up to a checkpoint, or only the checkpoint's if the file is lost.

    The file may be a generation ahead of the checkpoint.
    """
    lineage: list[Champion] = []
    with contextlib.suppress(RunFolderError):
        lineage = folder.load_lineage()
    lineage = [each for each in lineage if each.genes.shape == checkpoint.genes.shape[:1]]
    done = [each for each in lineage if each.generation < checkpoint.generation]
    return extended(done, [each for each in checkpoint.records if each is not None])


def _require_finite(
    experiment: ExperimentParts, genes: Float[np.ndarray, "g all"], done: int
) -> None:
    """Check the genomes of a strategy, unless the strategy disables the check.

    Raises:
        StrategyError: not all genomes are finite.
    """
    wrong = int((~np.isfinite(genes)).any(0).sum())
    if wrong and experiment.strategy.checks_genes:
        raise StrategyError(
            f"evolution.type: {type(experiment.strategy).__name__} returned genomes that are not "
            f"finite for generation {done} ({wrong} of {genes.shape[1]}). The run folder holds the "
            "earlier generations"
        )


def _individual(
    genes: Float[np.ndarray, " g"], found: Evaluated, generation: int, run: int, index: int
) -> Champion:
    """Return an evaluated individual of a generation as a `Champion`."""
    fitness = float(found.worth.fitness[run, index])
    terms = {name: float(values[run, index]) for name, values in found.worth.terms.items()}
    scales = {name: float(values[run]) for name, values in found.scales.items()}
    return Champion(np.ascontiguousarray(genes), fitness, generation, terms, scales, run, index)


def _metrics(
    experiment: ExperimentParts,
    before: Checkpoint,
    found: Evaluated,
    result: Generation,
    run: int,
    champion: Champion | None,
    seconds: float,
    sizes: dict[str, float],
) -> dict[str, float]:
    fitness = np.asarray(found.worth.fitness[run])
    judged = np.isfinite(fitness)
    finite = fitness[judged] if judged.any() else np.array([np.nan])
    simulation = experiment.simulation
    trials = found.worth.fitness.size * experiment.trials
    steps = trials * simulation.steps * simulation.substeps
    best = int(result.best[run])
    return {
        "generation": before.generation,
        **({"run": run} if experiment.runs > 1 else {}),
        "best": float(finite.max()),
        "mean": float(finite.mean()),
        "median": float(np.median(finite)),
        "worst": float(finite.min()),
        "diverged": int((~np.asarray(found.alive[run])).sum()),
        "champion": champion.fitness if champion else float("nan"),
        **{name: float(values[run]) for name, values in result.metrics.items()},
        **{f"best_{name}": float(values[run, best]) for name, values in found.worth.terms.items()},
        **{f"best_{name}": size for name, size in sizes.items()},
        "seconds": seconds,
        "steps_per_second": steps / seconds,
    }


TIMING_COLUMNS = ("seconds", "steps_per_second")
"""Columns of metrics.csv that measure time, so they differ when a run is repeated."""


def train(
    experiment: ExperimentParts,
    folder: RunFolder,
    on_generation: Callable[[list[dict[str, float]]], object] = lambda rows: None,
    mesh: Mesh | None = None,
    on_compiled: Callable[[], object] = lambda: None,
) -> Checkpoint:
    """Evolve one experiment (see `train_together`)."""
    return train_together(
        [experiment], [folder], lambda number, rows: on_generation(rows), mesh, on_compiled
    )[0]


def train_together(
    experiments: Sequence[ExperimentParts],
    folders: Sequence[RunFolder],
    on_generation: Callable[[int, list[dict[str, float]]], object] = lambda number, rows: None,
    mesh: Mesh | None = None,
    on_compiled: Callable[[], object] = lambda: None,
) -> list[Checkpoint]:
    """Evolve several experiments, each from its folder's newest checkpoint to its last generation.

    The result of each experiment does not depend on the others.

    Args:
        experiments: experiments with equal simulations and equally many trials of an individual.
        folders: existing run folder of each experiment.
        on_generation: called after each generation of an experiment, with the experiment's index
            and its new rows of metrics.csv, one for each run.
        mesh: devices to use, or None for all.
        on_compiled: called once, after the program of the trials has been compiled and run. It can
            start a thread that compiles later programs.

    Returns:
        The checkpoint of each experiment after its last generation.

    Raises:
        StrategyError: a strategy returns genomes that are not finite, or a checkpoint comes from
            another strategy.
    """
    mesh = mesh or population_mesh()
    running = [
        Running(experiment, folder, mesh)
        for experiment, folder in zip(experiments, folders, strict=True)
    ]
    cluster = current_cluster()
    evaluate = Team(cluster, running).evaluate if cluster else evaluate_here(experiments[0], mesh)
    compiled = False
    while left := [
        number
        for number, each in enumerate(running)
        if not is_finished(experiments[number], each.checkpoint)
    ]:
        # After a kill some experiments may be one generation ahead of the others.
        fewest = min(running[number].checkpoint.generation for number in left)
        behind = [number for number in left if running[number].checkpoint.generation == fewest]
        start = time.perf_counter()
        found = evaluate([running[number] for number in behind])
        if not compiled:
            on_compiled()
            compiled = True
        widths = [each.worth.fitness.size for each in found]
        spent = time.perf_counter() - start
        for number, own, width in zip(behind, found, widths, strict=True):
            # Each experiment's time includes its part of the time for the common trials.
            own_start = time.perf_counter() - spent * width / sum(widths)
            rows = running[number].tell(own, own_start)
            if rows:
                on_generation(number, rows)
    return [each.checkpoint for each in running]


def evaluate_here(
    experiment: ExperimentParts, mesh: Mesh
) -> Callable[[Sequence[Running]], list[Evaluated]]:
    """Return a function that evaluates the populations of several experiments in this process."""
    trials, run_trials = experiment.trials, compile_trials(experiment.simulation, mesh)

    def evaluate(behind: Sequence[Running]) -> list[Evaluated]:
        given = [each.trials() for each in behind]
        joined = jax.tree.map(lambda *arrays: np.concatenate(arrays, axis=-1), *given)
        outcome = run_trials(*(joined if len(given) > 1 else given[0]), trials)
        found, end = [], 0
        for each, (genes, _, _) in zip(behind, given, strict=True):
            first, end = end, end + trials * genes.shape[1]
            own = jax.tree.map(lambda x, own=slice(first, end): x[..., own], outcome)
            found.append(each.evaluated(own))
        return found

    return evaluate
