"""Force laws of joint axes, tendons and balls as arrays of the physics.

A law acts on one coordinate: the angle of an axis, the length of a tendon, or the angle of a ball.
`evo_cpg.physics.tree.joint_torque` and `evo_cpg.physics.tree.muscle` have the equations.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.creature.algebra.decisions import chosen, some_hold
from evo_cpg.creature.algebra.numerics import Numbers, xp
from evo_cpg.creature.axis_kinds import SPANNING
from evo_cpg.creature.creature import NO_LIMIT, DegreeOfFreedom, Muscle, TorqueMotor

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


class TorqueMotors(eqx.Module):
    """Motors whose torque the controller commands. `Tree.torque_limit` has their limits.

    Attributes:
        driven: True for each axis with such a motor.
        gear: torque per unit of a controller's output, N m, 0 about other axes.
    """

    driven: tuple[bool, ...] = eqx.field(static=True)
    gear: Float[Numbers, " d"]


class Muscles(eqx.Module):
    """A pair of muscles about every joint axis. All numbers are 0 about axes without muscles.

    Attributes:
        driven: True for each axis with muscles.
        hill: True for each axis whose muscles depend on length and velocity.
        strength: alpha, torque of one fully active muscle, N m.
        stiffening: beta, stiffness that one fully active muscle adds, N m/rad.
        rest_stiffness: beta gamma, stiffness of relaxed muscles, N m/rad.
        damping: delta, N m s/rad.
        strain: e, change of the fibres' length per angle, 1/rad.
        slowness: q per joint rate, s/rad.
        curvature: k of Hill's curve, 1 about axes without muscles, which divide by it.
        power: F0 vmax, W.
    """

    driven: tuple[bool, ...] = eqx.field(static=True)
    hill: tuple[bool, ...] = eqx.field(static=True)
    strength: Float[Numbers, " d"]
    stiffening: Float[Numbers, " d"]
    rest_stiffness: Float[Numbers, " d"]
    damping: Float[Numbers, " d"]
    strain: Float[Numbers, " d"]
    slowness: Float[Numbers, " d"]
    curvature: Float[Numbers, " d"]
    power: Float[Numbers, " d"]


class BallLimits(eqx.Module):
    """Limits of the angles of ball joints, with the names of the laws of joint axes (`Tree`).

    Attributes:
        first: first degree of freedom of each ball with a limit.
        lower: no limit, because the angle of a rotation is never negative.
        upper: largest angle, rad.
        limit_stiffness: stiffness of the soft limits, N m/rad, the largest of a ball's three axes.
        limit_damping: damping of the soft limits, N m s/rad.
    """

    first: tuple[int, ...] = eqx.field(static=True)
    lower: Float[Numbers, " b"]
    upper: Float[Numbers, " b"]
    limit_stiffness: Float[Numbers, " b"]
    limit_damping: Float[Numbers, " b"]


def torque_motors_of(motors: Sequence[TorqueMotor | None]) -> TorqueMotors | None:
    """Return the torque motors of all axes, or None if no axis has one."""
    if not any(motors):
        return None
    gears = xp.array([motor.gear if motor else 0.0 for motor in motors], float)
    return TorqueMotors(tuple(motor is not None for motor in motors), gears)


def muscles_of(motors: Sequence[Muscle | None]) -> Muscles | None:
    """Return the muscles about all axes, or None if no axis has muscles."""
    if not any(motors):
        return None
    without = {"curvature": 1.0}
    numbers = {
        field.name: xp.array(
            [getattr(m, field.name) if m else without.get(field.name, 0.0) for m in motors], float
        )
        for field in dataclasses.fields(Muscles)
        if field.name not in ("driven", "hill")
    }
    return Muscles(
        driven=tuple(m is not None for m in motors),
        hill=tuple(m is not None and m.hill for m in motors),
        **numbers,
    )


def ball_limits_of(
    dofs: Sequence[DegreeOfFreedom],
    stiffness: Float[Numbers, " d"],
    damping: Float[Numbers, " d"],
) -> BallLimits | None:
    """Return the limits of all balls, or None if no ball has one.

    Args:
        dofs: all degrees of freedom.
        stiffness: stiffness of the soft limit of each, N m/rad.
        damping: damping of the soft limit of each, N m s/rad.
    """
    balls = [i for i, dof in enumerate(dofs) if dof.kind.at_once][::SPANNING]
    if not balls:
        return None
    limited = chosen(lambda: [dofs[i].upper < NO_LIMIT for i in balls])
    first = tuple(i for i, has in zip(balls, limited, strict=True) if has)
    if not first:
        return None
    rows = np.array(first)[:, None] + np.arange(SPANNING)
    return BallLimits(
        first,
        np.full(len(first), -NO_LIMIT),
        xp.array([dofs[i].upper for i in first], float),
        xp.max(stiffness[rows], 1),
        xp.max(damping[rows], 1),
    )


def soft_limits(
    inertia: Float[Numbers, " d"],
    servo: Float[Numbers, " d"],
    torque_limit: Float[Numbers, " d"],
    torque_motors: TorqueMotors | None,
) -> tuple[Float[Numbers, " d"], Float[Numbers, " d"]]:
    """Return stiffness (N m/rad) and damping (N m s/rad) of soft limits.

    A limit balances a torque motor like a servo of its full torque at 1 rad/s. A servo damps its
    joint, but a torque motor does not, so the limit has the damping of that servo.

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
    """Return the dry friction of joint axes or tendons, or None without any."""
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
