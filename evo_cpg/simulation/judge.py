"""Outcome of a trial: terms of the task, measures of gait, and which individuals are alive.

Rules disqualify an animal in the control step in which it breaks them. Evolution exploits the
errors of a simulator, and a rule removes such a motion from the search at once. Otherwise only an
audit of the champion (`evo-cpg audit`) would find it.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.native.fuse import fuse
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.contact.pairs import gaps_of_pairs
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.control_step import AnimalState, Effects, transition
from evo_cpg.simulation.measures import Trial
from evo_cpg.simulation.observers import Observer, Seen
from evo_cpg.simulation.simulation import Rules, Simulation
from evo_cpg.simulation.task import Task, Transition


def keeps(
    rules: Rules, world: World, state: State, energy: Float[Array, " *n"], duration: Number
) -> Bool[Array, " *n"]:
    """Return whether every animal keeps the rules in a control step.

    Args:
        rules: the rules.
        world: the animals and their environment.
        state: state at the end of the control step.
        energy: energy spent by all motors in the step, J.
        duration: duration of a control step, s.
    """
    valid = jnp.ones(energy.shape, bool)
    if rules.speed is not None:
        linear = state.linear_velocity
        valid &= (linear * linear).sum(0) <= rules.speed**2
    if rules.joint_rate is not None:
        rates = state.qd[~world.tree.slides]
        valid &= (jnp.abs(rates) <= rules.joint_rate).all(0)
    if rules.power is not None:
        valid &= energy <= rules.power * duration
    if rules.penetration is None and rules.overlap is None:
        return valid
    kin = kinematics(world.tree, state)
    if rules.penetration is not None and world.contact_model is not None:
        valid &= (clearance(world.contact_model, kin) >= -rules.penetration).all(0)
    if rules.overlap is not None and rules.pairs is not None:
        gap = gaps_of_pairs(rules.pairs, kin)
        deep = (gap < -rules.overlap) & (expand_dims_like(rules.pairs.pair_stiffness, gap) > 0)
        valid &= ~deep.any(0)
    return valid


# A trial has diverged beyond this angular velocity of a joint or the root (rad/s), or this speed of
# the root (m/s). No animal of metre size moves so fast, and the time step no longer resolves such
# motion.
_WILDEST_RATE = 1e3
WILDEST_SPEED = 1e2


class Outcome(NamedTuple):
    """Outcome of a trial.

    Attributes:
        terms: the task's terms by name.
        alive: False for an individual that diverged or broke a rule.
    """

    terms: dict[str, Float[Array, " *n"]]
    alive: Bool[Array, " *n"]


@dataclasses.dataclass(frozen=True)
class Judge(Observer):
    """Returns the `Outcome` of a whole trial."""

    def begin(self, simulation: Simulation, animal: AnimalState) -> tuple[PyTree, Array]:
        """Return the tallies before a trial, with all individuals alive."""
        batch, dtype = animal.state.position.shape[1:], animal.state.q.dtype
        return begin_tally(simulation, batch, dtype), jnp.ones(batch, bool)

    def update(self, tally: tuple[PyTree, Array], seen: Seen) -> tuple[PyTree, Array]:
        """Return the tallies after a control step, and which individuals are still alive."""
        simulation, constants, index, animal, effects = seen
        own, alive = tally
        ndim = alive.ndim

        def update(own: Any, effects: Effects, light: Array | None) -> Any:
            happened = transition(simulation, constants._replace(light=light), effects, index)
            return update_tally(simulation, own, happened)

        name = f"{type(simulation.task).__name__}.update"
        own = fuse(update, own, effects, constants.light, batch_ndim=ndim, name=name)
        sane = fuse(is_sane, animal.state, batch_ndim=ndim, name="divergence")
        if simulation.rules is not None:
            duration = 1 / simulation.control_rate
            given = simulation.rules, simulation.world
            keep = functools.partial(keeps, *given, duration=duration)
            sane &= fuse(keep, effects.after, effects.energy, batch_ndim=ndim, name="rules")
        return own, alive & sane

    def finish(self, simulation: Simulation, tally: tuple[PyTree, Array], steps: tuple) -> Outcome:
        """Convert the tallies to terms."""
        del steps
        own, alive = tally
        finish = functools.partial(finish_tally, simulation)
        name = f"{type(simulation.task).__name__}.terms"
        return Outcome(fuse(finish, own, batch_ndim=alive.ndim, name=name), alive)


JUDGE = Judge()


@dataclasses.dataclass(frozen=True)
class Scored(Judge):
    """Returns the fitness of a trial, one number, so that its gradient costs least.

    Attributes:
        scales: scales of the task.
    """

    scales: dict[str, Float[Array, ""]]

    def finish(
        self, simulation: Simulation, tally: tuple[PyTree, Array], steps: tuple
    ) -> Float[Array, " *n"]:
        """Return the fitness (`score`)."""
        return score(simulation.task, super().finish(simulation, tally, steps), self.scales)


def score(task: Task, outcome: Outcome, scales: dict[str, Float[Array, ""]]) -> Float[Array, " *n"]:
    """Return the fitness of every individual, or -inf if it diverged or broke a rule."""
    fitness = task.fitness(outcome.terms, scales)
    return jnp.where(outcome.alive & jnp.isfinite(fitness), fitness, -jnp.inf)


def no_terms(simulation: Simulation, batch: tuple[int, ...] = (1,)) -> dict[str, Array]:
    """Return the terms of a trial with no steps: the task's terms and the measures of gait."""
    return finish_tally(simulation, begin_tally(simulation, batch, jnp.dtype("float32")))


def begin_tally(
    simulation: Simulation, batch: tuple[int, ...], dtype: jnp.dtype
) -> tuple[PyTree, PyTree]:
    """Return the tallies of the task and of the measures of gait before a trial."""
    own = simulation.task.begin(batch, dtype, simulation.steps)
    gait = (one.begin(simulation.world, batch, dtype) for one in simulation.measures.each)
    return own, tuple(gait)


def update_tally(
    simulation: Simulation, tally: tuple[PyTree, PyTree], happened: Transition
) -> tuple[PyTree, PyTree]:
    """Return both tallies after one more control step."""
    own, gait = tally
    own = simulation.task.update(own, happened, simulation.steps)
    pairs = zip(simulation.measures.each, gait, strict=True)
    return own, tuple(one.update(tally, happened) for one, tally in pairs)


def finish_tally(simulation: Simulation, tally: tuple[PyTree, PyTree]) -> dict[str, Array]:
    """Return the terms of the task and the measures of gait, by name."""
    own, gait = tally
    trial = Trial(simulation.world, simulation.duration)
    terms = simulation.task.terms(own, simulation.steps)
    names, each = simulation.measures.names, simulation.measures.each
    triples = zip(names, each, gait, strict=True)
    return terms | {name: one.finish(tally, trial) for name, one, tally in triples}


def is_sane(state: State) -> Bool[Array, " *n"]:
    """Return False for individuals whose motion has diverged or is NaN."""
    speed = jnp.abs(state.linear_velocity).max(0)
    rate = jnp.abs(state.angular_velocity).max(0)
    if state.qd.shape[0]:
        rate = jnp.maximum(rate, jnp.abs(state.qd).max(0))
    return (speed < WILDEST_SPEED) & (rate < _WILDEST_RATE)
