"""Checks of the values that a user's own classes return.

Tracing a control step shows shapes and types. The same step then runs with random numbers, and
again with other numbers for some individuals. The results of the remaining individuals must not
change, because each individual is alone in its trial.
"""

import contextlib
import dataclasses
import inspect
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from evo_cpg.control.controller import Command
from evo_cpg.creature.algebra.numerics import is_traced
from evo_cpg.evolution.map_elites import METRICS
from evo_cpg.evolution.strategy import Evaluation, Strategy
from evo_cpg.io.errors import Key, KeyProblem
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.section import CustomConfig
from evo_cpg.io.trust import own_parts
from evo_cpg.native.engine import Engine, using
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.simulation.control_step import (
    Effects,
    begin_episode,
    no_forces,
    sense,
    snapshot_of,
    transition,
)
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import CourseStart, term_names
from evo_cpg.training.experiment import TABLE_COLUMNS, descriptors

# Number of individuals: a prime, so that the axis is rarely confused with another axis.
_INDIVIDUALS = 7
_BATCH = (_INDIVIDUALS,)

# Individuals whose numbers change, in two tries. Results that depend on the first, the last or the
# largest individual differ in one of them.
_CHANGED = ([0, 1, 2, 3], [4, 5, 6])

# Result of each method of the user's own classes, by the key of its section and its name.
Results = dict[tuple[Key, str], Any]

# Returns the problem of a value, worded to follow the name of the method, or None.
Test = Callable[[Any], str | None]


def check_own_returns(config: ExperimentConfig, simulation: Simulation) -> None:
    """Check the user's own classes in one control step.

    Raises:
        KeyProblem: a class fails, returns a wrong type or shape, mixes individuals, or its fitness
            is always NaN.
    """
    own = own_parts(config)
    if not own:
        return
    results: Results = {}

    def methods(part: Any, *key: str | int) -> _Methods:
        return _Methods(part, key, key in own, results)

    light = methods(simulation.task, "task").call("light", test=_is_light)
    if light is None and simulation.task.moves_light:
        raise KeyProblem(("task", "type"), "moves its light, so `light` must be a place, not None")
    simulation = dataclasses.replace(simulation, noise=Noise())
    shapes: dict[str, Any] = {}

    def go(given: dict[str, Any]) -> Results:
        """Take a control step, with given numbers in place of those that the step computes."""

        def put(name: str, computed: Any) -> Any:
            shapes[name] = jax.tree.map(_shape_of, computed)
            return given.get(name, computed)

        results.clear()
        genes = given["genes"]
        controller = methods(simulation.controller, "controller")
        draw = jax.random.key(0), _BATCH, jnp.float32
        count = simulation.controller.gene_count
        own_genes = controller.call("random_genes", *draw, test=_is_like(_numbers(count)))
        controller.call("decode", put("own genes", jnp.asarray(own_genes, genes.dtype)))
        keys, task = None, methods(simulation.task, "task")
        if simulation.task.moves_light:
            keys = jnp.zeros((4, _INDIVIDUALS), jnp.uint32)
            place = jnp.zeros((3, _INDIVIDUALS), genes.dtype)
            first = put("position", place), put("light", place)
            start = CourseStart(*first, simulation.course_keys(keys))
            course = task.call("begin_course", start)
            light = task.call("place_light", course, test=_is_like(_numbers(3)))
        constants, animal = put("start", begin_episode(simulation, genes, keys, None))
        forces = put("forces", no_forces(simulation, animal.state))
        for i, sensor in enumerate(simulation.extra_sensors):
            snapshot = snapshot_of(simulation, constants, animal.state)
            readings = _is_like(_numbers(sensor.count))
            methods(sensor, "creature", "sensors", i).call("sense", snapshot, forces, test=readings)
        observation = put("observation", sense(simulation, constants, animal, 0)[0])

        def is_act(found: Any) -> str | None:
            if not (isinstance(found, tuple) and len(found) == 2 and isinstance(found[1], Command)):
                return "must return a pair of the next state and a Command"
            dofs, fields = simulation.world.tree.dof_count, found[1]._asdict()
            like = dict.fromkeys(fields, _numbers(dofs)) | {"activation": _numbers(2, dofs)}
            left_out = [name for name in Command._field_defaults if fields[name] is None]
            like = like | dict.fromkeys(left_out)
            return _is_like(animal.nerves, exact=True)(found[0]) or _is_like(like)(fields)

        nerves = constants.phenotype.controller, animal.nerves
        _, command = controller.call("act", *nerves, observation, test=is_act)
        command = put("command", command)
        energy = put("energy", jnp.zeros(_INDIVIDUALS, genes.dtype))
        after, airborne = put("after", animal.state), put("airborne", energy)
        effects = Effects(animal.state, after, observation, command, forces, energy, airborne)
        if simulation.task.moves_light:
            effects = effects._replace(light=light, course=animal.course)
        seen = transition(simulation, constants, effects, jnp.int32(0))
        # The methods of the task in the order of a run.
        steps = simulation.steps
        if simulation.task.moves_light:
            moved = animal.course, seen.after, jnp.int32(0)
            task.call("advance_course", *moved, test=_is_like(animal.course, exact=True))
        each, alone = _numbers(), jax.ShapeDtypeStruct((), jnp.float32)
        tally = task.call("begin", _BATCH, seen.energy.dtype, steps)
        tally = task.call("update", tally, seen, steps, test=_is_like(tally, exact=True))
        terms = task.call("terms", tally, steps, test=_is_dict_of(each))
        terms = put("terms", terms | dict.fromkeys(simulation.measures.names, seen.energy))
        # Scales are measured on the whole first generation.
        scales = put("scales", task.call("scales", terms, test=_is_dict_of(alone)))
        task.call("descriptors", terms, test=_is_dict_of(each))
        task.call("fitness", terms, scales, test=_is_like(each))
        first = {name: jnp.asarray(term)[0] for name, term in terms.items()}
        task.call("fitness", first, scales, test=_is_like(alone))
        return results

    genes = jax.ShapeDtypeStruct((simulation.genome.count, _INDIVIDUALS), jnp.float32)
    with using(Engine("jax")):
        jax.eval_shape(go, {"genes": genes})
        tried = require_separate(go, {"genes": genes} | shapes)
    name = ("task",), f"{type(simulation.task).__name__}.fitness"
    if all(name in found and np.isnan(found[name]).all() for found in tried):
        problem = f"{name[1]} is NaN for every animal that was tried, so all would be disqualified"
        raise KeyProblem(("task", "type"), problem)


