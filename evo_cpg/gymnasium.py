"""Animals as environments of Gymnasium, one at a time or many at once.

``gymnasium.make("evo_cpg.gymnasium:evo_cpg/swimmer-v0")`` makes an `AnimalEnv`, and ``make_vec`` an
`AnimalVectorEnv`. Both wrap `evo_cpg.Environment`: the rewards of an episode add up to the task's
fitness. The end of the trial truncates an episode, and divergence terminates it.

Each number of an action is from -1 to 1, over the range of its command. Readings outside the bounds
of the observation space are clipped to them.
"""

import copy
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.api.environment import Environment, Session
from evo_cpg.api.experiment import Experiment, load
from evo_cpg.io.shipped import shipped_names
from evo_cpg.native.engine import using
from evo_cpg.native.native import Stepper
from evo_cpg.system import command_for

try:
    import gymnasium as gym
    from gymnasium.spaces import Box
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError as error:
    hint = f"evo_cpg.gymnasium needs Gymnasium. Install it with `{command_for('gymnasium')}`"
    raise ModuleNotFoundError(hint, name=error.name) from None

# Bounds of readings without a limit of their own: angles (rad or m) of axes without limits, rates
# (rad/s or m/s), and readings of further sensors.
_ANGLE, _RATE, _READING = 100.0, 100.0, 10.0
# Angles may exceed the limits of a joint a little, because limits are springs.
_BEYOND = 0.5
_BOUNDS = {
    "light": (0.0, 1.0),
    "pressure": (0.0, 1.0),
    "vertical_cosine": (-1.0, 1.0),
    "vertical_sine": (0.0, 1.0),
    "joint_rate": (-_RATE, _RATE),
    "depth": (0.0, 1.0),
    "custom": (-_READING, _READING),
    "load": (0.0, _READING),
    "bearing": (-1.0, 1.0),
}
# Rate of a motor at full action if the configuration's controller has no largest rate, rad/s.
_FULL_RATE = 5.0
_SEEDS = 2**31


class _Spaces:
    """Spaces of an animal, and its commands from actions.

    Attributes:
        environment: the animal without its controller.
        observations: observation space.
        actions: action space, from -1 to 1.
    """

    def __init__(self, experiment: Experiment, actions: str | None, trial: int):
        self.environment = experiment.environment(actions or natural_actions(experiment), trial)
        lower, upper = command_range(self.environment, experiment)
        self._driven = np.flatnonzero(upper > lower)
        self._middle, self._half = (x[self._driven] / 2 for x in (upper + lower, upper - lower))
        self.actions = Box(-1.0, 1.0, (len(self._driven),))
        self.observations = Box(*reading_bounds(self.environment))

    def commands(self, action: Float[np.ndarray, "*n a"]) -> Float[np.ndarray, "*n c"]:
        """Return the commands of actions, 0 for axes that nothing drives."""
        found = np.zeros((*action.shape[:-1], self.environment.action_size), np.float32)
        found[..., self._driven] = self._middle + self._half * np.clip(action, -1.0, 1.0)
        return found

    def seen(self, readings: Float[np.ndarray, "*n o"]) -> Float[np.ndarray, "*n o"]:
        """Return readings within the bounds of the observation space, as a new array."""
        return np.clip(readings, self.observations.low, self.observations.high)


def natural_actions(experiment: Experiment) -> str:
    """Return what an animal's actions set: muscles, torque motors, or the rates of its motors."""
    tree = experiment.parts.simulation.world.tree
    if tree.muscles is not None:
        return "activations"
    return "torques" if any(tree.torque_driven) else "rates"


