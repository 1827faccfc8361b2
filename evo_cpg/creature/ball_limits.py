"""Limits of ball joints as arrays of the physics (`tree.ball_limit` has the law)."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Numbers, xp
from evo_cpg.creature.creature import NO_LIMIT, SPANNING, DegreeOfFreedom


class BallLimits(eqx.Module):
    """Limits of the angles of ball joints. The names are those of the laws of joint axes (`Tree`).

    Attributes:
        first: first degree of freedom of each ball with a limit.
        lower: no limit. The angle of a rotation is never negative.
        upper: largest angle, rad.
        limit_stiffness: stiffness of the soft limits, N m/rad, the largest of a ball's three axes.
        limit_damping: damping of the soft limits, N m s/rad.
    """

    first: tuple[int, ...] = eqx.field(static=True)
    lower: Float[Numbers, " b"]
    upper: Float[Numbers, " b"]
    limit_stiffness: Float[Numbers, " b"]
    limit_damping: Float[Numbers, " b"]


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
    balls = [i for i, dof in enumerate(dofs) if dof.kind == "ball"][::SPANNING]
    if not balls:
        return None

    def limited() -> list[bool]:
        return [dofs[i].upper < NO_LIMIT for i in balls]

    first = tuple(i for i, has in zip(balls, chosen(limited), strict=True) if has)
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
