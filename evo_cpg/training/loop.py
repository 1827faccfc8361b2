"""The generation loop: evolve, keep the champion, leave a checkpoint after every generation."""

import functools
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int, PyTree, UInt32

from evo_cpg.simulation.judge import Outcome, no_terms
from evo_cpg.simulation.recording import Recording, as_recording
from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.experiment import (
    Experiment,
    Generation,
    begin,
    breed,
    champion_keys,
    compile_trials,
    generation_keys,
    judge,
    replay,
    situation_numbers,
)
from evo_cpg.training.lineage import extended, until
from evo_cpg.training.memetic import compile_learning
from evo_cpg.training.processes import ALONE, Team, load_together, start_together
from evo_cpg.training.reevaluation import CANDIDATES, Choice, Contest, is_finished
from evo_cpg.training.run_folder import CANDIDATES_FILE, RunFolder, RunFolderError
from evo_cpg.training.strategy_state import StrategyError, state_arrays, state_from

# Fitness, terms and motion of an individual that lives again.
Replayed = tuple[float, dict[str, float], Recording]

# Likewise with what is recorded of every control step (`evo_cpg.simulation.recording.Recorder`).
Lived = tuple[float, dict[str, float], dict[str, Array]]

# Columns of metrics.csv that differ from run to run.
TIMING_COLUMNS = ("seconds", "steps_per_second")


class Trials(NamedTuple):
    """What the trials of a generation take, see `compile_trials`.

    Attributes:
        genes: of every individual.
        keys: of the noise of every trial; None where there is none.
        numbers: of the situation of every trial; None where there is one.
    """

    genes: Float[np.ndarray, "g individuals"]
    keys: UInt32[np.ndarray, "w n"] | None
    numbers: Int[np.ndarray, " n"] | None


class Evolution(NamedTuple):
    """What a run computes besides its trials: functions that are compiled at their first call.

    Attributes:
        begin: as of that name, without the experiment.
        keys: `generation_keys` of the number of a generation.
        breed: as of that name, without the experiment.
    """

    begin: Callable[..., tuple[Array, PyTree[Array]]]
    keys: Callable[..., Array | None]
    breed: Callable[..., Generation]


def train(
    experiment: Experiment,
    folder: RunFolder,
    on_generation: Callable[[list[dict[str, float]]], None] = lambda rows: None,
    mesh: Mesh | None = None,
    on_compiled: Callable[[], object] = lambda: None,
    team: Team = ALONE,
) -> Checkpoint:
    """Evolve from the folder's newest checkpoint, or from the start, to the last generation.

    Args:
        experiment: what to evolve.
        folder: a run folder that was created before.
        on_generation: called with the new rows of metrics.csv, one for each run, after every
            generation.
        mesh: devices to use; None for all of this process.
        on_compiled: called once, when the program of the trials is compiled and has run: the
            moment to compile in a thread what is needed later.
        team: the processes that evolve together. Only their lead reads and writes the folder.

    Returns:
        The state after the last generation.

    Raises:
        StrategyError: the strategy asks for genomes that are no numbers, or the checkpoint is not
            one of it.
    """
    mesh = mesh or population_mesh()
    running = Running(experiment, folder, mesh, team)
    live = compile_trials(experiment.simulation, mesh)
    compiled = False
    while not running.finished:
        began = time.perf_counter()
        part = live(*running.trials(), experiment.trials)
        if not compiled:
            on_compiled()
            compiled = True
        rows = running.tell(part, began)
        if rows:
            on_generation(rows)
    return running.checkpoint


