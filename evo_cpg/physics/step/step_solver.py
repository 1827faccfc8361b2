"""Solve one time step with contact: Newton's method with three outer updates.

The step is a strictly convex minimisation over the accelerations y (`step_problem`). The problem
fixes the friction-cone radii L, the restitution e and the velocity-product bias b of touching
limbs. Once Newton's iteration has solved the problem, the first update that is needed changes it,
and the iteration continues (`outer_updates`):

            free motion: fixes the velocity products
                 |
            first iterate: full Newton step at the warm start; e = 1, b at the start of the step
                 |
      +--------> solved? ------ no ------> Newton iteration: linearize, solve, line search
      |          | yes                     (60 in all, then y is returned as it is)
      +<-- L --- friction cone: Coulomb error > 1e-2?        L <- mu f_n (Anderson)
      |          | no, or the last round
      +<-- e --- restitution: contact injects energy?        e <- 1/2, 1/4, then 0
      |          | no, or e = 0
      +<-- b --- pair bias: touching limbs drift > 0.2 mm?   b <- b at the end of the step
                 | no, or the last update
                 y is the step's solution

The arrows on the left lead through a Newton iteration, too. float64 takes all rounds of cones.

The error that remains in Coulomb's law is reported (`Residual.coulomb`).
`evo_cpg.physics.step.step_derivative` has the derivatives.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.linear import matvec_t, where_each, where_needed
from evo_cpg.native.fuse import implicit, while_each
from evo_cpg.physics.step.equations import (
    Residual,
    StepSolution,
    Warmstart,
    prepare,
    with_mean_products,
)
from evo_cpg.physics.step.newton import Iterate, damped_step
from evo_cpg.physics.step.outer_updates import Cone, Outer, next_update
from evo_cpg.physics.step.step_derivative import SearchRecord, SolvedStep, Visited, replay
from evo_cpg.physics.step.step_problem import StepProblem
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand, clamp_torque
from evo_cpg.physics.tree.root import JOINTS, ROOT
from evo_cpg.physics.tree.state import State
from evo_cpg.physics.tree.tendon import length_of

# Most Newton iterations in a step.
_ITERATIONS = 60


class _Search(NamedTuple):
    """State of the iteration.

    Attributes:
        y: the iterate, accelerations of root and joints.
        visited: intermediate solutions, for derivatives.
    """

    y: Float[Array, "v *n"]
    outer: Outer
    iterations: Int[Array, "*n"]
    done: Bool[Array, "*n"]
    visited: Visited


def solve_step(
    world: World, h: float, state: State, command: MotorCommand, warmstart: Warmstart | None = None
) -> StepSolution:
    """Solve a step with contact or motors that have a largest torque.

    Steps with neither are solved at once, joint limits included (`equations.solve_at_once`).
    """
    equations = prepare(world, h, state, command)
    with jax.named_scope("free motion"):
        problem = StepProblem.of(world, h, equations)
        # The velocity products are means over the start and the end of the free motion. Individuals
        # whose free motion is wrong keep the initial ones.
        free = free_motion(problem)
        bias = where_needed(
            ~problem.needs_contact_or_other_limits(free),
            lambda: with_mean_products(world, h, equations, free[ROOT], free[JOINTS]).bias,
            equations.bias,
        )
        problem = StepProblem.of(world, h, equations._replace(bias=bias))
    batch = state.q.shape[1:]
    if warmstart is None:
        warmstart = coldstart(world, batch, state.q.dtype)
    radius, start = warmstart.radius, problem.under(jnp.ones(batch, state.q.dtype))
    first = start.motion(start.linearized(radius, warmstart.qdd, warmstart.velocity))
    visited, none = Visited.first(problem, first), jnp.zeros(batch, jnp.int32)
    template = SearchRecord(visited.cones, visited.biases, jnp.ones(batch, state.q.dtype), none)
    with jax.named_scope("search"):
        answer = implicit(
            functools.partial(_solve, problem, radius),
            functools.partial(replay, problem, radius),
            first,
            template,
        )
    # The forces of the laws at the solution.
    end, y, radius = problem.under(answer.restitution, answer.bias), answer.y, answer.radius
    qdd, velocity = y[JOINTS], end.velocity(y)
    linear, allowed = end.linearized(radius, qdd, velocity), end.cone_radius(velocity)
    contacts, local, force = end.equations.contacts, None, None
    if contacts is not None and linear.contact is not None:
        local = linear.contact.force
        force = matvec_t(contacts.frame, local)
    solved = jax.lax.stop_gradient(end.residual(y, linear))
    friction = jax.lax.stop_gradient(end.coulomb_error(radius, allowed, velocity, linear))
    tree, tendons, tension = world.tree, end.equations.tendons, None
    if tendons is not None:
        tension = tendons.motor.at(tendons.tendons, length_of(tendons.tendons, qdd), h)
        tension = clamp_torque(tendons.tendons, tension)
    return StepSolution(
        root=y[ROOT],
        qdd=qdd,
        torque=clamp_torque(tree, end.equations.motor.at(tree, qdd, h)),
        contact_frame_force=local,
        contact_force=force,
        pair_force=None if linear.pairs is None else linear.pairs.force,
        residual=Residual(solved, solved + friction),
        warmstart=Warmstart(qdd, velocity, allowed),
        tension=tension,
    )


def free_motion(problem: StepProblem) -> Float[Array, "v *n"]:
    """Return the accelerations without contact.

    Motors that exceed their torque limit at zero acceleration stay at that limit. The result is
    therefore wrong if there is contact, or if a motor leaves its limit. A light limb, for example,
    reaches 1000 rad/s although its motor leaves the limit at 50.
    """
    still = jnp.zeros_like(problem.force[JOINTS])
    linear = problem.linearized(problem.force[:0], still, None)
    return problem.motion(linear._replace(pairs=None))


def coldstart(world: World, batch: tuple[int, ...], dtype: DTypeLike) -> Warmstart:
    """Return the warm start of a first step: no contact, motors below their limits."""
    points = 0 if world.contact_model is None else len(world.contact_model.bodies)
    velocity = None if world.contact_model is None else jnp.zeros((3, points, *batch), dtype)
    qdd = jnp.zeros((world.tree.dof_count, *batch), dtype)
    return Warmstart(qdd, velocity, jnp.zeros((points, *batch), dtype))


def _solve(
    problem: StepProblem, radius: Float[Array, "p *n"], first: Float[Array, "v *n"]
) -> tuple[SolvedStep, SearchRecord]:
    """Iterate to the solution from a first iterate, with the first cone radii."""
    none, one = jnp.zeros(first.shape[1:], jnp.int32), jnp.ones(first.shape[1:], first.dtype)

    def advance(search: _Search) -> _Search:
        current = problem.under(search.outer.restitution, search.outer.bias)
        iterate = damped_step(current, search.outer.cone.radius, search.y)
        return updated(current, search._replace(iterations=search.iterations + 1), iterate)

    def updated(current: StepProblem, search: _Search, iterate: Iterate) -> _Search:
        outer, solved, change_cone = next_update(current, search.outer, iterate)
        visited = search.visited.updated(iterate.y, search.outer, change_cone)
        done = solved | (search.iterations >= _ITERATIONS)
        return _Search(iterate.y, outer, search.iterations, done, visited)

    start, outer = problem.under(one), Outer(Cone.first(radius), one, problem.pair_bias, none)
    begin = _Search(first, outer, none, none > 0, Visited.first(problem, first))
    begin = updated(start, begin, Iterate(first, start.velocity(first)))
    end = while_each(lambda search: ~search.done, advance, begin)
    answer = SolvedStep(end.y, end.outer.cone.radius, end.outer.restitution, end.outer.bias)
    # Rounds that an individual did not need repeat the solution of its last round.
    cones, visited = [end.visited.cones[0]], end.visited
    for k, solution in enumerate(visited.cones[1:], 1):
        cones.append(where_each(visited.last_round < k, cones[-1], solution))
    final = end.outer.restitution, end.outer.bias_updates
    return answer, SearchRecord(tuple(cones), visited.biases, *final)
