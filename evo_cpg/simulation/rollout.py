"""A trial: an animal with its controller in a world, judged by a task.

One trial is ``steps`` control steps of ``1 / control_rate`` seconds (2000 steps of 1/60 s in
Iwadate 2010); in each the controller senses and commands once, and the physics takes
``substeps`` steps with the command held.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, UInt32

from evo_cpg.control.controller import Command, Controller, Observation
from evo_cpg.creature.tree import Tree
from evo_cpg.fusion.kernels import fuse
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.state import State
from evo_cpg.physics.step import Effort, step
from evo_cpg.physics.world import World
from evo_cpg.simulation.backward import Backward
from evo_cpg.simulation.noise import Noise, disturb_motion, disturb_start
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.sensors import Sensors, fathom, feel, see
from evo_cpg.simulation.situation import Place, Situation, light_places, starting_state
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
        noise: how much is left to chance.
        situations: what each trial of an individual begins with, or one for all of its trials.
    """

    world: World
    sensors: Sensors
    controller: Controller
    task: Task
    control_rate: float
    substeps: int = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    noise: Noise = Noise()
    situations: tuple[Situation, ...] = (Situation(),)

    @property
    def step_length(self) -> float:
        """Length of a physics step, s."""
        return 1.0 / (self.control_rate * self.substeps)

    @property
    def lights(self) -> tuple[Place | None, ...]:
        """Where the light is in each situation, m; None for tasks in the dark."""
        return tuple(situation.light or self.task.light for situation in self.situations)


class Outcome(NamedTuple):
    """What a trial amounted to.

    Attributes:
        terms: the task's terms by name.
        alive: False for an individual that diverged.
    """

    terms: dict[str, Float[Array, " *n"]]
    alive: Bool[Array, " *n"]


class _Animal(NamedTuple):
    """What goes on from one control step to the next.

    Attributes:
        state: of the body.
        nerves: of the controller.
        pressure: what the skin felt last.
    """

    state: State
    nerves: Any
    pressure: Float[Array, "s *n"]


class _Instant(NamedTuple):
    """One control step, for recording."""

    moment: Moment
    command: Command
    torque: Array
    state: State


def rollout(
    simulation: Simulation,
    genes: Float[Array, "g *n"],
    keys: UInt32[Array, "w *n"] | None = None,
    trial: Int[Array, " *n"] | None = None,
    backward: Backward | None = None,
) -> Outcome:
    """Let every individual live through one trial.

    Args:
        simulation: the trial.
        genes: one genome per individual, on the trailing axes.
        keys: a raw random key for each trial's noise; None lets all live without noise.
        trial: number of the situation in each lane; None puts all into the first.
        backward: how to differentiate it, where it will be.
    """
    return _live(simulation, genes, slice(0), keys, trial, backward)[0]


def score(task: Task, outcome: Outcome, scales: dict[str, Float[Array, ""]]) -> Float[Array, " *n"]:
    """Fitness of every individual; -inf for those that diverged."""
    fitness = task.fitness(outcome.terms, scales)
    return jnp.where(outcome.alive & jnp.isfinite(fitness), fitness, -jnp.inf)


def record(
    simulation: Simulation,
    genes: Float[Array, "g n"],
    count: int = 1,
    keys: UInt32[Array, "w n"] | None = None,
    trial: Int[Array, " n"] | None = None,
) -> dict[str, Array]:
    """The trials of the first individuals, step by step; see `as_recording`.

    Args:
        simulation: the trial.
        genes: a population.
        count: individuals to record.
        keys: see `rollout`.
        trial: see `rollout`.
    """
    return _live(simulation, genes, slice(count), keys, trial)[1]


def rollout_and_record(
    simulation: Simulation,
    genes: Float[Array, "g n"],
    individual: int,
    keys: UInt32[Array, "w n"] | None = None,
    trial: Int[Array, " n"] | None = None,
) -> tuple[Outcome, dict[str, Array]]:
    """`rollout` of all and `record` of one individual, in one program: it compiles but once.

    Args:
        simulation: the trial.
        genes: a population, so that the champion can be replayed among as many neighbours as it
            had in training and its numbers come out the same.
        individual: which is recorded.
        keys: see `rollout`.
        trial: see `rollout`.
    """
    return _live(simulation, genes, slice(individual, individual + 1), keys, trial)


