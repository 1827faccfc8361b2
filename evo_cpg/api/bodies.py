"""Individuals with bodies of their own: they differ in numbers of the configuration."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jax.typing import ArrayLike

from evo_cpg.config.batched import build_batch
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.numbers import number_at
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.simulation.batched import BatchedSimulation
from evo_cpg.simulation.judge import Outcome
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.experiment import Experiment, compile_trials

Numbers = Mapping[str, ArrayLike | Sequence[float]]


class Bodies:
    """Trials of individuals that differ in numbers; one program for all of the same keys.

    Args:
        parts: what they have in common.
        config: the configuration.
        source: file that it came from.
    """

    def __init__(self, parts: Experiment, config: ExperimentConfig, source: Path):
        self._parts, self._config, self._source = parts, config, source
        self._made: dict[frozenset[str], tuple[BatchedSimulation, Callable[..., Outcome]]] = {}

    def trials(
        self, numbers: Numbers, count: int
    ) -> tuple[Callable[..., Outcome], tuple[np.ndarray, ...]] | None:
        """The trials of some individuals, and what these take as their last argument.

        Args:
            numbers: by key, ``(count,)``.
            count: individuals.

        Returns:
            None where all have the numbers of the configuration.

        Raises:
            ConfigError: see `evo_cpg.config.batched.build_batch`.
            ValueError: not one value of each number for each individual.
        """
        columns = {key: np.asarray(values, float) for key, values in numbers.items()}
        for key, values in columns.items():
            if values.shape != (count,):
                raise ValueError(
                    f"{key} must have a value for each of the {count} individuals, got the shape "
                    f"{values.shape}"
                )
        own = {key: number_at(self._config, key, self._source) for key in columns}
        if all((values == own[key]).all() for key, values in columns.items()):
            return None
        before, run = self._made.get(frozenset(columns), (None, None))
        batched = self._batch(columns, before)
        if run is None or before is None or batched.common is not before.common:
            run = compile_trials(batched.common, population_mesh(), inputs=batched.inputs)
            self._made[frozenset(columns)] = batched, run
        return run, batched.values

    def _batch(
        self, columns: dict[str, np.ndarray], before: BatchedSimulation | None
    ) -> BatchedSimulation:
        """As a program has it that is there already, or anew."""
        task = self._parts.simulation.task
        if before is not None:
            try:
                return build_batch(self._config, self._source, columns, like=before, task=task)
            except ConfigError:
                # More may come to differ than did at first, or bodies that were alike.
                pass
        return build_batch(self._config, self._source, columns, task=task)
