"""What a user's own classes give is checked on a trial of shapes, before anything is computed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from evo_cpg.config.errors import ConfigError, Key
from evo_cpg.config.own_classes import own_parts
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.control.controller import Command
from evo_cpg.evolution.map_elites import METRICS
from evo_cpg.evolution.strategy import Evaluation, Strategy
from evo_cpg.fusion.engine import Engine, using
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.state import resting_state
from evo_cpg.physics.world import World
from evo_cpg.simulation.control_step import (
    Effects,
    begin_episode,
    no_forces,
    sense,
    snapshot_of,
    transition,
)
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import term_names
from evo_cpg.training.experiment import TABLE_COLUMNS, descriptors

# As many as two individuals are told from one, and from what a creature has two of.
_INDIVIDUALS = 7


def check_own_returns(config: ExperimentConfig, simulation: Simulation, source: Path | str) -> None:
    """Let the user's own classes take part in one control step, of which only shapes are computed.

    Raises:
        ConfigError: one of them fails, or gives something of another kind or shape than it must.
    """
    own = [key for key, _ in own_parts(config)]
    if not own:
        return

    def go(genes: jax.Array) -> None:
        checked = _Checked(own, source)
        numbers = checked(
            ("controller",),
            simulation.controller,
            "random_genes",
            lambda method: method(jax.random.key(0), (_INDIVIDUALS,), jnp.float32),
        )
        shape = simulation.controller.gene_count, _INDIVIDUALS
        _expect_array(checked.where("random_genes"), numbers, shape)
        own_genes = jnp.asarray(numbers, genes.dtype)
        checked(("controller",), simulation.controller, "decode", lambda method: method(own_genes))
        constants, animal = begin_episode(simulation, genes, None, None)
        forces = no_forces(simulation, animal.state)
        for i, sensor in enumerate(simulation.extra_sensors):
            snapshot = snapshot_of(simulation, constants, animal.state)
            key = "creature", "sensors", i
            read = checked(key, sensor, "sense", lambda method, s=snapshot: method(s, forces))
            _expect_array(checked.where("sense"), read, (sensor.count, _INDIVIDUALS))
        observation = sense(simulation, constants, animal)
        given = constants.phenotype.controller, animal.nerves, observation
        found = checked(("controller",), simulation.controller, "act", lambda act: act(*given))
        if not (isinstance(found, tuple) and len(found) == 2 and isinstance(found[1], Command)):
            checked.where("act").fail("must return a pair of the next state and a Command")
        nerves, command = found
        _expect_like(checked.where("act"), "the next state", nerves, animal.nerves)
        dofs = simulation.world.tree.dof_count, _INDIVIDUALS
        for name, value in zip(Command._fields, command, strict=True):
            if value is not None or name != "target_angle":
                _expect_array(checked.where("act"), value, dofs, f"its {name}")
        energy = jnp.zeros(_INDIVIDUALS, genes.dtype)
        effects = Effects(animal.state, animal.state, observation, command, forces, energy, energy)
        _check_task(checked, simulation, transition(simulation, constants, effects, jnp.int32(0)))

    shape = simulation.genome.count, _INDIVIDUALS
    with using(Engine("jax")):
        jax.eval_shape(go, jax.ShapeDtypeStruct(shape, jnp.float32))


def check_own_forces(config: ExperimentConfig, world: World, source: Path | str) -> None:
    """Let the user's own force laws act on the creature, of which only shapes are computed.

    Raises:
        ConfigError: one of them fails, or gives something of another kind or shape than it must.
    """
    count = len(config.world.forces)
    if not count:
        return
    keys = [("world", "forces", i) for i in range(count)]
    checked, shape = _Checked(keys, source), (6, world.tree.body_count, _INDIVIDUALS)

    def go() -> None:
        state = resting_state(world.tree, (_INDIVIDUALS,), jnp.float32)
        bodies = world.bodies(kinematics(world.tree, state), 1e-3)
        for key, law in zip(keys, world.forces[-count:], strict=True):
            wrench = checked(key, law, "wrench", lambda method: method(bodies))
            _expect_array(checked.where("wrench"), wrench, shape)
            slope = checked(key, law, "derivative", lambda method: method(bodies))
            _expect_array(checked.where("derivative"), slope, (6, *shape))

    with using(Engine("jax")):
        jax.eval_shape(go)


def check_own_strategy(
    config: ExperimentConfig,
    strategy: Strategy,
    simulation: Simulation,
    trials: int,
    source: Path | str,
) -> None:
    """Let a strategy of the user's own take part in two generations, of which only shapes matter.

    Raises:
        ConfigError: it fails, or gives something of another kind or shape than it must.
    """
    key = ("evolution",)
    if key not in [key for key, _ in own_parts(config)]:
        return
    given = config.evolution
    islands = getattr(given, "islands", None)
    map_metrics = METRICS if given.axes and not strategy.map_axes else ()
    shape = simulation.genome.count, strategy.population
    names = (*term_names(simulation.task), *simulation.measures.names)
    taken = {*TABLE_COLUMNS, *map_metrics, *(f"best_{name}" for name in names)}
    checked = _Checked([key], source)
    asked = given.population // (islands.count if islands else 1)
    if strategy.population != asked:
        where, kind = " on each island" if islands else "", type(strategy).__name__
        problem = f"{asked}{where}: {kind} has another population, {strategy.population}"
        raise ConfigError(source, (*key, "population"), problem)
    metrics = checked(key, strategy, "metric_names", lambda names: names)
    where = checked.where("metric_names")
    if not isinstance(metrics, tuple) or not all(isinstance(name, str) for name in metrics):
        where.fail(f"must be a tuple of names, got {metrics!r}")
    for name in metrics:
        if name in taken or metrics.count(name) > 1:
            where.fail(f"must not have {name!r}, which metrics.csv has already")

    def go(random: jax.Array, fitness: jax.Array) -> None:
        draw = jax.random.key(0)
        first = checked(key, strategy, "init", lambda init: init(draw, random))
        kept = None
        for state in (first, None):
            if state is None:
                terms = dict.fromkeys(names, fitness)
                in_trials = jnp.tile(fitness, (trials, 1))
                worth = Evaluation(fitness, terms, descriptors(simulation, terms), in_trials)
                given = draw, kept, random, worth
                state = checked(key, strategy, "tell", lambda tell, x=given: tell(*x))
            found = checked(key, strategy, "ask", lambda ask, x=state: ask(draw, x))
            where = checked.where("ask")
            if not (isinstance(found, tuple) and len(found) == 2):
                where.fail("must return a pair of genomes and a state")
            _expect_array(where, found[0], shape)
            _expect_like(where, "the state", found[1], found[1] if kept is None else kept)
            kept = found[1]
        # Of a state after trials, as in a run.
        told = checked(key, strategy, "metrics", lambda metrics: metrics(kept))
        _expect_dict(checked.where("metrics"), told, "metric")
        if set(told) != set(metrics):
            wanted, given = (", ".join(names) or "nothing" for names in (metrics, told))
            checked.where("metrics").fail(
                f"must return what metric_names has, {wanted}; got {given}"
            )

    given = (jax.ShapeDtypeStruct(x, jnp.float32) for x in (shape, shape[1:]))
    jax.eval_shape(go, *given)


def _check_task(checked: "_Checked", simulation: Simulation, seen: Any) -> None:
    task, steps, key = simulation.task, simulation.steps, ("task",)
    dtype = seen.energy.dtype
    batch = (_INDIVIDUALS,)
    tally = checked(key, task, "begin", lambda begin: begin(batch, dtype, steps))
    after = checked(key, task, "update", lambda update: update(tally, seen, steps))
    _expect_like(checked.where("update"), "the tally", after, tally)
    terms = checked(key, task, "terms", lambda terms: terms(after, steps))
    _expect_dict(checked.where("terms"), terms, "term", batch)
    terms = terms | dict.fromkeys(simulation.measures.names, seen.energy)
    scales = checked(key, task, "scales", lambda scales: scales(terms))
    _expect_dict(checked.where("scales"), scales, "scale")
    about = checked(key, task, "descriptors", lambda descriptors: descriptors(terms))
    _expect_dict(checked.where("descriptors"), about, "descriptor", batch)
    for crowd in (terms, {name: jnp.asarray(term)[0] for name, term in terms.items()}):
        alone = "" if crowd is terms else "one individual alone"
        fitness = checked(key, task, "fitness", lambda fitness, x=crowd: fitness(x, scales))
        _expect_array(checked.where("fitness"), fitness, () if alone else batch, alone)


class _Where:
    """A method of the user's own, for messages."""

    def __init__(self, source: Path | str, key: Key, name: str):
        self._source, self._key, self._name = source, key, name

    def fail(self, problem: str) -> None:
        """Complain of it.

        Raises:
            ConfigError: always.
        """
        raise ConfigError(self._source, (*self._key, "type"), f"{self._name} {problem}") from None


