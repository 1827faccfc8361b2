"""Animal as an environment for reinforcement learning, with Brax's interface.

``reset(key)`` and ``step(state, action)`` are pure functions of one animal, for `jax.jit`,
`jax.vmap` and `jax.lax.scan`. The rewards of an episode add up to the task's fitness. Each reward
is the change, in one control step, of the fitness that the trial would have if it stopped there.
Averages in that fitness are over the whole trial.
"""

import copy
import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.api.progress import working
from evo_cpg.control.controller import Command, Observation
from evo_cpg.native.engine import using
from evo_cpg.native.fuse import fuse
from evo_cpg.native.jax_internals import Tracer
from evo_cpg.native.native import Stepper
from evo_cpg.simulation.batched import inputs_of
from evo_cpg.simulation.control_step import (
    AnimalState,
    EpisodeConstants,
    initial_animal,
    lit,
    move,
    push,
    sense,
    transition,
)
from evo_cpg.simulation.judge import begin_tally, finish_tally, is_sane, update_tally
from evo_cpg.simulation.noise import friction_scale_of, raw_keys
from evo_cpg.simulation.simulation import Phenotype, Simulation
from evo_cpg.simulation.situation import light_places


class EnvironmentState(eqx.Module):
    """State of an environment. Later versions may add fields.

    Attributes:
        obs: observation of the animal's senses.
        reward: reward of the last step.
        done: True if the trial is over or the animal diverged.
        metrics: task's terms and gait measures so far.
        inner: rest of the state, not part of the stable interface.
    """

    obs: Float[Array, " o"]
    reward: Float[Array, ""]
    done: Bool[Array, ""]
    metrics: dict[str, Float[Array, ""]]
    inner: "_Inner"

    def __repr__(self) -> str:
        return (
            f"EnvironmentState(obs of shape {self.obs.shape}, reward={_number(self.reward)}, "
            f"done={_number(self.done)}, metrics: {', '.join(self.metrics)})"
        )


class _Inner(eqx.Module):
    animal: AnimalState
    tally: Any
    value: Float[Array, ""]
    number: Int[Array, ""]
    alive: Bool[Array, ""]
    keys: Array | None
    drawn: list[Array]