def command_range(
    environment: Environment, experiment: Experiment
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Return the lowest and the highest command of each axis or muscle, equal if none follows it.

    Rates are within the controller's ``max_rate``. Torques are within the motor's limit or, without
    a limit, within its ``gear``. Angles are within the limits of the joint, or half a turn.
    """
    tree = environment.tree
    if environment.actions == "activations":
        full = np.tile(np.asarray(tree.muscles and tree.muscles.driven, float), 2)
        return 0 * full, full
    if environment.actions == "torques":
        limit = np.asarray(tree.of_commands("torque_limit"))
        full = np.where(np.isfinite(limit), limit, np.abs(np.asarray(tree.gears)))
        full = np.where(tree.torque_driven, full, 0.0)
        return -full, full
    if environment.actions == "angles":
        follows = np.asarray(tree.of_commands("servo_stiffness")) > 0
        limits = (np.asarray(tree.of_commands(name)) for name in ("lower", "upper"))
        low, high = (np.where(follows, np.clip(limit, -np.pi, np.pi), 0.0) for limit in limits)
        return low, high
    most = getattr(experiment.config.controller, "max_rate", _FULL_RATE)
    full = np.where(np.asarray(tree.of_commands("servo_gain")) > 0, most, 0.0)
    return -full, full


def reading_bounds(
    environment: Environment,
) -> tuple[Float[np.ndarray, " o"], Float[np.ndarray, " o"]]:
    """Return the least and the largest reading of every sense."""
    bounds = []
    for name, count in environment.observation_sizes.items():
        if name == "joint_angle":
            limits = np.stack([environment.tree.lower, environment.tree.upper])
            ends = np.array([[-1.0], [1.0]])
            found = np.where(np.abs(limits) < _ANGLE, limits + _BEYOND * ends, _ANGLE * ends)
            bounds.append(found)
        else:
            bounds.append(np.repeat([_BOUNDS[name]], count, 0).T)
    low, high = np.concatenate(bounds, 1).astype(np.float32)
    return low, high


def _experiment(config: str | Path | Experiment, overrides: Mapping[str, Any] | None) -> Experiment:
    if isinstance(config, Experiment):
        return config
    return load(config, dict(overrides or {}))


# Libraries make several animals of one experiment, and tracing each would take seconds.
@functools.lru_cache(maxsize=8)
def _made(experiment: Experiment, actions: str | None, trial: int) -> tuple[_Spaces, Session]:
    spaces = _Spaces(experiment, actions, trial)
    return spaces, spaces.environment.session()


class AnimalEnv(gym.Env[np.ndarray, np.ndarray]):
    """One animal. Its steps are native code, without JAX, so that a loop in Python is fast.

    Animals of the same `evo_cpg.Experiment` share this code, so that only the first is compiled.

    Args:
        config: file or name of a configuration, or an experiment.
        overrides: changes of the configuration, by key.
        actions: quantity that actions set, see `evo_cpg.Experiment.environment`. By default that of
            the animal's muscles or motors.
        trial: number of the trial, from 0, which sets the start and the place of the light.

    Raises:
        ConfigError: the configuration is wrong.
        Unsupported: a step does not become native code, for example with ``engine: jax``.
        ValueError: there is no such trial, or the animal cannot follow such actions.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - as in the base class

    def __init__(
        self,
        config: str | Path | Experiment,
        overrides: Mapping[str, Any] | None = None,
        actions: str | None = None,
        trial: int = 0,
    ):
        self._spaces, session = _made(_experiment(config, overrides), actions, trial)
        spaces = self._spaces.actions, self._spaces.observations
        self.action_space, self.observation_space = copy.deepcopy(spaces)
        self._session = session.twin()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the first observation. The seed determines the noise of all following trials."""
        super().reset(seed=seed, options=options)
        readings, _ = self._session.reset(int(self.np_random.integers(_SEEDS)))
        return self._spaces.seen(readings), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Compute a control step. At the end of an episode the information has its terms."""
        readings, reward, diverged, over, _ = self._session.step(self._spaces.commands(action))
        terms = self._session.metrics if diverged or over else {}
        return self._spaces.seen(readings), reward, diverged, over, terms


class AnimalVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many animals in one program. An animal whose episode has ended restarts in the next step.

    Args:
        config: as of `AnimalEnv`, like all arguments but the next one.
        num_envs: number of animals.
        overrides: see `AnimalEnv`.
        actions: see `AnimalEnv`.
        trial: see `AnimalEnv`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as in the base class
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        config: str | Path | Experiment,
        num_envs: int = 1,
        overrides: Mapping[str, Any] | None = None,
        actions: str | None = None,
        trial: int = 0,
    ):
        experiment = _experiment(config, overrides)
        self._spaces, self.num_envs = _Spaces(experiment, actions, trial), num_envs
        environment = self._spaces.environment
        self.single_action_space = self._spaces.actions
        self.single_observation_space = self._spaces.observations
        self.action_space = batch_space(self._spaces.actions, num_envs)
        self.observation_space = batch_space(self._spaces.observations, num_envs)
        self._reset = jax.jit(
            jax.vmap(lambda seed: environment.reset(jax.random.key(seed)), out_axes=-1)
        )
        state = self._reset(jnp.zeros(num_envs, jnp.uint32))
        still = jnp.zeros((environment.action_size, num_envs), jnp.float32)
        step = environment.step, state, still, "a step of the environment", num_envs
        with using(experiment.parts.simulation.engine):
            self._stepper = Stepper(*step)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the first observations, ``(num_envs, o)``."""
        super().reset(seed=seed, options=options)
        self._restart(np.ones(self.num_envs, bool))
        return self._spaces.seen(self._state.obs.T), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Compute a control step of all animals, or the restart of those that have ended.

        A restart ignores the action, and its reward is 0. If any episode has ended, the information
        has the terms of all animals. Their names with an underscore in front say whose have ended.
        """
        ended = self._state.done.copy()
        self._stepper(self._spaces.commands(np.asarray(actions)).T)
        if ended.any():
            self._restart(ended)
        state = self._state
        done, alive = state.done.copy(), state.inner.alive.copy()
        info: dict[str, Any] = {}
        if done.any():
            for name, values in state.metrics.items():
                info |= {name: values.copy(), f"_{name}": done}
        return self._spaces.seen(state.obs.T), state.reward.copy(), ~alive, done & alive, info

    @property
    def _state(self) -> Any:
        """Present state, whose arrays have the animals on the last axis."""
        leaves = [leaf[..., : self.num_envs] for leaf in self._stepper.leaves]
        return self._stepper.structure.unflatten(leaves)

    def _restart(self, which: Bool[np.ndarray, " n"]) -> None:
        """Put some animals at their start, with new noise."""
        seeds = self.np_random.integers(_SEEDS, size=self.num_envs).astype(np.uint32)
        fresh, chosen = jax.tree.leaves(self._reset(seeds)), np.flatnonzero(which)
        for own, value in zip(self._stepper.leaves, fresh, strict=True):
            own[..., chosen] = np.asarray(value)[..., chosen]


# Bodies of these configurations evolve, so that they have no animal before a search.
_WITHOUT_ANIMAL = "evolving_", "virtual_", "follow_"


def _register() -> None:
    """Register every shipped configuration with an animal, and the swimmer by a short name."""
    names = {name: name for name in shipped_names() if not name.startswith(_WITHOUT_ANIMAL)}
    for name, config in (names | {"swimmer": "iwadate2010_swimmer"}).items():
        gym.register(
            f"evo_cpg/{name}-v0",
            entry_point=f"{__name__}:{AnimalEnv.__name__}",
            vector_entry_point=f"{__name__}:{AnimalVectorEnv.__name__}",
            kwargs={"config": config},
        )


_register()
