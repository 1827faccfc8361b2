"""How far to go along a Newton step: where the potential of a step's motion is least.

Along the way d from the accelerations y, with the share a of it, everything is linear but the laws
F of the points, whose velocities change by dv, and those tau of the motors:

    phi'(a) = h d . (M (y + a d) - M y_free - tau) - sum dv . F(v + a dv)
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from evo_cpg.fusion.converge import while_each
from evo_cpg.physics.root import joint_part
from evo_cpg.physics.step_problem import StepProblem
from evo_cpg.spatial.linear import dot, matvec

# Slope at which a line search ends, as a share of that at its start; evaluations at most.
_FLAT, _EVALUATIONS = 0.3, 30


def line_search(
    problem: StepProblem,
    radius: Float[Array, "p *n"],
    start: Float[Array, "v *n"],
    velocity: Float[Array, "3 p *n"] | None,
    end: Float[Array, "v *n"],
    least: Float[Array, "*n"],
) -> tuple[Float[Array, "v *n"], Float[Array, "3 p *n"] | None]:
    """The motion with the least potential between two others, and the contact points' velocity.

    Args:
        problem: whose potential it is.
        radius: of the friction cones.
        start: a motion.
        velocity: of the contact points in it.
        end: the motion under the laws linearized there.
        least: slope (W) from which on the way is searched: where the potential falls less steeply
            at its start, all of it is gone.
    """
    way, h = end - start, problem.h
    turn, pairs = joint_part(way), problem.equations.pairs
    change = None if velocity is None else problem.change_of_velocity(way)
    parting = None if pairs is None else pairs.change(turn)
    rest, bend = dot(way, problem.resistance(start)), dot(way, matvec(problem.mass, way))

    def at(share: Array) -> tuple[Array, Array | None]:
        now = start + share[None] * way
        if velocity is None or change is None:
            return now, None
        return now, velocity + share[None, None] * change

    def slope(share: Array) -> Array:
        y, now = at(share)
        there = problem.linearized(radius, joint_part(y), now)
        total = h * (rest + share * bend - dot(turn, problem.torque(y, there)))
        if change is not None and there.contact is not None:
            total = total - (change * there.contact.force).sum((0, 1))
        if parting is not None and there.pairs is not None:
            total = total - there.pairs.power(parting)
        return total

    one = jnp.ones_like(bend)
    at_start, at_end = slope(0 * one), slope(one)

    def goes_on(given: tuple) -> Bool[Array, "*n"]:
        *_, here, _, count = given
        return (jnp.abs(here) > _FLAT * jnp.abs(at_start)) & (count < _EVALUATIONS)

    def closer(given: tuple) -> tuple:
        # Regula falsi; a bound that stays twice counts half (Illinois).
        low, below, high, above, share, here, side, count = given
        rises = here > 0
        now = jnp.where(rises, 1, -1).astype(jnp.int32)
        again = side == now
        low, high = jnp.where(rises, low, share), jnp.where(rises, share, high)
        below = jnp.where(rises, jnp.where(again, 0.5 * below, below), here)
        above = jnp.where(rises, here, jnp.where(again, 0.5 * above, above))
        share = low - below * (high - low) / (above - below)
        return low, below, high, above, share, slope(share), now, count + 1

    none = jnp.zeros(at_start.shape, jnp.int32)
    # Where it no longer falls, but for rounding, the whole way is gone.
    rises = (at_start < -least) & (at_end > 0)
    begin = 0 * one, at_start, one, at_end, one, jnp.where(rises, at_end, 0.0), none, none
    return at(while_each(goes_on, closer, begin)[4])
