"""A trial: an animal with its controller in a world, judged by a task.

One trial is ``steps`` control steps of ``1 / control_rate`` seconds (2000 steps of 1/60 s in
Iwadate 2010); in each the controller senses and commands once, and the physics takes
``substeps`` steps with the command held.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, UInt32

from evo_cpg.control.controller import Command, Controller, Observation
from evo_cpg.creature.tree import Tree
from evo_cpg.fusion.engine import Engine, using
from evo_cpg.fusion.fuse import fuse
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
        engine: what computes it.
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
    engine: Engine = eqx.field(static=True, default=Engine())

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
    """One control step, for the task and for recording.

    Attributes:
        seen: fields of the `Moment` that every individual has of its own.
        command: of the controller.
        torque: of the motors in the last physics step, N m.
        state: at its beginning.
    """

    seen: dict[str, Array]
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
    with using(simulation.engine):
        life, first = _begin(simulation, genes, None, None)
        first = first._replace(state=begin(first.state))

        def advance(animal: _Animal, index: Array) -> tuple[_Animal, State]:
            animal, _ = _control_step(simulation, life, animal, index)
            return animal, animal.state

        _, states = jax.lax.scan(advance, first, jnp.arange(simulation.steps))
    return jax.tree.map(
        lambda first, rest: jnp.concatenate([first[None], rest]), first.state, states
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
    ndim = genes.ndim - 1
    # What makes no difference is no argument of the program.
    keys = None if simulation.noise.silent else keys
    trial = None if len(simulation.situations) == 1 else trial

    def whole(genes: Array, keys: Array | None, trial: Array | None) -> Outcome:
        return _trial(simulation, genes, slice(0), keys, trial, None)[0]

    with using(simulation.engine):
        if recorded.stop or backward is not None:
            return _trial(simulation, genes, recorded, keys, trial, backward)
        return fuse(whole, genes, keys, trial, batch_ndim=ndim, name="a trial"), {}


def _trial(
    simulation: Simulation,
    genes: Array,
    recorded: slice,
    keys: Array | None,
    trial: Array | None,
    backward: Backward | None,
) -> tuple[Outcome, dict[str, Array]]:
    """One trial: its control steps are programs of their own, or parts of one."""
    batch, task, steps = genes.shape[1:], simulation.task, simulation.steps
    ndim, tree = len(batch), simulation.world.tree
    life, animal = _begin(simulation, genes, keys, trial)

    def advance(carry, index):
        animal, tally, alive = carry
        if backward is not None:
            animal = _Animal(*backward.forget(animal.state, animal.nerves), animal.pressure)
        animal, instant = _control_step(simulation, life, animal, index)

        def watch(tally: Any, seen: dict[str, Array], light: Array | None) -> Any:
            light = _light_of(life, light, seen["position"])
            return task.watch(tally, Moment(step=index, light_position=light, **seen), steps)

        name = f"{_name(task)}.watch"
        tally = fuse(watch, tally, instant.seen, life.light, batch_ndim=ndim, name=name)
        sane = fuse(_is_sane, animal.state, batch_ndim=ndim)
        frame = {}
        if recorded.stop:
            frame = fuse(functools.partial(_frame, tree), instant, batch_ndim=ndim)
            frame = {name: values[..., recorded] for name, values in frame.items()}
        return (animal, tally, alive & sane), frame

    carry = animal, task.begin(batch, genes.dtype, steps), jnp.ones(batch, bool)
    if backward is None:
        (_, tally, alive), frames = jax.lax.scan(advance, carry, jnp.arange(steps))
    else:
        (_, tally, alive), frames = backward.scan(advance, carry, steps), {}

    def finish(tally: Any) -> dict[str, Array]:
        return task.terms(tally, steps)

    terms = fuse(finish, tally, batch_ndim=ndim, name=f"{_name(task)}.terms")
    return Outcome(terms, alive), frames


def _frame(tree: Tree, instant: _Instant) -> dict[str, Array]:
    """What is recorded of one control step."""
    kin = kinematics(tree, instant.state)
    com = lift(tree.com, kin.origin)
    return {
        "position": kin.origin + (kin.rotation * com[None]).sum(1),
        "rotation": kin.rotation,
        "joint_angle": instant.seen["joint_angle"],
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


class _Life(NamedTuple):
    """What stays the same throughout a trial.

    Attributes:
        decoded: the genes, as the controller made them its own.
        keys: of the trial's noise.
        light: where it is for each individual; None where it is the same for all.
        common_light: where it is for all; None where each has its own, or there is none.
    """

    decoded: PyTree[Array]
    keys: Array | None
    light: Array | None
    common_light: np.ndarray | Array | None


def _begin(
    simulation: Simulation, genes: Array, keys: Array | None, trial: Array | None
) -> tuple[_Life, _Animal]:
    """The trials as they begin."""
    tree, dtype, ndim = simulation.world.tree, genes.dtype, genes.ndim - 1
    own = trial is not None

    def begin(genes: Array, keys: Array | None, trial: Array | None) -> tuple:
        batch = genes.shape[1:]
        rest = starting_state(simulation.situations, trial, tree, batch, dtype)
        animal = _Animal(
            disturb_start(simulation.noise, tree, rest, keys),
            simulation.controller.initial_state(batch, dtype),
            jnp.zeros((len(simulation.sensors.pressure_bodies), *batch), dtype),
        )
        light = light_places(simulation.lights, trial, dtype) if own else None
        return simulation.controller.decode(genes), light, animal

    name = f"{_name(simulation.controller)}.decode"
    decoded, light, animal = fuse(begin, genes, keys, trial, batch_ndim=ndim, name=name)
    common = None if own else light_places(simulation.lights, None, dtype)
    return _Life(decoded, keys, light, common), animal


def _control_step(
    simulation: Simulation, life: _Life, animal: _Animal, index: Array
) -> tuple[_Animal, _Instant]:
    """Sense, command, and move for one control step."""

    def whole(decoded: PyTree[Array], keys: Array | None, light: Array | None, animal: _Animal):
        own = _Life(decoded, keys, light, life.common_light)
        return _sense_command_move(simulation, own, animal, index)

    ndim = animal.state.position.ndim - 1
    given = life.decoded, life.keys, life.light, animal
    return fuse(whole, *given, batch_ndim=ndim, name="a control step")


def _sense_command_move(
    simulation: Simulation, life: _Life, animal: _Animal, index: Array
) -> tuple[_Animal, _Instant]:
    """The parts of a control step."""
    state, nerves, pressure = animal
    world, controller = simulation.world, simulation.controller
    ndim = state.position.ndim - 1

    def push(state: State, keys: Array | None) -> State:
        duration = 1.0 / simulation.control_rate
        return disturb_motion(simulation.noise, state, keys, index, duration)

    def look(state: State, light: Array | None) -> tuple[Array, Array, Array, Array]:
        kin = kinematics(world.tree, state)
        place = _light_of(life, light, state.position)
        return *see(simulation.sensors, kin, place), fathom(simulation.sensors, world, kin)

    state = fuse(push, state, life.keys, batch_ndim=ndim, name="noise")
    strength, cosine, sine, depth = fuse(look, state, life.light, batch_ndim=ndim, name="sensors")
    observation = Observation(strength, pressure, cosine, sine, state.q, state.qd, depth)
    name = f"{_name(controller)}.act"
    act = life.decoded, nerves, observation
    nerves, command = fuse(controller.act, *act, batch_ndim=ndim, name=name)
    moved, pressure, energy, airborne, torque = _move(simulation, state, command, pressure)
    seen = {
        "position": state.position,
        "orientation": state.orientation,
        "light": strength,
        "joint_angle": state.q,
        "energy": energy,
        "airborne": airborne,
    }
    return _Animal(moved, nerves, pressure), _Instant(seen, command, torque, state)


def _move(
    simulation: Simulation, state: State, command: Command, pressure: Array
) -> tuple[State, Array, Array, Array, Array]:
    """The physics steps of a control step.

    Returns:
        The state, what the skin feels, the energy spent (J), the share of the time off the ground
        and the torques of the last step (N m).
    """
    world, h, batch = simulation.world, simulation.step_length, state.position.shape[1:]
    feels = world.footing is not None and bool(simulation.sensors.pressure_bodies)

    def advance(carry, _):
        state, energy, airborne, _, support = carry
        state, effort = step(world, state, command.target_rate, h, command.target_angle)
        support = effort.support if feels else support
        airborne = airborne + _is_airborne(effort) / simulation.substeps
        return (state, energy + effort.energy, airborne, effort.torque, support), None

    none = jnp.zeros(batch, state.q.dtype)
    places = len(world.footing.bodies) if world.footing is not None and feels else 0
    untouched = jnp.zeros((3, places, *batch), state.q.dtype)
    start = state, none, none, jnp.zeros_like(state.q), untouched
    (moved, energy, airborne, torque, support), _ = jax.lax.scan(
        advance, start, None, length=simulation.substeps
    )

    def touch(state: State, support: Array) -> Array:
        return feel(simulation.sensors, world, kinematics(world.tree, state), support)

    if feels:
        pressure = fuse(touch, moved, support, batch_ndim=len(batch), name="sensors")
    return moved, pressure, energy, airborne, torque


def _light_of(life: _Life, own: Array | None, position: Array) -> Array | None:
    """Where the light is, with axes of individuals."""
    place = life.common_light if own is None else own
    return None if place is None else lift(place, position)


def _name(part: Any) -> str:
    return type(part).__name__


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