def check_own_forces(config: ExperimentConfig, world: World) -> None:
    """Check the user's own force laws.

    Raises:
        KeyProblem: a force law fails, returns a wrong type or shape, mixes individuals, or is
            infinite or NaN at rest.
    """
    given = config.world.forces
    shape, results = (6, world.tree.body_count), Results()
    laws = [
        _Methods(law, ("world", "forces", i), results=results)
        for i, law in enumerate(world.forces[len(world.forces) - len(given) :])
        if isinstance(given[i], CustomConfig)
    ]
    if not laws:
        return

    def go(state: State) -> Results:
        results.clear()
        bodies = world.bodies(kinematics(world.tree, state), 1e-3)
        for law in laws:
            law.call("wrench", bodies, test=_is_like(_numbers(*shape)))
            law.call("derivative", bodies, test=_is_like(_numbers(6, *shape)))
        return results

    with using(Engine("jax")):
        rest = resting_state(world.tree, _BATCH, jnp.float32)
        shapes = jax.tree.map(_shape_of, rest)
        jax.eval_shape(go, shapes)
        at_rest = {} if is_traced(world) else require_separate(go, shapes, rest)[0]
    for (key, name), values in at_rest.items():
        if not np.isfinite(values).all():
            problem = (
                f"{name} is NaN or infinite for a creature at rest. Add a small number under a "
                "root or in a denominator: jnp.sqrt(v @ v + 1e-12)"
            )
            raise KeyProblem((*key, "type"), problem)


