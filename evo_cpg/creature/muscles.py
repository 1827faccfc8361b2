"""Muscles of a creature as arrays of the physics (`tree.muscle` has the equations)."""

from collections.abc import Sequence

import equinox as eqx
from jaxtyping import Float

from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import Muscle


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
        curvature: k of Hill's curve.
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


def muscles_of(motors: Sequence[Muscle | None]) -> Muscles | None:
    """Return the muscles about all axes, or None if no axis has muscles.

    Args:
        motors: the muscles about each axis, or None for an axis without muscles.
    """
    if not any(motors):
        return None

    def each(name: str, without: float = 0.0) -> Float[Numbers, " d"]:
        values: list[Number] = [getattr(m, name) if m else without for m in motors]
        return xp.array(values, float)

    return Muscles(
        driven=tuple(m is not None for m in motors),
        hill=tuple(m is not None and m.hill for m in motors),
        strength=each("strength"),
        stiffening=each("stiffening"),
        rest_stiffness=each("rest_stiffness"),
        damping=each("damping"),
        strain=each("strain"),
        slowness=each("slowness"),
        # Axes without muscles divide by it.
        curvature=each("curvature", 1.0),
        power=each("power"),
    )
