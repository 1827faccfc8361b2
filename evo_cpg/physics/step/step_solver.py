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

Derivatives use the implicit function theorem. One more Newton step at a solution changes nothing,
and its derivative is the derivative of the solution. `_replay` takes that step in every round of
cones, and under every further pair bias.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.linear import matvec_t, where_each
from evo_cpg.native.fuse import implicit, while_each
from evo_cpg.physics.step.equations import (
    ContactForces,
    Residual,
    StepSolution,
    Warmstart,
    prepare,
    with_mean_products,
)
from evo_cpg.physics.step.newton import Iterate, damped_step, full_step, tolerances
from evo_cpg.physics.step.outer_updates import Cone, PairBias, reduced
from evo_cpg.physics.step.step_problem import StepProblem
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand, clamp_torque
from evo_cpg.physics.tree.root import joint_part, root_part
from evo_cpg.physics.tree.state import State

# Most rounds of friction cones, values of the pair bias, and Newton iterations in a step.
_CONE_ROUNDS, _PAIR_BIASES, _ITERATIONS = 8, 3, 60

# Largest Coulomb error (`StepProblem.coulomb_error`) at which float32 stops updating the cones.
_COULOMB = 1e-2


class _Visited(NamedTuple):
    """Intermediate solutions, at which `_replay` takes its Newton steps.

    Attributes:
        cones: accelerations under each round of cones with the first pair bias.
        biases: accelerations under each further pair bias.
    """

    cones: tuple[Float[Array, "v *n"], ...]
    biases: tuple[Float[Array, "v *n"], ...]


class _Search(NamedTuple):
    """State of the iteration.

    Attributes:
        y: the iterate, accelerations of root and joints.
        cone: friction cones of the current problem.
        restitution: remaining fraction of the restitution, 0 to 1.
        bias: velocity-product bias of pairs.
        iterations: number of Newton iterations.
        done: whether y is the solution.
        visited: intermediate solutions.
        last_round_of_first_bias: number of the last round of cones under the first pair bias.
    """

    y: Float[Array, "v *n"]
    cone: Cone
    restitution: Float[Array, "*n"]
    bias: PairBias
    iterations: Int[Array, "*n"]
    done: Bool[Array, "*n"]
    visited: _Visited
    last_round_of_first_bias: Int[Array, "*n"]


class _Answer(NamedTuple):
    """The solution y, and the parameters of its problem (see `_Search`)."""

    y: Float[Array, "v *n"]
    radius: Float[Array, "p *n"]
    restitution: Float[Array, "*n"]
    bias: Float[Array, "k *n"]


class _Record(NamedTuple):
    """Input of `_replay` (see `_Search`)."""

    visited: _Visited
    restitution: Float[Array, "*n"]
    bias_updates: Int[Array, "*n"]


def solve_step(
    world: World,
    h: float,
    state: State,
    command: MotorCommand,
    warmstart: Warmstart | None = None,
) -> StepSolution:
    """Solve a step with contact or motors that have a largest torque.

    Steps with neither are solved at once, joint limits included (`equations.solve_at_once`).

    Args:
        world: the creature and its environment.
        h: step, s.
        state: state at the start of the step.
        command: command to motors and muscles.
        warmstart: result of the previous step, or None for a first step.
    """
    problem = _with_velocity_products(world, h, state, command)
    batch = state.q.shape[1:]
    if warmstart is None:
        warmstart = coldstart(world, batch, state.q.dtype)
    one = jnp.ones(batch, state.q.dtype)
    radius, start = warmstart.radius, problem.with_restitution(one)
    first = start.motion(start.linearized(radius, warmstart.qdd, warmstart.velocity))
    template = _Record(_none_visited(problem, first), one, jnp.zeros(batch, jnp.int32))
    answer = implicit(
        functools.partial(_solve, problem, radius),
        functools.partial(_replay, problem, radius),
        first,
        template,
    )
    end = problem.with_restitution(answer.restitution).with_pair_bias(answer.bias)
    return _solution(end, answer.radius, answer.y)


