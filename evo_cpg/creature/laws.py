"""Force laws of joint axes, tendons and balls as arrays of the physics.

A law acts on one coordinate: the angle of an axis, the length of a tendon, or the angle of a ball.
`evo_cpg.physics.tree` has the equations: `joint_torque`, `muscle`, `tendon` and `ball_limit`.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Self

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.creature.algebra.decisions import chosen, some_hold
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.axis_kinds import SPANNING
from evo_cpg.creature.creature import (
    NO_LIMIT,
    Actuator,
    CreatureError,
    DegreeOfFreedom,
    Muscle,
    Tendon,
    TorqueMotor,
)
from evo_cpg.errors import nearest

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
    """Motors whose torque the controller commands. `CoordinateLaws.torque_limit` has their limits.

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


class CoordinateLaws(eqx.Module):
    """Numbers of the force laws on some coordinates: angles of axes, or lengths of tendons.

    Units are those of `DegreeOfFreedom` for axes, and of `Tendon` for tendons.

    Attributes:
        stiffness: stiffness of the passive springs.
        damping: passive damping.
        armature: inertia of the rotors.
        dry_friction: dry friction, or None if there is none.
        lower: lower limit, or ``-NO_LIMIT`` (`evo_cpg.creature.creature`).
        upper: upper limit, or ``NO_LIMIT``.
        servo_gain: force of the motors per rate error, 0 without a servo.
        servo_stiffness: stiffness of the motors' springs.
        torque_limit: largest force of the motors.
        torque_motors: motors whose force is commanded, or None if there are none.
        muscles: muscles about the axes, or None if there are none. Tendons have none.
        limit_stiffness: stiffness of the soft limits.
        limit_damping: damping of the soft limits.
    """

    stiffness: Float[Numbers, " d"]
    damping: Float[Numbers, " d"]
    armature: Float[Numbers, " d"]
    dry_friction: DryFriction | None
    lower: Float[Numbers, " d"]
    upper: Float[Numbers, " d"]
    servo_gain: Float[Numbers, " d"]
    servo_stiffness: Float[Numbers, " d"]
    torque_limit: Float[Numbers, " d"]
    torque_motors: TorqueMotors | None
    muscles: Muscles | None
    limit_stiffness: Float[Numbers, " d"]
    limit_damping: Float[Numbers, " d"]

    def with_idle(self, which: Bool[np.ndarray, " d"]) -> Self:
        """Return the laws with idle motors, which have no torque and cost no energy.

        The springs and dampers of relaxed muscles stay.
        """
        limit, muscles = self.torque_limit, self.muscles
        if self.torque_motors is not None:
            limit = xp.where(np.array(self.torque_motors.driven) & which, 0.0, limit)
        if muscles is not None:
            active = ("strength", "stiffening", "power")
            none = {name: getattr(muscles, name) * ~which for name in active}
            muscles = dataclasses.replace(muscles, **none)
        return dataclasses.replace(
            self,
            servo_gain=self.servo_gain * ~which,
            servo_stiffness=self.servo_stiffness * ~which,
            torque_limit=limit,
            muscles=muscles,
        )


class BallLimits(eqx.Module):
    """Limits of the angles of ball joints, with the names of `CoordinateLaws`.

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


class Tendons(CoordinateLaws):
    """Fixed tendons, with the force laws on their lengths.

    Attributes:
        names: names of the tendons.
        owners: tendon of each coefficient.
        dofs: degree of freedom of each coefficient.
        channels: degree of freedom whose command the motor of each tendon follows, or -1 without a
            motor.
        coefficients: change of the tendon's length per change of the joint's angle.
        shortest_rest: shortest length at which a spring is slack.
        longest_rest: longest length at which a spring is slack.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    owners: tuple[int, ...] = eqx.field(static=True)
    dofs: tuple[int, ...] = eqx.field(static=True)
    channels: tuple[int, ...] = eqx.field(static=True)
    coefficients: Float[Numbers, " m"]
    shortest_rest: Float[Numbers, " t"]
    longest_rest: Float[Numbers, " t"]

    @property
    def torque_gears(self) -> dict[int, Number]:
        """Gear of the torque motor that follows the command of each degree of freedom."""
        motors = self.torque_motors
        if motors is None:
            return {}
        each = zip(self.channels, motors.driven, motors.gear, strict=True)
        return {channel: gear for channel, driven, gear in each if driven}


