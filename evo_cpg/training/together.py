"""Several experiments side by side: what their animals live in is the same, what searches is not.

Their populations stand one after the other on the population axis of one program of trials, so a
machine's vectors and cores are full however small each is, and the program compiles once.
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
from evo_cpg.training.experiment import Experiment, compile_trials
from evo_cpg.training.loop import Running, Trials
from evo_cpg.training.run_folder import RunFolder

# Number of the experiment, and its new rows of metrics.csv.
Told = Callable[[int, list[dict[str, float]]], object]


def train_together(
    experiments: Sequence[Experiment],
    folders: Sequence[RunFolder],
    on_generation: Told = lambda number, rows: None,
    mesh: Mesh | None = None,
) -> list[Checkpoint]:
    """Evolve several experiments, each from its folder's newest checkpoint to its last generation.

    Every one comes to what it would come to alone (see `evo_cpg.training.loop.train`).

    Args:
        experiments: with equal simulations and as many trials of an individual.
        folders: run folders that were created before.
        on_generation: called after every generation of each.
        mesh: devices to use; None for all.

    Returns:
        How each stands after its last generation.

    Raises:
        StrategyError: a strategy does not do what it must.
    """
    mesh = mesh or population_mesh()
    running = [
        Running(experiment, folder, mesh)
        for experiment, folder in zip(experiments, folders, strict=True)
    ]
    trials = experiments[0].trials
    live = compile_trials(experiments[0].simulation, mesh)
    while behind := _behind(running):
        began = time.perf_counter()
        taken = [running[number].trials() for number in behind]
        outcome = live(*_joined(taken), trials)
        widths = [part.genes.shape[1] for part in taken]
        waited = time.perf_counter() - began
        parts = _apart(outcome, widths, trials)
        for number, part, width in zip(behind, parts, widths, strict=True):
            # The clock of each shows its own part of what all took.
            own = time.perf_counter() - waited * width / sum(widths)
            rows = running[number].tell(part, own)
            if rows:
                on_generation(number, rows)
    return [each.checkpoint for each in running]


def _behind(running: Sequence[Running]) -> list[int]:
    """Who has done the fewest generations of those that have some left.

    After a kill some may be ahead of the others by one.
    """
    left = {i: each.checkpoint.generation for i, each in enumerate(running) if not each.finished}
    fewest = min(left.values(), default=0)
    return [number for number, done in left.items() if done == fewest]


def _joined(parts: Sequence[Trials]) -> Trials:
    """The trials of all, one after the other."""

    def join(*arrays: np.ndarray) -> np.ndarray:
        return np.concatenate(arrays, axis=-1)

    return jax.tree.map(join, *parts)


def _apart(outcome: Outcome, widths: Sequence[int], trials: int) -> list[Outcome]:
    """The outcome of each."""
    ends = [trials * end for end in itertools.accumulate(widths, initial=0)]
    return [
        jax.tree.map(lambda x, own=slice(first, last): x[..., own], outcome)
        for first, last in itertools.pairwise(ends)
    ]
