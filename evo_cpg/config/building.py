"""Simulations that differ in numbers alone: built of known numbers, or of traced ones.

What a configuration describes is built of its numbers twice. With known ones NumPy makes constants,
and notes what was chosen by them (see `evo_cpg.spatial.choices`). With traced ones JAX makes the
same functions of the numbers, exactly and wherever they are, as long as the choices hold.
"""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from evo_cpg.config.build import build_simulation
from evo_cpg.config.numbers import put_numbers
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.creature.self_collision import PlanPairs
from evo_cpg.creature.surface import PointLayout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task
from evo_cpg.spatial.choices import Choices, Condition, Undecidable, noting, repeating
from evo_cpg.spatial.numerics import is_number


class Built(NamedTuple):
    """A simulation of known numbers.

    Attributes:
        paths: of its leaves.
        leaves: its leaves.
        structure: the rest.
        choices: by which it came about.
    """

    paths: list[Any]
    leaves: list[Any]
    structure: Any
    choices: Choices

    def same_layout(self, other: "Built") -> list[Any] | None:
        """The leaves if nothing but numbers is different in the other one, or None."""
        if self.structure != other.structure or self.choices != other.choices:
            return None
        for mine, given in zip(self.leaves, other.leaves, strict=True):
            if not (is_number(given) and is_number(mine)):
                if not np.array_equal(mine, given):
                    return None
            elif np.shape(mine) != np.shape(given):
                return None
        return self.leaves


class Building:
    """How simulations are built that differ from that of a configuration in numbers alone.

    Attributes:
        source: file that the configuration came from.
        layout: of the surface points (`evo_cpg.creature.surface`).
        pairs: see `evo_cpg.config.build.build_experiment`.
        task: instead of the configuration's.
        own: the simulation of the configuration itself.
    """

    def __init__(
        self,
        config: ExperimentConfig,
        source: Path | str,
        layout: PointLayout = "merged",
        pairs: PlanPairs | None = None,
        task: Task | None = None,
    ):
        self.source, self.pairs, self.task = source, pairs, task
        self.layout: PointLayout = layout
        self.own = self.known(config)

    def known(self, config: ExperimentConfig) -> Built:
        """Of known numbers.

        Raises:
            ConfigError: parts that do not fit together.
        """
        with noting() as choices:
            simulation = self._build(config)
        paths, structure = jax.tree_util.tree_flatten_with_path(simulation)
        names, leaves = zip(*paths, strict=True)
        return Built(list(names), list(leaves), structure, choices)

    def traced(
        self,
        config: ExperimentConfig,
        numbers: dict[str, Any],
        conditions: list[Condition] | None = None,
    ) -> list[Any]:
        """Return the leaves as functions of some numbers, which may be traced.

        Args:
            config: the configuration.
            numbers: by key.
            conditions: a list to which is added whether this is what `known` would build.

        Raises:
            Undecidable: the numbers are traced in a way that no condition can be computed.
        """
        with repeating(self.own.choices, conditions), jax.numpy_rank_promotion("allow"):
            leaves, structure = jax.tree.flatten(self._build(put_numbers(config, numbers)))
        if conditions is not None and structure != self.own.structure:
            raise Undecidable("what is no number would change")
        return leaves

    def name(self, place: int) -> str:
        """Return the path of a leaf."""
        return jax.tree_util.keystr(self.own.paths[place])[1:]

    def _build(self, config: ExperimentConfig) -> Simulation:
        _, simulation = build_simulation(config, self.source, self.layout, self.pairs)
        return dataclasses.replace(simulation, task=self.task) if self.task else simulation
