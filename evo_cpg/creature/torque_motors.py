"""Torque motors of a creature as arrays of the physics."""

from collections.abc import Sequence

import equinox as eqx
from jaxtyping import Float

from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import TorqueMotor


class TorqueMotors(eqx.Module):
    """Motors whose torque the controller commands. `Tree.torque_limit` has their limits.

    Attributes:
        driven: True for each axis with such a motor.
        gear: torque per unit of a controller's output, N m, 0 about other axes.
    """

    driven: tuple[bool, ...] = eqx.field(static=True)
    gear: Float[Numbers, " d"]


def torque_motors_of(motors: Sequence[TorqueMotor | None]) -> TorqueMotors | None:
    """Return the torque motors of all axes, or None if no axis has one.

    Args:
        motors: the torque motor of each axis, or None for an axis without one.
    """
    if not any(motors):
        return None
    gears: list[Number] = [motor.gear if motor else 0.0 for motor in motors]
    return TorqueMotors(tuple(motor is not None for motor in motors), xp.array(gears, float))
