"""Different bodies from one configuration: the same but for some numbers."""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from evo_cpg.config.build import build_experiment
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.numbers import number_at, with_numbers
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.simulation.batched import BatchedSimulation, LayoutError, batch
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task


def build_batch(
    config: ExperimentConfig,
    source: Path | str,
    numbers: Mapping[str, Float[np.ndarray, " n"]],
    folders: Iterable[Path] = (),
    like: BatchedSimulation | None = None,
    task: Task | None = None,
) -> BatchedSimulation:
    """What a configuration describes with some of its numbers different for each individual.

    Each is built alone, in NumPy, as if it were the only one. What they have in common is the
    simulation that the configuration describes as it stands.

    Args:
        config: the configuration.
        source: file it came from.
        numbers: their values by key, such as ``creature.bodies.1.shape.size.0``.
        folders: see `evo_cpg.config.build.build_experiment`.
        like: see `evo_cpg.simulation.batched.batch`.
        task: instead of the configuration's.

    Raises:
        ConfigError: a key that does not exist or is no real number, a value that is not allowed,
            numbers that change how the simulation is laid out, or nothing.
        ValueError: not one value for each individual.
    """
    folders = tuple(folders)
    for key in numbers:
        number_at(config, key, source)
    sizes = {np.shape(values) for values in numbers.values()}
    if len(sizes) != 1 or len(next(iter(sizes))) != 1:
        raise ValueError(f"one value for each individual, equally many of each, got {sizes}")
    columns = [np.asarray(values, float).tolist() for values in numbers.values()]
    configs = [
        with_numbers(config, dict(zip(numbers, row, strict=True)), source)
        for row in zip(*columns, strict=True)
    ]
    problem = ""
    # Bodies with surfaces that are alike may come to differ, and are then treated one by one.
    for apart in (False, True):
        common, *simulations = (
            _with_task(build_experiment(each, source, folders, apart).simulation, task)
            for each in (config, *configs)
        )
        try:
            return batch(common, simulations, like)
        except LayoutError as error:
            problem = str(error)
        except ValueError as error:
            problem = str(error)
            break
    raise ConfigError(source, (), f"{', '.join(numbers)}: {problem}")


def _with_task(simulation: Simulation, task: Task | None) -> Simulation:
    return dataclasses.replace(simulation, task=task) if task else simulation
