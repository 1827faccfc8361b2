"""A trial: an animal with its controller in a world, judged by a task.

One trial is ``steps`` control steps of ``1 / control_rate`` seconds (2000 steps of 1/60 s in
Iwadate 2010), each as in `evo_cpg.simulation.control_step`.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, UInt32

from evo_cpg.creature.tree import Tree
from evo_cpg.fusion.engine import using
from evo_cpg.fusion.fuse import fuse
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.state import State
from evo_cpg.simulation.backward import Backward
from evo_cpg.simulation.control_step import Animal, Effects, begin_life, control_step, transition
from evo_cpg.simulation.measures import Trial
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.rules import keeps
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task, Transition
from evo_cpg.spatial.linear import cross, expand_dims_like

# Beyond these rates (rad/s) and speeds (m/s) a trial counts as diverged: no animal of metre size
# moves like that, and the step no longer resolves it.
_WILDEST_RATE = 1e3
_WILDEST_SPEED = 1e2


# What frames call the readings of senses and the state of the controller.
SENSE, NERVE = "sense.", "nerve."


class Outcome(NamedTuple):
    """What a trial amounted to.

    Attributes:
        terms: the task's terms by name.
        alive: False for an individual that diverged or broke a rule.
    """

    terms: dict[str, Float[Array, " *n"]]
    alive: Bool[Array, " *n"]


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


def no_terms(simulation: Simulation, batch: tuple[int, ...] = (1,)) -> dict[str, Array]:
    """What a trial without a step amounts to: the task's terms and the measures of gait."""
    return finish_tally(simulation, begin_tally(simulation, batch, jnp.dtype("float32")))


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
    full: bool = False,
) -> dict[str, Array]:
    """The trials of the first individuals, step by step; see `as_recording`.

    Args:
        simulation: the trial.
        genes: a population.
        count: individuals to record.
        keys: see `rollout`.
        trial: see `rollout`.
        full: with velocities, senses and what the controller remembers, too.
    """
    return _live(simulation, genes, slice(count), keys, trial, full=full)[1]


def rollout_and_record(
    simulation: Simulation,
    genes: Float[Array, "g n"],
    individual: int,
    keys: UInt32[Array, "w n"] | None = None,
    trial: Int[Array, " n"] | None = None,
    full: bool = False,
) -> tuple[Outcome, dict[str, Array]]:
    """`rollout` of all and `record` of one individual, in one program: it compiles but once.

    Args:
        simulation: the trial.
        genes: a population, so that the champion can be replayed among as many neighbours as it
            had in training and its numbers come out the same.
        individual: which is recorded.
        keys: see `rollout`.
        trial: see `rollout`.
        full: see `record`.
    """
    recorded = slice(individual, individual + 1)
    return _live(simulation, genes, recorded, keys, trial, full=full)


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
        life, first = begin_life(simulation, genes, None, None)
        first = first._replace(state=begin(first.state))

        def advance(animal: Animal, index: Array) -> tuple[Animal, State]:
            animal, _ = control_step(simulation, life, animal, index)
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
    full: bool = False,
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
            return _trial(simulation, genes, recorded, keys, trial, backward, full)
        return fuse(whole, genes, keys, trial, batch_ndim=ndim, name="a trial"), {}