def motion(
    simulation: Simulation,
    genes: Float[Array, "g *n"],
    begin: Callable[[State], State] = lambda state: state,
) -> State:
    """The states of a trial without noise: at its start and after every control step, stacked.

    Args:
        simulation: the trial; the first of its situations.
        genes: one genome per individual, on the trailing axes.
        begin: makes another state of the one that the trial starts with.
    """
    batch, dtype = genes.shape[1:], genes.dtype
    light = light_places(simulation.lights, None, dtype)
    decoded = simulation.controller.decode(genes)
    animal = _start(simulation, batch, dtype, None, None)
    animal = animal._replace(state=begin(animal.state))

    def advance(animal: _Animal, index: Array) -> tuple[_Animal, State]:
        animal, _ = _control_step(simulation, decoded, None, light, animal, index)
        return animal, animal.state

    _, states = jax.lax.scan(advance, animal, jnp.arange(simulation.steps))
    return jax.tree.map(
        lambda first, rest: jnp.concatenate([first[None], rest]), animal.state, states
    )


def _live(
    simulation: Simulation,
    genes: Array,
    recorded: slice,
    keys: Array | None,
    trial: Array | None,
    backward: Backward | None = None,
) -> tuple[Outcome, dict[str, Array]]:
    """What the trials of all amounted to, and some of them step by step."""
    batch, dtype = genes.shape[1:], genes.dtype
    task, steps, tree = simulation.task, simulation.steps, simulation.world.tree
    light = light_places(simulation.lights, trial, dtype)
    decoded = simulation.controller.decode(genes)

    def advance(carry, index):
        animal, tally, alive = carry
        if backward is not None:
            animal = _Animal(*backward.forget(animal.state, animal.nerves), animal.pressure)
        animal, instant = _control_step(simulation, decoded, keys, light, animal, index)
        tally = task.watch(tally, instant.moment, steps)
        frame = {}
        if recorded.stop:
            frame = {name: values[..., recorded] for name, values in _frame(tree, instant).items()}
        return (animal, tally, alive & _is_sane(animal.state)), frame

    carry = (
        _start(simulation, batch, dtype, keys, trial),
        task.begin(batch, dtype, steps),
        jnp.ones(batch, bool),
    )
    if backward is None:
        (_, tally, alive), frames = jax.lax.scan(advance, carry, jnp.arange(steps))
    else:
        (_, tally, alive), frames = backward.scan(advance, carry, steps), {}
    return Outcome(task.terms(tally, steps), alive), frames


def _frame(tree: Tree, instant: _Instant) -> dict[str, Array]:
    """What is recorded of one control step."""
    kin = kinematics(tree, instant.state)
    com = jnp.asarray(tree.com, kin.origin.dtype)[None, ..., None]
    return {
        "position": kin.origin + (kin.rotation * com).sum(1),
        "rotation": kin.rotation,
        "joint_angle": instant.moment.joint_angle,
        "target_rate": instant.command.target_rate,
        "cpg_output": instant.command.signal,
        "torque": instant.torque,
    }


def as_recording(
    simulation: Simulation,
    frames: dict[str, Array],
    names: list[str],
    individual: int = 0,
    trial: int = 0,
) -> Recording:
    """Order the bodies as the creature does and add what belongs to a film.

    Args:
        simulation: the trial.
        frames: from `record`.
        names: of the bodies in the order of ``creature.bodies``.
        individual: which of those recorded.
        trial: number of the situation that it lived in.
    """
    tree = simulation.world.tree
    order = [tree.names.index(name) for name in names]
    light = simulation.lights[trial if len(simulation.situations) > 1 else 0]
    arrays = {name: np.asarray(values[..., individual]) for name, values in frames.items()}
    position = np.moveaxis(arrays["position"], -1, 1)
    root = position[:, 0]
    way = root - light if light else (root - root[0])[:, :2]
    return Recording(
        time=np.arange(simulation.steps) / simulation.control_rate,
        position=position[:, order],
        rotation=np.moveaxis(arrays["rotation"], -1, 1)[:, order],
        joint_angle=arrays["joint_angle"],
        target_rate=arrays["target_rate"],
        cpg_output=arrays["cpg_output"],
        torque=arrays["torque"],
        distance=np.linalg.norm(way, axis=-1),
        goal=np.array(light, float) if light else np.full(3, np.nan),
        dof_names=tree.dof_names,
    )


