"""Fixed tendons of a creature as arrays of the physics (`tree.tendon` has the laws)."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import CreatureError, Tendon, driven_by
from evo_cpg.creature.laws import (
    DryFriction,
    TorqueMotors,
    dry_friction_of,
    idle_motors,
    soft_limits,
    torque_motors_of,
)
from evo_cpg.errors import nearest


class Tendons(eqx.Module):
    """Fixed tendons. Their laws have the same names as those of joint axes (`Tree`).

    Units are those of `Tendon`.

    Attributes:
        names: names of the tendons.
        owners: tendon of each coefficient.
        dofs: degree of freedom of each coefficient.
        channels: degree of freedom whose command the motor of each tendon follows, or -1 without a
            motor.
        coefficients: change of the tendon's length per change of the joint's angle.
        stiffness: stiffness of the springs.
        shortest_rest: shortest length at which a spring is slack.
        longest_rest: longest length at which a spring is slack.
        damping: damping.
        armature: inertia that moves with the rate of length.
        dry_friction: dry friction, or None if there is none.
        lower: lower limit of the length, or ``-NO_LIMIT``.
        upper: upper limit of the length, or ``NO_LIMIT``.
        servo_gain: force of the motors per rate error, 0 without a servo.
        servo_stiffness: force of the motors per error of length.
        torque_limit: largest force of the motors.
        torque_motors: motors whose force is commanded, or None if there are none.
        limit_stiffness: stiffness of the soft limits.
        limit_damping: damping of the soft limits.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    owners: tuple[int, ...] = eqx.field(static=True)
    dofs: tuple[int, ...] = eqx.field(static=True)
    channels: tuple[int, ...] = eqx.field(static=True)
    coefficients: Float[Numbers, " m"]
    stiffness: Float[Numbers, " t"]
    shortest_rest: Float[Numbers, " t"]
    longest_rest: Float[Numbers, " t"]
    damping: Float[Numbers, " t"]
    armature: Float[Numbers, " t"]
    dry_friction: DryFriction | None
    lower: Float[Numbers, " t"]
    upper: Float[Numbers, " t"]
    servo_gain: Float[Numbers, " t"]
    servo_stiffness: Float[Numbers, " t"]
    torque_limit: Float[Numbers, " t"]
    torque_motors: TorqueMotors | None
    limit_stiffness: Float[Numbers, " t"]
    limit_damping: Float[Numbers, " t"]
    # Tendons have no muscles.
    muscles: None = eqx.field(static=True, default=None)

    @property
    def torque_gears(self) -> dict[int, Number]:
        """Gear of the torque motor that follows the command of each degree of freedom."""
        motors = self.torque_motors
        if motors is None:
            return {}
        each = zip(self.channels, motors.driven, motors.gear, strict=True)
        return {channel: gear for channel, driven, gear in each if driven}

    def places(self, tendon: int) -> tuple[int, ...]:
        """Return the places of a tendon's coefficients."""
        return tuple(i for i, owner in enumerate(self.owners) if owner == tendon)

    def without_motors(self, axes: Bool[np.ndarray, " d"]) -> "Tendons":
        """Return the tendons with idle motors where a tendon spans any of some joint axes."""
        idle = np.zeros(len(self.names), bool)
        idle[[owner for owner, dof in zip(self.owners, self.dofs, strict=True) if axes[dof]]] = True
        return dataclasses.replace(self, **idle_motors(self, idle))