def _trial(
    simulation: Simulation,
    genes: Array,
    recorded: slice,
    keys: Array | None,
    trial: Array | None,
    backward: Backward | None,
    full: bool = False,
) -> tuple[Outcome, dict[str, Array]]:
    """One trial: its control steps are programs of their own, or parts of one."""
    batch, task, steps = genes.shape[1:], simulation.task, simulation.steps
    ndim, tree = len(batch), simulation.world.tree
    life, animal = begin_life(simulation, genes, keys, trial)

    def advance(carry, index):
        animal, tally, alive = carry
        if backward is not None:
            inner = animal.nerves, animal.warmstart
            state, (nerves, warmstart) = backward.forget(animal.state, inner)
            animal = animal._replace(state=state, nerves=nerves, warmstart=warmstart)
        animal, effects = control_step(simulation, life, animal, index)

        def update(tally: Any, effects: Effects, light: Array | None) -> Any:
            seen = transition(simulation, life._replace(light=light), effects, index)
            return update_tally(simulation, tally, seen)

        name = f"{_name(task)}.update"
        tally = fuse(update, tally, effects, life.light, batch_ndim=ndim, name=name)
        sane = fuse(is_sane, animal.state, batch_ndim=ndim)
        if simulation.rules is not None:
            given = effects.after, effects.energy
            sane &= fuse(keep, *given, batch_ndim=ndim, name="rules")
        frame = {}
        if recorded.stop:
            frame = fuse(functools.partial(_frame, tree, full), effects, batch_ndim=ndim)
            if full:
                frame |= nerve_frames(animal.nerves)
            frame = {name: values[..., recorded] for name, values in frame.items()}
        return (animal, tally, alive & sane), frame

    def keep(state: State, energy: Array) -> Array:
        assert simulation.rules is not None
        return keeps(simulation.rules, simulation.world, state, energy, 1 / simulation.control_rate)

    tally = begin_tally(simulation, batch, genes.dtype)
    carry = animal, tally, jnp.ones(batch, bool)
    if backward is None:
        (_, tally, alive), frames = jax.lax.scan(advance, carry, jnp.arange(steps))
    else:
        (_, tally, alive), frames = backward.scan(advance, carry, steps), {}

    finish = functools.partial(finish_tally, simulation)
    terms = fuse(finish, tally, batch_ndim=ndim, name=f"{_name(task)}.terms")
    return Outcome(terms, alive), frames


def begin_tally(
    simulation: Simulation, batch: tuple[int, ...], dtype: jnp.dtype
) -> tuple[PyTree, PyTree]:
    """The tally of the task and that of the measures of gait, before a trial."""
    measures = simulation.measures
    own = simulation.task.begin(batch, dtype, simulation.steps)
    return own, measures and measures.begin(simulation.world, batch, dtype)


def update_tally(
    simulation: Simulation, tally: tuple[PyTree, PyTree], seen: Transition
) -> tuple[PyTree, PyTree]:
    """Both after one more control step."""
    measures, (own, gait) = simulation.measures, tally
    told = simulation.task.update(own, seen, simulation.steps)
    return told, measures and measures.update(gait, seen)


def finish_tally(simulation: Simulation, tally: tuple[PyTree, PyTree]) -> dict[str, Array]:
    """What they amount to: terms by name."""
    own, gait = tally
    terms = simulation.task.terms(own, simulation.steps)
    if simulation.measures is not None:
        trial = Trial(simulation.world, simulation.duration)
        terms = terms | simulation.measures.finish(gait, trial)
    return terms


def _frame(tree: Tree, full: bool, effects: Effects) -> dict[str, Array]:
    """What is recorded of one control step."""
    kin = kinematics(tree, effects.before)
    com = expand_dims_like(tree.com, kin.origin)
    residual = {} if effects.residual is None else effects.residual._asdict()
    lever = (kin.rotation * com[None]).sum(1)
    frame = {
        "position": kin.origin + lever,
        "rotation": kin.rotation,
        "joint_angle": effects.before.q,
        "target_rate": effects.command.target_rate,
        "cpg_output": effects.command.signal,
        "torque": effects.forces.torque,
        "contact_force": effects.forces.contact_force,
        "pair_force": effects.forces.pair_force,
        "energy": effects.energy,
        **{f"{name}_residual": values for name, values in residual.items()},
    }
    if full:
        # Joint angles and rates are those of the state.
        senses = effects.observation._replace(joint_angle=None, joint_rate=None)._asdict()
        frame |= {
            "velocity": kin.linear + cross(kin.angular, lever),
            "angular_velocity": kin.angular,
            "joint_rate": effects.before.qd,
            **{SENSE + name: values for name, values in senses.items() if values is not None},
        }
    return frame


def nerve_frames(nerves: PyTree[Array]) -> dict[str, Array]:
    """What a controller remembers, by the names of its fields."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(nerves)
    return {NERVE + jax.tree_util.keystr(path).strip("."): values for path, values in leaves}


def as_recording(
    simulation: Simulation,
    frames: Mapping[str, Array | np.ndarray],
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


def _name(part: Any) -> str:
    return type(part).__name__


def is_sane(state: State) -> Bool[Array, " *n"]:
    """False where the motion has blown up, NaN included."""
    speed = jnp.abs(state.velocity[3:]).max(0)
    rate = jnp.abs(state.velocity[:3]).max(0)
    if state.qd.shape[0]:
        rate = jnp.maximum(rate, jnp.abs(state.qd).max(0))
    return (speed < _WILDEST_SPEED) & (rate < _WILDEST_RATE)
