"""Motion of joints under a constant command to their motors and muscles."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.fusion.jax_internals import quick_jit
from evo_cpg.physics.joint_torque import MotorCommand
from evo_cpg.physics.state import resting_state
from evo_cpg.physics.step import step
from evo_cpg.physics.world import World


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