class Environment:
    """One animal in its world, without its controller. `Experiment.environment` makes it.

    Attributes:
        action_names: degree of freedom that each number of an action moves. Activations have the
            side of the muscle at the end, + or -.
        action_size: count of numbers in an action.
        observation_sizes: names of the observation's parts, in order, with the count of numbers in
            each part (see `evo_cpg.Observation`).
        observation_size: count of numbers in an observation.
        episode_length: control steps of a trial.
        actions: quantity that an action sets.
        tree: bodies and joints of the animal.
    """

    def __init__(
        self, simulation: Simulation, scales: dict[str, Float[Array, ""]], actions: str, trial: int
    ):
        tree = simulation.world.tree
        if actions not in ("rates", "angles", "activations", "torques"):
            allowed = "'rates', 'angles', 'activations' or 'torques'"
            raise ValueError(f"actions must be {allowed}, got {actions!r}")
        if actions == "activations" and tree.muscles is None:
            raise ValueError("actions='activations' needs muscles, but no joint has muscles")
        if actions == "torques" and not any(tree.torque_driven):
            raise ValueError("actions='torques' needs torque motors, but no joint has one")
        if actions == "angles" and not np.asarray(tree.of_commands("servo_stiffness")).any():
            raise ValueError("actions='angles' needs motors with a stiffness, but no motor has one")
        situations = simulation.situations
        own = situations[trial if len(situations) > 1 else 0]
        self._simulation = dataclasses.replace(simulation, situations=(own,))
        self._fixed = dataclasses.replace(self._simulation, draws=None)
        self._inputs, self._kept = None, []
        if simulation.draws is not None:
            self._inputs, self._kept = inputs_of(simulation.draws, self._fixed)
        self._scales, self.actions, self.tree = scales, actions, tree
        self.action_names = tree.dof_names
        if actions == "activations":
            self.action_names = tuple(f"{name}{side}" for side in "+-" for name in tree.dof_names)
        self.action_size = len(self.action_names)
        self.episode_length = simulation.steps
        seen = jax.eval_shape(lambda: self._begin(self._keys(jax.random.key(0)))[2])
        self.observation_sizes = {
            name: x.shape[0] for name, x in seen._asdict().items() if x is not None
        }
        self.observation_size = sum(self.observation_sizes.values())

    def __repr__(self) -> str:
        senses = ", ".join(f"{name} {size}" for name, size in self.observation_sizes.items())
        return (
            f"Environment({self.action_size} actions ({self.actions}), {self.observation_size} "
            f"observations ({senses}), {self.episode_length} steps of "
            f"{1 / self._simulation.control_rate:.4g} s)"
        )

    def reset(self, key: Array) -> EnvironmentState:
        """Return the initial state of the animal.

        Args:
            key: random key of the trial's noise, if there is any.
        """
        key = (
            key if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) else jax.random.wrap_key_data(key)
        )
        keys = self._keys(key)
        with using(self._simulation.engine), working("compiling the start of the environment"):
            drawn, animal, observation = self._begin(keys)
            simulation = self._of(drawn)
            tally = begin_tally(simulation, (), jnp.dtype("float32"))
            terms, value = self._judge(simulation, tally)
        inner = _Inner(animal, tally, value, jnp.int32(0), jnp.asarray(True), keys, drawn)
        seen = jnp.concatenate([x for x in observation if x is not None])
        return EnvironmentState(seen, jnp.float32(0.0), jnp.asarray(False), terms, inner)

    def step(self, state: EnvironmentState, action: Float[Array, " a"]) -> EnvironmentState:
        """Return the state one control step later. A finished animal is not reset.

        Args:
            state: state from `reset` or the previous step.
            action: joint rate (rad/s), angle (rad) or torque (N m) of every degree of freedom, or
                activation (0 to 1) of the muscles that pull to positive angles, then of the others.

        Raises:
            ValueError: the action has the wrong shape.
        """
        action = jnp.asarray(action, jnp.float32)
        if action.shape != (self.action_size,):
            raise ValueError(
                f"action must have the shape ({self.action_size},), got {action.shape}"
            )
        inner = state.inner

        def whole(
            animal: AnimalState,
            tally: Any,
            number: Array,
            keys: Array | None,
            drawn: list[Array],
            action: Array,
        ):
            simulation = self._of(drawn)
            still = jnp.zeros_like(animal.state.q)
            if self.actions == "activations":
                both = jnp.clip(action, 0.0, 1.0).reshape(2, -1)
                command = Command(still, both[0] - both[1], activation=both)
            elif self.actions == "angles":
                command = Command(still, still, action)
            elif self.actions == "torques":
                command = Command(still, action, torque=action)
            else:
                command = Command(action, still)
            constants = _constants(simulation, keys, animal)
            seen, memories = sense(simulation, constants, animal, number)
            animal = animal._replace(memories=memories)
            animal, effects = move(simulation, constants, animal, seen, command, number)
            happened = transition(simulation, constants, effects, number)
            tally = update_tally(simulation, tally, happened)
            sane = is_sane(animal.state)
            animal, observation = _pushed(simulation, animal, keys, number + 1)
            return animal, tally, sane, observation, self._judge(simulation, tally)

        with using(self._simulation.engine), working("compiling a step of the environment"):
            given = inner.animal, inner.tally, inner.number, inner.keys, inner.drawn, action
            animal, tally, sane, observation, (terms, value) = fuse(
                whole, *given, batch_ndim=0, name="a step of the environment"
            )
        alive, number = inner.alive & sane, inner.number + 1
        reward = jnp.where(alive, value - inner.value, 0.0)
        later = _Inner(animal, tally, value, number, alive, inner.keys, inner.drawn)
        done = ~alive | (number >= self.episode_length)
        seen = jnp.concatenate([x for x in observation if x is not None])
        return EnvironmentState(seen, reward, done, terms, later)

    def session(self) -> "Session":
        """Return the animal for a loop in Python, which steps one animal at a time.

        Raises:
            Unsupported: a step does not become native code, for example with ``engine: jax``.
        """
        return Session(self)

    def _keys(self, key: Array) -> Array | None:
        return None if self._simulation.silent else raw_keys(key)

    def _begin(self, keys: Array | None) -> tuple[list[Array], AnimalState, Observation]:
        """Return the numbers of the course, the animal at the start, and its observation."""
        drawn = []
        if self._simulation.draws is not None:
            course = self._simulation.course_keys(keys)
            assert course is not None
            found = self._simulation.draws.traced(course)
            drawn = [jnp.asarray(found[i], jnp.float32) for i in self._kept]
        simulation = self._of(drawn)
        animal = initial_animal(simulation, keys, None, (), jnp.dtype("float32"))
        return drawn, *_pushed(simulation, animal._replace(nerves=()), keys, 0)

    def _of(self, drawn: list[Array]) -> Simulation:
        """Return the simulation of a course."""
        return self._fixed if self._inputs is None else self._inputs.put(self._fixed, drawn)

    def _judge(self, simulation: Simulation, tally: Any) -> tuple[dict[str, Array], Array]:
        """Return the terms so far and their fitness. A fitness that is not finite becomes 0."""
        terms = finish_tally(simulation, tally)
        value = simulation.task.fitness(terms, self._scales)
        return terms, jnp.where(jnp.isfinite(value), value, 0.0)


