"""Newton's iteration on a step problem with fixed cones, restitution and pair bias.

One iteration linearizes the force laws at the iterate, solves for the accelerations, and searches
the line to that solution for the least potential. The problem is strictly convex
(`evo_cpg.physics.step.step_problem`), so the iteration converges to its only solution.

On the line ``y + a d``, with the length a in [0, 1], only the force laws are nonlinear. They are F
of the contact points, tau of motors and limits, and the forces of pairs. The velocities of contact
points change by a dv. The derivative of the potential along the line, pairs left out, is

    phi'(a) = h d . (M (y + a d) - M y_free - tau) - sum dv . F(v + a dv).

Its root is found by regula falsi with the Illinois rule.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.linear import dot, matvec
from evo_cpg.native.fuse import while_each
from evo_cpg.physics.step.step_problem import Linearization, StepProblem
from evo_cpg.physics.tree.root import JOINTS

# Largest residual (`StepProblem.residual`) of a solution. The second serves while the friction
# cones still change. In float64, in which derivatives are checked, the third serves for both.
_TOLERANCE, _ROUGH, _EXACT = 1e-3, 0.05, 1e-10

# Derivative at which a line search ends, as a fraction of the initial derivative, and the largest
# number of evaluations in a search.
_FLAT, _EVALUATIONS = 0.3, 30


class Iterate(NamedTuple):
    """An iterate, and results of its evaluation.

    Attributes:
        y: accelerations of root and joints.
        velocity: velocities of the contact points, m/s, or None without ground.
        pair_sums: `PairForces.sums`, or None if they are not known.
    """

    y: Float[Array, "v *n"]
    velocity: Float[Array, "3 p *n"] | None
    pair_sums: Any = None


class _Bracket(NamedTuple):
    """Interval of lengths that holds the root, and the latest evaluation.

    Attributes:
        low: a length at which the potential falls.
        at_low: derivative at the lower end, halved if that end has stayed.
        high: a length at which the potential rises.
        at_high: derivative at the upper end, halved if that end has stayed.
        length: the latest length.
        derivative: derivative at the latest length.
        moved: end that moved last: 1 the upper, -1 the lower, 0 none.
        pair_sums: `PairForces.sums` at the latest length.
    """

    low: Float[Array, "*n"]
    at_low: Float[Array, "*n"]
    high: Float[Array, "*n"]
    at_high: Float[Array, "*n"]
    length: Float[Array, "*n"]
    derivative: Float[Array, "*n"]
    moved: Int[Array, "*n"]
    evaluations: Int[Array, "*n"]
    pair_sums: Any


def tolerances(like: Array) -> tuple[float, float]:
    """Return the largest residual of a solution, and the one while the cones still change."""
    return (_EXACT, _EXACT) if like.dtype == jnp.float64 else (_TOLERANCE, _ROUGH)


def full_step(
    problem: StepProblem, radius: Float[Array, "p *n"], y: Float[Array, "v *n"]
) -> Float[Array, "v *n"]:
    """Return the accelerations under the force laws linearized at an iterate."""
    return problem.motion(problem.linearized(radius, y[JOINTS], problem.velocity(y)))


def damped_step(
    problem: StepProblem, radius: Float[Array, "p *n"], start: Float[Array, "v *n"]
) -> Iterate:
    """Return the next iterate: the one with the least potential on the line to the solution.

    The line leads from the accelerations ``start`` to those under the laws linearized there. If the
    potential hardly decreases along the line, its end is returned without a search.
    """
    velocity, h = problem.velocity(start), problem.h
    with jax.named_scope("linearized laws"):
        linear = problem.linearized(radius, start[JOINTS], velocity)
    with jax.named_scope("linear equations"):
        direction = problem.motion(linear) - start
    # If the potential falls more slowly than this (W per length), rounding would determine the
    # step's length.
    tolerance, _ = tolerances(start)
    least = h * tolerance**2 * problem.square_of_forces(start, linear)
    turning, pairs = direction[JOINTS], problem.equations.pairs
    change = None if velocity is None else problem.change_of_velocity(direction)
    parting = None if pairs is None else pairs.change(turning)
    linear_part = dot(direction, problem.resistance(start))
    curvature = dot(direction, matvec(problem.mass, direction))

    def at(length: Array) -> tuple[Array, Array | None]:
        """Return the accelerations, and the velocities of the contact points, at a length."""
        y = start + length[None] * direction
        if velocity is None or change is None:
            return y, None
        return y, velocity + length[None, None] * change

    def derivative_at(length: Array, laws: Linearization | None = None) -> tuple[Array, Any]:
        """Return phi' at a length, W, and the sums of the pairs there."""
        y, point_velocity = at(length)
        if laws is None:
            laws = problem.linearized(radius, y[JOINTS], point_velocity)
        total = h * (linear_part + length * curvature - dot(turning, problem.torque(y, laws)))
        if change is not None and laws.contact is not None:
            total = total - (change * laws.contact.force).sum((0, 1))
        if parting is not None and laws.pairs is not None:
            total = total - laws.pairs.power(parting)
        return total, None if laws.pairs is None else laws.pairs.sums

    one = jnp.ones_like(curvature)
    start_derivative, _ = derivative_at(0 * one, linear)
    end_derivative, end_sums = derivative_at(one)

    def unfinished(bracket: _Bracket) -> Bool[Array, "*n"]:
        steep = jnp.abs(bracket.derivative) > _FLAT * jnp.abs(start_derivative)
        return steep & (bracket.evaluations < _EVALUATIONS)

    def narrowed(bracket: _Bracket) -> _Bracket:
        low, at_low, high, at_high, length, here, moved, evaluations, _ = bracket
        rises = here > 0
        end_to_move = jnp.where(rises, 1, -1).astype(jnp.int32)
        again = moved == end_to_move
        low, high = jnp.where(rises, low, length), jnp.where(rises, length, high)
        # Illinois rule: halve the derivative at an end that stays twice.
        at_low = jnp.where(rises, jnp.where(again, 0.5 * at_low, at_low), here)
        at_high = jnp.where(rises, here, jnp.where(again, 0.5 * at_high, at_high))
        length = low - at_low * (high - low) / (at_high - at_low)
        found, pair_sums = derivative_at(length)
        ends = low, at_low, high, at_high, length, found
        return _Bracket(*ends, end_to_move, evaluations + 1, pair_sums)

    none = jnp.zeros(start_derivative.shape, jnp.int32)
    # A line along which the potential falls to its end needs no search.
    overshoots = (start_derivative < -least) & (end_derivative > 0)
    first = _Bracket(
        low=0 * one,
        at_low=start_derivative,
        high=one,
        at_high=end_derivative,
        length=one,
        derivative=jnp.where(overshoots, end_derivative, 0.0),
        moved=none,
        evaluations=none,
        pair_sums=end_sums,
    )
    with jax.named_scope("line"):
        last = while_each(unfinished, narrowed, first)
    return Iterate(*at(last.length), last.pair_sums)
