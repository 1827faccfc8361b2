"""Real numbers of a configuration by key, and simulations built from known or traced numbers.

A simulation is built twice. With known numbers NumPy computes constants, and records the decisions
that depend on the numbers (see `evo_cpg.creature.algebra.decisions`). With traced numbers JAX
computes the constants as exact functions of the numbers, valid as long as the decisions hold.
"""

import dataclasses
import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import BaseModel, ValidationError

from evo_cpg.creature.algebra.decisions import (
    Condition,
    StaticDecisions,
    Undecidable,
    recording_decisions,
    replaying_decisions,
)
from evo_cpg.creature.algebra.numerics import Number, is_number, is_traced, xp
from evo_cpg.io.build import OWN_PLAN, CommonPlan, build_simulation
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.keys import follow, inside, parts_of, put
from evo_cpg.io.load import check_config
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.simulation.batched import Inputs
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task

# Sections whose numbers are no parameters of a trial, and keys of lists that are too long to list
# each number.
_OUTSIDE = ("audit", "evolution", "noise")
_LONG = ("vertices", "faces", "heights")

# Allowed rounding of unchanged elements, as a fraction of the largest number in their array.
_ROUNDING = 1e-9


def number_keys(config: ExperimentConfig) -> tuple[str, ...]:
    """Return the keys of all real numbers, except in `_OUTSIDE` sections and `_LONG` lists."""

    def found(place: Any, key: str) -> Iterator[str]:
        if isinstance(place, float):
            yield key
        elif isinstance(place, (dict, list)):
            for name, inner in place.items() if isinstance(place, dict) else enumerate(place):
                if name not in _LONG:
                    yield from found(inner, f"{key}.{name}")

    data = config.model_dump(mode="json", exclude=set(_OUTSIDE))
    return tuple(key.removeprefix(".") for key in found(data, ""))


def number_at(config: ExperimentConfig, key: str, source: Path | str = "") -> float:
    """Return the real number of a configuration at a key.

    Raises:
        ConfigError: there is no real number.
    """
    parts = parts_of(key)
    place, known = follow(config.model_dump(mode="json"), parts)
    if known == len(parts) and isinstance(place, float):
        return place
    keys = number_keys(config)
    near = [other for other in keys if other.startswith(f"{key}.")]
    near += difflib.get_close_matches(key, keys, n=3, cutoff=0.6)
    near += [other for other in keys if other.rpartition(".")[2] == key.rpartition(".")[2]]
    hint = f"did you mean {', '.join(dict.fromkeys(near[:4]))}?" if near else "see docs/config.md"
    if known < len(parts):
        problem = f"does not exist: {hint}"
    elif isinstance(place, int) and not isinstance(place, bool):
        problem = f"is a whole number ({place}), and only real numbers can vary"
    elif isinstance(place, (dict, list)):
        problem = f"is a section or a list, not a number: {hint}"
    else:
        problem = f"is {place!r}, not a number"
    raise ConfigError(source, parts, problem)


def with_numbers(
    config: ExperimentConfig, numbers: Mapping[str, float], source: Path | str
) -> ExperimentConfig:
    """Return a configuration with other numbers.

    Raises:
        ConfigError: the numbers are not allowed.
    """
    data = config.model_dump(mode="json")
    for key, number in numbers.items():
        data = put(data, parts_of(key), number)
    return check_config(data, source)


def are_allowed(config: ExperimentConfig, columns: Mapping[str, Float[np.ndarray, " n"]]) -> bool:
    """Return whether values lie in the ranges of their fields.

    Each range is one interval, so only the least and the largest value of a key are checked.

    Args:
        config: the configuration, in which each number is checked alone (`are_checked_alone`).
        columns: values by key.
    """
    for key, values in columns.items():
        *_, (section, rest) = _sections(config, key)
        for extreme in (values.min(), values.max()):
            try:
                changed = put(section, rest, float(extreme))
                type(section).model_validate(changed.model_dump(mode="json"))
            except ValidationError:
                return False
    return True


def are_checked_alone(config: ExperimentConfig, keys: Sequence[str]) -> bool:
    """Return whether only the fields' own checks, and no section's check, use some numbers.

    The checks run with traced numbers: a check that uses one fails.
    """

    def check(numbers: list[Array]) -> None:
        changed = put_numbers(config, dict(zip(keys, numbers, strict=True)))
        sections = {id(each): each for key in keys for each, _ in _sections(changed, key)}
        for section in sections.values():
            validators = type(section).__pydantic_decorators__.model_validators
            for name, validator in validators.items():
                # Validators before the fields only rename or complete keys.
                if validator.info.mode == "after":
                    getattr(section, name)()

    try:
        jax.eval_shape(check, [jnp.zeros(())] * len(keys))
    except (jax.errors.JAXTypeError, TypeError):
        return False
    return True


def put_numbers(config: ExperimentConfig, numbers: Mapping[str, Number]) -> ExperimentConfig:
    """Return a configuration with other, unchecked numbers, which may be traced."""
    for key, number in numbers.items():
        config = put(config, parts_of(key), number)
    return config


def _sections(place: Any, key: str) -> Iterator[tuple[BaseModel, list[str]]]:
    """Yield the sections around a number, outermost first, with the rest of the key in each."""
    names = list(parts_of(key))
    for i, name in enumerate(names):
        if isinstance(place, BaseModel):
            yield place, names[i:]
        place = inside(place, name)


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
        conditions: list[Condition] = []
        for place, (leaf, own) in enumerate(zip(leaves, self.leaves, strict=True)):
            if not (is_traced(leaf) or is_number(leaf)):
                conditions.append(np.array_equal(leaf, own))
                continue
            if np.shape(leaf) != np.shape(own):
                raise Undecidable("the shape of an array would change")
            rest = np.delete(np.arange(np.size(own)), moving.get(place, np.array([], int)))
            found, known = xp.ravel(leaf)[rest], np.ravel(own)[rest]
            slack = np.abs(own, where=np.isfinite(own), out=np.zeros(np.shape(own)))
            slack = _ROUNDING * slack.max(initial=0.0)
            # Infinities are equal, but their difference is NaN.
            with np.errstate(invalid="ignore"):
                conditions.append(((found == known) | (abs(found - known) <= slack)).all())
        return conditions


class Building:
    """Builder of simulations that differ from a configuration's simulation only in numbers.

    Attributes:
        plan: decisions that all simulations have in common.
        task: task that replaces the configuration's task.
        own: simulation of the configuration itself.
    """

    def __init__(
        self, config: ExperimentConfig, plan: CommonPlan = OWN_PLAN, task: Task | None = None
    ):
        self.plan, self.task = plan, task
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

        ``conditions`` is a list that gets conditions under which `known` would build the same.

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
        _, simulation = build_simulation(config, self.plan)
        return dataclasses.replace(simulation, task=self.task) if self.task else simulation


def values_of(leaves: list[Any], inputs: Inputs, dtype: jnp.dtype) -> list[Array]:
    """Return the inputs among the leaves of a simulation, which may be traced."""
    return [
        jnp.asarray(leaves[place], dtype).reshape(-1)[elements.copy()]
        for place, elements in zip(inputs.places, inputs.elements, strict=True)
    ]
