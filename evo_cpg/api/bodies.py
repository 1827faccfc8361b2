"""Individuals with bodies of their own: they differ in numbers of the configuration."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jax.typing import ArrayLike

from evo_cpg.config.batched import BodyPlan, build_batch
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.numbers import number_at
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.simulation.judge import Outcome
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.experiment import Experiment, compile_trials

Numbers = Mapping[str, ArrayLike | Sequence[float]]


class Bodies:
    """Trials of individuals that differ in numbers; one program for all of the same keys.

    One program builds all bodies that fit a plan (`BodyPlan`). Others are built one by one, and
    join the trials of the plan if they differ in its numbers alone. If they do not, there is a new
    plan, in which the old bodies and the new ones fit.

    Args:
        parts: what they have in common.
        config: the configuration.
        source: file that it came from.
    """

    def __init__(self, parts: Experiment, config: ExperimentConfig, source: Path):
        self._parts, self._config, self._source = parts, config, source
        self._made: dict[frozenset[str], tuple[BodyPlan, Callable[..., Outcome]]] = {}

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
        differs = {
            key: v != number_at(self._config, key, self._source) for key, v in columns.items()
        }
        if not any(each.any() for each in differs.values()):
            return None
        if frozenset(columns) not in self._made:
            # By somebody for each number who differs in it, and by the last one.
            self._plan(
                columns, np.unique([*(each.argmax() for each in differs.values()), count - 1])
            )
        plan, run = self._made[frozenset(columns)]
        values, fits = plan.build(columns)
        if not fits.all():
            try:
                self._build_one_by_one(plan, columns, values, ~fits)
            except ConfigError:
                plan, run = self._plan(columns, np.arange(count))
                values = list(map(np.asarray, plan.batched.values))
        return run, tuple(values)

    def _plan(
        self, columns: dict[str, np.ndarray], individuals: np.ndarray
    ) -> tuple[BodyPlan, Callable[..., Outcome]]:
        """Plan by some of the individuals."""
        task = self._parts.simulation.task
        some = {key: values[individuals] for key, values in columns.items()}
        plan = BodyPlan(self._config, self._source, some, task)
        run = compile_trials(plan.batched.common, population_mesh(), inputs=plan.batched.inputs)
        self._made[frozenset(columns)] = plan, run
        return plan, run

    def _build_one_by_one(
        self,
        plan: BodyPlan,
        columns: dict[str, np.ndarray],
        values: list[np.ndarray],
        individuals: np.ndarray,
    ) -> None:
        """Put into the values those of some individuals.

        Raises:
            ConfigError: they do not fit the plan's trials.
        """
        some = {key: column[individuals] for key, column in columns.items()}
        task = self._parts.simulation.task
        built = build_batch(self._config, self._source, some, like=plan.batched, task=task)
        for value, own in zip(values, built.values, strict=True):
            value[:, individuals] = own
