"""Contacts between many pairs of bodies of one creature, in loops whose code does not grow.

`evo_cpg.physics.contact.pairs` has the contact law, and `evo_cpg.physics.contact.pair_contacts` the
members of both classes. The code there grows with the number of pairs. Here, each individual lists
the points that can act in the step, because most points are too far apart:

1. A pair whose bounding balls are too far apart has no points.
2. A point is listed if its gap is small. The threshold is the distance that any points of the two
   bodies can approach in a step at present joint rates, plus the approach of these two points in a
   further step, plus a tenth of the thickness. The balls' threshold has the first distance twice.
3. A listed point that does not push adds nothing to the torques and the matrix.

Each individual handles its own k-th point in round k of a loop. The longest list of a vector
therefore determines the number of rounds, which is less than its number of different points.

All positions refer to the root's origin. A body's twist at constant rates has the angular velocity
w and the velocity v_0 of its point at the origin. Points p_1 and p_2 with the normal n separate at

    v_n = n . v_02 + w_2 . (p_2 x n) - n . v_01 - w_1 . (p_1 x n),

and the entry of J for a joint axis a through o is ``+-(a . (p x n) - n . (a x o))``.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.linear import cross, dot, expand_dims_like, matvec
from evo_cpg.creature.algebra.numerics import is_traced
from evo_cpg.creature.reach import chain_to_root
from evo_cpg.creature.tree import Tree
from evo_cpg.native.fuse import unset
from evo_cpg.physics.contact.contact import rest_velocity
from evo_cpg.physics.contact.pairs import (
    KINDS,
    LARGEST_DRIFT,
    Alike,
    Pairs,
    PointMotion,
    acceleration_field,
    parting_acceleration,
    placed_boxes,
)
from evo_cpg.physics.tree.kinematics import Kinematics, motion_of_bodies
from evo_cpg.physics.tree.root import ROOT_DOFS
from evo_cpg.physics.tree.spatial_algebra import BodyMotion

# Further approach within a step, because rates change in it, as a fraction of the thickness.
_MARGIN = 0.1

# Number of rounds that one test skips, because no individual's list is that long.
_TOGETHER = 8

# Type of indices, because indices without sign need no test of their sign.
_NO_SIGN = np.uint32

# Numbers of a listed point: its number, gap, normal, both places, and `Separation.carried`.
_POINT = 13


class _Lists(NamedTuple):
    """The points that each individual lists. Rows behind the end of a list have no meaning.

    Attributes:
        count: number of listed points.
        points: `_POINT` numbers of each listed point.
        laws: v* (m/s), c (N s/m) and J (m) of each listed point.
        drift: mean change of the separation velocity over the step by velocity products, m/s.
    """

    count: Int[Array, "*n"]
    points: Float[Array, "p k *n"]
    laws: Float[Array, "p l *n"]
    drift: Float[Array, "p *n"]


class ManyPairContacts:
    """Listed points of many pairs (see `evo_cpg.physics.contact.pair_contacts.PairContacts`).

    Args:
        tree: the creature.
        pairs: its pairs of bodies.
        kin: kinematics at the start of the step.
        qd: joint rates at the start of the step, rad/s.
        h: step, s.
        lists: lists that were found before in this step, or None to find them.
        bias: joint accelerations that lead to the rates of the velocity-product bias, or None for
            the rates at the start.
    """

    def __init__(
        self,
        tree: Tree,
        pairs: Pairs,
        kin: Kinematics,
        qd: Float[Array, "d *n"],
        h: float,
        lists: _Lists | None = None,
        bias: Float[Array, "d *n"] | None = None,
    ):
        self.tree, self.pairs, self.kin, self.qd, self.h = tree, pairs, kin, qd, h
        self.places = kin.origin - kin.origin[:, :1]
        self.bias = jnp.zeros_like(qd) if bias is None else bias
        self.owners = np.array(pairs.owners)
        self.size = self.owners.shape[1]
        self.lists = self._found() if lists is None else lists

    def with_bias(self, bias: Float[Array, "d *n"]) -> "ManyPairContacts":
        """Return the contacts with the velocity-product bias at other joint rates."""
        lists, differs = self.lists, (bias != self.bias).any(0)

        accelerations = self.accelerations(bias)

        def value(k: Array) -> Array:
            old = _at(lists.drift, k)
            # The bias of most steps never changes.
            new = jax.lax.cond(
                jnp.any(differs),
                lambda: self.drift(_at(lists.points, k), accelerations),
                lambda: old,
            )
            return jnp.where(differs, new, old)

        lists = lists._replace(drift=_table(lists.count, self.size, value, self.qd))
        return ManyPairContacts(self.tree, self.pairs, self.kin, self.qd, self.h, lists, bias)

    def bias_at(self, qdd: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Return `bias` for the joint rates after the step: the joint accelerations themselves.

        `accelerations` computes the velocity-product accelerations from them.
        """
        return qdd

    def change(self, turn: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Return the argument of `ManyPairForces.power` for a change of joint accelerations."""
        return turn

    def at(self, qdd: Float[Array, "d *n"], sums: "_Sums | None" = None) -> "ManyPairForces":
        """Return the forces at joint accelerations (rad/s^2), with their sums if they are known."""
        return ManyPairForces(self, qdd, sums)

    def touches(self, qdd: Float[Array, "d *n"]) -> Bool[Array, "*n"]:
        """Return for which individuals any pair pushes at joint accelerations."""
        return self.at(qdd).load > 0

    def drifts(
        self, qdd: Float[Array, "d *n"], bias: Float[Array, "d *n"], among: Bool[Array, "*n"]
    ) -> Bool[Array, "*n"]:
        """Return which of some individuals need an update of their velocity-product bias.

        Another bias would move a touching pair by more than `LARGEST_DRIFT`.
        """
        rates, count = self.qd + self.h * qdd, jnp.where(among, self.lists.count, 0)
        none = jnp.zeros(count.shape, bool)

        def found() -> Array:
            accelerations = self.accelerations(bias)

            def look(found: Array, k: Array) -> Array:
                law, velocity = self.law(k, rates)
                drift = self.drift(_at(self.lists.points, k), accelerations) - _at(
                    self.lists.drift, k
                )
                pushes = (k < count) & (law[0] > velocity + jnp.minimum(drift, 0.0))
                return found | (pushes & (self.h * jnp.abs(drift) > LARGEST_DRIFT))

            return _over_lists(count, self.size, look, none)

        return jax.lax.cond(jnp.any(count > 0), found, lambda: none)

    def parting(self, rates: Float[Array, "d *n"]) -> Float[Array, "p *n"]:
        """Return ``J rates`` of all points, m/s, or 0 for points that are not listed."""
        return self.of_points(lambda k: (_at(self.lists.laws, k)[2:] * rates).sum(0))

    # Quantities of bodies, as tables.

    def accelerations(self, qdd: Float[Array, "d *n"]) -> Float[Array, "12 b *n"]:
        """Return twists and accelerations of all bodies at joint accelerations.

        The acceleration of a body's point p is ``d_0 + e x p + w x (w x p)`` at constant rates. The
        rows are w, v_0, e and d_0.
        """
        motion = self.motion(self.qd + self.h * qdd)
        a, A = acceleration_field(motion)
        spin, turning = motion.angular, motion.bias_angular
        linear = motion.linear - cross(spin, self.places)
        return jnp.concatenate([spin, linear, turning, a - matvec(A, self.places)])

    def motion(self, rates: Float[Array, "d *n"]) -> BodyMotion:
        """Return the motion of all bodies at joint rates, with the root at rest."""
        still = jnp.zeros((ROOT_DOFS, *rates.shape[1:]), rates.dtype)
        return motion_of_bodies(self.tree, self.kin, still, rates)

    # Quantities of listed points.

    def law(self, k: Array, rates: Float[Array, "d *n"]) -> tuple[Array, Array]:
        """Return a row of `_Lists.laws`, and the separation velocity at joint rates, m/s."""
        law = _at(self.lists.laws, k)
        return law, (law[2:] * rates).sum(0) + _at(self.lists.drift, k)

    def drift(self, point: Float[Array, "k *n"], accelerations: Float[Array, "12 b *n"]) -> Array:
        """Return `_Lists.drift` of a listed point, from `accelerations`."""
        number, normal, places, carried = _parts(point)
        points = []
        for owners, p in zip(self.owners, places, strict=True):
            body = _constant(owners, number)
            spin, linear, turning, base = _own(accelerations, body).reshape(4, 3, *body.shape)
            velocity, acceleration = linear + cross(spin, p), base + cross(turning, p)
            acceleration = acceleration + cross(spin, cross(spin, p))
            points.append(PointMotion(spin, velocity, acceleration))
        return 0.5 * self.h * parting_acceleration(normal, carried, points)

    def of_points(self, value: Callable[[Array], Array]) -> Float[Array, "p *n"]:
        """Return a function of the rounds for all points, 0 for points that are not listed."""
        count, points = self.lists.count, self.lists.points

        def look(values: Array, k: Array) -> Array:
            number = _parts(_at(points, k))[0]
            return _add(values, number, jnp.where(k < count, value(k), 0.0))

        start = jnp.zeros((self.size, *count.shape), points.dtype)
        return _over_lists(count, self.size, look, start)

    # The lists.

    def _found(self) -> _Lists:
        """Find the listed points at the start of the step."""
        pairs, h = self.pairs, self.h
        # Positions are relative to the root's origin.
        kin = self.kin._replace(origin=self.places)
        centre, half, radius = placed_boxes(pairs, kin)
        own = self.motion(self.qd)
        size = jnp.sqrt((half * half).sum(0)) + radius
        passing = own.linear + cross(own.angular, centre - self.places)
        speed = jnp.sqrt(dot(passing, passing)) + jnp.sqrt(dot(own.angular, own.angular)) * size
        approach, margin = h * speed, _MARGIN * (half.min(0) + radius)
        twists = own.angular, own.linear - cross(own.angular, self.places)
        boxes, ball = (centre, kin.rotation, half, radius), size + 2.0 * approach + margin
        bodies = _Bodies(boxes, twists, ball, approach + margin, h)
        points, count = _near_points(pairs, bodies, self.qd)
        accelerations = self.accelerations(jnp.zeros_like(self.qd))
        drift = _table(
            count, self.size, lambda k: self.drift(_at(points, k), accelerations), self.qd
        )
        return _Lists(count, points, self._laws(points, count), drift)

    def _laws(self, points: Float[Array, "p k *n"], count: Int[Array, "*n"]) -> Array:
        """Return `_Lists.laws` of listed points."""
        bodies, sign_of = np.array(self.tree.dof_bodies, int), self._signs(points)
        S = self.kin.axes
        moments = cross(S.angular, self.places[:, bodies])
        if S.linear is not None:
            moments = moments - S.linear
        stiffness = jnp.asarray(self.pairs.stiffness, points.dtype) / self.h

        def law(k: Array) -> Array:
            point = _at(points, k)
            number, normal, places, _ = _parts(point)
            first, second = (cross(p, normal)[:, None] for p in places)
            sign = sign_of(number)
            turned = dot(S.angular, jnp.where(sign[None] > 0, second, first))
            J = sign * (turned - dot(normal[:, None], moments))
            first_two = [rest_velocity(point[1], self.h), _constant(stiffness, number)]
            return jnp.concatenate([jnp.stack(first_two), J])

        return _table(count, self.size, law, self.qd)

    def _signs(self, points: Float[Array, "p k *n"]) -> Callable[[Array], Array]:
        """Return a function from the number of a point to the sign of each joint's effect on it.

        A joint parts the points if it moves the second body only (1) or the first only (-1).
        """
        tree, bodies = self.tree, np.array(self.tree.dof_bodies, int)
        if tree.walk is None:
            chains = [np.isin(bodies, chain_to_root(tree, b)) for b in range(tree.body_count)]
            moves = np.array(chains, points.dtype)
            signs = moves[self.owners[1]] - moves[self.owners[0]]
            return lambda number: _constant(signs.T, number)
        above = jnp.asarray(tree.walk.above, points.dtype)[:, bodies].T
        moves = jnp.broadcast_to(expand_dims_like(above, points), (*above.shape, *points.shape[2:]))

        def signs_of(number: Array) -> Array:
            first, second = (_own(moves, _constant(each, number)) for each in self.owners)
            return second - first

        return signs_of


class _Sums(NamedTuple):
    """Sums over all points: joint torques of the forces (N m), and all forces (N)."""

    torque: Float[Array, "d *n"]
    load: Float[Array, "*n"]


class ManyPairForces:
    """The forces of all pairs at joint accelerations, and their derivatives.

    Args:
        contacts: the contacts of the step.
        qdd: joint accelerations, rad/s^2.
        sums: `sums` at these accelerations, or None to compute them when they are needed.
    """

    def __init__(
        self, contacts: ManyPairContacts, qdd: Float[Array, "d *n"], sums: _Sums | None = None
    ):
        self._contacts, self._qdd, self._sums = contacts, qdd, sums
        self._rates = contacts.qd + contacts.h * qdd

    @property
    def force(self) -> Float[Array, "p *n"]:
        """Force of every point, N."""
        return self._contacts.of_points(lambda k: self._push(k)[1])

    @property
    def load(self) -> Float[Array, "*n"]:
        """Sum of all forces, N."""
        return self.sums.load

    @property
    def torque(self) -> Float[Array, "d *n"]:
        """Joint torques of the forces, ``J^T f``, N m."""
        return self.sums.torque

    @property
    def sums(self) -> _Sums:
        """Joint torques and the sum of all forces, computed once."""
        if self._sums is None:
            total = self._over_pushing(lambda law, push: [law[2:] * push[None], push[None]])
            self._sums = _Sums(total[:-1], total[-1])
        return self._sums

    def power(self, change: Float[Array, "d *n"]) -> Float[Array, "*n"]:
        """Return the forces' power for a change from `ManyPairContacts.change`, W."""
        return self._contacts.h * dot(change, self.torque)

    def newton(self) -> tuple[Float[Array, "d *n"], Float[Array, "d d *n"]]:
        """Return the linearized torques at zero joint acceleration, and ``h J^T K J``.

        The loop over the points computes `sums`, too, unless they are known.
        """
        h, qdd, known = self._contacts.h, self._qdd, self._sums is not None
        count = len(qdd)
        rows, columns = np.tril_indices(count)

        def add(law: Array, push: Array) -> list[Array]:
            J = law[2:]
            derivative = jnp.where(push > 0, law[1], 0.0)
            force = push + derivative * h * (J * qdd).sum(0)
            scaled = (h * derivative)[None] * J
            own = [] if known else [J * push[None], push[None]]
            return [J * force[None], scaled[rows] * J[columns], *own]

        total = self._over_pushing(add)
        last = count + len(rows)
        if not known:
            self._sums = _Sums(total[last:-1], total[-1])
        i, j = np.indices((count, count))
        most, least = np.maximum(i, j), np.minimum(i, j)
        return total[:count], total[count:last][most * (most + 1) // 2 + least]

    def _push(self, k: Array) -> tuple[Array, Array]:
        """Return the law of each individual's k-th point, and its force, N."""
        law, velocity = self._contacts.law(k, self._rates)
        push = law[1] * jnp.maximum(law[0] - velocity, 0.0)
        return law, jnp.where(k < self._contacts.lists.count, push, 0.0)

    def _over_pushing(self, values: Callable[[Array, Array], list[Array]]) -> Array:
        """Return sums over the points that push, of values from their laws and forces."""
        contacts, like = self._contacts, self._qdd[0]
        law = jnp.zeros((2 + len(self._qdd), *like.shape), like.dtype)
        start = jnp.zeros_like(jnp.concatenate(values(law, like)))
        places = np.arange(len(start))

        def look(total: Array, k: Array) -> Array:
            law, push = self._push(k)

            def add(total: Array) -> Array:
                new = jnp.concatenate(values(law, push))
                return total.at[places].add(new, mode="promise_in_bounds")

            return jax.lax.cond(jnp.any(push > 0), add, lambda total: total, total)

        return _over_lists(contacts.lists.count, contacts.size, look, start)


class _Bodies(NamedTuple):
    """Tables of all bodies at the start of the step.

    Attributes:
        boxes: placed boxes (`Alike.boxes`).
        twists: twists at present rates: rad/s, and m/s at the root's origin.
        ball: radius of the ball that bounds all places within two steps, m.
        reach: distance that any point moves in a step, and a margin, m.
        h: step, s.
    """

    boxes: tuple[Array, ...]
    twists: tuple[Array, Array]
    ball: Array
    reach: Array
    h: float


def _near_points(pairs: Pairs, bodies: _Bodies, like: Array) -> tuple[Array, Array]:
    """Return the near points that each individual lists, and their counts."""
    first, second = (jnp.asarray(x, _NO_SIGN) for x in (pairs.first, pairs.second))
    runs = np.repeat(np.arange(len(pairs.runs)), [run.count for run in pairs.runs])
    sizes = [run.count * KINDS[run.kind][1] for run in pairs.runs]
    starts = np.cumsum([0, *sizes[:-1]])
    places = [start + np.arange(run.count) for start, run in zip(starts, pairs.runs, strict=True)]

    def round_(listed: tuple[Array, Array], p: Array) -> tuple[tuple[Array, Array], None]:
        pair = first[p], second[p]
        away = _at(bodies.boxes[0], pair[1], 1) - _at(bodies.boxes[0], pair[0], 1)
        close = dot(away, away) < sum(_at(bodies.ball, body) for body in pair) ** 2
        if is_traced(pairs.stiffness):
            close = close & (_at(jnp.asarray(pairs.stiffness), numbers[p]) > 0)

        def look(listed: tuple[Array, Array]) -> tuple[Array, Array]:
            for r, run in enumerate(pairs.runs):
                append = functools.partial(_with_near, run, pair, numbers[p], close, bodies)
                listed = jax.lax.cond(which[p] == r, append, lambda listed: listed, listed)
            return listed

        return jax.lax.cond(jnp.any(close), look, lambda listed: listed, listed), None

    which, numbers = jnp.asarray(runs), jnp.asarray(np.concatenate(places), _NO_SIGN)
    points = unset((sum(sizes), _POINT, *like.shape[1:]), like)
    start = points, jnp.zeros(like.shape[1:], _NO_SIGN)
    return jax.lax.scan(round_, start, jnp.arange(len(runs), dtype=_NO_SIGN))[0]


def _with_near(
    run: Alike,
    pair: tuple[Array, Array],
    number: Array,
    close: Array,
    bodies: _Bodies,
    listed: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Append the near points of a pair, whose first point has the number, to the lists."""
    boxes = (run.boxes(bodies.boxes, body, side) for side, body in enumerate(pair))
    reach = sum(_at(bodies.reach, body) for body in pair)
    twists = [[_at(x, body, 1) for x in bodies.twists] for body in pair]
    for e, one in enumerate(KINDS[run.kind][0](*boxes)):
        gap, normal, *places, carried = one.gap[0], *(x[:, 0] for x in one[1:])
        closing = jnp.maximum(-_apart(normal, places, twists), 0.0)
        near = close & (gap < reach + bodies.h * closing)
        own = jnp.broadcast_to(number + run.count * e, gap.shape).astype(gap.dtype)
        row = jnp.concatenate([jnp.stack([own, gap]), normal, *places, carried])
        listed = _appended(listed, near, row)
    return listed


def _appended(listed: tuple[Array, Array], near: Array, row: Array) -> tuple[Array, Array]:
    """Append a row to the list of every individual for which it is near."""
    size = len(listed[0])

    def append(listed: tuple[Array, Array]) -> tuple[Array, Array]:
        points, count = listed
        return _put(points, jnp.where(near, count, size), row), count + near.astype(_NO_SIGN)

    return jax.lax.cond(jnp.any(near), append, lambda listed: listed, listed)


def _apart(normal: Array, places: list[Array], twists: list[list[Array]]) -> Array:
    """Return the separation velocity of a point at constant twists of both bodies, m/s."""
    one, two = (
        dot(normal, linear) + dot(spin, cross(place, normal))
        for place, (spin, linear) in zip(places, twists, strict=True)
    )
    return two - one


def _parts(point: Array) -> tuple[Array, Array, tuple[Array, Array], Array]:
    """Return the number, the normal, both places and `Separation.carried` of a listed point."""
    return point[0].astype(_NO_SIGN), point[2:5], (point[5:8], point[8:11]), point[11:]


def _over_lists(count: Array, most: int, look: Callable[[Any, Array], Any], start: Any) -> Any:
    """Fold a function over the rounds in which any individual has a listed point.

    ``count`` is the length of each individual's list, at most ``most``.
    """

    def one(carry: Any, k: Array) -> tuple[Any, None]:
        within = jnp.any(k < count)
        return jax.lax.cond(within, lambda carry: look(carry, k), lambda carry: carry, carry), None

    def group(carry: Any, g: Array) -> tuple[Any, None]:
        rounds = _TOGETHER * g + jnp.arange(_TOGETHER, dtype=_NO_SIGN)
        within = jnp.any(_TOGETHER * g < count)
        return jax.lax.cond(
            within, lambda carry: jax.lax.scan(one, carry, rounds)[0], lambda carry: carry, carry
        ), None

    return jax.lax.scan(group, start, jnp.arange(-(-most // _TOGETHER), dtype=_NO_SIGN))[0]


def _table(count: Array, most: int, value: Callable[[Array], Array], like: Array) -> Array:
    """Return a table of a function of the rounds, for the points that each individual lists.

    ``like`` is as in `unset`.
    """

    def look(table: Array, k: Array) -> Array:
        return _put(table, jnp.where(k < count, k, most), value(k))

    row = jax.eval_shape(value, jax.ShapeDtypeStruct((), _NO_SIGN))
    return _over_lists(count, most, look, unset((most, *row.shape), like))


# Rows of tables, at an index for all individuals or at an index for each.


def _at(x: Array, index: Array, axis: int = 0) -> Array:
    return jax.lax.dynamic_index_in_dim(x, index, axis, keepdims=False)


def _each(function: Callable, place: Array) -> Callable:
    """Return a function of arrays with the batch axes of ``place``, individual by individual."""
    for _ in range(place.ndim):
        function = jax.vmap(function, -1, -1)
    return function


def _own(x: Array, place: Array) -> Array:
    """Return the columns of a table at each individual's index."""
    return _each(lambda x, i: _at(x, i, 1), place)(x, place)


def _constant(x: Any, place: Array) -> Array:
    """Return the last axis of a table that all individuals share, at each individual's index."""
    return jnp.take(jnp.asarray(x), place, axis=-1, mode="clip")


def _put(table: Array, place: Array, row: Array) -> Array:
    """Write a row at each individual's index, unless the index is behind the end of the table."""

    def put(table: Array, place: Array, row: Array) -> Array:
        return table.at[place].set(row, mode="drop", unique_indices=True)

    return _each(put, place)(table, place, row)


def _add(sums: Array, place: Array, value: Array) -> Array:
    """Add a number at each individual's index."""

    def add(sums: Array, place: Array, value: Array) -> Array:
        return sums.at[place].add(value, mode="drop")

    return _each(add, place)(sums, place, value)
