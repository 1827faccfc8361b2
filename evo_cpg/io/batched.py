"""Batches of bodies from one configuration that differ in some numbers only.

One program builds all bodies (`BodyPlan`). Its plan comes from a few bodies, which NumPy builds
one by one (`build_batch`). NumPy also builds the bodies that do not fit the plan.
"""

import abc
import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped
from typing_extensions import override

from evo_cpg.creature.algebra.decisions import Condition, Undecidable, all_hold
from evo_cpg.creature.self_collision import PlanPairs
from evo_cpg.creature.surface import PointLayout
from evo_cpg.io.build import CommonPlan, build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.numbers import (
    Building,
    are_allowed,
    are_checked_alone,
    number_at,
    values_of,
    with_numbers,
)
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.simulation.batched import BatchedSimulation, LayoutError, batch
from evo_cpg.simulation.simulation import NumberBuilder, Simulation
from evo_cpg.simulation.task import Task
from evo_cpg.training.devices import Layout, population_mesh, run_on, sharded

# Errors of building with traced numbers, on which the form of the model depends.
UNTRACEABLE = (Undecidable, jax.errors.JAXTypeError, TypeError, ValueError)


class BodyPlan:
    """The common part of bodies that differ in some numbers, and the program that builds them.

    Attributes:
        batched: bodies that the plan was made from.
        hindrance: reason why no program can build bodies, or empty if a program can.
    """

    def __init__(
        self,
        config: ExperimentConfig,
        source: Path | str,
        numbers: Mapping[str, Float[np.ndarray, " n"]],
        task: Task | None = None,
    ):
        """Make a plan from some bodies. See `build_batch` for the arguments and errors."""
        self._config, self._keys = config, tuple(numbers)
        self.batched, plan = _build(config, source, numbers, None, task)
        self._building = Building(config, plan, task)
        alone = are_checked_alone(config, self._keys)
        self.hindrance = "" if alone else "numbers are checked together"
        self._run = jax.jit(jax.vmap(self.one, in_axes=-1, out_axes=-1))

    def build(
        self, numbers: Mapping[str, Float[np.ndarray, " n"]]
    ) -> tuple[list[Float[np.ndarray, "_ n"]], Bool[np.ndarray, " n"]]:
        """Build bodies that follow the plan, in float64.

        Args:
            numbers: values of each key of the plan, equally many.

        Returns:
            The values of `BatchedSimulation`, and whether each body fits the plan. The values of
            bodies that do not fit are undefined.
        """
        columns = np.stack([np.asarray(numbers[key], float) for key in self._keys])
        none = np.zeros(columns.shape[1], bool)
        shapes = [(len(elements), len(none)) for elements in self.batched.inputs.elements]
        if self.hindrance or not are_allowed(self._config, numbers):
            return [np.zeros(shape) for shape in shapes], none
        try:
            with jax.enable_x64(True):
                values, fits = jax.device_get(self._run(columns))
        except UNTRACEABLE as error:
            self.hindrance = str(error).partition("\n")[0]
            return [np.zeros(shape) for shape in shapes], none
        return list(map(np.array, values)), fits

    def one(self, numbers: Sequence[Array], checks: bool = True) -> tuple[list[Array], Condition]:
        """Return the values of one body with traced numbers, and whether it fits the plan.

        Without ``checks``, it counts as fitting.
        """
        conditions: list[Condition] = []
        given = dict(zip(self._keys, numbers, strict=True))
        inputs = self.batched.inputs
        leaves = self._building.traced(self._config, given, conditions if checks else None)
        if checks:
            conditions += self._building.own.agrees(leaves, inputs)
        values = values_of(leaves, inputs, jnp.result_type(*numbers))
        return values, jnp.asarray(all_hold(conditions))


# Simulations that are built at a time. A fixed number gives each the same bits in any population.
_WIDTH = 64


class NumbersOfPlan(NumberBuilder):
    """Builder of the simulations of one plan (see `NumberBuilder`). Subclasses define `numbers`.

    Attributes:
        common: simulation of the plan, at the configuration's own numbers.
    """

    def __init__(
        self,
        config: ExperimentConfig,
        source: Path | str,
        samples: Mapping[str, Float[np.ndarray, " n"]],
    ):
        """Make the plan from samples of the whole range.

        Raises:
            ConfigError: a sample is not allowed, or samples differ in more than numbers.
        """
        self._plan = BodyPlan(config, source, samples)
        batched = self._plan.batched
        self.common = batched.common
        paths = jax.tree_util.tree_flatten_with_path(batched.common)[0]
        self.inputs = tuple(
            (jax.tree_util.keystr(paths[place][0]), elements)
            for place, elements in zip(batched.inputs.places, batched.inputs.elements, strict=True)
        )
        self._mesh = population_mesh()
        self._run = sharded(jax.vmap(self._one, in_axes=-1, out_axes=-1), self._mesh, (2,))

    @abc.abstractmethod
    def numbers(self, origin: Shaped[Array, " b"]) -> list[Array]:
        """Return the numbers of one simulation, in the order of the samples."""

    def _one(self, origin: Shaped[Array, " b"]) -> list[Array]:
        values, fits = self._plan.one(self.numbers(origin))
        return [jnp.where(fits, value, jnp.nan) for value in values]

    @override
    def values(self, origin: Shaped[np.ndarray, "b n"]) -> list[Float[np.ndarray, "_ n"]]:
        with jax.enable_x64(True):
            return run_on(self._run, Layout(self._mesh, _WIDTH), (origin,))

    @override
    def traced(self, origin: Shaped[Array, " b"]) -> list[Array]:
        return self._plan.one(self.numbers(origin), checks=False)[0]


