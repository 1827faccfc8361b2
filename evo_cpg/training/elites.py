"""Elites: individuals in the map of behaviour of a run."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from evo_cpg.evolution.strategy import Archive, Axis
from evo_cpg.training.checkpoint import Champion, Checkpoint, StrategyError, state_from
from evo_cpg.training.experiment import ExperimentParts, begin


class GaitMap(NamedTuple):
    """Map of behaviour of one run.

    Attributes:
        axes: axes of the map.
        fitness: fitness of the elites, with an array axis for each map axis. NaN in empty cells.
        archive: the elites, with cells along the last axis.
    """

    axes: tuple[Axis, ...]
    fitness: Float[np.ndarray, "..."]
    archive: Archive


def gait_map(experiment: ExperimentParts, checkpoint: Checkpoint, run: int) -> GaitMap | None:
    """Return the map of a run, or None if its strategy has none.

    Raises:
        StrategyError: the checkpoint comes from another strategy.
    """
    strategy = experiment.strategy
    axes = strategy.map_axes
    if not axes or not checkpoint.state:
        return None
    like = jax.eval_shape(lambda: begin(experiment))[1]
    state = jax.tree.map(lambda x: x[run], state_from(checkpoint.state, like))
    archive = strategy.map_of(state)
    assert archive is not None
    fitness = np.where(np.isfinite(archive.fitness), archive.fitness, np.nan)
    return GaitMap(axes, fitness.reshape([axis.cells for axis in axes]), archive)


def elite(
    experiment: ExperimentParts, checkpoint: Checkpoint, cell: tuple[int, ...], run: int
) -> Champion:
    """Return the individual of a cell, ready to be replayed.

    Args:
        experiment: experiment in which the individual evolved.
        checkpoint: checkpoint of the run.
        cell: index of the cell on each axis of the map, from 0.
        run: number of the run.

    Raises:
        StrategyError: there is no map, no such cell, or the cell is empty.
    """
    found = gait_map(experiment, checkpoint, run)
    if found is None:
        raise StrategyError("there is no map: the search of this run fills no cells")
    axes, shape = found.axes, found.fitness.shape
    if len(cell) != len(shape) or not all(0 <= i < n for i, n in zip(cell, shape, strict=True)):
        allowed = ", ".join(f"{axis.name} 0 to {axis.cells - 1}" for axis in axes)
        raise StrategyError(f"there is no cell {','.join(map(str, cell))}. Allowed: {allowed}")
    number = int(np.ravel_multi_index(cell, shape))
    archive = found.archive
    if not np.isfinite(archive.fitness[number]):
        filled = np.argwhere(np.isfinite(found.fitness))
        near = filled[np.abs(filled - np.array(cell)).sum(1).argmin()] if len(filled) else None
        hint = "" if near is None else f". The nearest filled cell is {','.join(map(str, near))}"
        raise StrategyError(f"cell {','.join(map(str, cell))} is empty{hint}")
    terms = archive.descriptors[:, number]
    return Champion(
        np.ascontiguousarray(archive.genes[:, number]),
        float(archive.fitness[number]),
        int(archive.generation[number]),
        {axis.name: float(value) for axis, value in zip(axes, terms, strict=True)},
        {name: values[run] for name, values in checkpoint.scales.items()},
        run,
        int(archive.index[number]),
    )
