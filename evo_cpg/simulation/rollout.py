"""A trial: an animal with its controller in a world, judged by a task.

One trial is ``steps`` control steps of ``1 / control_rate`` seconds (2000 steps of 1/60 s in
Iwadate 2010); in each the controller senses and commands once, and the physics takes
``substeps`` steps with the command held.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.control.controller import Command, Controller, Observation
from evo_cpg.fusion.kernels import fuse
from evo_cpg.physics.kinematics import Kinematics, kinematics
from evo_cpg.physics.state import State, resting_state
from evo_cpg.physics.step import World, step
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.sensors import Sensors, see
from evo_cpg.simulation.task import Moment, Task
from evo_cpg.spatial.linear import lift

# Beyond these rates (rad/s) and speeds (m/s) a trial counts as diverged: no animal of metre size
# moves like that, and the step no longer resolves it.
_WILDEST_RATE = 1e3
_WILDEST_SPEED = 1e2


class Simulation(eqx.Module):
    """Everything that a trial needs but the genes.

    Attributes:
        world: the creature in its surroundings.
        sensors: where its sensors sit.
        controller: its nervous system.
        task: what it is judged by.
        control_rate: control steps per second, 1/s.
        substeps: physics steps per control step.
        steps: control steps in a trial.
    """

    world: World
    sensors: Sensors
    controller: Controller
    task: Task
    control_rate: float
    substeps: int = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    @property
    def step_length(self) -> float:
        """Length of a physics step, s."""
        return 1.0 / (self.control_rate * self.substeps)


class Outcome(NamedTuple):
    """What a trial amounted to.

    Attributes:
        terms: the task's terms by name.
        alive: False for an individual that diverged.
    """

    terms: dict[str, Float[Array, " *n"]]
    alive: Bool[Array, " *n"]


class _Instant(NamedTuple):
    """One control step, for recording."""

    moment: Moment
    command: Command
    torque: Array
    kinematics: Kinematics


def rollout(simulation: Simulation, genes: Float[Array, "g *n"]) -> Outcome:
    """Let every individual live through one trial.

    Args:
        simulation: the trial.
        genes: one genome per individual, on the trailing axes.
    """
    batch, dtype = genes.shape[1:], genes.dtype
    task, steps = simulation.task, simulation.steps

    def advance(carry, index):
        state, nerves, tally, alive = carry
        state, nerves, instant = _control_step(simulation, genes, state, nerves, index)
        tally = task.watch(tally, instant.moment, steps)
        return (state, nerves, tally, alive & _is_sane(state)), None

    carry = (
        resting_state(simulation.world.tree, batch, dtype),
        simulation.controller.initial_state(batch, dtype),
        task.begin(batch, dtype, steps),
        jnp.ones(batch, bool),
    )
    (_, _, tally, alive), _ = jax.lax.scan(advance, carry, jnp.arange(steps))
    return Outcome(task.terms(tally, steps), alive)


def score(task: Task, outcome: Outcome, scales: dict[str, Float[Array, ""]]) -> Float[Array, " *n"]:
    """Fitness of every individual; -inf for those that diverged."""
    fitness = task.fitness(outcome.terms, scales)
    return jnp.where(outcome.alive & jnp.isfinite(fitness), fitness, -jnp.inf)


def record(simulation: Simulation, genes: Float[Array, "g n"], count: int = 1) -> dict[str, Array]:
    """The trials of the first individuals, step by step; see `as_recording`.

    Args:
        simulation: the trial.
        genes: a population, so that the champion can be replayed among as many neighbours as it
            had in training and its numbers come out the same.
        count: individuals to record.
    """
    batch, dtype = genes.shape[1:], genes.dtype
    tree = simulation.world.tree

    def advance(carry, index):
        state, nerves = carry
        state, nerves, instant = _control_step(simulation, genes, state, nerves, index)
        kin = instant.kinematics
        centre = kin.origin + (kin.rotation * jnp.asarray(tree.com, dtype)[None, ..., None]).sum(1)
        frame = {
            "position": centre,
            "rotation": kin.rotation,
            "joint_angle": instant.moment.joint_angle,
            "target_rate": instant.command.target_rate,
            "cpg_output": instant.command.signal,
            "torque": instant.torque,
        }
        frame = {name: values[..., :count] for name, values in frame.items()}
        return (state, nerves), frame

    carry = resting_state(tree, batch, dtype), simulation.controller.initial_state(batch, dtype)
    return jax.lax.scan(advance, carry, jnp.arange(simulation.steps))[1]


def as_recording(
    simulation: Simulation, frames: dict[str, Array], names: list[str], individual: int = 0
) -> Recording:
    """Order the bodies as the creature does and add what belongs to a film.

    Args:
        simulation: the trial.
        frames: from `record`.
        names: of the bodies in the order of ``creature.bodies``.
        individual: which of those recorded.
    """
    tree = simulation.world.tree
    order = [tree.names.index(name) for name in names]
    goal = np.asarray(simulation.task.light, float)
    arrays = {name: np.asarray(values[..., individual]) for name, values in frames.items()}
    position = np.moveaxis(arrays["position"], -1, 1)
    return Recording(
        time=np.arange(simulation.steps) / simulation.control_rate,
        position=position[:, order],
        rotation=np.moveaxis(arrays["rotation"], -1, 1)[:, order],
        joint_angle=arrays["joint_angle"],
        target_rate=arrays["target_rate"],
        cpg_output=arrays["cpg_output"],
        torque=arrays["torque"],
        distance=np.linalg.norm(position[:, 0] - goal, axis=-1),
        goal=goal,
        dof_names=tree.dof_names,
    )


def _control_step(
    simulation: Simulation, genes: Array, state: State, nerves, index: Array
) -> tuple[State, object, _Instant]:
    """Sense, command, and move for one control step."""
    world, batch = simulation.world, genes.shape[1:]
    h = simulation.step_length
    kin = kinematics(world.tree, state)
    light = np.asarray(simulation.task.light)
    strength, cosine, sine = fuse(
        lambda state: see(
            simulation.sensors, kinematics(world.tree, state), lift(light, state.position)
        ),
        state,
        batch_ndim=len(batch),
    )
    # In open water nothing solid presses on the skin.
    pressure = jnp.zeros((len(simulation.sensors.pressure_bodies), *batch), genes.dtype)
    observation = Observation(strength, pressure, cosine, sine, state.q, state.qd)
    nerves, command = simulation.controller.act(genes, nerves, observation)

    def move(carry, _):
        state, energy, _ = carry
        state, effort = step(world, state, command.target_rate, h, command.target_angle)
        return (state, energy + effort.energy.sum(0), effort.torque), None

    energy = jnp.zeros(batch, genes.dtype)
    (moved, energy, torque), _ = jax.lax.scan(
        move, (state, energy, jnp.zeros_like(state.q)), None, length=simulation.substeps
    )
    moment = Moment(index, state.position, state.orientation, strength, state.q, energy)
    return moved, nerves, _Instant(moment, command, torque, kin)


def _is_sane(state: State) -> Bool[Array, " *n"]:
    """False where the motion has blown up, NaN included."""
    speed = jnp.abs(state.velocity[3:]).max(0)
    rate = jnp.abs(state.velocity[:3]).max(0)
    if state.qd.shape[0]:
        rate = jnp.maximum(rate, jnp.abs(state.qd).max(0))
    return (speed < _WILDEST_SPEED) & (rate < _WILDEST_RATE)