def free_motion(problem: StepProblem) -> Float[Array, "v *n"]:
    """Return the accelerations without contact.

    Motors that exceed their torque limit at zero acceleration stay at that limit. The result is
    therefore wrong if there is contact, or if a motor leaves its limit. A light limb, for example,
    reaches 1000 rad/s although its motor leaves the limit at 50.
    """
    still = jnp.zeros_like(joint_part(problem.force))
    linear = problem.linearized(problem.force[:0], still, None)
    return problem.motion(linear._replace(pairs=None))


def coldstart(world: World, batch: tuple[int, ...], dtype: DTypeLike) -> Warmstart:
    """Return the warm start of a first step: no contact, motors below their limits."""
    points = 0 if world.contact_model is None else len(world.contact_model.bodies)
    velocity = None if world.contact_model is None else jnp.zeros((3, points, *batch), dtype)
    qdd = jnp.zeros((world.tree.dof_count, *batch), dtype)
    return Warmstart(qdd, velocity, jnp.zeros((points, *batch), dtype))


def _with_velocity_products(
    world: World,
    h: float,
    state: State,
    command: MotorCommand,
) -> StepProblem:
    """Return the problem of a step.

    Its velocity products are means over the start and the end of the free motion. Individuals whose
    free motion is wrong (`free_motion`) keep the initial velocity products.
    """
    equations = prepare(world, h, state, command)
    problem = StepProblem.of(world, h, equations)
    free = free_motion(problem)
    later = with_mean_products(world, h, equations, root_part(free), joint_part(free))
    unlike = problem.touches(free) | problem.changes_overload(free)
    bias = where_each(unlike, equations.bias, later.bias)
    return StepProblem.of(world, h, equations._replace(bias=bias))


def _cone_rounds(problem: StepProblem) -> int:
    """Return the largest number of rounds of friction cones."""
    return 1 if problem.world.contact_model is None else _CONE_ROUNDS


def _pair_biases(problem: StepProblem) -> int:
    """Return the largest number of values of the pair bias."""
    return 1 if problem.world.pairs is None else _PAIR_BIASES


def _none_visited(problem: StepProblem, y: Float[Array, "v *n"]) -> _Visited:
    return _Visited((y,) * _cone_rounds(problem), (y,) * (_pair_biases(problem) - 1))


def _solve(
    problem: StepProblem, radius: Float[Array, "p *n"], first: Float[Array, "v *n"]
) -> tuple[_Answer, _Record]:
    """Iterate to the solution from a first iterate, with the first cone radii."""
    none = jnp.zeros(first.shape[1:], jnp.int32)
    begin = _Search(
        y=first,
        cone=Cone.first(radius),
        restitution=jnp.ones(first.shape[1:], first.dtype),
        bias=PairBias.first(problem.pair_bias),
        iterations=none,
        done=jnp.zeros(first.shape[1:], bool),
        visited=_none_visited(problem, first),
        last_round_of_first_bias=none,
    )
    start = problem.with_restitution(begin.restitution)
    begin = _updated(start, begin, Iterate(first, start.velocity(first)))

    def advance(search: _Search) -> _Search:
        current = problem.with_restitution(search.restitution).with_pair_bias(search.bias.value)
        iterate = damped_step(current, search.cone.radius, search.y)
        return _updated(current, search._replace(iterations=search.iterations + 1), iterate)

    end = while_each(lambda search: ~search.done, advance, begin)
    cones = [end.visited.cones[0]]
    for k, one in enumerate(end.visited.cones[1:], 1):
        # Rounds that an individual did not need repeat the solution of its last round.
        cones.append(where_each(end.last_round_of_first_bias < k, cones[-1], one))
    visited = end.visited._replace(cones=tuple(cones))
    answer = _Answer(end.y, end.cone.radius, end.restitution, end.bias.value)
    return answer, _Record(visited, end.restitution, end.bias.updates)


