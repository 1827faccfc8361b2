"""Limits of a sound gait, and the rules of a trial that follow from them."""

import dataclasses
from collections.abc import Sequence

from evo_cpg.creature.algebra.numerics import Number, xp
from evo_cpg.physics.contact.pairs import Pairs
from evo_cpg.simulation.simulation import Rules

# Default limits: depth in m, and as a fraction of the animal's length. The largest speed is the
# speed after a fall from `_FALL` lengths, with the earth's gravity in m/s^2. The largest joint rate
# is `_SWING` times the rate sqrt(g / length) of a pendulum as long as the animal. The factor is
# ours. It allows 23 rad/s at a length of 1.8 m.
_DEEPEST, _DEPTH, _FALL, _SWING, _GRAVITY = 0.01, 0.02, 20.0, 10.0, 9.81


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits of a sound gait.

    Fractions of the displacement refer to the champion's displacement in its own configuration.
    Fractions of energy refer to the absolute work of its motors.

    Attributes:
        half_step: least fraction of the displacement at half the physics step.
        quarter_step: least fraction at a quarter of the physics step.
        friction: least fraction with 10 % more and less friction.
        drag: least fraction with 10 % more and less drag.
        pose: least fraction from slightly different initial poses.
        surface_points: least fraction with other surface points in water.
        precision: least fraction in float64.
        other_engine: least fraction with the other engine.
        limp_way: largest fraction of the displacement with motors that exert no torque.
        simulator_energy: largest fraction of energy that no force explains, summed over intervals
            of a quarter of a second in which it is a gain.
        push_out_energy: largest fraction of energy from lifting sunken points out of the ground.
        limb_energy: largest fraction of energy from limbs that push each other apart.
        limit_energy: largest fraction of energy from soft limits that push joints back.
        simulator_momentum: largest fraction of the environment's impulses that no force explains.
        penetration: largest penetration of the ground, m, or None for 1 cm or a fiftieth of the
            animal's length, whichever is less.
        overlap: deepest overlap of two bodies, m, or None for the default of ``penetration``.
        unsolved: largest fraction of steps whose equations are not solved to 1e-3.
        slipping: largest fraction of steps whose friction misses its cone by a tenth.
        airborne_way: largest fraction of the displacement without contact with ground or water.
        overload: largest torque of a motor beyond its limit, as a fraction of the limit.
        speed: largest speed of the root, in lengths of the animal per second, or None for the speed
            after a fall from twenty times its length.
        joint_rate: largest rate of a turning axis, rad/s, or None for ten times sqrt(g / length) of
            the animal.
        power: largest power of all motors, W for each kg of animal, or None for no limit.
        free_energy: largest excess of the energy spent over the most that costs fitness, as a
            fraction of the latter.
        seen_through_ground: largest fraction of the light seen with ground in the way.
    """

    half_step: float = 0.9
    quarter_step: float = 0.8
    friction: float = 0.5
    drag: float = 0.5
    pose: float = 0.5
    surface_points: float = 0.5
    precision: float = 0.5
    other_engine: float = 0.5
    limp_way: float = 0.1
    simulator_energy: float = 0.1
    push_out_energy: float = 0.05
    limb_energy: float = 0.05
    limit_energy: float = 0.05
    simulator_momentum: float = 0.05
    penetration: float | None = None
    overlap: float | None = None
    unsolved: float = 0.01
    slipping: float = 0.05
    airborne_way: float = 0.5
    overload: float = 0.01
    speed: float | None = None
    joint_rate: float | None = None
    power: float | None = None
    free_energy: float = 0.0
    seen_through_ground: float = 0.01

    def of_length(self, length: Number) -> "Limits":
        """Return the limits with defaults that depend on the animal's length (m)."""
        depth = xp.minimum(_DEEPEST, _DEPTH * length)
        found = {
            "penetration": depth,
            "overlap": depth,
            "speed": xp.sqrt(2 * _GRAVITY * _FALL / length),
            "joint_rate": _SWING * xp.sqrt(_GRAVITY / length),
        }
        missing = {name: each for name, each in found.items() if getattr(self, name) is None}
        return dataclasses.replace(self, **missing)


def rules_of(
    names: Sequence[str],
    limits: Limits,
    length: Number,
    mass: Number,
    pairs: Pairs | None,
    fraction: float = 1.0,
) -> Rules:
    """Return the limits of some names as rules for an animal.

    Args:
        names: names of limits that are rules.
        limits: limits of the animal.
        length: its length, m.
        mass: its mass, kg.
        pairs: pairs of bodies that are checked for overlap.
        fraction: fraction of the limits that is allowed.
    """
    limits, units = limits.of_length(length), {"speed": length, "power": mass}
    most = {name: fraction * getattr(limits, name) * units.get(name, 1.0) for name in names}
    return Rules(**most, pairs=pairs if "overlap" in most else None)