class Running:
    """A run that goes on: what its next generation takes, and what comes of that.

    Where chance has a say, some rounds of trials follow the last generation, in which the champion
    is chosen (`evo_cpg.training.reevaluation`). The first of them tries the population that the
    run ends with, as the generation that it would have been.

    Args:
        experiment: what evolves.
        folder: its run folder, where it goes on from the newest checkpoint.
        mesh: devices, for elites that learn.
        team: the processes that evolve together. Only their lead reads and writes the folder.

    Attributes:
        checkpoint: how it stands.

    Raises:
        StrategyError: see `train`.
    """

    checkpoint: Checkpoint

    def __init__(
        self, experiment: Experiment, folder: RunFolder, mesh: Mesh, team: Team = ALONE
    ) -> None:
        self._experiment, self._folder, self._team = experiment, folder, team
        self._programs = compile_evolution(experiment)
        self._learn = compile_learning(experiment, mesh) if experiment.learning else None
        self._share = team.share(
            experiment.runs * experiment.strategy.population, experiment.trials
        )
        checkpoint = load_together(team, folder)
        if checkpoint is None:
            start = start_together(team, folder)
            genes, self._state = jax.device_get(self._programs.begin(start))
            _require_numbers(experiment, genes, 0)
            nobody = (None,) * experiment.runs
            checkpoint = Checkpoint(0, genes, nobody, [], _no_scales(experiment))
        else:
            like = jax.eval_shape(lambda: begin(experiment))[1]
            self._state = state_from(checkpoint.state, like)
            if checkpoint.history and team.leads:
                # A kill may have come between the checkpoint and the table.
                folder.write_metrics(checkpoint.history)
        self.checkpoint = checkpoint
        self._lineage = _lineage_until(folder, checkpoint) if team.leads else []
        self._choice: Choice | None = None

    @property
    def finished(self) -> bool:
        """Whether the last generation is done, and the champion known."""
        return is_finished(self._experiment, self.checkpoint)

    def trials(self) -> Trials:
        """What the trials of the next generation or round take: this process's share of them."""
        share, trials = self._share, self._experiment.trials
        of_share = slice(share.start * trials, share.stop * trials)
        keys = jax.tree.map(lambda x: x[:, of_share], self._keys())
        numbers = jax.tree.map(
            lambda x: np.tile(x, share.stop - share.start), situation_numbers(self._experiment)
        )
        return Trials(self._genes()[:, share], keys, numbers)

    def tell(self, part: Outcome, began: float) -> list[dict[str, float]]:
        """What the trials came to: breed, and leave a checkpoint.

        Args:
            part: of this process's share.
            began: when the generation did, by `time.perf_counter`, s.

        Returns:
            The new rows of metrics.csv; none after a round in which the champion is chosen.
        """
        experiment, before = self._experiment, self.checkpoint
        genes, number = self._genes(), self._number
        outcome = self._team.gather(part, genes, number, experiment.trials)
        index, yardsticks = np.int32(number), _float32(before.scales)
        result = jax.device_get(
            self._programs.breed(genes, outcome, index, yardsticks, self._state)
        )
        if before.generation >= experiment.generations:
            # For the fitness alone: nothing is bred of it.
            self._choose(genes, number, result)
            return []
        done, self._state = before.generation + 1, result.state
        scales = {name: tuple(values.tolist()) for name, values in result.scales.items()}
        population = np.asarray(result.next_genes)
        _require_numbers(experiment, population, done)
        if self._learn and experiment.learning and done % experiment.learning.every == 0:
            population = self._learn(population, done, scales)
        seconds = time.perf_counter() - began
        records = tuple(
            _better(champion, result, before.generation, run)
            for run, champion in enumerate(before.records)
        )
        rows = [
            _metrics(experiment, before.generation, result, run, champion, seconds)
            for run, champion in enumerate(records)
        ]
        history, remembered = [*before.history, *rows], state_arrays(self._state)
        self.checkpoint = Checkpoint(done, population, records, history, scales, remembered)
        if self._team.leads:
            # Before the checkpoint: a kill in between leaves a lineage that is ahead of it.
            found = [
                new
                for new, old in zip(records, before.records, strict=True)
                if new is not None and new is not old
            ]
            if found:
                self._lineage = extended(self._lineage, found)
                self._folder.save_lineage(self._lineage)
            if before.chosen and self.checkpoint.champion is not None:
                # Chosen when this was to be the end of the run, which has gone on since.
                self._folder.save_champion(self.checkpoint.champion)
            self._folder.save(self.checkpoint)
        return rows

    def _choose(self, genes: np.ndarray, number: int, result: Generation) -> None:
        """Take a round in which champions are chosen, and write them when all are."""
        experiment, checkpoint = self._experiment, self.checkpoint
        if self._choice is None:
            by_run = np.split(genes, experiment.runs, axis=1)
            population = experiment.strategy.population
            self._choice = Choice(
                [
                    Contest(_candidates(record, own, result, number, run), population)
                    for run, (record, own) in enumerate(
                        zip(checkpoint.records, by_run, strict=True)
                    )
                ]
            )
        else:
            self._choice.take(np.asarray(result.fitness))
        if self._choice.done:
            self.checkpoint = checkpoint._replace(chosen=self._choice.chosen())
            rows = self._choice.rows()
            if self._team.leads:
                if rows:
                    self._folder.write_table(CANDIDATES_FILE, rows)
                self._folder.save(self.checkpoint)

    @property
    def _number(self) -> int:
        """Of the generation whose random numbers come next."""
        return self._choice.generation if self._choice else self.checkpoint.generation

    def _genes(self) -> np.ndarray:
        """Who is tried next."""
        return self._choice.genes(self.checkpoint.genes) if self._choice else self.checkpoint.genes

    def _keys(self) -> np.ndarray | None:
        """Of all trials that come next."""
        keys = jax.device_get(self._programs.keys(np.int32(self._number)))
        return self._choice.keys(keys, self._experiment.trials) if self._choice else keys


