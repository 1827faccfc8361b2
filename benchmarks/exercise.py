"""Commands to a population of an animal, the same for us and for our peers.

An exercise has no brain: the commands of the motors are given. They are constant over a physics
step of the config, even if the step is divided.
"""

import abc
import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from benchmarks.plan import imported_experiment
from evo_cpg.control.postures import PostureController
from evo_cpg.io.models.mjcf_import import Imported
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.training.experiment import ExperimentParts

# Travelling wave of the target rates about z: amplitude (rad/s), frequency (Hz), and lag from joint
# to joint (degrees).
WAVE_RATE, WAVE_FREQUENCY, WAVE_LAG = 2.0, 1.0, 36.0
# Largest relative difference between the amplitudes of individuals.
_WAVE_SPREAD = 0.2
# The fractional parts of the golden ratio's multiples fill the range from 0 to 1 evenly for any
# count. So a larger population begins with the individuals of a smaller one.
_GOLDEN = 0.6180339887498949
_SEED = 0
# Random torques: time for which each is held (s), as in gymnasium's half_cheetah and ant, and their
# number. After the last one the first one follows.
_HELD, _TORQUES = 0.05, 32


@dataclasses.dataclass(frozen=True)
class Exercise(abc.ABC):
    """Commands for all individuals at all times.

    Attributes:
        experiment: experiment with the animal and its world.
    """

    experiment: ExperimentParts

    @abc.abstractmethod
    def lanes(self, count: int) -> Float[np.ndarray, "k n"]:
        """Return the inputs in which individuals differ, float32.

        A larger population begins with the individuals of a smaller one.
        """

    @abc.abstractmethod
    def prepare(self, lanes: Float[Array, "k n"]) -> Array:
        """Return the data that are computed once, before the first step."""

    @abc.abstractmethod
    def command(self, commands: Array, index: Int[Array, ""]) -> MotorCommand:
        """Return the commands to the motors in a physics step.

        Args:
            commands: data from `prepare`.
            index: number of the physics step.
        """

    @abc.abstractmethod
    def signals(
        self, lanes: Float[np.ndarray, "k n"], index: Int[np.ndarray, " steps"]
    ) -> Float[np.ndarray, "n steps d"]:
        """Return commands for MuJoCo.

        Motors with springs get angles, rad. Torque motors get torques, N m. Others get rates,
        rad/s.

        Args:
            lanes: inputs of the individuals, from `lanes`.
            index: numbers of the physics steps.
        """


class Wave(Exercise):
    """A wave of target rates from head to tail, whose amplitude differs between individuals."""

    def lanes(self, count: int) -> Float[np.ndarray, "k n"]:
        """Return each individual's factor on the amplitude of the wave."""
        spread = (np.arange(count) * _GOLDEN % 1 - 0.5) * _WAVE_SPREAD
        return (1 + spread)[None].astype(np.float32)

    def prepare(self, lanes: Float[Array, "k n"]) -> Array:
        """Return the factors unchanged."""
        return lanes

    def command(self, commands: Array, index: Int[Array, ""]) -> MotorCommand:
        """Return target rates, the wave of one period times the factors, and no angles."""
        table = jnp.asarray(self.period(), commands.dtype)
        return MotorCommand(table[index % len(table)][:, None] * commands)

    def signals(
        self, lanes: Float[np.ndarray, "k n"], index: Int[np.ndarray, " steps"]
    ) -> Float[np.ndarray, "n steps d"]:
        """Return the target rates of `command` for MuJoCo."""
        table = self.period()
        return lanes[0].astype(float)[:, None, None] * table[index % len(table)][None]

    def period(self) -> Float[np.ndarray, "steps d"]:
        """Return target rates of all joint axes over one period, rad/s, zero unless about z."""
        simulation = self.experiment.simulation
        tree, h = simulation.world.tree, simulation.step_length
        depth = [0]
        for parent in tree.parents[1:]:
            depth.append(depth[parent] + 1)
        joint = np.array([depth[body] for body in tree.dof_bodies]) - 1
        bends = np.array([name.endswith(".z") for name in tree.dof_names])
        index = np.arange(round(1 / (WAVE_FREQUENCY * h)))
        phase = 2 * np.pi * WAVE_FREQUENCY * h * index[:, None]
        return WAVE_RATE * bends * np.cos(phase - np.deg2rad(WAVE_LAG) * joint)