class _Checked:
    """Calls methods; what they raise is the user's to know where they are the user's own."""

    def __init__(self, own: list, source: Path | str):
        self._own, self._source = own, source
        self._last: tuple[Key, Any] = (), None

    def __call__(self, key: Key, part: Any, method: str, call: Callable) -> Any:
        self._last = key, part
        try:
            return call(getattr(part, method))
        except Exception as error:
            if tuple(key) not in self._own:
                raise
            reason = str(error).strip().splitlines() or [""]
            self.where(method).fail(f"fails ({type(error).__name__}: {reason[0]})")

    def where(self, method: str) -> _Where:
        """A method of whatever was called last."""
        key, part = self._last
        return _Where(self._source, key, f"{type(part).__name__}.{method}")


def _expect_array(where: _Where, value: Any, shape: tuple[int, ...], what: str = "") -> None:
    what = f" for {what}" if what else ""
    found = getattr(value, "shape", () if isinstance(value, (int, float)) else None)
    if found != shape:
        numbers = " x ".join(map(str, shape[:-1])) or "one number" if shape else "one number"
        axis = f", the last axis being individuals ({shape[-1]} here)" if shape else ""
        where.fail(f"must return {numbers}{what}, shape {shape}{axis}; got {described(value)}")
    if not is_real(value):
        where.fail(f"must return real numbers{what}; got {described(value)}")


