"""Simulations that differ only in numbers, built from known or traced numbers.

A simulation is built twice. With known numbers NumPy computes constants, and records the decisions
that depend on the numbers (see `evo_cpg.creature.algebra.decisions`). With traced numbers JAX
computes the constants as exact functions of the numbers, valid as long as the decisions hold.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from evo_cpg.creature.algebra.decisions import (
    Condition,
    StaticDecisions,
    Undecidable,
    recording_decisions,
    replaying_decisions,
)
from evo_cpg.creature.algebra.numerics import is_number, is_traced, xp
from evo_cpg.creature.self_collision import PlanPairs
from evo_cpg.creature.surface import PointLayout
from evo_cpg.io.build import build_simulation
from evo_cpg.io.numbers import put_numbers
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.simulation.batched import Inputs
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task

# Allowed rounding of unchanged elements, as a fraction of the largest number in their array.
_ROUNDING = 1e-9


class Built(NamedTuple):
    """A simulation built from known numbers.

    Attributes:
        paths: paths of the leaves.
        leaves: leaves of the simulation.
        structure: tree structure without the leaves.
        choices: decisions that the build depends on.
    """

    paths: list[Any]
    leaves: list[Any]
    structure: Any
    choices: StaticDecisions

    def has_layout_of(self, other: "Built") -> bool:
        """Return whether the other simulation differs only in numbers."""
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
        """Return whether each leaf of another simulation equals the own leaf, except at the inputs.

        Raises:
            Undecidable: a traced leaf has another shape.
        """
        moving = dict(zip(inputs.places, inputs.elements, strict=True))
        return [
            _is_same(leaf, own, moving.get(place, np.array([], int)))
            for place, (leaf, own) in enumerate(zip(leaves, self.leaves, strict=True))
        ]


class Building:
    """Builder of simulations that differ from a configuration's simulation only in numbers.

    Attributes:
        layout: layout of the surface points (`evo_cpg.creature.surface`).
        pairs: pairs of bodies to check, see `evo_cpg.io.build.build_experiment`.
        task: task that replaces the configuration's task.
        own: simulation of the configuration itself.
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
        """Build a simulation from known numbers.

        Raises:
            KeyProblem: parts do not fit together.
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
            numbers: values by key.
            conditions: list that gets conditions under which `known` would build the same.

        Raises:
            Undecidable: a condition cannot be computed from the traced numbers.
        """
        with replaying_decisions(self.own.choices, conditions), jax.numpy_rank_promotion("allow"):
            leaves, structure = jax.tree.flatten(self._build(put_numbers(config, numbers)))
        if conditions is not None and structure != self.own.structure:
            raise Undecidable("more than numbers would change")
        return leaves

    def name(self, place: int) -> str:
        """Return the path of a leaf."""
        return jax.tree_util.keystr(self.own.paths[place])[1:]

    def _build(self, config: ExperimentConfig) -> Simulation:
        _, simulation = build_simulation(config, self.layout, self.pairs)
        return dataclasses.replace(simulation, task=self.task) if self.task else simulation


def values_of(leaves: list[Any], inputs: Inputs, dtype: jnp.dtype) -> list[Array]:
    """Return the inputs among the leaves of a simulation, which may be traced."""
    return [
        jnp.asarray(leaves[place], dtype).reshape(-1)[elements]
        for place, elements in zip(inputs.places, inputs.elements, strict=True)
    ]


def _is_same(leaf: Any, own: Any, moving: np.ndarray) -> Condition:
    """Return whether a leaf equals another one, except at elements that may differ."""
    if not (is_traced(leaf) or is_number(leaf)):
        return np.array_equal(leaf, own)
    if np.shape(leaf) != np.shape(own):
        raise Undecidable("the shape of an array would change")
    rest = np.delete(np.arange(np.size(own)), moving)
    found, known = xp.ravel(leaf)[rest], np.ravel(own)[rest]
    slack = np.abs(own, where=np.isfinite(own), out=np.zeros(np.shape(own)))
    slack = _ROUNDING * slack.max(initial=0.0)
    # Infinities are equal, but their difference is NaN.
    with np.errstate(invalid="ignore"):
        return ((found == known) | (abs(found - known) <= slack)).all()
