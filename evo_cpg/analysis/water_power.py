"""Thrust and power that a recorded swimmer puts into the water, from the force laws.

The net force on a free swimmer is zero on average, so a force law that pushes has to be told from
laws that resist. **Thrust** is the force of reactive thrust alone: of the water that leaves the
tail (`evo_cpg.physics.water.reactive_thrust`). **Power** is the energy that all laws of the water
take from the body per time. Over whole cycles it is the power of the muscles into the water.

Without reactive thrust, drag both pushes and resists, and thrust cannot be told apart. Such an
animal needs a tow.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis.along_time import along_time
from evo_cpg.creature.algebra.linear import cross, expand_dims_like, matvec
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joints import Subspace
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.water.reactive_thrust import ReactiveThrust


class WaterPower(NamedTuple):
    """Force and power at every control step.

    Attributes:
        thrust: force of reactive thrust on the whole body, world axes, N.
        power: energy that the water takes from the body per time, W.
    """

    thrust: Float[np.ndarray, "t 3"]
    power: Float[np.ndarray, " t"]


def water_power(
    world: World, frames: Mapping[str, Array | np.ndarray], h: float
) -> WaterPower | None:
    """Return thrust and power of a recorded trial, or None without reactive thrust.

    Args:
        world: world of the trial.
        frames: ``full`` frames of one individual (`evo_cpg.simulation.recording.Recorder`).
        h: duration of a physics step, s.
    """
    if world.law(ReactiveThrust) is None or "angular_velocity" not in frames:
        return None
    laws = [law for law in world.forces if law.of_water]

    def of_step(position: Array, rotation: Array, velocity: Array, turning: Array) -> tuple:
        lever = matvec(rotation, expand_dims_like(world.tree.centre, position))
        still = jnp.zeros_like(position)
        kin = Kinematics(
            rotation=rotation,
            origin=position - lever,
            offset=still,
            axes=Subspace(still[:, :0]),
            angular=turning,
            linear=velocity - cross(turning, lever),
            bias_angular=still,
            bias_linear=still,
        )
        bodies = world.bodies(kin, h)
        thrust, power = jnp.zeros_like(position[:, 0]), jnp.zeros_like(position[0, 0])
        for law in laws:
            wrench = law.wrench(bodies)
            power = power - (wrench * bodies.relative).sum((0, 1))
            if isinstance(law, ReactiveThrust):
                thrust = thrust + matvec(rotation, wrench[3:]).sum(1)
        return thrust, power

    names = ("position", "rotation", "velocity", "angular_velocity")
    steps = [np.moveaxis(np.asarray(frames[name])[..., 0], 0, -1) for name in names]
    thrust, power = along_time(of_step, *steps)
    return WaterPower(thrust.T, power)