def _start(
    simulation: Simulation,
    batch: tuple[int, ...],
    dtype: jnp.dtype,
    keys: Array | None,
    trial: Array | None,
) -> _Animal:
    """The animals as the trials begin."""
    tree = simulation.world.tree
    rest = starting_state(simulation.situations, trial, tree, batch, dtype)
    return _Animal(
        disturb_start(simulation.noise, tree, rest, keys),
        simulation.controller.initial_state(batch, dtype),
        jnp.zeros((len(simulation.sensors.pressure_bodies), *batch), dtype),
    )


def _control_step(
    simulation: Simulation,
    decoded: PyTree[Array],
    keys: Array | None,
    light: np.ndarray | Array | None,
    animal: _Animal,
    index: Array,
) -> tuple[_Animal, _Instant]:
    """Sense, command, and move for one control step."""
    state, nerves, pressure = animal
    world, batch = simulation.world, state.position.shape[1:]
    h = simulation.step_length
    state = disturb_motion(simulation.noise, state, keys, index, 1.0 / simulation.control_rate)
    # What differs between individuals must be an argument of what is fused, what does not is a
    # constant there.
    same = light is None or isinstance(light, np.ndarray) or light.ndim <= len(batch)
    own = None if same else light

    def look(state: State, own: Array | None) -> tuple[Array, Array, Array, Array]:
        place = light if own is None else own
        place = None if place is None else lift(place, state.position)
        kin = kinematics(world.tree, state)
        return *see(simulation.sensors, kin, place), fathom(simulation.sensors, world, kin)

    strength, cosine, sine, depth = fuse(look, state, own, batch_ndim=len(batch))
    observation = Observation(strength, pressure, cosine, sine, state.q, state.qd, depth)
    nerves, command = simulation.controller.act(decoded, nerves, observation)

    def touch(state: State, support: Array) -> Array:
        return feel(simulation.sensors, world, kinematics(world.tree, state), support)

    def go_on(state: State, command: Command) -> tuple[State, Array, Array, Array, Array | None]:
        state, effort = step(world, state, command.target_rate, h, command.target_angle)
        airborne = _is_airborne(effort) / simulation.substeps
        return state, effort.energy, airborne, effort.torque, effort.support if feels else None

    def move(carry, _):
        state, energy, airborne, _, support = carry
        # Fused as a whole, so that of the ground's many forces only what is asked for is stored.
        state, spent, off_ground, torque, felt = fuse(go_on, state, command, batch_ndim=len(batch))
        support = support if felt is None else felt
        return (state, energy + spent, airborne + off_ground, torque, support), None

    none = jnp.zeros(batch, state.q.dtype)
    feels = world.footing is not None and bool(simulation.sensors.pressure_bodies)
    places = len(world.footing.bodies) if world.footing is not None and feels else 0
    untouched = jnp.zeros((3, places, *batch), state.q.dtype)
    (moved, energy, airborne, torque, support), _ = jax.lax.scan(
        move,
        (state, none, none, jnp.zeros_like(state.q), untouched),
        None,
        length=simulation.substeps,
    )
    if feels:
        pressure = fuse(touch, moved, support, batch_ndim=len(batch))
    moment = Moment(
        index,
        state.position,
        state.orientation,
        strength,
        state.q,
        energy,
        airborne,
        None if light is None else lift(light, state.position),
    )
    return _Animal(moved, nerves, pressure), _Instant(moment, command, torque, state)


def _is_airborne(effort: Effort) -> Float[Array, " *n"]:
    """1 where nothing touched the ground in a physics step, else 0; 1 without ground."""
    if effort.support is None:
        return jnp.ones_like(effort.energy)
    return jnp.all(effort.support[2] <= 0, axis=0).astype(effort.energy.dtype)


def _is_sane(state: State) -> Bool[Array, " *n"]:
    """False where the motion has blown up, NaN included."""
    speed = jnp.abs(state.velocity[3:]).max(0)
    rate = jnp.abs(state.velocity[:3]).max(0)
    if state.qd.shape[0]:
        rate = jnp.maximum(rate, jnp.abs(state.qd).max(0))
    return (speed < _WILDEST_SPEED) & (rate < _WILDEST_RATE)
