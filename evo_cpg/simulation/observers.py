"""Observers. `evo_cpg.simulation.rollout.rollout` returns the result of each.

| observer | in | result | of |
|---|---|---|---|
| `Judge` | `evo_cpg.simulation.judge` | terms of the task, survivors | the whole trial |
| `Recorder` | `evo_cpg.simulation.recording` | poses, commands, forces | every control step |
| `States` | here | states of the body | every control step |
| `EachPhysicsStep` | here | states, forces | every physics step |

Films and plots need the motion once per control step. An audit needs the states before and after
every physics step, with the forces of motors, ground and limbs.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.control_step import AnimalState, Effects, EpisodeConstants, motor_command
from evo_cpg.simulation.simulation import Simulation


class Seen(NamedTuple):
    """View of one control step for an observer.

    Attributes:
        simulation: the trial.
        constants: constants of the trial.
        index: number of the control step, from 0.
        animal: the animal at the end of the step.
        effects: result of the step.
    """

    simulation: Simulation
    constants: EpisodeConstants
    index: Array
    animal: AnimalState
    effects: Effects


@dataclasses.dataclass(frozen=True)
class Observer:
    """Follows a trial and returns a result. Subclasses override some of the methods.

    All methods are pure JAX functions of arrays whose trailing axes are individuals.

    Attributes:
        every_step: True if `of_step` returns anything. If it is False for all observers, a whole
            trial can be one native program.
        physics: True if `Effects.physics` is needed. Physics steps are then separate programs.
    """

    every_step = False
    physics = False

    def begin(self, simulation: Simulation, animal: AnimalState) -> PyTree[Array]:
        """Return the tally before the first control step."""
        del simulation, animal
        return ()

    def update(self, tally: PyTree[Array], seen: Seen) -> PyTree[Array]:
        """Return the tally after a control step: same structure, shapes and types."""
        del seen
        return tally

    def of_step(self, seen: Seen) -> PyTree[Array]:
        """Return the arrays to keep of a control step."""
        del seen
        return ()

    def finish(self, simulation: Simulation, tally: PyTree[Array], steps: PyTree[Array]) -> Any:
        """Return the result. The default is ``steps``, the results of `of_step` stacked in time."""
        del simulation, tally
        return steps

    def of_bodies(self, result: Any) -> Any:
        """Return the result for a batch of different bodies, each of which was followed alone."""
        return result


@dataclasses.dataclass(frozen=True)
class States(Observer):
    """Keeps the states of the body: at the start and after every control step, stacked."""

    every_step = True

    def begin(self, simulation: Simulation, animal: AnimalState) -> State:
        """Return the state at the start."""
        del simulation
        return animal.state

    def of_step(self, seen: Seen) -> State:
        """Return the state after the step."""
        return seen.animal.state

    def finish(self, simulation: Simulation, tally: State, steps: State) -> State:
        """Return the states of all steps, after the initial state."""
        del simulation
        return jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), tally, steps)


class PhysicsSteps(NamedTuple):
    """Physics steps of one individual. The last axis of every array is time.

    Attributes:
        before: state at the start of the step, after any push by noise.
        after: state at the end of the step.
        target_rate: commanded rate of each motor, rad/s.
        target_angle: commanded angle of the motors' springs, rad, or 0 if the controller commands
            none.
        activation: activation of the muscles, first of those that pull to positive angles, or 0 if
            the controller commands none.
        commanded_torque: commanded torque of each torque motor, N m, or 0 if the controller
            commands none.
        torque: torque of the motors and muscles, those of tendons included, N m.
        contact_force: force of the ground on every contact point, world axes, N. No points without
            ground.
        pair_force: force between touching limbs, N. Empty if no limbs can touch.
        solved_residual: residual of the step's equations
        (`evo_cpg.physics.step.equations.Residual`), 0
            if the physics solves each step exactly, without iterations.
        coulomb_residual: residual of Coulomb's law (`evo_cpg.physics.step.equations.Residual`), 0
        if the
            physics solves each step exactly, without iterations.
        light: light seen by each eye in the control step, 0 to 1.
        tension: forces of the motors of tendons, or None without tendons.
        time: start of the control step, s, or None if the water does not change.
    """

    before: State
    after: State
    target_rate: Float[Array, "d t"]
    target_angle: Float[Array, "d t"]
    activation: Float[Array, "2 d t"]
    commanded_torque: Float[Array, "d t"]
    torque: Float[Array, "d t"]
    contact_force: Float[Array, "3 p t"]
    pair_force: Float[Array, "k t"]
    solved_residual: Float[Array, " t"]
    coulomb_residual: Float[Array, " t"]
    light: Float[Array, "e t"]
    tension: Float[Array, "k t"] | None = None
    time: Float[Array, " t"] | None = None


@dataclasses.dataclass(frozen=True)
class EachPhysicsStep(Observer):
    """Keeps every physics step of the first individual of a population.

    The other individuals are simulated too, so that the results equal those in training.
    """

    every_step = True
    physics = True

    def of_step(self, seen: Seen) -> PhysicsSteps:
        """Return the physics steps of a control step, along the first axis."""
        command, observation = seen.effects.command, seen.effects.observation
        assert seen.effects.physics is not None
        before, after, effort = seen.effects.physics
        held = *motor_command(command).filled(), observation.light
        rates, angles, active, torques, light = jax.tree.map(
            lambda x: x[None].repeat(len(before.q), 0), held
        )
        none = jnp.zeros_like(rates[:, :0])
        exact, residual = jnp.zeros_like(effort.energy), effort.residual
        time = None
        if seen.simulation.world.changes:
            time = jnp.full_like(exact, seen.index / seen.simulation.control_rate)
        steps = PhysicsSteps(
            before,
            after,
            rates,
            angles,
            active,
            torques,
            effort.torque,
            none[:, None].repeat(3, 1) if effort.contact_force is None else effort.contact_force,
            none if effort.pair_force is None else effort.pair_force,
            exact if residual is None else residual.solved,
            exact if residual is None else residual.coulomb,
            light,
            effort.tension,
            time,
        )
        return jax.tree.map(lambda x: x[..., 0], steps)

    def finish(self, simulation: Simulation, tally: tuple, steps: PhysicsSteps) -> PhysicsSteps:
        """Join ``(control steps, physics steps, ...)`` to one axis of time, the last."""
        del simulation, tally
        return jax.tree.map(
            lambda x: jnp.moveaxis(x.reshape(x.shape[0] * x.shape[1], *x.shape[2:]), 0, -1), steps
        )
