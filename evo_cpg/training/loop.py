"""The generation loop: evolve, keep the champion, leave a checkpoint after every generation."""

import functools
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.rollout import as_recording, score
from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.devices import fast_jit, population_mesh
from evo_cpg.training.experiment import (
    Experiment,
    Generation,
    breed,
    compile_trials,
    first_population,
    replay,
)
from evo_cpg.training.run_folder import RunFolder

# Columns of metrics.csv that differ from run to run.
TIMING_COLUMNS = ("seconds", "steps_per_second")


def train(
    experiment: Experiment,
    folder: RunFolder,
    on_generation: Callable[[dict[str, float]], None] = lambda row: None,
    mesh: Mesh | None = None,
) -> Checkpoint:
    """Evolve from the folder's newest checkpoint, or from the start, to the last generation.

    Args:
        experiment: what to evolve.
        folder: a run folder that was created before.
        on_generation: called with the new row of metrics.csv after every generation.
        mesh: devices to use; None for all.

    Returns:
        The state after the last generation.
    """
    mesh = mesh or population_mesh()
    checkpoint = folder.load()
    if checkpoint is None:
        genes = fast_jit(lambda: first_population(experiment))()
        checkpoint = Checkpoint(0, np.asarray(genes), None, [], _no_scales(experiment))
    elif checkpoint.history:
        # A kill may have come between the checkpoint and the table.
        folder.write_metrics(checkpoint.history)
    run_trials = compile_trials(experiment.simulation, mesh)
    run_breeding = fast_jit(functools.partial(breed, experiment))
    while checkpoint.generation < experiment.generations:
        start = time.perf_counter()
        outcome = run_trials(checkpoint.genes)
        index = np.int32(checkpoint.generation)
        yardsticks = {name: np.float32(value) for name, value in checkpoint.scales.items()}
        result = jax.device_get(run_breeding(checkpoint.genes, outcome, index, yardsticks))
        seconds = time.perf_counter() - start
        scales = {name: float(value) for name, value in result.scales.items()}
        champion = _better(checkpoint.champion, result, checkpoint.generation, scales)
        row = _metrics(experiment, checkpoint.generation, result, champion, seconds)
        checkpoint = Checkpoint(
            checkpoint.generation + 1,
            np.asarray(result.next_genes),
            champion,
            [*checkpoint.history, row],
            scales,
        )
        folder.save(checkpoint)
        on_generation(row)
    return checkpoint


def replay_champion(
    experiment: Experiment, champion: Champion, devices: int
) -> tuple[float, dict[str, float], Recording]:
    """Live the champion's trial again.

    Args:
        experiment: that it was evolved in.
        champion: the individual.
        devices: how many shared the population in training.

    Returns:
        Its fitness, its terms and its motion.
    """
    mesh = population_mesh(min(devices, len(jax.devices())))
    simulation = experiment.simulation
    run = fast_jit(lambda genes: replay(simulation, mesh, genes, experiment.genetics.population))
    outcome, frames = run(champion.genes)
    scales = {name: jnp.float32(value) for name, value in champion.scales.items()}
    fitness = float(score(simulation.task, outcome, scales))
    terms = {name: float(value) for name, value in outcome.terms.items()}
    names = [body.name for body in experiment.creature.bodies]
    return fitness, terms, as_recording(simulation, frames, names)


def _no_scales(experiment: Experiment) -> dict[str, float]:
    """Placeholders for the yardsticks that generation 0 will measure."""
    task, steps = experiment.simulation.task, experiment.simulation.steps
    shapes = jax.eval_shape(
        lambda: task.scales(task.terms(task.begin((1,), jnp.dtype("float32"), steps), steps))
    )
    return dict.fromkeys(shapes, 1.0)


def _better(
    champion: Champion | None, result: Generation, generation: int, scales: dict[str, float]
) -> Champion | None:
    best = int(result.best)
    fitness = float(result.fitness[best])
    if not np.isfinite(fitness) or (champion is not None and fitness <= champion.fitness):
        return champion
    terms = {name: float(values[best]) for name, values in result.terms.items()}
    return Champion(np.asarray(result.best_genes), fitness, generation, terms, scales)


def _metrics(
    experiment: Experiment,
    generation: int,
    result: Generation,
    champion: Champion | None,
    seconds: float,
) -> dict[str, float]:
    fitness = np.asarray(result.fitness)
    alive = np.isfinite(fitness)
    finite = fitness[alive] if alive.any() else np.array([np.nan])
    simulation = experiment.simulation
    steps = fitness.size * simulation.steps * simulation.substeps
    best = int(result.best)
    return {
        "generation": generation,
        "best": float(finite.max()),
        "mean": float(finite.mean()),
        "median": float(np.median(finite)),
        "worst": float(finite.min()),
        "diverged": int((~alive).sum()),
        "champion": champion.fitness if champion else float("nan"),
        **{f"best_{name}": float(values[best]) for name, values in result.terms.items()},
        "seconds": seconds,
        "steps_per_second": steps / seconds,
    }