def build_batch(
    config: ExperimentConfig,
    source: Path | str,
    numbers: Mapping[str, Float[np.ndarray, " n"]],
    like: BatchedSimulation | None = None,
    task: Task | None = None,
) -> BatchedSimulation:
    """Build simulations from a configuration, with some numbers different for each individual.

    Each simulation is built separately, in NumPy. The common part is the simulation of the
    unchanged configuration.

    Args:
        config: the configuration.
        source: file of the configuration.
        numbers: values by key, such as ``creature.bodies.1.shape.size.0``.
        like: see `evo_cpg.simulation.batched.batch`.
        task: task that replaces the configuration's task.

    Raises:
        ConfigError: a key does not exist or is not a real number, a value is not allowed, or the
            numbers change the layout of the simulation, or nothing.
        ValueError: a key does not have one value for each individual.
    """
    return _build(config, source, numbers, like, task)[0]


def _build(
    config: ExperimentConfig,
    source: Path | str,
    numbers: Mapping[str, Float[np.ndarray, " n"]],
    like: BatchedSimulation | None,
    task: Task | None,
) -> tuple[BatchedSimulation, CommonPlan]:
    """Return the result of `build_batch`, and the plan of its bodies."""
    for key in numbers:
        number_at(config, key, source)
    sizes = {np.shape(values) for values in numbers.values()}
    if len(sizes) != 1 or len(next(iter(sizes))) != 1:
        raise ValueError(f"each key needs one value for each individual, got shapes {sizes}")
    columns = [np.asarray(values, float).tolist() for values in numbers.values()]
    configs = [
        with_numbers(config, dict(zip(numbers, row, strict=True)), source)
        for row in zip(*columns, strict=True)
    ]
    return _combine(
        config,
        configs,
        source,
        ", ".join(numbers),
        lambda simulation, _: dataclasses.replace(simulation, task=task) if task else simulation,
        like,
    )


def batch_of_configs(
    config: ExperimentConfig,
    configs: Sequence[ExperimentConfig],
    source: Path | str,
    edit: Callable[[Simulation, int], Simulation],
) -> BatchedSimulation:
    """Build simulations from configurations that differ in numbers only, and change each.

    Args:
        config: configuration whose numbers the simulations have in common.
        configs: configurations of the individuals.
        source: file of the configuration.
        edit: function that returns a changed simulation, given the number of its individual, from
            -1 for the common part.

    Raises:
        ConfigError: the simulations differ in more than numbers, or in nothing.
    """
    return _combine(config, configs, source, "the settings", edit)[0]


def _combine(
    config: ExperimentConfig,
    configs: Sequence[ExperimentConfig],
    source: Path | str,
    named: str,
    edit: Callable[[Simulation, int], Simulation],
    like: BatchedSimulation | None = None,
) -> tuple[BatchedSimulation, CommonPlan]:
    """Return a batch of the edited simulations of some configurations, and their plan."""

    def build(plan: CommonPlan) -> list[Simulation]:
        return [
            edit(build_experiment(each, source, plan=plan).simulation, individual)
            for individual, each in enumerate((config, *configs), -1)
        ]

    problem, pairs = "", None
    # With other numbers, equal surfaces may become different, and bodies may cover other points. So
    # try more and more general layouts.
    layouts: tuple[PointLayout, ...] = "merged", "separate", "complete"
    for layout in layouts:
        common, *simulations = build(CommonPlan(layout, pairs))
        sets = [_pairs(each) for each in (like.common if like else common, *simulations)]
        every = PlanPairs(*(tuple(sorted({*itertools.chain(*x)})) for x in zip(*sets, strict=True)))
        if like and every != sets[0]:
            problem = "limbs can touch that cannot touch in the other bodies"
            break
        if len(set(sets)) > 1:
            # Longer limbs may touch more bodies. Let all simulations check the union of all pairs.
            pairs = every
            common, *simulations = build(CommonPlan(layout, pairs))
        try:
            batched = _with_whole_floor(batch(common, simulations, like))
            return batched, CommonPlan(layout, _pairs(batched.common))
        except LayoutError as error:
            problem = str(error)
        except ValueError as error:
            problem = str(error)
            break
    raise ConfigError(source, (), f"{named}: {problem}")


def _with_whole_floor(batched: BatchedSimulation) -> BatchedSimulation:
    """Make all heights of a floor inputs if some are.

    JAX refuses arrays of known and traced numbers where contact looks for the first touch.
    """
    leaves = jax.tree_util.tree_leaves_with_path(batched.common)
    inputs = batched.inputs
    floors = [".ground.floor." in jax.tree_util.keystr(leaves[i][0]) for i in inputs.places]
    if not any(floors):
        return batched
    elements = tuple(
        np.arange(np.size(leaves[place][1])) if floor else own
        for place, own, floor in zip(inputs.places, inputs.elements, floors, strict=True)
    )
    inputs = inputs._replace(elements=elements)
    each = (inputs.of(batched[individual]) for individual in range(batched.size))
    return batched._replace(
        inputs=inputs, values=tuple(np.stack(x, axis=-1) for x in zip(*each, strict=True))
    )


def _pairs(simulation: Simulation) -> PlanPairs:
    """Return the pairs of bodies that a simulation checks."""
    rules, names = simulation.rules, simulation.world.tree.names
    found = []
    for pairs in (simulation.world.pairs, rules.pairs if rules else None):
        both = zip(pairs.first, pairs.second, strict=True) if pairs else ()
        found.append(tuple(sorted((names[min(pair)], names[max(pair)]) for pair in both)))
    return PlanPairs(*found)
