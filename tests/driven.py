"""Motion of joints under commands to their motors and muscles."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.analysis.energy import Ledger, ledger
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.step.step import Effort, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.simulation.observers import PhysicsSteps


def moved(
    world: World, command: MotorCommand, count: int, h: float, angle: float = 0, rate: float = 0
):
    """Return angles, rates, torques and energies, steps first, all joints with one start."""

    @quick_jit
    def motion(state):
        def advance(s, _):
            s, effort = step(world, s, command, h)
            return s, (s.q, s.qd, effort.torque, effort.energy)

        return jax.lax.scan(advance, state, None, count)[1]

    angles, rates = (jnp.full(world.tree.dof_count, float(x)) for x in (angle, rate))
    start = resting_state(world.tree, (), jnp.float64, angles=angles)
    return jax.tree.map(np.asarray, motion(dataclasses.replace(start, qd=rates)))


def balance(
    world: World, start: State, command: Callable, count: int, h: float
) -> tuple[Ledger, Effort]:
    """Return the ledger of a motion on a dry place, and the efforts, time last.

    Args:
        world: the creature and its environment.
        start: initial state, in float64.
        command: function from the time, s, to the command.
        count: number of steps.
        h: step, s.
    """

    @quick_jit
    def motion(state):
        def advance(s, n):
            held = command(h * n)
            new, effort = step(world, s, held, h)
            return new, (s, new, held.filled(), effort)

        return jax.lax.scan(advance, state, jnp.arange(count))[1]

    before, after, held, effort = jax.tree.map(
        lambda x: np.moveaxis(np.asarray(x), 0, -1), motion(start)
    )
    none, exact = np.zeros((0, count)), np.zeros(count)
    forces = effort.torque, np.zeros((3, 0, count)), none, exact, exact, none, effort.tension
    return ledger(world, PhysicsSteps(before, after, *held, *forces), h), effort
