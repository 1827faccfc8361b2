"""Newton's iteration on a step problem with fixed cones, restitution and pair bias.

One iteration linearises the force laws at the iterate, solves for the accelerations, and searches
the line to that solution for the least potential. The problem is strictly convex
(`evo_cpg.physics.step_problem`), so the iteration converges to its only solution.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.physics.line_search import line_search
from evo_cpg.physics.root import joint_part
from evo_cpg.physics.step_problem import StepProblem

# Largest residual (`StepProblem.residual`) of a solution. The second serves while the friction
# cones still change. In float64, in which derivatives are checked, the third serves for both.
_TOLERANCE, _ROUGH, _EXACT = 1e-3, 0.05, 1e-10


def tolerances(like: Array) -> tuple[float, float]:
    """Return the largest residual of a solution, and the one while the cones still change."""
    return (_EXACT, _EXACT) if like.dtype == jnp.float64 else (_TOLERANCE, _ROUGH)


def full_step(
    problem: StepProblem, radius: Float[Array, "p *n"], y: Float[Array, "v *n"]
) -> Float[Array, "v *n"]:
    """Return the accelerations under the force laws linearised at an iterate.

    Args:
        problem: of the step.
        radius: of the friction cones, N.
        y: the iterate.
    """
    return problem.motion(problem.linearized(radius, joint_part(y), problem.velocity(y)))


def damped_step(
    problem: StepProblem, radius: Float[Array, "p *n"], y: Float[Array, "v *n"]
) -> tuple[Float[Array, "v *n"], Float[Array, "3 p *n"] | None]:
    """Return the next iterate, and the velocities of the contact points in it.

    Args:
        problem: of the step.
        radius: of the friction cones, N.
        y: the iterate.
    """
    velocity = problem.velocity(y)
    linear = problem.linearized(radius, joint_part(y), velocity)
    # Below this slope rounding would decide the length of the step.
    tolerance, _ = tolerances(y)
    least = problem.h * tolerance**2 * problem.square_of_forces(y, linear)
    return line_search(problem, radius, y, velocity, problem.motion(linear), least)