def require_separate(
    go: Callable[[Any], Results], shapes: Any, *others: Any
) -> list[dict[tuple[Key, str], list[np.ndarray]]]:
    """Check that no result of an individual depends on other individuals, and return all results.

    Args:
        go: function that returns the results of methods for given numbers.
        shapes: shapes of the given numbers, for random ones.
        others: further numbers, whose results come first.

    Raises:
        KeyProblem: the result of an individual changes with the numbers of other individuals.
    """
    names: list[tuple[Key, str]] = []

    def numbers(given: Any) -> list[list[Array]]:
        found = go(given)
        names[:] = found
        return [[x for x in jax.tree.leaves(value) if is_real(x)] for value in found.values()]

    run = quick_jit(numbers)
    first = _random(shapes)
    negative = jax.tree.map(lambda x: -x if jnp.issubdtype(x.dtype, jnp.floating) else x, first)
    given = [*others, negative, first, *(_random(shapes, changed) for changed in _CHANGED)]
    tried = [dict(zip(names, jax.device_get(run(one)), strict=True)) for one in given]
    before, *after = tried[-1 - len(_CHANGED) :]
    for changed, found in zip(_CHANGED, after, strict=True):
        kept = np.setdiff1d(np.arange(_INDIVIDUALS), changed)
        for (key, name), values in found.items():
            pairs = zip(before[key, name], values, strict=True)
            if not all(
                np.array_equal(x[..., kept], y[..., kept], True)
                for x, y in pairs
                if np.shape(x)[-1:] == _BATCH
            ):
                problem = (
                    f"{name} mixes individuals: the result of one depends on the others. "
                    "Individuals are on the last axis. Sum and compare along the axes before it, "
                    "such as x.sum(0)"
                )
                raise KeyProblem((*key, "type"), problem)
    return tried


def _random(shapes: Any, changed: Sequence[int] = ()) -> Any:
    """Return random numbers of given shapes: always the same, except for changed individuals.

    Numbers that are not real stay 0. The others are positive and below 1, because most functions
    are defined there.
    """
    rng = np.random.default_rng(0)

    def fill(leaf: jax.ShapeDtypeStruct) -> Any:
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            return jax.random.split(jax.random.key(0), leaf.shape)
        if not jnp.issubdtype(leaf.dtype, jnp.floating):
            return np.zeros(leaf.shape, leaf.dtype)
        values, others = (rng.uniform(*ends, leaf.shape) for ends in ((0.1, 0.5), (0.5, 1.0)))
        if leaf.shape[-1:] == _BATCH:
            values[..., changed] = others[..., changed]
        return values.astype(leaf.dtype)

    return jax.tree.map(fill, shapes)


def check_own_strategy(
    config: ExperimentConfig,
    strategy: Strategy,
    population: int,
    simulation: Simulation,
    mapped: bool,
) -> None:
    """Check a user's own strategy in two traced generations: only types and shapes.

    Args:
        config: configuration that names the strategy.
        strategy: strategy on one island.
        population: population that it was requested to have.
        simulation: simulation of a trial.
        mapped: whether a map adds its own columns to metrics.csv.

    Raises:
        KeyProblem: the strategy fails, or returns a wrong type or shape.
    """
    own = _Methods(strategy, ())
    if strategy.population != population:
        problem = f"{population}: {type(strategy).__name__} has another one, {strategy.population}"
        raise KeyProblem(("population",), problem)
    names = (*term_names(simulation.task), *simulation.measures.names)
    taken = {*TABLE_COLUMNS, *(METRICS if mapped else ()), *(f"best_{name}" for name in names)}

    def are_new(names: Any) -> str | None:
        if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
            return f"must be a tuple of names, got {names!r}"
        twice = [name for name in names if name in taken or names.count(name) > 1]
        return f"must not contain {twice[0]!r} again, a column of metrics.csv" if twice else None

    declared = own.call("metric_names", test=are_new)
    alone = jax.ShapeDtypeStruct((), jnp.float32)

    def go(random: jax.Array, fitness: jax.Array) -> None:
        def is_generation(found: Any) -> str | None:
            if not (isinstance(found, tuple) and len(found) == 2):
                return "must return a pair of genomes and a state"
            like = found[1] if kept is None else kept
            return _is_like(random)(found[0]) or _is_like(like, exact=True)(found[1])

        draw, kept = jax.random.key(0), None
        _, kept = own.call("ask", draw, own.call("init", draw, random), test=is_generation)
        terms = dict.fromkeys(names, fitness)
        in_trials = jnp.tile(fitness, (config.trial_count, 1))
        worth = Evaluation(fitness, terms, descriptors(simulation, terms), in_trials)
        updated = own.call("tell", draw, kept, random, worth)
        _, kept = own.call("ask", draw, updated, test=is_generation)
        # Metrics are computed from a state after trials, as in a run.
        own.call("metrics", kept, test=_is_like(dict.fromkeys(declared, alone)))

    shape = simulation.genome.count, strategy.population
    jax.eval_shape(go, *(jax.ShapeDtypeStruct(x, jnp.float32) for x in (shape, shape[1:])))


