"""The motion of a step whose laws have kinks: motors with limits, contact with the ground.

At the end of the step it minimises

    1/2 |x - x_free|^2 in the metric of the implicit mass matrix
    + h times one convex potential for every contact point, motor and limit of a joint,

whose derivatives are their laws: a one-sided spring along the normal, friction as Huber's function
(it sticks up to its limit, and slides under it), pushes of bodies on each other and limits of
joints as one-sided springs, motors up to their torque. The problem is strictly convex and has one
answer. Newton's method finds it: each step replaces the laws by their tangents, which one
articulated-body solve takes (and one more for every pair of bodies that touch), and goes as far
along the way to that answer as the potential falls (an exact line search). It ends when the laws
hold.

Friction's limit is ``mu f_n`` with the normal force that was found last; with it, the problem is
solved anew. So Coulomb's law holds but for what the last round would have changed. Restitution is
likewise taken less, and the problem solved anew, where contact would give the creature energy.

The line search needs no mass matrix. An iterate is the answer to the equations under certain forces
``f`` at the points (and torques), which need not obey the laws. Between two of them, everything is
linear but the laws F, so along the way with the share a

    phi'(a) = sum dv . (f + a df - F(v + a dv)) + the same for the motors.

Derivatives follow by the implicit function theorem: where the laws hold, one more Newton step from
there goes nowhere, and its derivative is that of the answer.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.fusion.converge import implicit, while_each
from evo_cpg.physics.contact import (
    bounded,
    contact_lines,
    contact_work,
    end_velocity,
    friction_change,
    friction_limit,
    line_force,
)
from evo_cpg.physics.equations import (
    ContactForces,
    Equations,
    Imposed,
    Lines,
    Residual,
    Warmstart,
    prepare,
    solve_with,
)
from evo_cpg.physics.joints import clamp_torque, limit_torque, overloaded, servo_slope
from evo_cpg.physics.pairs import pair_lines, parting_change, parting_velocity
from evo_cpg.physics.state import State
from evo_cpg.physics.world import World
from evo_cpg.spatial.linear import expand_dims_like, matvec_t, of_each, where_each
from evo_cpg.spatial.numerics import xp

# How many limits of friction are tried, and Newton steps with all of them at most.
_LIMITS, _STEPS = 8, 60

# What is left of restitution each time that it is taken less, and how often before it is left out.
_LESS, _TRIES = 0.5, 2

# A law holds when its force is missed by less than this share of all normal forces, or the weight;
# while friction's limit is not yet the last one, the second will do, and the third for the limit
# itself. In float64, as derivatives are checked in, the fourth.
_TOLERANCE, _ROUGH, _COULOMB, _EXACT = 1e-3, 0.05, 1e-2, 1e-10

# Slope at which a line search ends, as a share of that at its start; evaluations at most.
_FLAT, _EVALUATIONS = 0.3, 30

# Slope (W) that counts as none; quotients of smaller ones would be no numbers.
_LEVEL = 1e-30

# Of limits (N) and torques (N m) that counts as none.
_NONE = 1e-12

# Rate (rad/s) whose torque by the slope of a joint's law is enough to measure what is missed by.
_SLOW = 1e-2


class Iterate(NamedTuple):
    """A motion, and under which forces the creature has it.

    Attributes:
        root: spatial acceleration of the root.
        qdd: joint accelerations, rad/s^2.
        torque: of motors and limits of joints, N m.
        velocity: of the contact points at the end of the step, m/s; None without ground.
        force: on them, N; likewise.
        push: of pairs of bodies, N; None where none can touch.
    """

    root: Float[Array, "6 *n"]
    qdd: Float[Array, "d *n"]
    torque: Float[Array, "d *n"]
    velocity: Float[Array, "3 p *n"] | None = None
    force: Float[Array, "3 p *n"] | None = None
    push: Float[Array, "k *n"] | None = None


class Missed(NamedTuple):
    """What an iterate has beyond the laws.

    Attributes:
        torque: of motors and limits of joints, N m.
        force: at the contact points, N; None without ground.
        push: of pairs of bodies, N; None where none can touch.
    """

    torque: Float[Array, "d *n"]
    force: Float[Array, "3 p *n"] | None
    push: Float[Array, "k *n"] | None


class _Search(NamedTuple):
    """How far a search has come.

    Attributes:
        iterate: the motion found last.
        limit: of friction, N.
        last_found: what the normal forces under the limit before it allowed.
        last_missed: by how much that differed from that limit.
        limits: how many were left behind.
        restitution: what is left of it, as a share.
        steps: of Newton's.
        done: whether the laws hold.
        reached: the motions under each limit.
    """

    iterate: Iterate
    limit: Float[Array, "p *n"]
    last_found: Float[Array, "p *n"]
    last_missed: Float[Array, "p *n"]
    limits: Int[Array, "*n"]
    restitution: Float[Array, "*n"]
    steps: Int[Array, "*n"]
    done: Bool[Array, "*n"]
    reached: tuple[Iterate, ...]


class _Answer(NamedTuple):
    """Where a search ended.

    Attributes:
        iterate: the motion.
        limit: of friction there, N.
        restitution: what was left of it, as a share.
    """

    iterate: Iterate
    limit: Float[Array, "p *n"]
    restitution: Float[Array, "*n"]


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
    problem = _Problem(world, h, prepare(world, h, state, target_rate, target_angle))
    if warmstart is None:
        warmstart = coldstart(world, state.q.shape[1:], state.q.dtype)
    whole = jnp.ones(state.q.shape[1:], state.q.dtype)
    limit, start = warmstart.limit, problem.bounded(whole)
    first = start.motion(start.tangents(limit, warmstart.qdd, warmstart.velocity))
    like = (first,) * problem.limits, whole
    answer = implicit(
        functools.partial(_descend, problem, limit),
        functools.partial(_replay, problem, limit),
        first,
        like,
    )
    return _imposed(problem.bounded(answer.restitution), answer.limit, answer.iterate)


def coldstart(world: World, batch: tuple[int, ...], dtype: jnp.dtype) -> Warmstart:
    """Of an animal that nothing touches, with motors that do as they are told."""
    places = 0 if world.footing is None else len(world.footing.bodies)
    velocity = None if world.footing is None else jnp.zeros((3, places, *batch), dtype)
    qdd = jnp.zeros((world.tree.dof_count, *batch), dtype)
    return Warmstart(qdd, velocity, jnp.zeros((places, *batch), dtype))


def _imposed(problem: "_Problem", limit: Float[Array, "p *n"], iterate: Iterate) -> Imposed:
    """A motion, and the forces in it by the laws, with the limits of friction that it has."""
    lines, found = problem.tangents_at(limit, iterate), problem.limit(iterate)
    contacts, forces = problem.equations.contacts, None
    if contacts is not None and lines.contact is not None:
        support = lines.contact.force
        forces = ContactForces(support, matvec_t(contacts.frame, support))
    solved = jax.lax.stop_gradient(problem.residual(iterate, lines))
    friction = jax.lax.stop_gradient(problem.beyond_coulomb(limit, found, iterate, lines))
    motor = clamp_torque(problem.world.tree, problem.asked(iterate.qdd))
    push = None if lines.pairs is None else lines.pairs.force
    warmstart = Warmstart(iterate.qdd, iterate.velocity, found)
    residual = Residual(solved, solved + friction)
    return Imposed(iterate.root, iterate.qdd, motor, forces, push, residual, warmstart)


class _Problem(NamedTuple):
    """What is minimised in a step."""

    world: World
    h: float
    equations: Equations

    @property
    def limits(self) -> int:
        """How many limits of friction are tried."""
        return 1 if self.world.footing is None else _LIMITS

    def motion(self, lines: Lines) -> Iterate:
        """The motion under lines, and what they give there."""
        equations, h = self.equations, self.h
        found, push = solve_with(self.world, h, equations, lines)
        torque = lines.torque - h * lines.slope * found.qdd
        velocity = force = None
        footing, contacts = self.world.footing, equations.contacts
        if footing is not None and contacts is not None and lines.contact is not None:
            velocity = end_velocity(footing, contacts, found, h)
            force = line_force(lines.contact, velocity)
        return Iterate(found.root, found.qdd, torque, velocity, force, push)

    def bounded(self, restitution: Float[Array, "*n"]) -> "_Problem":
        """The problem with what is left of restitution."""
        equations = self.equations
        if equations.contacts is None:
            return self
        contacts = bounded(equations.contacts, restitution)
        return self._replace(equations=equations._replace(contacts=contacts))

    def gains(self, iterate: Iterate) -> Bool[Array, "*n"]:
        """Where bouncing contacts give the creature energy."""
        contacts = self.equations.contacts
        if contacts is None or iterate.velocity is None or iterate.force is None:
            return jnp.zeros(iterate.qdd.shape[1:], bool)
        work = contact_work(contacts, iterate.velocity, iterate.force, self.h)
        return (work > 0) & (contacts.bounce > 0).any(0)

    def asked(self, qdd: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Of the motors at the end of the step, N m."""
        wanted = self.equations.wanted
        return wanted - self.h * servo_slope(self.world.tree, wanted, self.h) * qdd

    def limit(self, iterate: Iterate) -> Float[Array, "p *n"]:
        """Of friction, under the normal forces of the laws at an iterate, N."""
        footing, contacts = self.world.footing, self.equations.contacts
        if footing is None or contacts is None or iterate.velocity is None:
            return iterate.qdd[:0]
        return friction_limit(footing, contacts, iterate.velocity, self.h)

    def tangents_at(self, limit: Float[Array, "p *n"], iterate: Iterate) -> Lines:
        """Of the laws at an iterate."""
        return self.tangents(limit, iterate.qdd, iterate.velocity)

    def tangents(
        self,
        limit: Float[Array, "p *n"],
        qdd: Float[Array, "d *n"],
        velocity: Float[Array, "3 p *n"] | None,
    ) -> Lines:
        """Of the laws at some motion."""
        tree, state, wanted = self.world.tree, self.equations.state, self.equations.wanted
        asked = self.asked(qdd)
        over = overloaded(tree, asked)
        torque = jnp.where(over, clamp_torque(tree, asked), wanted)
        slope = jnp.where(over, 0.0, servo_slope(tree, wanted, self.h))
        change = self.h * qdd
        stop, stop_slope = limit_torque(tree, state.q, state.qd + change, self.h)
        torque, slope = torque + stop + stop_slope * change, slope + stop_slope
        footing, contacts, lines = self.world.footing, self.equations.contacts, None
        if footing is not None and contacts is not None and velocity is not None:
            lines = contact_lines(footing, contacts, limit, velocity, self.h)
        pairs, apart, pushes = self.world.pairs, self.equations.pairs, None
        if pairs is not None and apart is not None:
            pushes = pair_lines(pairs, apart, parting_velocity(apart, qdd, self.h), self.h)
        return Lines(torque, slope, lines, pushes)

    def missed(self, iterate: Iterate, lines: Lines) -> Missed:
        """What an iterate's torques and forces have beyond the laws', whose tangents are given."""
        torque = iterate.torque - (lines.torque - self.h * lines.slope * iterate.qdd)
        force = push = None
        if iterate.force is not None and lines.contact is not None:
            force = iterate.force - lines.contact.force
        if iterate.push is not None and lines.pairs is not None:
            push = iterate.push - lines.pairs.force
        return Missed(torque, force, push)

    def residual(self, iterate: Iterate, lines: Lines) -> Float[Array, "*n"]:
        """Norm of what the laws are missed by, as shares of motors' limits and of the load."""
        torque, force, push = self.missed(iterate, lines)
        limit = self.world.tree.torque_limit
        most = expand_dims_like(xp.where(xp.isfinite(limit), limit, 0.0), torque)
        most = jnp.maximum(jnp.maximum(most, jnp.abs(iterate.torque)), _SLOW * lines.slope)
        shares = torque / jnp.maximum(most, _NONE)
        total = (shares * shares).sum(0)
        if force is not None:
            total = total + (force * force).sum((0, 1)) / self.load(lines) ** 2
        if push is not None:
            total = total + (push * push).sum(0) / self.load(lines) ** 2
        return jnp.sqrt(total)

    def beyond_coulomb(
        self,
        limit: Float[Array, "p *n"],
        found: Float[Array, "p *n"],
        iterate: Iterate,
        lines: Lines,
    ) -> Float[Array, "*n"]:
        """Norm of what friction misses its law by with a limit, as a share of the load.

        Args:
            limit: that the iterate was found with.
            found: the one that its own normal forces give.
            iterate: some motion.
            lines: tangents there.
        """
        footing = self.world.footing
        if footing is None or iterate.velocity is None:
            return jnp.zeros(iterate.qdd.shape[1:], iterate.qdd.dtype)
        change = friction_change(footing, limit, found, iterate.velocity, self.h)
        return jnp.sqrt((change * change).sum(0)) / self.load(lines)

    def load(self, lines: Lines) -> Float[Array, "*n"]:
        """What ground and pairs carry, or the weight if that is more, N."""
        weight = self.world.gravity * self.world.tree.mass.sum()
        carried = jnp.zeros_like(lines.torque[:0]).sum(0)
        if lines.contact is not None:
            carried = carried + lines.contact.force[2].sum(0)
        if lines.pairs is not None:
            carried = carried + lines.pairs.force.sum(0)
        return jnp.maximum(carried, xp.maximum(weight, _NONE))