def compile_evolution(experiment: Experiment) -> Evolution:
    """Compile what a run computes besides its trials, whatever the number of its generations."""
    functions = begin, generation_keys, breed
    return Evolution(*(jax.jit(functools.partial(one, experiment)) for one in functions))


def replay_champion(
    experiment: Experiment, champion: Champion, devices: int, recorded: int = 0
) -> Replayed:
    """Live the champion's trials again, with the noise that they had.

    Args:
        experiment: that it was evolved in.
        champion: the individual.
        devices: how many shared the population in training.
        recorded: number of the trial whose motion is wanted, from 0.

    Returns:
        Its fitness, its terms and its motion in one trial.
    """
    return compile_replay(experiment, devices, recorded)(champion)


def compile_replay(
    experiment: Experiment, devices: int, recorded: int = 0
) -> Callable[[Champion], Replayed]:
    """Compile `replay_champion` before there is a champion.

    The program of the trials in training cannot serve: it computes a whole trial as one piece of
    native code whose results are what the trial amounted to, and the frames of all its individuals
    would take hundreds of megabytes. A recording takes a trial step by step.
    """
    live = compile_life(experiment, devices, recorded)
    names = [body.name for body in experiment.creature.bodies]

    def of(champion: Champion) -> Replayed:
        fitness, terms, frames = live(champion)
        motion = as_recording(experiment.simulation, frames, names, trial=recorded)
        return fitness, terms, motion

    return of


def compile_life(
    experiment: Experiment, devices: int, recorded: int = 0, full: bool = False
) -> Callable[[Champion], Lived]:
    """As `compile_replay`, with what was recorded of each control step in place of a motion.

    With ``full`` that is all of it, see `evo_cpg.simulation.recording.Recorder`.
    """
    simulation, genes = experiment.simulation, experiment.simulation.genome.count
    numbers = situation_numbers(experiment)
    somebody = Champion(np.zeros(genes, np.float32), 0.0, 0, {}, {}, 0, 0)
    keys = jax.eval_shape(lambda: champion_keys(experiment, somebody))
    live = jax.jit(functools.partial(replay, experiment, devices, recorded=recorded, full=full))
    lived = live.lower(jax.ShapeDtypeStruct((genes,), jnp.float32), keys, numbers)
    # Compiled as in training: a multiplication and an addition may become one operation, with one
    # rounding.
    scales = {name: jnp.float32(1.0) for name in _no_scales(experiment)}
    assess = jax.jit(functools.partial(judge, simulation.task))
    assessed = assess.lower(lived.out_info[0], scales).compile()
    run = lived.compile()

    def of(champion: Champion) -> Lived:
        given = np.asarray(champion.genes, np.float32), champion_keys(experiment, champion)
        outcome, frames = run(*given, numbers)
        fitness, mean = assessed(
            outcome, {name: jnp.float32(value) for name, value in champion.scales.items()}
        )
        terms = {name: float(value) for name, value in mean.terms.items()}
        return float(fitness), terms, frames

    return of


