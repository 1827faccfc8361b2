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
from evo_cpg.evolution.islands import Islands
from evo_cpg.evolution.map_elites import Mapped
from evo_cpg.evolution.strategy import Evaluation, Strategy
from evo_cpg.fusion.engine import Engine, using
from evo_cpg.simulation.control_step import (
    Effects,
    begin_life,
    no_forces,
    sense,
    snapshot_of,
    transition,
)
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import term_names
from evo_cpg.training.experiment import descriptors

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
        _expect_array(checked.where("random_genes"), numbers, genes.shape)
        checked(("controller",), simulation.controller, "decode", lambda method: method(genes))
        life, animal = begin_life(simulation, genes, None, None)
        forces = no_forces(simulation, animal.state)
        for i, sensor in enumerate(simulation.extra_sensors):
            snapshot = snapshot_of(simulation, life, animal.state)
            key = "creature", "sensors", i
            read = checked(key, sensor, "sense", lambda method, s=snapshot: method(s, forces))
            _expect_array(checked.where("sense"), read, (sensor.count, _INDIVIDUALS))
        observation = sense(simulation, life, animal)
        given = life.decoded, animal.nerves, observation
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
        _check_task(checked, simulation, transition(simulation, life, effects, jnp.int32(0)))

    shape = simulation.controller.gene_count, _INDIVIDUALS
    with using(Engine("jax")):
        jax.eval_shape(go, jax.ShapeDtypeStruct(shape, jnp.float32))


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
    while isinstance(strategy, Islands | Mapped):
        strategy = strategy.strategy
    shape = simulation.controller.gene_count, strategy.population
    measures = simulation.measures.names if simulation.measures else ()
    names = (*term_names(simulation.task), *measures)
    checked = _Checked([key], source)

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
            if kept is not None:
                _expect_like(where, "the state", found[1], kept)
            kept = found[1]

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
    if not isinstance(terms, dict) or not all(isinstance(name, str) for name in terms):
        checked.where("terms").fail(f"must return a dict by name, not {_described(terms)}")
    for name, value in terms.items():
        _expect_array(checked.where("terms"), value, batch, f"the term {name!r}")
    scales = checked(key, task, "scales", lambda scales: scales(terms))
    for name, value in scales.items():
        _expect_array(checked.where("scales"), value, (), f"the scale {name!r}")
    fitness = checked(key, task, "fitness", lambda fitness: fitness(terms, scales))
    _expect_array(checked.where("fitness"), fitness, batch)


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
    found = getattr(value, "shape", () if isinstance(value, (int, float)) else None)
    if found != shape:
        numbers = " x ".join(map(str, shape[:-1])) or "one number" if shape else "one number"
        axis = f", the last axis being individuals ({shape[-1]} here)" if shape else ""
        what = f" for {what}" if what else ""
        where.fail(f"must return {numbers}{what}, shape {shape}{axis}; got {_described(value)}")


def _expect_like(where: _Where, what: str, value: Any, wanted: Any) -> None:
    def kinds(tree: Any) -> Any:
        return jax.tree.map(lambda x: (jnp.shape(x), jnp.result_type(x)), tree)

    if jax.tree.structure(value) != jax.tree.structure(wanted) or kinds(value) != kinds(wanted):
        where.fail(
            f"must return {what} with the same structure, shapes and types as it began with, "
            f"{_described(wanted)}; got {_described(value)}"
        )


def _described(value: Any) -> str:
    if hasattr(value, "shape"):
        return f"{jnp.result_type(value)}{list(value.shape)}"
    if jax.tree.structure(value) == jax.tree.structure(0):
        return repr(value)
    return str(jax.tree.map(lambda x: f"{jnp.result_type(x)}{list(jnp.shape(x))}", value))
