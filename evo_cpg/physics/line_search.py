"""How far to go along a Newton step: where the potential of a step's motion is least.

The exact line search needs no mass matrix. An iterate is the answer to the equations under certain
forces ``f`` at the points (and torques), which need not obey the laws. Between two of them,
everything is linear but the laws F, so along the way with the share a

    phi'(a) = sum dv . (f + a df - F(v + a dv)) + the same for the motors.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from evo_cpg.fusion.converge import while_each
from evo_cpg.physics.equations import Linearization
from evo_cpg.physics.pairs import parting_change
from evo_cpg.physics.step_problem import Iterate, StepProblem
from evo_cpg.spatial.linear import of_each

# Slope at which a line search ends, as a share of that at its start; evaluations at most.
_FLAT, _EVALUATIONS = 0.3, 30

# Slope (W) that counts as none; quotients of smaller ones would be no numbers.
_LEVEL = 1e-30


def line_search(
    problem: StepProblem,
    radius: Float[Array, "p *n"],
    start: Iterate,
    linear: Linearization,
    end: Iterate,
) -> tuple[Iterate, Linearization]:
    """The point with the least potential between two iterates, and the laws linearized there.

    Args:
        problem: whose potential it is.
        radius: of the friction cones.
        start: an iterate.
        linear: the laws linearized there.
        end: the motion under these.
    """
    way = jax.tree.map(jnp.subtract, end, start)

    def at(share: Array) -> Iterate:
        return jax.tree.map(lambda x, d: x + of_each(share, x) * d, start, way)

    def slope(here: Iterate, linear: Linearization) -> Array:
        torque, force, push = problem.force_residual(here, linear)
        total = problem.h * (way.qdd * torque).sum(0)
        if force is not None:
            total = total + (way.velocity * force).sum((0, 1))
        pairs = problem.equations.pairs
        if push is None or pairs is None:
            return total
        return total + (parting_change(pairs, way.qdd, problem.h) * push).sum(0)

    at_start, at_end = slope(start, linear), slope(end, problem.linearized_at(radius, end))

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
        iterate = at(share)
        here = slope(iterate, problem.linearized_at(radius, iterate))
        return low, below, high, above, share, here, now, count + 1

    one = jnp.ones_like(at_start)
    none = jnp.zeros(at_start.shape, jnp.int32)
    # Where it no longer falls, but for rounding, the whole way is gone.
    rises = (at_start < -_LEVEL) & (at_end > 0)
    begin = 0 * one, at_start, one, at_end, one, jnp.where(rises, at_end, 0.0), none, none
    found = at(while_each(goes_on, closer, begin)[4])
    return found, problem.linearized_at(radius, found)