class Postures(Exercise):
    """Random postures in turn, as the genes of a posture controller encode them."""

    @property
    def controller(self) -> PostureController:
        """Return the config's controller."""
        controller = self.experiment.simulation.controller
        assert isinstance(controller, PostureController)
        return controller

    def lanes(self, count: int) -> Float[np.ndarray, "k n"]:
        """Return random bits, which are the genes of each individual's postures."""
        generator = np.random.default_rng(_SEED)
        bits = generator.integers(0, 2, (count, self.controller.gene_count))
        return bits.T.astype(np.float32)

    def prepare(self, lanes: Float[Array, "k n"]) -> Array:
        """Return angles ``(postures, d, n)``, rad."""
        return self.controller.decode(lanes)

    def command(self, commands: Array, index: Int[Array, ""]) -> MotorCommand:
        """Return zero rates, and the angles of the present posture."""
        posture = self.controller.posture(index // self.experiment.simulation.substeps)
        return MotorCommand(jnp.zeros_like(commands[0]), commands[posture])

    def signals(
        self, lanes: Float[np.ndarray, "k n"], index: Int[np.ndarray, " steps"]
    ) -> Float[np.ndarray, "n steps d"]:
        """Return the target angles of `command` for MuJoCo."""
        angles = np.asarray(self.controller.decode(jnp.asarray(lanes)), float)
        return np.moveaxis(angles, -1, 0)[:, self.numbers(index)]

    def numbers(self, index: Int[np.ndarray, " steps"]) -> Int[np.ndarray, " steps"]:
        """Return the number of the posture at each physics step."""
        substeps = self.experiment.simulation.substeps
        return np.asarray(self.controller.posture(jnp.asarray(index // substeps)))


@dataclasses.dataclass(frozen=True)
class Torques(Exercise):
    """Random torques of all motors within their limits, each held for `_HELD`.

    Attributes:
        imported: import of the file of the animal.
        path: the file, which MuJoCo simulates.
    """

    imported: Imported
    path: Path

    @classmethod
    def of(cls, path: Path) -> "Torques":
        """Return the exercise of an imported animal."""
        experiment, imported = imported_experiment(path)
        return cls(experiment, imported, path)

    def lanes(self, count: int) -> Float[np.ndarray, "k n"]:
        """Return all torques of each individual as fractions of the limits, -1 to 1."""
        generator = np.random.default_rng(_SEED)
        size = count, _TORQUES * len(self._limits)
        return generator.uniform(-1, 1, size).T.astype(np.float32)

    def prepare(self, lanes: Float[Array, "k n"]) -> Array:
        """Return torques ``(torques, d, n)``, N m."""
        limits = jnp.asarray(self._limits, lanes.dtype)
        return lanes.reshape(_TORQUES, len(limits), -1) * limits[None, :, None]

    def command(self, commands: Array, index: Int[Array, ""]) -> MotorCommand:
        """Return the present torques."""
        torque = commands[index // self._held % _TORQUES]
        return MotorCommand(jnp.zeros_like(torque), torque=torque)

    def signals(
        self, lanes: Float[np.ndarray, "k n"], index: Int[np.ndarray, " steps"]
    ) -> Float[np.ndarray, "n steps d"]:
        """Return the torques of `command` for MuJoCo."""
        torques = lanes.astype(float).T.reshape(lanes.shape[1], _TORQUES, -1) * self._limits
        return torques[:, index // self._held % _TORQUES]

    @property
    def _limits(self) -> Float[np.ndarray, " d"]:
        """Torque limits, N m, 0 for an axis without a motor."""
        return np.asarray(self.experiment.simulation.world.tree.torque_limit, float)

    @property
    def _held(self) -> int:
        """Number of physics steps for which a torque is held."""
        return round(_HELD / self.experiment.simulation.step_length)