def _updated(problem: StepProblem, search: _Search, iterate: Iterate) -> _Search:
    """Return the search with a new iterate, after the first outer update that it needs.

    Args:
        problem: problem with the restitution and the pair bias of the search.
        search: search before the update.
        iterate: the new iterate.
    """
    y, velocity, pair_sums = iterate
    rounds, biases, qdd = _cone_rounds(problem), _pair_biases(problem), joint_part(y)
    cone, bias = search.cone, search.bias
    linear = problem.linearized(cone.radius, qdd, velocity, pair_sums)

    # Solved?
    tolerance, rough = tolerances(y)
    residual = problem.residual(y, linear)
    last_round = cone.rounds + 1 >= rounds
    solved = residual <= jnp.where(last_round, tolerance, rough)

    # Friction cone: float32 stops early once Coulomb's law holds.
    allowed = problem.cone_radius(velocity)
    coulomb = problem.coulomb_error(cone.radius, allowed, velocity, linear) <= _COULOMB
    early = (y.dtype != jnp.float64) & coulomb & (residual <= tolerance)
    cone_done = (solved & last_round) | early
    change_cone = solved & ~cone_done

    # Restitution.
    bounces = problem.must_reduce_restitution(y, linear) & (search.restitution > 0)
    reduce_restitution = cone_done & bounces

    # Pair bias.
    finished, change_bias, new_bias = cone_done & ~bounces, jnp.zeros(bounces.shape, bool), None
    if biases > 1:
        new_bias = problem.pair_bias_at(qdd)
        change_bias = finished & (bias.updates + 1 < biases) & problem.drifts(qdd, new_bias)

    return _Search(
        y=y,
        cone=cone.updated_where(change_cone, allowed),
        restitution=jnp.where(reduce_restitution, reduced(search.restitution), search.restitution),
        bias=bias if new_bias is None else bias.updated_where(change_bias, new_bias),
        iterations=search.iterations,
        done=(finished & ~change_bias) | (search.iterations >= _ITERATIONS),
        visited=_visit(search, y),
        last_round_of_first_bias=jnp.where(
            bias.updates > 0, search.last_round_of_first_bias, cone.rounds + change_cone
        ),
    )


def _visit(search: _Search, y: Float[Array, "v *n"]) -> _Visited:
    """Return the visited solutions, with y under the cones and the bias of a search."""
    rounds, updates = search.cone.rounds, search.bias.updates
    return _Visited(
        tuple(
            where_each((updates == 0) & (rounds == k), y, old)
            for k, old in enumerate(search.visited.cones)
        ),
        tuple(where_each(updates == k, y, old) for k, old in enumerate(search.visited.biases, 1)),
    )


def _replay(problem: StepProblem, radius: Float[Array, "p *n"], notes: _Record) -> _Answer:
    """Return the solution by one Newton step under every cone and pair bias, for derivatives."""
    start = problem.with_restitution(jnp.ones_like(notes.restitution))
    end = problem.with_restitution(notes.restitution)
    first, *further = notes.visited.cones
    cone = Cone.first(radius)
    y = full_step(start if further else end, radius, first)
    for k, point in enumerate(further, 1):
        cone = cone.updated(start.cone_radius(start.velocity(y)))
        y = full_step(end if k == len(further) else start, cone.radius, point)
    bias = problem.pair_bias
    for k, point in enumerate(notes.visited.biases, 1):
        new = problem.pair_bias_at(joint_part(y))
        there = full_step(end.with_pair_bias(new), cone.radius, point)
        y, bias = where_each(notes.bias_updates >= k, (there, new), (y, bias))
    return _Answer(y, cone.radius, notes.restitution, bias)


def _solution(
    problem: StepProblem, radius: Float[Array, "p *n"], y: Float[Array, "v *n"]
) -> StepSolution:
    """Return accelerations, with the forces of the laws at them."""
    qdd, velocity = joint_part(y), problem.velocity(y)
    linear, allowed = problem.linearized(radius, qdd, velocity), problem.cone_radius(velocity)
    contacts, forces = problem.equations.contacts, None
    if contacts is not None and linear.contact is not None:
        local = linear.contact.force
        forces = ContactForces(local, matvec_t(contacts.frame, local))
    solved = jax.lax.stop_gradient(problem.residual(y, linear))
    friction = jax.lax.stop_gradient(problem.coulomb_error(radius, allowed, velocity, linear))
    motor = clamp_torque(problem.world.tree, problem.commanded_torque(qdd))
    tendons, tension = problem.equations.tendons, None
    if tendons is not None:
        tension = clamp_torque(tendons.tendons, tendons.commanded(qdd, problem.h))
    push = None if linear.pairs is None else linear.pairs.force
    warmstart = Warmstart(qdd, velocity, allowed)
    residual = Residual(solved, solved + friction)
    return StepSolution(root_part(y), qdd, motor, forces, push, residual, warmstart, tension)