def _expect_dict(where: _Where, value: Any, kind: str, shape: tuple[int, ...] = ()) -> None:
    if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
        where.fail(f"must return a dict by name, not {described(value)}")
    for name, each in value.items():
        _expect_array(where, each, shape, f"the {kind} {name!r}")


def _expect_like(where: _Where, what: str, value: Any, wanted: Any) -> None:
    def kinds(tree: Any) -> Any:
        return jax.tree.map(lambda x: (getattr(x, "shape", ()), _type_of(x)), tree)

    if not all(map(_is_array, jax.tree.leaves(value))):
        where.fail(f"must return {what} as a pytree of arrays; got {described(value)}")
    if jax.tree.structure(value) != jax.tree.structure(wanted) or kinds(value) != kinds(wanted):
        where.fail(
            f"must return {what} with the same structure, shapes and types as it began with, "
            f"{described(wanted)}; got {described(value)}"
        )


def is_real(value: Any) -> bool:
    """Whether an array, or a number, is of integers, real numbers or truth values."""
    kinds = jnp.bool_, jnp.integer, jnp.floating
    return _is_array(value) and any(jnp.issubdtype(_type_of(value), kind) for kind in kinds)


def _is_array(value: Any) -> bool:
    return _type_of(value) is not None


def _type_of(value: Any) -> Any:
    """Of the numbers of an array; None where it is none."""
    try:
        return jnp.result_type(value)
    except TypeError:
        return None


def described(value: Any) -> str:
    """What somebody's method returned, for messages: kinds and shapes of arrays."""
    if hasattr(value, "shape"):
        return f"{_type_of(value)}{list(value.shape)}"
    if jax.tree.structure(value) == jax.tree.structure(0):
        return repr(value)
    return str(
        jax.tree.map(
            lambda x: f"{_type_of(x)}{list(jnp.shape(x))}" if _is_array(x) else repr(x), value
        )
    )
