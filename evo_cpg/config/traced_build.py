"""Simulations that differ in numbers alone: built of known numbers, or of traced ones.

What a configuration describes is built of its numbers twice. With known ones NumPy makes constants,
and notes what was chosen by them (see `evo_cpg.spatial.decisions`). With traced ones JAX makes the
same functions of the numbers, exactly and wherever they are, as long as the choices hold.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from evo_cpg.config.build import build_simulation
from evo_cpg.config.numbers import put_numbers
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.creature.self_collision import PlanPairs
from evo_cpg.creature.surface import PointLayout
from evo_cpg.simulation.batched import Inputs
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task
from evo_cpg.spatial.decisions import (
    Condition,
    StaticDecisions,
    Undecidable,
    recording_decisions,
    replaying_decisions,
)
from evo_cpg.spatial.numerics import is_number, is_traced, xp

# What no number changes may differ by this fraction of the largest number in its array: rounding.
_ROUNDING = 1e-9


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
    choices: StaticDecisions

    def has_layout_of(self, other: "Built") -> bool:
        """Whether nothing but numbers is different in the other one."""
        return (
            self.structure == other.structure
            and self.choices == other.choices
            and all(
                np.shape(mine) == np.shape(theirs)
                if is_number(mine) and is_number(theirs)
                else np.array_equal(mine, theirs)
                for mine, theirs in zip(self.leaves, other.leaves, strict=True)
            )
        )

    def agrees(self, leaves: list[Any], inputs: Inputs) -> list[Condition]:
        """Whether each leaf of another one is the same, but for the inputs.

        Raises:
            Undecidable: a traced leaf has another shape.
        """
        moving = dict(zip(inputs.places, inputs.elements, strict=True))
        return [
            _is_same(leaf, own, moving.get(place, np.array([], int)))
            for place, (leaf, own) in enumerate(zip(leaves, self.leaves, strict=True))
        ]


class Building:
    """How simulations are built that differ from that of a configuration in numbers alone.

    Attributes:
        layout: of the surface points (`evo_cpg.creature.surface`).
        pairs: see `evo_cpg.config.build.build_experiment`.
        task: instead of the configuration's.
        own: the simulation of the configuration itself.
    """

    def __init__(
        self,
        config: ExperimentConfig,
        layout: PointLayout = "merged",
        pairs: PlanPairs | None = None,
        task: Task | None = None,
    ):
        self.pairs, self.task = pairs, task
        self.layout: PointLayout = layout
        self.own = self.known(config)

    def known(self, config: ExperimentConfig) -> Built:
        """Of known numbers.

        Raises:
            KeyProblem: parts that do not fit together.
        """
        with recording_decisions() as choices:
            simulation = self._build(config)
        paths, structure = jax.tree_util.tree_flatten_with_path(simulation)
        names, leaves = zip(*paths, strict=True)
        return Built(list(names), list(leaves), structure, choices)

    def traced(
        self,
        config: ExperimentConfig,
        numbers: Mapping[str, Any],
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
        with replaying_decisions(self.own.choices, conditions), jax.numpy_rank_promotion("allow"):
            leaves, structure = jax.tree.flatten(self._build(put_numbers(config, numbers)))
        if conditions is not None and structure != self.own.structure:
            raise Undecidable("what is no number would change")
        return leaves

    def name(self, place: int) -> str:
        """Return the path of a leaf."""
        return jax.tree_util.keystr(self.own.paths[place])[1:]

    def _build(self, config: ExperimentConfig) -> Simulation:
        _, simulation = build_simulation(config, self.layout, self.pairs)
        return dataclasses.replace(simulation, task=self.task) if self.task else simulation


def values_of(leaves: list[Any], inputs: Inputs, dtype: jnp.dtype) -> list[Array]:
    """The inputs among the leaves of a simulation, which may be traced."""
    return [
        jnp.asarray(leaves[place], dtype).reshape(-1)[elements]
        for place, elements in zip(inputs.places, inputs.elements, strict=True)
    ]


def _is_same(leaf: Any, own: Any, moving: np.ndarray) -> Condition:
    """Whether a leaf has the same numbers as another one, but for elements that may differ."""
    if not (is_traced(leaf) or is_number(leaf)):
        return np.array_equal(leaf, own)
    if np.shape(leaf) != np.shape(own):
        raise Undecidable("the shape of an array would change")
    rest = np.delete(np.arange(np.size(own)), moving)
    found, known = xp.ravel(leaf)[rest], np.ravel(own)[rest]
    slack = np.abs(own, where=np.isfinite(own), out=np.zeros(np.shape(own)))
    slack = _ROUNDING * slack.max(initial=0.0)
    # Infinities are equal, and their difference is no number.
    with np.errstate(invalid="ignore"):
        return ((found == known) | (abs(found - known) <= slack)).all()