def ball_limits_of(
    dofs: Sequence[DegreeOfFreedom], stiffness: Float[Numbers, " d"], damping: Float[Numbers, " d"]
) -> BallLimits | None:
    """Return the limits of all balls, or None if no ball has one.

    Stiffness (N m/rad) and damping (N m s/rad) are those of the soft limit of each degree of
    freedom.
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


def laws_of(
    coordinates: Sequence[DegreeOfFreedom | Tendon], inertia: Float[Numbers, " d"]
) -> dict[str, Any]:
    """Return the fields of `CoordinateLaws` of some coordinates.

    A limit balances a torque motor like a servo of its full torque at 1 rad/s. A servo damps its
    joint, but a torque motor does not, so the limit has the damping of that servo.

    The inertias are the effective ones, without the rotors, kg m^2.
    """
    motors = [x.actuator for x in coordinates]
    servos = [x if isinstance(x, Actuator) else None for x in motors]
    gain = xp.array([x.gain if x else 0.0 for x in servos], float)
    spring = xp.array([x.stiffness if x else 0.0 for x in servos], float)
    # Muscles have no limit of their torque, and nothing pulls about a passive axis.
    limit = xp.array([getattr(x, "torque_limit", np.inf) if x else 0.0 for x in motors], float)
    torque_motors = muscles = None
    driven = tuple(isinstance(x, TorqueMotor) for x in motors)
    if any(driven):
        gears = [x.gear if isinstance(x, TorqueMotor) else 0.0 for x in motors]
        torque_motors = TorqueMotors(driven, xp.array(gears, float))
    own = [x if isinstance(x, Muscle) else None for x in motors]
    rows = [x.numbers if x else None for x in own]
    if any(own):
        muscles = Muscles(
            driven=tuple(x is not None for x in own),
            hill=tuple(x is not None and x.hill for x in own),
            # Axes without muscles divide by a curvature of 1.
            **{
                name: xp.array([x[name] if x else float(name == "curvature") for x in rows], float)
                for name in next(filter(None, rows))
            },
        )
    stiffness, loose, armature, loss, lower, upper = (
        xp.array([getattr(x, name) for x in coordinates], float)
        for name in ("stiffness", "damping", "armature", "friction_loss", "lower", "upper")
    )
    inertia = inertia + armature
    rate = 2 * np.pi * LIMIT_FREQUENCY
    push, damping = gain + spring, 2 * LIMIT_DAMPING_RATIO * inertia * rate
    if muscles is not None:
        push = push + muscles.strength
    if torque_motors is not None:
        full = xp.minimum(xp.abs(torque_motors.gear), limit)
        full = xp.where(np.array(torque_motors.driven), full, 0.0)
        push, damping = push + full, damping + full
    return {
        "stiffness": stiffness,
        "damping": loose,
        "armature": armature,
        "dry_friction": DryFriction(loss, inertia) if some_hold(lambda: loss != 0) else None,
        "lower": lower,
        "upper": upper,
        "servo_gain": gain,
        "servo_stiffness": spring,
        "torque_limit": limit,
        "torque_motors": torque_motors,
        "muscles": muscles,
        "limit_stiffness": inertia * rate**2 + push * rate,
        "limit_damping": damping,
    }


def tendons_of(
    tendons: Sequence[Tendon],
    dof_names: Sequence[str],
    dofs: Sequence[DegreeOfFreedom],
    inertia: Float[Numbers, " d"],
) -> Tendons | None:
    """Return the tendons of a creature, or None if it has none.

    The effective inertia of a tendon of joints with inertias I and coefficients c is about
    ``1 / sum c^2 / I``, plus its armature. Limits and dry friction use it.

    The motor of a tendon follows the command of the tendon's first joint without a motor of its own
    that no earlier tendon has taken.

    Args:
        tendons: the tendons.
        dof_names: names of the degrees of freedom.
        dofs: the degrees of freedom.
        inertia: effective inertia of each degree of freedom, with its rotor, kg m^2.

    Raises:
        CreatureError: a name is used twice, a tendon spans an unknown joint or a ball, or its
            motor finds no free command.
    """
    if not tendons:
        return None
    names, index = [tendon.name for tendon in tendons], {x: i for i, x in enumerate(dof_names)}
    owners: list[int] = []
    spanned: list[int] = []
    channels: list[int] = []
    for number, tendon in enumerate(tendons):
        where = "tendons", number
        if tendon.name in names[:number]:
            raise CreatureError(f"two tendons are called {tendon.name!r}", (*where, "name"))
        for name, _ in tendon.joints:
            if name not in index:
                raise CreatureError(
                    f"tendon {tendon.name!r} spans {name!r}, which is no degree of freedom: "
                    f"{nearest(name, list(dof_names))}",
                    (*where, "joints"),
                )
            if dofs[index[name]].kind.at_once:
                raise CreatureError(
                    f"tendon {tendon.name!r} spans {name!r}, a part of a ball joint, which has no "
                    "angle of its own. Allowed: axes that turn or slide",
                    (*where, "joints"),
                )
            owners.append(number)
            spanned.append(index[name])
        own = [index[name] for name, _ in tendon.joints]
        free = [i for i in own if dofs[i].actuator is None and i not in channels]
        if tendon.actuator is not None and not free:
            raise CreatureError(
                f"tendon {tendon.name!r} has a motor, but each of its joints has a motor or gives "
                "its command to another tendon. Leave one joint without an actuator",
                (*where, "actuator"),
            )
        channels.append(-1 if tendon.actuator is None else free[0])
    coefficients = xp.array([x for tendon in tendons for _, x in tendon.joints], float)
    softness = coefficients * coefficients / inertia[np.array(spanned, int)]
    belongs = np.arange(len(tendons))[:, None] == np.array(owners)
    return Tendons(
        names=tuple(names),
        owners=tuple(owners),
        dofs=tuple(spanned),
        channels=tuple(channels),
        coefficients=coefficients,
        shortest_rest=xp.array([tendon.rest[0] for tendon in tendons], float),
        longest_rest=xp.array([tendon.rest[1] for tendon in tendons], float),
        **laws_of(tendons, 1.0 / (belongs * softness).sum(1)),
    )