def _descend(
    problem: _Problem, limit: Float[Array, "p *n"], first: Iterate
) -> tuple[_Answer, tuple[tuple[Iterate, ...], Array]]:
    """The answer, and for `_replay` the answers under all limits and what restitution was left."""
    exact, rough = _tolerances(first.qdd)
    early = first.qdd.dtype != jnp.float64
    whole = jnp.ones(first.qdd.shape[1:], first.qdd.dtype)
    start = problem.bounded(whole)
    lines, found = start.tangents_at(limit, first), start.limit(first)
    holds = early & (start.residual(first, lines) <= exact)
    holds &= start.beyond_coulomb(limit, found, first, lines) <= _COULOMB
    none = jnp.zeros(holds.shape, jnp.int32)
    count = problem.limits

    def advance(search: _Search) -> _Search:
        now = problem.bounded(search.restitution)
        limit, lines = search.limit, now.tangents_at(search.limit, search.iterate)
        ahead = now.motion(lines)
        iterate, lines = _line_search(now, limit, search.iterate, lines, ahead)
        found, residual = now.limit(iterate), now.residual(iterate, lines)
        coulomb = now.beyond_coulomb(limit, found, iterate, lines) <= _COULOMB
        last = search.limits + 1 >= count
        settled = residual <= jnp.where(last, exact, rough)
        # The first limit has none before it.
        compared = search.limits > 0
        new = _next_limit(limit, found, search.last_found, search.last_missed, compared)
        ends = (settled & last) | (early & coulomb & (residual <= exact))
        changed = settled & ~last & ~ends
        too_much = ends & now.gains(iterate) & (search.restitution > 0)
        steps = search.steps + 1
        return _Search(
            iterate,
            where_each(changed, new, limit),
            where_each(changed, found, search.last_found),
            where_each(changed, found - limit, search.last_missed),
            search.limits + changed,
            jnp.where(too_much, _less(search.restitution), search.restitution),
            steps,
            (ends & ~too_much) | (steps >= _STEPS),
            tuple(
                where_each(search.limits == k, iterate, old) for k, old in enumerate(search.reached)
            ),
        )

    done = holds & ~start.gains(first)
    begin = _Search(first, limit, limit, limit, none, whole, none, done, (first,) * count)
    end = while_each(lambda search: ~search.done, advance, begin)
    reached = tuple(
        where_each(end.limits < k, end.iterate, one) for k, one in enumerate(end.reached)
    )
    return _Answer(end.iterate, end.limit, end.restitution), (reached, end.restitution)


