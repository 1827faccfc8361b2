"""Different bodies from one configuration: the same but for some numbers."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from evo_cpg.config.build import build_creature, build_experiment
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.numbers import number_at, with_numbers
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.creature.self_collision import PairNames, SelfCollision, colliding_pairs_of_all
from evo_cpg.creature.tree import build_tree
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
    problem, pairs = "", _pairs(like.common) if like else None
    # Bodies with surfaces that are alike may come to differ, and are then treated one by one.
    for apart in (False, True):

        def build(pairs: PairNames | None, apart: bool = apart) -> list[Simulation]:
            return [
                _with_task(build_experiment(each, source, folders, apart, pairs).simulation, task)
                for each in (config, *configs)
            ]

        common, *simulations = build(pairs)
        if len({_pairs(each) for each in (common, *simulations)}) > 1:
            # Longer limbs meet others.
            pairs = _pairs_of_all((config, *configs), source)
            common, *simulations = build(pairs)
        try:
            return batch(common, simulations, like)
        except LayoutError as error:
            problem = str(error)
        except ValueError as error:
            problem = str(error)
            break
    raise ConfigError(source, (), f"{', '.join(numbers)}: {problem}")


def _pairs(simulation: Simulation) -> PairNames:
    """Names of the bodies that are kept from passing through each other."""
    pairs, names = simulation.world.pairs, simulation.world.tree.names
    if pairs is None:
        return ()
    both = zip(pairs.first, pairs.second, strict=True)
    return tuple(sorted((names[min(pair)], names[max(pair)]) for pair in both))


def _pairs_of_all(configs: Sequence[ExperimentConfig], source: Path | str) -> PairNames:
    """Those of creatures of one plan, of which limbs can meet."""
    first = configs[0]
    wanted = first.creature.build_self_collision(on_ground=first.world.ground is not None)
    creatures = (build_creature(each, source) for each in configs)
    every = ((creature, build_tree(creature)) for creature in creatures)
    return colliding_pairs_of_all(every, wanted or SelfCollision())


def _with_task(simulation: Simulation, task: Task | None) -> Simulation:
    return dataclasses.replace(simulation, task=task) if task else simulation