def _no_scales(experiment: Experiment) -> dict[str, tuple[float, ...]]:
    """Placeholders for the yardsticks that generation 0 will measure."""
    simulation = experiment.simulation
    shapes = jax.eval_shape(lambda: simulation.task.scales(no_terms(simulation)))
    return dict.fromkeys(shapes, (1.0,) * experiment.runs)


def _lineage_until(folder: RunFolder, checkpoint: Checkpoint) -> list[Champion]:
    """The champions on the way to a checkpoint; where their file is lost, those of its end."""
    try:
        lineage = folder.load_lineage()
    except RunFolderError:
        lineage = []
    lineage = [each for each in lineage if each.genes.shape == checkpoint.genes.shape[:1]]
    return until(lineage, checkpoint.records, checkpoint.generation)


def _float32(scales: dict[str, tuple[float, ...]]) -> dict[str, np.ndarray]:
    return {name: np.array(values, np.float32) for name, values in scales.items()}


def _require_numbers(experiment: Experiment, genes: Float[np.ndarray, "g all"], done: int) -> None:
    """Check what the strategy asks for.

    Raises:
        StrategyError: not all are numbers.
    """
    wrong = int((~np.isfinite(genes)).any(0).sum())
    if wrong and experiment.strategy.checks_genes:
        raise StrategyError(
            f"evolution.type: {type(experiment.strategy).__name__} asked for genomes that are not "
            f"finite for generation {done} ({wrong} of {genes.shape[1]}); what was done before "
            "is in the run folder"
        )


def _better(
    champion: Champion | None, result: Generation, generation: int, run: int
) -> Champion | None:
    best = int(result.best[run])
    fitness = float(result.fitness[run, best])
    if not np.isfinite(fitness) or (champion is not None and fitness <= champion.fitness):
        return champion
    genes = np.asarray(result.best_genes[run])
    return _individual(genes, result, generation, run, best)


def _candidates(
    record: Champion | None,
    genes: Float[np.ndarray, "g n"],
    result: Generation,
    generation: int,
    run: int,
) -> list[Champion]:
    """Who may become champion: the best so far, and the fittest of the last population."""
    fittest = np.argsort(-result.fitness[run], kind="stable")[:CANDIDATES]
    tried = [_individual(genes[:, i], result, generation, run, int(i)) for i in fittest]
    return [one for one in (record, *tried) if one is not None and np.isfinite(one.fitness)]


def _individual(
    genes: Float[np.ndarray, " g"], result: Generation, generation: int, run: int, index: int
) -> Champion:
    """One of those that were tried."""
    fitness = float(result.fitness[run, index])
    terms = {name: float(values[run, index]) for name, values in result.terms.items()}
    scales = {name: float(values[run]) for name, values in result.scales.items()}
    return Champion(np.ascontiguousarray(genes), fitness, generation, terms, scales, run, index)


def _metrics(
    experiment: Experiment,
    generation: int,
    result: Generation,
    run: int,
    champion: Champion | None,
    seconds: float,
) -> dict[str, float]:
    fitness = np.asarray(result.fitness[run])
    judged = np.isfinite(fitness)
    finite = fitness[judged] if judged.any() else np.array([np.nan])
    simulation = experiment.simulation
    trials = result.fitness.size * experiment.trials
    steps = trials * simulation.steps * simulation.substeps
    best = int(result.best[run])
    return {
        "generation": generation,
        **({"run": run} if experiment.runs > 1 else {}),
        "best": float(finite.max()),
        "mean": float(finite.mean()),
        "median": float(np.median(finite)),
        "worst": float(finite.min()),
        "diverged": int((~np.asarray(result.alive[run])).sum()),
        "champion": champion.fitness if champion else float("nan"),
        **{name: float(values[run]) for name, values in result.metrics.items()},
        **{f"best_{name}": float(values[run, best]) for name, values in result.terms.items()},
        "seconds": seconds,
        "steps_per_second": steps / seconds,
    }
