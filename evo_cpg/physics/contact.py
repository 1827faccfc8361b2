"""Contact with the ground: it holds, lets slide and throws back."""

from typing import Literal

import equinox as eqx

# How two materials' values become one. The factors 0.6 x 0.9 and 0.3 x 0.9 of Fukui 2003 suggest
# products for restitution; PhysX averages unless told otherwise, Havok is believed to take the
# geometric mean of frictions and the larger restitution.
Combination = Literal["multiply", "average", "geometric", "min", "max"]


class Ground(eqx.Module):
    """Flat ground.

    Attributes:
        restitution: of its material.
        static_friction: of its material.
        dynamic_friction: of its material.
        restitution_rule: how the body's and the ground's restitution combine.
        friction_rule: how their frictions combine.
        normal: unit vector out of the ground.
        height: of the plane above the world's origin along its normal, m.
        margin: points nearer than this are watched for an impact within the next step, m; it does
            not hold bodies off the ground.
        stribeck_speed: sliding speed at which friction has gone half of the way from static to
            dynamic, m/s.
    """

    restitution: float = 0.5
    static_friction: float = 0.8
    dynamic_friction: float = 0.8
    restitution_rule: Combination = eqx.field(static=True, default="multiply")
    friction_rule: Combination = eqx.field(static=True, default="geometric")
    normal: tuple[float, float, float] = eqx.field(static=True, default=(0.0, 0.0, 1.0))
    height: float = 0.0
    margin: float = 0.05
    stribeck_speed: float = 0.01
