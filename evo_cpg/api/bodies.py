"""Individuals whose bodies differ in numbers of the configuration."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jax.typing import ArrayLike

from evo_cpg.io.batched import BodyPlan, build_batch
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.numbers import number_at
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.simulation.judge import Outcome
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.experiment import ExperimentParts

Numbers = Mapping[str, ArrayLike | Sequence[float]]


class VariedBodies:
    """Trials of individuals that differ in numbers of the configuration.

    One program computes all trials with the same set of configuration keys. Another builds all
    bodies that fit a plan (`BodyPlan`). Other bodies are built one by one. They join the plan's
    trials if they differ only in numbers that are inputs of these trials. Otherwise a new plan is
    made from all individuals of the call.

    Args:
        parts: experiment that the individuals have in common.
        config: the configuration.
        source: file of the configuration.
    """

    def __init__(self, parts: ExperimentParts, config: ExperimentConfig, source: Path):
        self._parts, self._config, self._source = parts, config, source
        self._made: dict[frozenset[str], tuple[BodyPlan, Callable[..., Outcome]]] = {}

    def trials(
        self, numbers: Numbers, count: int
    ) -> tuple[Callable[..., Outcome], tuple[np.ndarray, ...]] | None:
        """Return the trials of individuals, and the last argument of these trials.

        Args:
            numbers: values by key, each ``(count,)``.
            count: number of individuals.

        Returns:
            The function and its argument, or None if no individual differs from the configuration.

        Raises:
            ConfigError: wrong numbers, see `evo_cpg.io.batched.build_batch`.
            ValueError: a number does not have one value for each individual.
        """
        columns = {key: np.asarray(values, float) for key, values in numbers.items()}
        for key, values in columns.items():
            if values.shape != (count,):
                raise ValueError(
                    f"{key} must have one value for each of the {count} individuals, got the shape "
                    f"{values.shape}"
                )
        differs = {
            key: v != number_at(self._config, key, self._source) for key, v in columns.items()
        }
        if not any(each.any() for each in differs.values()):
            return None
        if frozenset(columns) not in self._made:
            # Plan from a few individuals: for each number the first that differs, and the last.
            self._plan(
                columns, np.unique([*(each.argmax() for each in differs.values()), count - 1])
            )
        plan, run = self._made[frozenset(columns)]
        values, fits = plan.build(columns)
        if not fits.all():
            some = {key: column[~fits] for key, column in columns.items()}
            task = self._parts.simulation.task
            try:
                built = build_batch(self._config, self._source, some, like=plan.batched, task=task)
                for value, own in zip(values, built.values, strict=True):
                    value[:, ~fits] = own
            except ConfigError:
                # These individuals do not fit the plan's trials.
                plan, run = self._plan(columns, np.arange(count))
                values = list(map(np.asarray, plan.batched.values))
        return run, tuple(values)

    def _plan(
        self, columns: dict[str, np.ndarray], individuals: np.ndarray
    ) -> tuple[BodyPlan, Callable[..., Outcome]]:
        """Make the plan and compile its trials, from some of the individuals."""
        task = self._parts.simulation.task
        some = {key: values[individuals] for key, values in columns.items()}
        plan = BodyPlan(self._config, self._source, some, task)
        run = compile_trials(plan.batched.common, population_mesh(), inputs=plan.batched.inputs)
        self._made[frozenset(columns)] = plan, run
        return plan, run
