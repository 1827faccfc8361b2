"""Fixed tendons of a creature as arrays of the physics (`tree.tendon` has the laws)."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import CreatureError, DegreeOfFreedom, Tendon
from evo_cpg.creature.laws import ForceLaws, laws_of
from evo_cpg.errors import nearest


class Tendons(ForceLaws):
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

    def places(self, tendon: int) -> tuple[int, ...]:
        """Return the places of a tendon's coefficients."""
        return tuple(i for i, owner in enumerate(self.owners) if owner == tendon)

    def without_motors(self, axes: Bool[np.ndarray, " d"]) -> "Tendons":
        """Return the tendons with idle motors where a tendon spans any of some joint axes."""
        idle = np.zeros(len(self.names), bool)
        idle[[owner for owner, dof in zip(self.owners, self.dofs, strict=True) if axes[dof]]] = True
        return self.with_idle(idle)


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
