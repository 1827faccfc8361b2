"""Numbers of force laws that act on one coordinate: a joint axis, or the length of a tendon."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.creature.algebra.decisions import some_hold
from evo_cpg.creature.algebra.numerics import Numbers, xp
from evo_cpg.creature.torque_motors import TorqueMotors

# A soft limit is a critically damped spring on the effective inertia of the coordinate, with its
# rotor. A step of 1/120 s resolves it. The spring also balances the coordinate's own motor, which
# would otherwise push through. A motor that commands 1 rad/s, or 1 rad beyond the limit, gets
# 0.016 rad beyond it.
LIMIT_FREQUENCY = 10.0
LIMIT_DAMPING_RATIO = 1.0


class DryFriction(eqx.Module):
    """Dry friction of joint axes or tendons.

    Attributes:
        loss: largest torque, N m, or force of a tendon, N.
        inertia: effective inertia of each coordinate in the neutral pose, with its rotor, kg m^2.
    """

    loss: Float[Numbers, " d"]
    inertia: Float[Numbers, " d"]


def soft_limits(
    inertia: Float[Numbers, " d"],
    servo: Float[Numbers, " d"],
    torque_limit: Float[Numbers, " d"],
    torque_motors: TorqueMotors | None,
) -> tuple[Float[Numbers, " d"], Float[Numbers, " d"]]:
    """Return stiffness (N m/rad) and damping (N m s/rad) of soft limits.

    A limit balances a torque motor like a servo of its full torque at 1 rad/s. A servo damps its
    joint, and a torque motor does not. So the limit has the damping of that servo.

    Args:
        inertia: effective inertia of each coordinate, with its rotor, kg m^2.
        servo: torque of servos and muscles at a command of 1 rad/s and 1 rad, N m.
        torque_limit: largest torque of motors, N m.
        torque_motors: torque motors, or None.
    """
    rate = 2 * np.pi * LIMIT_FREQUENCY
    push, damping = servo, 2 * LIMIT_DAMPING_RATIO * inertia * rate
    if torque_motors is not None:
        full = xp.minimum(xp.abs(torque_motors.gear), torque_limit)
        full = xp.where(np.array(torque_motors.driven), full, 0.0)
        push, damping = push + full, damping + full
    return inertia * rate**2 + push * rate, damping


def dry_friction_of(
    loss: Float[Numbers, " d"], inertia: Float[Numbers, " d"]
) -> DryFriction | None:
    """Return the dry friction of joint axes or tendons (`DryFriction`), or None without any."""
    return DryFriction(loss, inertia) if some_hold(lambda: loss != 0) else None


def idle_motors(laws: Any, axes: Bool[np.ndarray, " d"]) -> dict[str, Numbers]:
    """Return the numbers of motors that change if some motors have no torque and cost no energy.

    Args:
        laws: `evo_cpg.creature.tree.Tree` or `evo_cpg.creature.tendons.Tendons`.
        axes: axes or tendons whose motors are idle.
    """
    limit = laws.torque_limit
    if laws.torque_motors is not None:
        limit = xp.where(np.array(laws.torque_motors.driven) & axes, 0.0, limit)
    gains = laws.servo_gain * ~axes, laws.servo_stiffness * ~axes
    return {"servo_gain": gains[0], "servo_stiffness": gains[1], "torque_limit": limit}
