"""Motion of joints under commands to their motors and muscles."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.analysis.energy import Ledger, ledger
from evo_cpg.creature.creature import (
    NO_LIMIT,
    Actuator,
    Body,
    Creature,
    Joint,
    Material,
    TorqueMotor,
)
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.step.step import Effort, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.simulation.observers import PhysicsSteps


def wheels(*motors: TorqueMotor | Actuator | None, **given: float) -> tuple[World, float]:
    """Return wheels on the centre of a hub, and the inertia that the first one sees alone."""
    hub, rim, water = Box((0.2, 0.2, 0.2)), Box((0.3, 0.3, 0.02)), Material(1000.0)
    centre, free = (0.0, 0.0, 0.0), ((-NO_LIMIT,), (NO_LIMIT,))
    bodies = [Body("hub", hub, water)]
    for i, motor in enumerate(motors):
        joint = Joint("hub", centre, centre, ((0.0, 0.0, 1.0),), *free, actuator=motor, **given)
        bodies.append(Body(f"wheel{i}", rim, water, joint))
    creature = Creature("wheels", tuple(bodies))
    inertias = [body.shape.inertia(body.mass)[2, 2] for body in creature.bodies]
    alone = 1 / (1 / inertias[0] + 1 / inertias[1]) + given.get("armature", 0.0)
    return World(build_tree(creature), 0.0), float(alone)


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