class _Methods:
    """Methods of a part of the simulation, which may fail if the part is the user's own.

    Args:
        part: the part.
        key: key of its section.
        own: whether the part is the user's own.
        results: receives the first result of each method if the part is the user's own.
    """

    def __init__(self, part: Any, key: Key, own: bool = True, results: Results | None = None):
        self._part, self._key, self._own, self._results = part, key, own, results

    def call(self, method: str, *given: Any, test: Test | None = None) -> Any:
        """Return the result of a method, or the value of an attribute.

        Raises:
            KeyProblem: the user's own method fails, or its result fails the test.
        """
        name, found = f"{type(self._part).__name__}.{method}", None
        try:
            found = getattr(self._part, method)
            found = found(*given) if given else found
        except Exception as error:
            if not self._own:
                raise
            file = inspect.getsourcefile(type(self._part))
            frames = traceback.extract_tb(error.__traceback__)
            lines = [frame.lineno for frame in frames if frame.filename == file]
            place = f" at line {lines[-1]} of {Path(file).name}" if file and lines else ""
            reason = (str(error).strip().splitlines() or [""])[0]
            problem = f"fails{place} ({type(error).__name__}: {reason})"
        else:
            problem = test and test(found)
        if problem:
            raise KeyProblem((*self._key, "type"), f"{name} {problem}")
        if self._own and self._results is not None:
            self._results.setdefault((tuple(self._key), name), found)
        return found


def _numbers(*shape: int) -> jax.ShapeDtypeStruct:
    """Return an array of numbers of a given shape for each individual."""
    return jax.ShapeDtypeStruct((*shape, _INDIVIDUALS), jnp.float32)


def _is_like(model: Any, exact: bool = False) -> Test:
    """Return a test for a pytree of arrays with the structure and shapes of a model.

    If ``exact``, types must also be equal. Otherwise any real type passes.
    """

    def test(value: Any) -> str | None:
        leaves, structure = jax.tree.flatten(value)
        model_leaves, expected = jax.tree.flatten(model)
        kinds = [(_type_of(x), jnp.shape(x)) for x in model_leaves]
        found = [
            (_type_of(x) if exact or not is_real(x) else kind, getattr(x, "shape", ()))
            for x, (kind, _) in zip(leaves, kinds, strict=False)
        ]
        arrays = all(kind is not None for kind, _ in kinds)
        if structure == expected and found == kinds and arrays:
            return None
        wrong = f"must return {described(model) if arrays else 'arrays'}, got {described(value)}"
        return wrong if exact else f"{wrong}. Individuals are on the last axis"

    return test


def _is_dict_of(leaf: jax.ShapeDtypeStruct) -> Test:
    """Return a test for a dict from names to arrays like a leaf."""

    def test(value: Any) -> str | None:
        if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
            return f"must return a dict by name, not {described(value)}"
        return _is_like(dict.fromkeys(value, leaf))(value)

    return test


def _is_light(value: Any) -> str | None:
    """Test that a value is None or the place of a light."""
    if value is None:
        return None
    with contextlib.suppress(TypeError, ValueError):
        place = np.asarray(value)
        if place.shape == (3,) and place.dtype.kind in "iuf" and np.isfinite(place).all():
            return None
    return f"must be None, or a place of three numbers (m), such as (8.0, 0.0, 0.0), got {value!r}"


def _shape_of(value: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(jnp.shape(value), jnp.result_type(value))


def is_real(value: Any) -> bool:
    """Return whether a value is an array or number of integer, real or boolean type."""
    kinds = jnp.bool_, jnp.integer, jnp.floating
    found = _type_of(value)
    return found is not None and any(jnp.issubdtype(found, kind) for kind in kinds)


def _type_of(value: Any) -> Any:
    """Return the type of the numbers of an array, or None if the value is not an array."""
    try:
        return jnp.result_type(value)
    except TypeError:
        return None


def described(value: Any) -> str:
    """Return a description of a returned value for messages: types and shapes of arrays."""

    def kind(x: Any) -> str:
        found = _type_of(x)
        return repr(x) if found is None else f"{found}{list(jnp.shape(x))}"

    if jax.tree.structure(value) == jax.tree.structure(0):
        return kind(value)
    return str(jax.tree.map(kind, value)).replace("'", "")
