"""A trial physics step by physics step: what an audit looks at.

A recording has the motion once per control step, as films and plots need it. Here are the states
before and after every physics step, with what motors, ground and limbs did in it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.control.controller import Command
from evo_cpg.fusion.engine import using
from evo_cpg.physics.state import State
from evo_cpg.physics.step import step
from evo_cpg.simulation.control_step import Animal, Life, act, begin_life, move, push, sense
from evo_cpg.simulation.simulation import Simulation


class PhysicsSteps(NamedTuple):
    """One individual in every physics step of a trial; the last axis of every array is time.

    Attributes:
        before: at its beginning, after the push of chance if there is any.
        after: at its end.
        target_rate: what the controller asked of each motor, rad/s.
        target_angle: where it asked the motors' springs to pull to, rad.
        torque: of the motors, N m.
        contact_force: of the ground on every contact point, world axes, N; none without ground.
        pair_force: with which limbs push each other, N; none where none can meet.
        solved_residual: of the step's equations (`evo_cpg.physics.equations.Residual`); 0 where one
            solve is exact.
        coulomb_residual: likewise.
        light: seen by each eye in the control step, 0 to 1.
    """

    before: State
    after: State
    target_rate: Float[Array, "d t"]
    target_angle: Float[Array, "d t"]
    torque: Float[Array, "d t"]
    contact_force: Float[Array, "3 p t"]
    pair_force: Float[Array, "k t"]
    solved_residual: Float[Array, " t"]
    coulomb_residual: Float[Array, " t"]
    light: Float[Array, "e t"]


def physics_steps(
    simulation: Simulation,
    genes: Float[Array, "g n"],
    keys: Array | None = None,
    trial: Array | None = None,
) -> PhysicsSteps:
    """The first individual of a population, in every physics step.

    Args:
        simulation: the trial.
        genes: a population; neighbours make the numbers come out as in training.
        keys: see `evo_cpg.simulation.rollout.rollout`.
        trial: likewise.
    """
    keys = None if simulation.noise.silent else keys
    trial = None if len(simulation.situations) == 1 else trial
    with using(simulation.engine):
        life, first = begin_life(simulation, genes, keys, trial)

        def advance(animal: Animal, index: Array) -> tuple[Animal, PhysicsSteps]:
            animal = push(simulation, life, animal, index)
            seen = sense(simulation, life, animal)
            nerves, command = act(simulation, life, animal, seen)
            animal = animal._replace(nerves=nerves)
            moved, _ = move(simulation, life, animal, seen, command)
            return moved, _each_step(simulation, life, animal, command, seen.light)

        _, steps = jax.lax.scan(advance, first, jnp.arange(simulation.steps))
    return jax.tree.map(_time_last, steps)


def _each_step(
    simulation: Simulation, life: Life, animal: Animal, command: Command, light: Array
) -> PhysicsSteps:
    """The physics steps of a control step, as `move` takes them."""
    world, h = simulation.world, simulation.step_length
    none = jnp.zeros((0, *animal.state.position.shape[1:]), animal.state.q.dtype)
    angle = command.target_angle
    asked = command.target_rate, jnp.zeros_like(animal.state.q) if angle is None else angle

    def advance(carry, _):
        state, warmstart = carry
        after, effort = step(world, state, command.target_rate, h, angle, warmstart, life.grip)
        residual = effort.residual
        exact = jnp.zeros_like(effort.energy)
        seen = PhysicsSteps(
            state,
            after,
            *asked,
            effort.torque,
            none[None].repeat(3, 0) if effort.contact_force is None else effort.contact_force,
            none if effort.pair_force is None else effort.pair_force,
            exact if residual is None else residual.solved,
            exact if residual is None else residual.coulomb,
            light,
        )
        return (after, effort.warmstart), jax.tree.map(lambda x: x[..., 0], seen)

    start = animal.state, animal.warmstart
    return jax.lax.scan(advance, start, None, length=simulation.substeps)[1]


def _time_last(values: Array) -> Array:
    """From ``(control steps, substeps, ...)``."""
    steps, substeps, *rest = values.shape
    return jnp.moveaxis(values.reshape(steps * substeps, *rest), 0, -1)
