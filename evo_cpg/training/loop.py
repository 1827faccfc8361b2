"""Generation loop: evolve one experiment, or several together in one program of trials.

Experiments evolve together if their animals have equal trials. Their populations are concatenated
on the population axis. So a machine's vectors and cores are full however small each population is,
and the program compiles once.
"""

import itertools
import time
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jax.sharding import Mesh

from evo_cpg.simulation.judge import Outcome
from evo_cpg.training.checkpoint import Checkpoint
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.experiment import ExperimentParts, compile_trials
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.running import Running, Trials

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
    trials = experiments[0].trials
    run_trials = compile_trials(experiments[0].simulation, mesh)
    compiled = False
    while behind := _behind(running):
        start = time.perf_counter()
        given = [running[number].trials() for number in behind]
        outcome = run_trials(*_joined(given), trials)
        if not compiled:
            on_compiled()
            compiled = True
        widths = [part.genes.shape[1] for part in given]
        spent = time.perf_counter() - start
        parts = _split(outcome, widths, trials)
        for number, part, width in zip(behind, parts, widths, strict=True):
            # Each experiment's time includes its part of the time for the common trials.
            own_start = time.perf_counter() - spent * width / sum(widths)
            rows = running[number].tell(part, own_start)
            if rows:
                on_generation(number, rows)
    return [each.checkpoint for each in running]


def _behind(running: Sequence[Running]) -> list[int]:
    """Return the indices of the unfinished experiments with the fewest generations done.

    After a kill some experiments may be one generation ahead of the others.
    """
    left = {i: each.checkpoint.generation for i, each in enumerate(running) if not each.finished}
    fewest = min(left.values(), default=0)
    return [number for number, done in left.items() if done == fewest]


def _joined(parts: Sequence[Trials]) -> Trials:
    """Return the trials of all experiments, concatenated."""
    if len(parts) == 1:
        return parts[0]
    return jax.tree.map(lambda *arrays: np.concatenate(arrays, axis=-1), *parts)


def _split(outcome: Outcome, widths: Sequence[int], trials: int) -> list[Outcome]:
    """Return the outcome of each experiment."""
    ends = [trials * end for end in itertools.accumulate(widths, initial=0)]
    return [
        jax.tree.map(lambda x, own=slice(first, last): x[..., own], outcome)
        for first, last in itertools.pairwise(ends)
    ]