def _replay(
    problem: _Problem,
    limit: Float[Array, "p *n"],
    notes: tuple[tuple[Iterate, ...], Float[Array, "*n"]],
) -> _Answer:
    """The same answer by one Newton step under each limit, for derivatives."""
    reached, restitution = notes
    start, end = problem.bounded(jnp.ones_like(restitution)), problem.bounded(restitution)
    found = missed = limit
    now = end if len(reached) == 1 else start
    iterate = now.motion(now.tangents_at(limit, reached[0]))
    for k, place in enumerate(reached[1:]):
        before, found = found, start.limit(iterate)
        missed_before, missed = missed, found - limit
        limit = _next_limit(limit, found, before, missed_before, jnp.asarray(k > 0))
        now = end if k + 2 == len(reached) else start
        iterate = now.motion(now.tangents_at(limit, place))
    return _Answer(iterate, limit, restitution)


def _less(restitution: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """What is left of it after it has been taken less once more."""
    less = _LESS * restitution
    return jnp.where(less < _LESS**_TRIES, 0.0, less)


def _next_limit(
    limit: Float[Array, "p *n"],
    found: Float[Array, "p *n"],
    last_found: Float[Array, "p *n"],
    last_missed: Float[Array, "p *n"],
    compared: Bool[Array, "*n"],
) -> Float[Array, "p *n"]:
    """Limits of friction for the next search: those found, with Anderson's acceleration.

    Args:
        limit: that the last search had.
        found: what the normal forces that it came to allow.
        last_found: the same one search earlier.
        last_missed: by how much that differed from its limit.
        compared: whether there was one.
    """
    missed = found - limit
    change = missed - last_missed
    share = (missed * change).sum(0) / jnp.maximum((change * change).sum(0), _NONE)
    share = jnp.where(compared, jnp.clip(share, -1.0, 1.0), 0.0)
    return jnp.maximum(found - share[None] * (found - last_found), 0.0)


def _line_search(
    problem: _Problem, limit: Float[Array, "p *n"], start: Iterate, lines: Lines, end: Iterate
) -> tuple[Iterate, Lines]:
    """The point with the least potential between two iterates, and the laws' tangents there.

    Args:
        problem: whose potential it is.
        limit: of friction.
        start: an iterate.
        lines: tangents there.
        end: the motion under these.
    """
    way = jax.tree.map(jnp.subtract, end, start)

    def at(share: Array) -> Iterate:
        return jax.tree.map(lambda x, d: x + of_each(share, x) * d, start, way)

    def slope(here: Iterate, lines: Lines) -> Array:
        torque, force, push = problem.missed(here, lines)
        total = problem.h * (way.qdd * torque).sum(0)
        if force is not None:
            total = total + (way.velocity * force).sum((0, 1))
        pairs = problem.equations.pairs
        if push is None or pairs is None:
            return total
        return total + (parting_change(pairs, way.qdd, problem.h) * push).sum(0)

    at_start, at_end = slope(start, lines), slope(end, problem.tangents_at(limit, end))

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
        here = slope(iterate, problem.tangents_at(limit, iterate))
        return low, below, high, above, share, here, now, count + 1

    one = jnp.ones_like(at_start)
    none = jnp.zeros(at_start.shape, jnp.int32)
    # Where it no longer falls, but for rounding, the whole way is gone.
    rises = (at_start < -_LEVEL) & (at_end > 0)
    begin = 0 * one, at_start, one, at_end, one, jnp.where(rises, at_end, 0.0), none, none
    found = at(while_each(goes_on, closer, begin)[4])
    return found, problem.tangents_at(limit, found)


def _tolerances(like: Array) -> tuple[float, float]:
    """Of the answer, and of those under limits of friction that are not the last."""
    return (_EXACT, _EXACT) if like.dtype == jnp.float64 else (_TOLERANCE, _ROUGH)
