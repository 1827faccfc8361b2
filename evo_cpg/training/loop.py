"""The generation loop: evolve, keep the champion, leave a checkpoint after every generation."""

import functools
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array

from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.rollout import as_recording
from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.experiment import (
    Experiment,
    Generation,
    breed,
    champion_keys,
    compile_trials,
    first_population,
    generation_keys,
    judge,
    replay,
    situation_numbers,
)
from evo_cpg.training.memetic import compile_learning
from evo_cpg.training.processes import ALONE, Team, load_together
from evo_cpg.training.run_folder import RunFolder

# Fitness, terms and motion of an individual that lives again.
Replayed = tuple[float, dict[str, float], Recording]

# Columns of metrics.csv that differ from run to run.
TIMING_COLUMNS = ("seconds", "steps_per_second")


class Evolution(NamedTuple):
    """What a run computes besides its trials: functions that are compiled at their first call.

    Attributes:
        first_population: as of that name, of nothing.
        keys: `generation_keys` of the number of a generation.
        breed: as of that name, without the experiment.
    """

    first_population: Callable[..., Array]
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
    """
    mesh = mesh or population_mesh()
    programs = compile_evolution(experiment)
    checkpoint = load_together(team, folder)
    if checkpoint is None:
        genes = programs.first_population()
        nobody = (None,) * experiment.runs
        checkpoint = Checkpoint(0, np.asarray(genes), nobody, [], _no_scales(experiment))
    elif checkpoint.history and team.leads:
        # A kill may have come between the checkpoint and the table.
        folder.write_metrics(checkpoint.history)
    run_trials = compile_trials(experiment.simulation, mesh)
    trials = experiment.trials
    share = team.share(experiment.runs * experiment.genetics.population, trials)
    of_share = slice(share.start * trials, share.stop * trials)
    numbers = jax.tree.map(
        lambda x: np.tile(x, share.stop - share.start), situation_numbers(experiment)
    )
    learn = compile_learning(experiment, mesh) if experiment.learning else None
    first = checkpoint.generation
    while checkpoint.generation < experiment.generations:
        start = time.perf_counter()
        index = np.int32(checkpoint.generation)
        keys = jax.tree.map(lambda x: x[:, of_share], jax.device_get(programs.keys(index)))
        part = run_trials(checkpoint.genes[:, share], keys, numbers, trials)
        if checkpoint.generation == first:
            on_compiled()
        outcome = team.gather(part, checkpoint.genes, checkpoint.generation, trials)
        yardsticks = {
            name: np.array(values, np.float32) for name, values in checkpoint.scales.items()
        }
        result = jax.device_get(programs.breed(checkpoint.genes, outcome, index, yardsticks))
        done = checkpoint.generation + 1
        scales = {name: tuple(values.tolist()) for name, values in result.scales.items()}
        population = np.asarray(result.next_genes)
        if learn and experiment.learning and done % experiment.learning.every == 0:
            population = learn(population, done, scales)
        seconds = time.perf_counter() - start
        champions = tuple(
            _better(champion, result, checkpoint.generation, run)
            for run, champion in enumerate(checkpoint.champions)
        )
        rows = [
            _metrics(experiment, checkpoint.generation, result, run, champion, seconds)
            for run, champion in enumerate(champions)
        ]
        checkpoint = Checkpoint(done, population, champions, [*checkpoint.history, *rows], scales)
        if team.leads:
            folder.save(checkpoint)
        on_generation(rows)
    return checkpoint


def compile_evolution(experiment: Experiment) -> Evolution:
    """Compile what a run computes besides its trials, whatever the number of its generations."""
    functions = first_population, generation_keys, breed
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
    simulation, genes = experiment.simulation, experiment.simulation.controller.gene_count
    numbers = situation_numbers(experiment)
    somebody = Champion(np.zeros(genes, np.float32), 0.0, 0, {}, {}, 0, 0)
    keys = jax.eval_shape(lambda: champion_keys(experiment, somebody))
    live = jax.jit(functools.partial(replay, experiment, devices, recorded=recorded))
    lived = live.lower(jax.ShapeDtypeStruct((genes,), jnp.float32), keys, numbers)
    # Compiled as in training: a multiplication and an addition may become one operation, with one
    # rounding.
    scales = {name: jnp.float32(1.0) for name in _no_scales(experiment)}
    assess = jax.jit(functools.partial(judge, simulation.task))
    assessed = assess.lower(lived.out_info[0], scales).compile()
    run = lived.compile()

    def of(champion: Champion) -> Replayed:
        given = np.asarray(champion.genes, np.float32), champion_keys(experiment, champion)
        outcome, frames = run(*given, numbers)
        fitness, mean = assessed(
            outcome, {name: jnp.float32(value) for name, value in champion.scales.items()}
        )
        terms = {name: float(value) for name, value in mean.terms.items()}
        names = [body.name for body in experiment.creature.bodies]
        return float(fitness), terms, as_recording(simulation, frames, names, trial=recorded)

    return of


def _no_scales(experiment: Experiment) -> dict[str, tuple[float, ...]]:
    """Placeholders for the yardsticks that generation 0 will measure."""
    task, steps = experiment.simulation.task, experiment.simulation.steps
    shapes = jax.eval_shape(
        lambda: task.scales(task.terms(task.begin((1,), jnp.dtype("float32"), steps), steps))
    )
    return dict.fromkeys(shapes, (1.0,) * experiment.runs)


def _better(
    champion: Champion | None, result: Generation, generation: int, run: int
) -> Champion | None:
    best = int(result.best[run])
    fitness = float(result.fitness[run, best])
    if not np.isfinite(fitness) or (champion is not None and fitness <= champion.fitness):
        return champion
    terms = {name: float(values[run, best]) for name, values in result.terms.items()}
    scales = {name: float(values[run]) for name, values in result.scales.items()}
    genes = np.asarray(result.best_genes[run])
    return Champion(genes, fitness, generation, terms, scales, run, best)


def _metrics(
    experiment: Experiment,
    generation: int,
    result: Generation,
    run: int,
    champion: Champion | None,
    seconds: float,
) -> dict[str, float]:
    fitness = np.asarray(result.fitness[run])
    alive = np.isfinite(fitness)
    finite = fitness[alive] if alive.any() else np.array([np.nan])
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
        "diverged": int((~alive).sum()),
        "champion": champion.fitness if champion else float("nan"),
        **{f"best_{name}": float(values[run, best]) for name, values in result.terms.items()},
        "seconds": seconds,
        "steps_per_second": steps / seconds,
    }
