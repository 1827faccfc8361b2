"""Newton's method for the motion of a step, with the friction cones found as it goes.

What is minimised is in `evo_cpg.physics.step_problem`; it is strictly convex and has one answer.
Each step linearizes the laws, finds the motion under these, and goes as far along the way to it as
the potential falls (`evo_cpg.physics.line_search`). It ends when the laws hold.

The radius of the friction cone is ``mu f_n`` with the normal force that was found last; with it,
the problem is solved anew. So Coulomb's law holds but for what the last round would have changed.
Restitution is likewise taken less, and the problem solved anew, where contact would give the
creature energy.

How far points of two limbs part within a step depends on how fast their joints turn at its end. So
where limbs push each other, and would come elsewhere than they are to, the problem is solved anew
with the motion that was found (`StepProblem.strays`).

Derivatives follow by the implicit function theorem: where the laws hold, one more Newton step from
there goes nowhere, and its derivative is that of the answer.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.fusion.converge import implicit, while_each
from evo_cpg.physics.equations import (
    ContactForces,
    Imposed,
    Residual,
    Warmstart,
    prepare,
    with_mean_products,
)
from evo_cpg.physics.generalized import ROOT_DOFS
from evo_cpg.physics.joints import clamp_torque
from evo_cpg.physics.line_search import line_search
from evo_cpg.physics.state import State
from evo_cpg.physics.step_problem import StepProblem
from evo_cpg.physics.world import World
from evo_cpg.spatial.linear import matvec_t, where_each

# How many radii of the friction cone are tried, and Newton steps with all of them at most.
_CONES, _STEPS = 8, 60

# How many sweeps of pairs of bodies are tried.
_SWEEPS = 3

# What is left of restitution each time that it is taken less, and how often before it is left out.
_LESS, _TRIES = 0.5, 2

# The laws hold when they are missed by less than this (`StepProblem.residual`); while the friction
# cone is not yet the last one, the second will do, and the third for its radius. In float64, as
# derivatives are checked in, the fourth.
_TOLERANCE, _ROUGH, _COULOMB, _EXACT = 1e-3, 0.05, 1e-2, 1e-10

# Squared friction (N^2) that counts as none.
_NONE = 1e-12


class _Search(NamedTuple):
    """How far a search has come.

    Attributes:
        y: the motion found last.
        radius: of the friction cone, N.
        last_found: what the normal forces under the radius before it allowed.
        last_missed: by how much that differed from that radius.
        cones: how many were left behind.
        restitution: what is left of it, as a share.
        sweep: of pairs of bodies (`evo_cpg.physics.pairs`), m/s^2.
        sweeps: how many were left behind.
        first_cones: how many radii were, under the first sweep.
        steps: of Newton's.
        done: whether the laws hold.
        reached: the motions under each radius, and then under each further sweep.
    """

    y: Float[Array, "v *n"]
    radius: Float[Array, "p *n"]
    last_found: Float[Array, "p *n"]
    last_missed: Float[Array, "p *n"]
    cones: Int[Array, "*n"]
    restitution: Float[Array, "*n"]
    sweep: Float[Array, "k *n"]
    sweeps: Int[Array, "*n"]
    first_cones: Int[Array, "*n"]
    steps: Int[Array, "*n"]
    done: Bool[Array, "*n"]
    reached: tuple[Float[Array, "v *n"], ...]


class _Answer(NamedTuple):
    """Where a search ended.

    Attributes:
        y: the motion.
        radius: of the friction cone there, N.
        restitution: what was left of it, as a share.
        sweep: of pairs of bodies there, m/s^2.
    """

    y: Float[Array, "v *n"]
    radius: Float[Array, "p *n"]
    restitution: Float[Array, "*n"]
    sweep: Float[Array, "k *n"]


class _Notes(NamedTuple):
    """How an answer came about.

    Attributes:
        reached: see `_Search`.
        restitution: what was left of it, as a share.
        sweeps: how many were left behind.
    """

    reached: tuple[Float[Array, "v *n"], ...]
    restitution: Float[Array, "*n"]
    sweeps: Int[Array, "*n"]


def search(
    world: World,
    h: float,
    state: State,
    target_rate: Float[Array, "d *n"],
    target_angle: Float[Array, "d *n"] | None,
    warmstart: Warmstart | None = None,
) -> Imposed:
    """The motion under motors, limits of joints and ground, as far as they can press and pull.

    Args:
        world: the creature and its surroundings.
        h: s.
        state: at the start of the step.
        target_rate: see `evo_cpg.physics.step.step`.
        target_angle: likewise.
        warmstart: what the step before came to; None for a first step.
    """
    equations = prepare(world, h, state, target_rate, target_angle)
    problem = StepProblem.of(world, h, equations)
    if warmstart is None:
        warmstart = coldstart(world, state.q.shape[1:], state.q.dtype)
    free = free_motion(problem)
    later = with_mean_products(world, h, equations, free[:ROOT_DOFS], free[ROOT_DOFS:])
    unlike = problem.touches(free) | problem.overloads_otherwise(free)
    bias = where_each(unlike, equations.bias, later.bias)
    equations = equations._replace(bias=bias)
    problem = StepProblem.of(world, h, equations)
    whole = jnp.ones(state.q.shape[1:], state.q.dtype)
    radius, start = warmstart.radius, problem.bounded(whole)
    first = start.motion(start.linearized(radius, warmstart.qdd, warmstart.velocity))
    rounds = _cone_count(problem) + _sweep_count(problem) - 1
    like = _Notes((first,) * rounds, whole, jnp.zeros(whole.shape, jnp.int32))
    answer = implicit(
        functools.partial(_descend, problem, radius),
        functools.partial(_replay, problem, radius),
        first,
        like,
    )
    end = problem.bounded(answer.restitution).swept(answer.sweep)
    return _imposed(end, answer.radius, answer.y)


def free_motion(problem: StepProblem) -> Float[Array, "v *n"]:
    """The motion of a step in which nothing is touched, and motors at their limits stay there.

    Where something would be touched, or a motor would not stay, it says little of the velocities
    after the step: velocity products are then those of its start. (A limb that hardly resists goes
    a thousand radians a second under a torque that its motor stops giving at fifty.)
    """
    still = jnp.zeros_like(problem.force[ROOT_DOFS:])
    linear = problem.linearized(problem.force[:0], still, None)
    return problem.motion(linear._replace(pairs=None))


def coldstart(world: World, batch: tuple[int, ...], dtype: DTypeLike) -> Warmstart:
    """Of an animal that nothing touches, with motors that do as they are told."""
    points = 0 if world.footing is None else len(world.footing.bodies)
    velocity = None if world.footing is None else jnp.zeros((3, points, *batch), dtype)
    qdd = jnp.zeros((world.tree.dof_count, *batch), dtype)
    return Warmstart(qdd, velocity, jnp.zeros((points, *batch), dtype))


def _cone_count(problem: StepProblem) -> int:
    """How many radii of the friction cone are tried."""
    return 1 if problem.world.footing is None else _CONES


def _sweep_count(problem: StepProblem) -> int:
    """How many sweeps of pairs of bodies are tried."""
    return 1 if problem.world.pairs is None else _SWEEPS


def _imposed(
    problem: StepProblem, radius: Float[Array, "p *n"], y: Float[Array, "v *n"]
) -> Imposed:
    """A motion, and the forces in it by the laws, with the friction cones that it has."""
    qdd, velocity = y[ROOT_DOFS:], problem.velocity(y)
    linear, found = problem.linearized(radius, qdd, velocity), problem.cone_radius(velocity)
    contacts, forces = problem.equations.contacts, None
    if contacts is not None and linear.contact is not None:
        local = linear.contact.force
        forces = ContactForces(local, matvec_t(contacts.frame, local))
    solved = jax.lax.stop_gradient(problem.residual(y, linear))
    friction = jax.lax.stop_gradient(problem.beyond_coulomb(radius, found, velocity, linear))
    motor = clamp_torque(problem.world.tree, problem.asked(qdd))
    push = None if linear.pairs is None else linear.pairs.force
    warmstart = Warmstart(qdd, velocity, found)
    residual = Residual(solved, solved + friction)
    return Imposed(y[:ROOT_DOFS], qdd, motor, forces, push, residual, warmstart)


def _newton_step(
    problem: StepProblem, radius: Float[Array, "p *n"], y: Float[Array, "v *n"]
) -> Float[Array, "v *n"]:
    """The motion under the laws linearized at another."""
    return problem.motion(problem.linearized(radius, y[ROOT_DOFS:], problem.velocity(y)))


def _descend(
    problem: StepProblem, radius: Float[Array, "p *n"], first: Float[Array, "v *n"]
) -> tuple[_Answer, _Notes]:
    """The answer, and what `_replay` needs."""
    count, most = _cone_count(problem), _sweep_count(problem)
    none = jnp.zeros(first.shape[1:], jnp.int32)
    whole = jnp.ones(first.shape[1:], first.dtype)
    begin = _Search(
        *(first, radius, radius, radius, none, whole, problem.own_sweep(), none, none, none),
        jnp.zeros(first.shape[1:], bool),
        (first,) * (count + most - 1),
    )
    start = problem.bounded(whole)
    begin = _judged(start, begin, first, start.velocity(first))

    def advance(search: _Search) -> _Search:
        now = problem.bounded(search.restitution).swept(search.sweep)
        radius, velocity = search.radius, now.velocity(search.y)
        linear = now.linearized(radius, search.y[ROOT_DOFS:], velocity)
        # Within the tolerance rounding would decide how far to go.
        exact, _ = _tolerances(first)
        least = problem.h * exact**2 * now.square_of_forces(search.y, linear)
        ahead = now.motion(linear)
        y, velocity = line_search(now, radius, search.y, velocity, ahead, least)
        return _judged(now, search._replace(steps=search.steps + 1), y, velocity)

    end = while_each(lambda search: ~search.done, advance, begin)
    reached = [end.reached[0]]
    for k, one in enumerate(end.reached[1:count], 1):
        # Where radii were no longer tried, the last one stands for the rest.
        reached.append(where_each(end.first_cones < k, reached[-1], one))
    notes = _Notes((*reached, *end.reached[count:]), end.restitution, end.sweeps)
    return _Answer(end.y, end.radius, end.restitution, end.sweep), notes


def _judged(
    now: StepProblem,
    search: _Search,
    y: Float[Array, "v *n"],
    velocity: Float[Array, "3 p *n"] | None,
) -> _Search:
    """The search with another motion: whether it is the answer, or else the next problem.

    Args:
        now: the problem with the restitution and the sweep of the search.
        search: before.
        y: the motion that was found.
        velocity: of the contact points in it.
    """
    count, most = _cone_count(now), _sweep_count(now)
    exact, rough = _tolerances(y)
    early, radius, qdd = y.dtype != jnp.float64, search.radius, y[ROOT_DOFS:]
    linear, found = now.linearized(radius, qdd, velocity), now.cone_radius(velocity)
    residual = now.residual(y, linear)
    coulomb = now.beyond_coulomb(radius, found, velocity, linear) <= _COULOMB
    last = search.cones + 1 >= count
    settled = residual <= jnp.where(last, exact, rough)
    # The first radius has none before it.
    compared = search.cones > 0
    new = _next_radius(radius, found, search.last_found, search.last_missed, compared)
    ends = (settled & last) | (early & coulomb & (residual <= exact))
    changed = settled & ~last & ~ends
    too_much = ends & now.gains(y, linear) & (search.restitution > 0)
    ends &= ~too_much
    sweep, strays = search.sweep, jnp.zeros(ends.shape, bool)
    if most > 1:
        sweep = now.sweep(qdd)
        strays = ends & (search.sweeps + 1 < most) & now.strays(qdd, sweep)
    here = jnp.where(search.sweeps > 0, count - 1 + search.sweeps, search.cones)
    return _Search(
        y,
        where_each(changed, new, radius),
        where_each(changed, found, search.last_found),
        where_each(changed, found - radius, search.last_missed),
        search.cones + changed,
        jnp.where(too_much, _less(search.restitution), search.restitution),
        where_each(strays, sweep, search.sweep),
        search.sweeps + strays,
        jnp.where(search.sweeps > 0, search.first_cones, search.cones + changed),
        search.steps,
        (ends & ~strays) | (search.steps >= _STEPS),
        tuple(where_each(here == k, y, old) for k, old in enumerate(search.reached)),
    )


def _replay(problem: StepProblem, radius: Float[Array, "p *n"], notes: _Notes) -> _Answer:
    """The same answer by one Newton step under each radius and sweep, for derivatives."""
    restitution, count = notes.restitution, _cone_count(problem)
    reached, further = notes.reached[:count], notes.reached[count:]
    start, end = problem.bounded(jnp.ones_like(restitution)), problem.bounded(restitution)
    found = missed = radius
    y = _newton_step(end if count == 1 else start, radius, reached[0])
    for k, point in enumerate(reached[1:]):
        before, found = found, start.cone_radius(start.velocity(y))
        missed_before, missed = missed, found - radius
        radius = _next_radius(radius, found, before, missed_before, jnp.asarray(k > 0))
        y = _newton_step(end if k + 2 == count else start, radius, point)
    sweep = problem.own_sweep()
    for k, point in enumerate(further, 1):
        new = problem.sweep(y[ROOT_DOFS:])
        there = _newton_step(end.swept(new), radius, point)
        y, sweep = where_each(notes.sweeps >= k, (there, new), (y, sweep))
    return _Answer(y, radius, restitution, sweep)


def _less(restitution: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """What is left of it after it has been taken less once more."""
    less = _LESS * restitution
    return jnp.where(less < _LESS**_TRIES, 0.0, less)


def _next_radius(
    radius: Float[Array, "p *n"],
    found: Float[Array, "p *n"],
    last_found: Float[Array, "p *n"],
    last_missed: Float[Array, "p *n"],
    compared: Bool[Array, "*#n"],
) -> Float[Array, "p *n"]:
    """Radii of the friction cones for the next search: those found, with Anderson's acceleration.

    Args:
        radius: that the last search had.
        found: what the normal forces that it came to allow.
        last_found: the same one search earlier.
        last_missed: by how much that differed from its radius.
        compared: whether there was one.
    """
    missed = found - radius
    change = missed - last_missed
    share = (missed * change).sum(0) / jnp.maximum((change * change).sum(0), _NONE)
    share = jnp.where(compared, jnp.clip(share, -1.0, 1.0), 0.0)
    return jnp.maximum(found - share[None] * (found - last_found), 0.0)


def _tolerances(like: Array) -> tuple[float, float]:
    """Of the answer, and of those under friction cones that are not the last."""
    return (_EXACT, _EXACT) if like.dtype == jnp.float64 else (_TOLERANCE, _ROUGH)