def tendons_of(
    tendons: Sequence[Tendon],
    dof_names: Sequence[str],
    idle: Sequence[bool],
    ball: Sequence[bool],
    inertia: Float[Numbers, " d"],
) -> Tendons | None:
    """Return the tendons of a creature, or None if it has none.

    The effective inertia of a tendon of joints with inertias I and coefficients c is about
    ``1 / sum c^2 / I``, plus its armature. Limits and dry friction use it.

    Args:
        tendons: the tendons.
        dof_names: names of the degrees of freedom.
        idle: whether each degree of freedom lacks a motor of its own.
        ball: whether each degree of freedom belongs to a ball joint.
        inertia: effective inertia of each degree of freedom, with its rotor, kg m^2.

    Raises:
        CreatureError: a name is used twice, a tendon spans an unknown joint or a ball, or its
            motor finds no free command.
    """
    if not tendons:
        return None
    owners, dofs = [], []
    names = [tendon.name for tendon in tendons]
    for number, tendon in enumerate(tendons):
        if tendon.name in names[:number]:
            raise CreatureError(
                f"two tendons are called {tendon.name!r}", ("tendons", number, "name")
            )
        for name, _ in tendon.joints:
            if name not in dof_names:
                raise CreatureError(
                    f"tendon {tendon.name!r} spans {name!r}, which is no degree of freedom: "
                    f"{nearest(name, list(dof_names))}",
                    ("tendons", number, "joints"),
                )
            if ball[list(dof_names).index(name)]:
                raise CreatureError(
                    f"tendon {tendon.name!r} spans {name!r}, a part of a ball joint, which has no "
                    "angle of its own. Allowed: axes that turn or slide",
                    ("tendons", number, "joints"),
                )
            owners.append(number)
            dofs.append(list(dof_names).index(name))
    coefficients = xp.array([x for tendon in tendons for _, x in tendon.joints], float)
    softness = coefficients * coefficients / inertia[np.array(dofs, int)]
    belongs = np.arange(len(tendons))[:, None] == np.array(owners)

    def each(name: str) -> Float[Numbers, " t"]:
        return xp.array([getattr(tendon, name) for tendon in tendons], float)

    armature, loss = each("armature"), each("friction_loss")
    own = 1.0 / (belongs * softness).sum(1) + armature
    gain, spring, limit, motors, _ = zip(*(driven_by(x.actuator) for x in tendons), strict=True)
    gain, spring, limit = (xp.array(list(x), float) for x in (gain, spring, limit))
    torque_motors = torque_motors_of(motors)
    limit_stiffness, limit_damping = soft_limits(own, gain + spring, limit, torque_motors)
    return Tendons(
        names=tuple(names),
        owners=tuple(owners),
        dofs=tuple(dofs),
        channels=_channels(tendons, dof_names, idle),
        coefficients=coefficients,
        stiffness=each("stiffness"),
        shortest_rest=xp.array([tendon.rest[0] for tendon in tendons], float),
        longest_rest=xp.array([tendon.rest[1] for tendon in tendons], float),
        damping=each("damping"),
        armature=armature,
        dry_friction=dry_friction_of(loss, own),
        lower=each("lower"),
        upper=each("upper"),
        servo_gain=gain,
        servo_stiffness=spring,
        torque_limit=limit,
        torque_motors=torque_motors,
        limit_stiffness=limit_stiffness,
        limit_damping=limit_damping,
    )


def _channels(
    tendons: Sequence[Tendon], dof_names: Sequence[str], idle: Sequence[bool]
) -> tuple[int, ...]:
    """Return the degree of freedom whose command each motor follows, or -1 without a motor.

    It is the tendon's first joint without a motor of its own that no earlier tendon has taken.

    Raises:
        CreatureError: there is no such joint.
    """
    found: list[int] = []
    for number, tendon in enumerate(tendons):
        free = [
            dof
            for dof in (list(dof_names).index(name) for name, _ in tendon.joints)
            if idle[dof] and dof not in found
        ]
        if tendon.actuator is None:
            found.append(-1)
            continue
        if not free:
            raise CreatureError(
                f"tendon {tendon.name!r} has a motor, but each of its joints has a motor or gives "
                "its command to another tendon. Leave one joint without an actuator",
                ("tendons", number, "actuator"),
            )
        found.append(free[0])
    return tuple(found)
