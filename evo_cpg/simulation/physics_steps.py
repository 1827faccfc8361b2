"""Physics steps of a trial, for an audit.

A recording has the motion once per control step, for films and plots. This module returns the
states before and after every physics step, with the forces of motors, ground and limbs.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.control_step import motor_command
from evo_cpg.simulation.observer import Observer, Seen
from evo_cpg.simulation.simulation import Simulation


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
        )
        return jax.tree.map(lambda x: x[..., 0], steps)

    def finish(self, simulation: Simulation, tally: tuple, steps: PhysicsSteps) -> PhysicsSteps:
        """Join ``(control steps, physics steps, ...)`` to one axis of time, the last."""
        del simulation, tally
        return jax.tree.map(
            lambda x: jnp.moveaxis(x.reshape(x.shape[0] * x.shape[1], *x.shape[2:]), 0, -1), steps
        )