def _constants(simulation: Simulation, keys: Array | None, animal: AnimalState) -> EpisodeConstants:
    light = light_places(simulation.lights, None, jnp.dtype("float32"))
    noise = simulation.noise_keys(keys)
    scale = friction_scale_of(simulation.noise, noise)
    return lit(simulation, EpisodeConstants(Phenotype(()), noise, None, light, scale), animal)


def _pushed(
    simulation: Simulation, animal: AnimalState, keys: Array | None, number: Array | int
) -> tuple[AnimalState, Observation]:
    """Return the animal after the random push of a control step, and its observation."""
    constants = _constants(simulation, keys, animal)
    animal = push(simulation, constants, animal, jnp.asarray(number))
    return animal, sense(simulation, constants, animal, number)[0]


class Session:
    """Animal for loops in Python, with gymnasium's interface. `Environment.session` makes it.

    The numbers are those of `Environment.reset` and `Environment.step`. A step takes a fifth of the
    time of a jitted `Environment.step`, because neither JAX nor XLA takes part in it.
    """

    def __init__(self, environment: Environment):
        self._reset, self._shape = jax.jit(environment.reset), (environment.action_size,)
        state, still = self._reset(jax.random.key(0)), jnp.zeros(self._shape, jnp.float32)
        with using(environment._simulation.engine):
            self._stepper = Stepper(environment.step, state, still, "a step of the environment")
        count = len(self._stepper.leaves)
        self._places: EnvironmentState = self._stepper.structure.unflatten(range(count))

    def reset(self, seed: int = 0) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the first observation, and no further information.

        Args:
            seed: seed of the trial's noise, if there is any.
        """
        start = jax.tree.leaves(self._reset(jax.random.key(seed)))
        for own, value in zip(self._stepper.leaves, start, strict=True):
            own[...] = value
        return self._stepper.leaves[self._places.obs].copy(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Compute a control step with an action as in `Environment.step`.

        Returns:
            The observation, the reward, whether the animal diverged, whether the trial is over, and
            no further information.

        Raises:
            ValueError: the action has the wrong shape.
        """
        if np.shape(action) != self._shape:
            raise ValueError(f"action must have the shape {self._shape}, got {np.shape(action)}")
        self._stepper(action)
        here, value = self._places, self._stepper.leaves
        diverged = not value[here.inner.alive]
        ends = diverged, not diverged and bool(value[here.done])
        return value[here.obs].copy(), float(value[here.reward]), *ends, {}

    def twin(self) -> "Session":
        """Return a session with the same machine code and a state of its own."""
        found = copy.copy(self)
        found._stepper = copy.copy(self._stepper)
        found._stepper.separate()
        return found

    @property
    def metrics(self) -> dict[str, float]:
        """Task's terms and gait measures so far."""
        return {name: float(self._stepper.leaves[k]) for name, k in self._places.metrics.items()}


def _number(value: Array) -> str:
    """Return a number as text, or the shape of a traced or stacked array."""
    if isinstance(value, Tracer) or jnp.ndim(value):
        return f"{value.dtype}{list(jnp.shape(value))}"
    item = np.asarray(value).item()
    return str(item) if isinstance(item, bool) else f"{item:.4g}"
