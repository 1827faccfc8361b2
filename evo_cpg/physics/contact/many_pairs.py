"""Contacts between many pairs of bodies of one creature, in loops over the pairs.

`evo_cpg.physics.contact.pairs` has the contact law, and `evo_cpg.physics.contact.pair_contacts` the
members of both classes. The code there grows with the number of pairs. This code has the same size
for any number, and skips pairs that cannot act:

1. A pair whose bounding balls are too far apart is skipped.
2. A point whose gap is too large is left out of the step. The threshold is the distance that any
   points of the two bodies can approach in a step at present joint rates, plus the approach of
   these two points in a further step, plus a tenth of the thickness. The balls' threshold has the
   first distance twice.
3. A point that does not push adds nothing to the torques and the matrix.

Most points are left out in most steps. One test therefore skips several consecutive points.

All positions refer to the root's origin. A body's twist at constant rates has the angular velocity
w and the velocity v_0 of its point at the origin. Points p_1 and p_2 with the normal n separate at

    v_n = n . v_02 + w_2 . (p_2 x n) - n . v_01 - w_1 . (p_1 x n),

and the entry of J for a joint axis a through o is ``+-(a . (p x n) - n . (a x o))``.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.algebra.linear import cross, dot, expand_dims_like, matvec, where_each
from evo_cpg.creature.reach import chain_to_root
from evo_cpg.creature.tree import Tree
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

# Number of consecutive points that one test skips. Fitted: 4 to 8 need equally many tests for
# vectors of 16 humanoids, 1 and 12 need a third more.
_TOGETHER = 6

# Type of indices, because indices without sign need no test of their sign.
_NO_SIGN = np.uint32


class _Points(NamedTuple):
    """The points of pairs of one kind, ``(points, *n)`` each. Points that are left out have zeros.

    Attributes:
        watched: 1 where a point counts in this step.
        gap: distance between the bodies, m, negative where they overlap.
        drift: mean change of the separation velocity over the step by velocity products, m/s.
        normal: x, y and z, from the first body to the second.
        first: the first body's point, x, y and z from the root's origin, m.
        second: the second body's point, x, y and z from the root's origin, m.
        carried: fractions of the normal that turn with the first and the second body.
    """

    watched: Array
    gap: Array
    drift: Array
    normal: tuple[Array, Array, Array]
    first: tuple[Array, Array, Array]
    second: tuple[Array, Array, Array]
    carried: tuple[Array, Array]


class _Paths(NamedTuple):
    """Tables of the joint axes between the bodies of every pair of a run, ``(pairs, k)`` each.

    Attributes:
        dofs: indices of the axes in ascending order, padded with the number of all axes.
        signs: 1 for an axis that moves the second body, -1 for the first, 0 for padding.
        rows: start of each axis's row in a packed lower triangle.
    """

    dofs: np.ndarray
    signs: np.ndarray
    rows: np.ndarray


class _Run(NamedTuple):
    """A run: consecutive pairs of one kind, with their points in this step.

    Attributes:
        kind: the kind, and the number of pairs.
        first: first body of each pair.
        second: second body of each pair.
        stiffness: c h of each point, kg.
        paths: joint axes between the bodies.
        near: 1 for each group of `_TOGETHER` points with one that counts, ``(groups, *n)``.
    """

    kind: Alike
    first: np.ndarray
    second: np.ndarray
    stiffness: Any
    paths: _Paths
    points: _Points
    near: Array


class ManyPairContacts:
    """Nearest points of many pairs (see `evo_cpg.physics.contact.pair_contacts.PairContacts`).

    Args:
        tree: the creature.
        pairs: its pairs of bodies.
        kin: kinematics at the start of the step.
        qd: joint rates at the start of the step, rad/s.
        h: step, s.
        runs: runs with points that were found before in this step, or None to find them.
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
        runs: tuple[_Run, ...] | None = None,
        bias: Float[Array, "d *n"] | None = None,
    ):
        self.tree, self.pairs, self.kin, self.qd, self.h = tree, pairs, kin, qd, h
        self.places = kin.origin - kin.origin[:, :1]
        self.bias = jnp.zeros_like(qd) if bias is None else bias
        if runs is None:
            runs = _find(self)
            runs = _with_drift(runs, self.drifts_of(runs, self.bias))
        self.runs = runs

    def with_bias(self, bias: Float[Array, "d *n"]) -> "ManyPairContacts":
        """Return the contacts with the velocity-product bias at other joint rates."""
        old, other = [run.points.drift for run in self.runs], (bias != self.bias).any(0)
        # The bias of most steps never changes.
        new = jax.lax.cond(jnp.any(other), lambda: self.drifts_of(self.runs, bias), lambda: old)
        drift = [where_each(other, *both) for both in zip(new, old, strict=True)]
        runs = _with_drift(self.runs, drift)
        return ManyPairContacts(self.tree, self.pairs, self.kin, self.qd, self.h, runs, bias)

    def bias_at(self, qdd: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Return `bias` for the joint rates after the step: the joint accelerations themselves.

        `drifts_of` computes the velocity-product accelerations from them.
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
        twists = self.twists(self.qd + self.h * qdd)

        def look(run: _Run, found: Array, q: Array) -> Array:
            point = _point(run, q)
            velocity = _turning_apart(run, point, q, twists) + point.drift
            return found | (point.watched & (rest_velocity(point.gap, self.h) > velocity))

        return _over_points(self.runs, look, jnp.zeros(qdd.shape[1:], bool))

    def drifts(self, qdd: Float[Array, "d *n"], bias: Float[Array, "d *n"]) -> Bool[Array, "*n"]:
        """Return for which individuals another bias moves a touching pair by > `LARGEST_DRIFT`."""
        twists, accelerations = self.twists(self.qd + self.h * qdd), self.accelerations(bias)

        def look(run: _Run, found: Array, q: Array) -> Array:
            point = _point(run, q)
            velocity = _turning_apart(run, point, q, twists) + point.drift
            other = velocity - point.drift + self.drift(run, point, q, accelerations)
            rest = rest_velocity(point.gap, self.h)
            pushes = point.watched & ((rest > velocity) | (rest > other))
            return found | (pushes & (self.h * jnp.abs(other - velocity) > LARGEST_DRIFT))

        return _over_points(self.runs, look, jnp.zeros(qdd.shape[1:], bool))

    def parting(self, rates: Float[Array, "d *n"]) -> Float[Array, "p *n"]:
        """Return ``J rates`` of all points, m/s, or 0 for points that are left out."""
        twists = self.twists(rates)
        return jnp.concatenate(
            _of_points(self.runs, lambda run, q: _turning_apart(run, _point(run, q), q, twists))
        )

    # Quantities of bodies, as tables.

    def twists(self, rates: Float[Array, "d *n"]) -> tuple[Array, Array]:
        """Return the twists of all bodies at joint rates: rad/s, and m/s at the root's origin."""
        motion = self.motion(rates)
        return motion.angular, motion.linear - cross(motion.angular, self.places)

    def accelerations(self, qdd: Float[Array, "d *n"]) -> tuple[Array, ...]:
        """Return twists, and d_0 and A of the accelerations ``d_0 + A p`` at constant rates."""
        motion = self.motion(self.qd + self.h * qdd)
        a, A = acceleration_field(motion)
        linear = motion.linear - cross(motion.angular, self.places)
        return motion.angular, linear, a - matvec(A, self.places), A

    def motion(self, rates: Float[Array, "d *n"]) -> BodyMotion:
        """Return the motion of all bodies at joint rates, with the root at rest."""
        still = jnp.zeros((ROOT_DOFS, *rates.shape[1:]), rates.dtype)
        return motion_of_bodies(self.tree, self.kin, still, rates)

    def axes(self) -> tuple[Array, Array]:
        """Return joint axes a and ``a x o``, padded with a zero axis: ``(3, d + 1, *n)``."""
        S, origins = self.kin.axes, self.places[:, np.array(self.tree.dof_bodies, int)]
        moments = cross(S.angular, origins)
        if S.linear is not None:
            moments = moments - S.linear
        none = jnp.zeros_like(moments[:, :1])
        return jnp.concatenate([S.angular, none], 1), jnp.concatenate([moments, none], 1)

    # Quantities of points.

    def drift(self, run: _Run, point: "_Point", q: Array, accelerations: Any) -> Array:
        """Return `_Points.drift` of a point, from `accelerations`."""
        spin, linear, base, A = accelerations
        points = []
        for body, p in zip(_bodies(run, q), (point.first, point.second), strict=True):
            angular = _at(spin, body, 1)
            velocity = _at(linear, body, 1) + cross(angular, p)
            acceleration = _at(base, body, 1) + matvec(_at(A, body, 2), p)
            points.append(PointMotion(angular, velocity, acceleration))
        return 0.5 * self.h * parting_acceleration(point.normal, point.carried, points)

    def drifts_of(self, runs: tuple[_Run, ...], bias: Float[Array, "d *n"]) -> list[Array]:
        """Return `_Points.drift` of all points of some runs, with a velocity-product bias."""
        accelerations = self.accelerations(bias)
        return _of_points(runs, lambda run, q: self.drift(run, _point(run, q), q, accelerations))

    def jacobian(self, run: _Run, point: "_Point", q: Array, axes: Any) -> tuple[Array, Array]:
        """Return the nonzero entries of J, ``(k, *n)``, and their axes, ``(k,)``."""
        pair = q % run.kind.count
        dofs, signs = (jnp.asarray(x)[pair] for x in (run.paths.dofs, run.paths.signs))
        a, moments = (jnp.take(x, dofs, axis=1, mode="clip") for x in axes)
        signs = expand_dims_like(signs.astype(a.dtype), a[0])
        n = point.normal[:, None]
        first, second = (cross(p, point.normal)[:, None] for p in (point.first, point.second))
        moment = jnp.where(signs[None] > 0, second, first)
        return signs * (dot(a, moment) - dot(n, moments)), dofs


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
        # Computed before any loop, so that the iterations only read the tables.
        self._twists = contacts.twists(contacts.qd + contacts.h * qdd)
        none = jnp.zeros_like(qdd[:1])
        # The row behind the torques is for the padding of `_Paths`.
        self._no_sums = _Sums(jnp.concatenate([jnp.zeros_like(qdd), none]), none.sum(0))

    @property
    def force(self) -> Float[Array, "p *n"]:
        """Force of every point, N."""
        runs = self._contacts.runs
        return jnp.concatenate(_of_points(runs, lambda run, q: self._push(run, q)[1]))

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
            contacts = self._contacts
            axes = contacts.axes()

            def add(run: _Run, sums: _Sums, q: Array, point: "_Point", push: Array) -> _Sums:
                J, dofs = contacts.jacobian(run, point, q, axes)
                return _Sums(_plus(sums.torque, dofs, J * push[None]), sums.load + push)

            torque, load = self._where_pushing(add, self._no_sums)
            self._sums = _Sums(torque[: contacts.tree.dof_count], load)
        return self._sums

    def power(self, change: Float[Array, "d *n"]) -> Float[Array, "*n"]:
        """Return the forces' power for a change from `ManyPairContacts.change`, W."""
        return self._contacts.h * dot(change, self.torque)

    def newton(self) -> tuple[Float[Array, "d *n"], Float[Array, "d d *n"]]:
        """Return the linearized torques at zero joint acceleration, and ``h J^T K J``.

        The loop over the points computes `sums`, too, unless they are known.
        """
        contacts, qdd, known = self._contacts, self._qdd, self._sums is not None
        h, batch, count = contacts.h, qdd.shape[1:], contacts.tree.dof_count
        rates = jnp.concatenate([qdd, jnp.zeros((1, *batch), qdd.dtype)])
        axes, size = contacts.axes(), (count + 1) * (count + 2) // 2

        def add(run: _Run, found: Any, q: Array, point: "_Point", push: Array) -> Any:
            (torque, matrix), sums = found
            J, dofs = contacts.jacobian(run, point, q, axes)
            stiffness = expand_dims_like(_at(jnp.asarray(run.stiffness), q), push) / h
            derivative = jnp.where(push > 0, stiffness, 0.0)
            own = jnp.take(rates, dofs, axis=0, mode="clip")
            force = push + derivative * h * (J * own).sum(0)
            rows = jnp.asarray(run.paths.rows)[q % run.kind.count]
            i, j = np.tril_indices(len(dofs))
            values = (h * derivative)[None] * J[i] * J[j]
            torque = _plus(torque, dofs, J * force[None])
            matrix = _plus(matrix, rows[i] + dofs[j], values)
            if not known:
                sums = _Sums(_plus(sums.torque, dofs, J * push[None]), sums.load + push)
            return (torque, matrix), sums

        start = jnp.zeros((count + 1, *batch), qdd.dtype), jnp.zeros((size, *batch), qdd.dtype)
        (torque, packed), sums = self._where_pushing(add, (start, None if known else self._no_sums))
        if sums is not None:
            self._sums = _Sums(sums.torque[:count], sums.load)
        rows, columns = np.indices((count, count))
        most, least = np.maximum(rows, columns), np.minimum(rows, columns)
        places = most * (most + 1) // 2 + least
        return torque[:count], packed[places.ravel()].reshape(count, count, *batch)

    def _push(self, run: _Run, q: Array) -> tuple["_Point", Array]:
        """Return a point and its force, N."""
        h, point = self._contacts.h, _point(run, q)
        velocity = _turning_apart(run, point, q, self._twists) + point.drift
        short = rest_velocity(point.gap, h) - velocity
        stiffness = expand_dims_like(_at(jnp.asarray(run.stiffness), q), short) / h
        return point, jnp.where(point.watched, stiffness * jnp.maximum(short, 0.0), 0.0)

    def _where_pushing(self, add: Callable, start: Any) -> Any:
        """Fold sums over the points that push."""

        def look(run: _Run, sums: Any, q: Array) -> Any:
            point, push = self._push(run, q)
            return jax.lax.cond(
                jnp.any(push > 0),
                lambda sums: add(run, sums, q, point, push),
                lambda sums: sums,
                sums,
            )

        return _over_points(self._contacts.runs, look, start)


class _Point(NamedTuple):
    """One point of one pair (see `_Points`)."""

    watched: Array
    gap: Array
    drift: Array
    normal: Array
    first: Array
    second: Array
    carried: Array


def _point(run: _Run, q: Array) -> _Point:
    watched, gap, drift, *vectors = jax.tree.map(
        lambda x: _at(x, q), run.points, is_leaf=lambda x: isinstance(x, jax.Array)
    )
    return _Point(watched > 0, gap, drift, *(jnp.stack(x) for x in vectors))


def _over_points(runs: tuple[_Run, ...], look: Callable, start: Any) -> Any:
    """Fold a function over the points of some runs that are watched for any individual."""
    for run in runs:

        def point(carry: Any, q: Array, run: _Run = run) -> tuple[Any, None]:
            anyone = jnp.any((_at(run.points.watched, q) > 0) & (q < len(run.points.gap)))
            return jax.lax.cond(
                anyone, lambda carry: look(run, carry, q), lambda carry: carry, carry
            ), None

        def group(
            carry: Any, g: Array, run: _Run = run, point: Callable = point
        ) -> tuple[Any, None]:
            points = _TOGETHER * g + jnp.arange(_TOGETHER, dtype=_NO_SIGN)
            return jax.lax.cond(
                jnp.any(_at(run.near, g) > 0),
                lambda carry: jax.lax.scan(point, carry, points)[0],
                lambda carry: carry,
                carry,
            ), None

        start, _ = jax.lax.scan(group, start, jnp.arange(len(run.near), dtype=_NO_SIGN))
    return start


def _of_points(runs: tuple[_Run, ...], look: Callable) -> list[Float[Array, "k *n"]]:
    """Return a function's value for every point of each run; 0 where it is not watched."""
    found = []
    for run in runs:
        watched = run.points.watched

        def add(run: _Run, values: Array, q: Array) -> Array:
            value = jnp.where(_at(run.points.watched, q) > 0, look(run, q), 0.0)
            return _plus(values, q[None], value[None])

        found.append(_over_points((run,), add, jnp.zeros_like(watched)))
    return found


def _with_drift(runs: tuple[_Run, ...], drifts: list[Array]) -> tuple[_Run, ...]:
    """Return the runs with other values of `_Points.drift`."""
    return tuple(
        run._replace(points=run.points._replace(drift=drift))
        for run, drift in zip(runs, drifts, strict=True)
    )


def _turning_apart(run: _Run, point: "_Point", q: Array, twists: tuple[Array, Array]) -> Array:
    """Return the separation velocity of a point at constant twists of all bodies, m/s."""
    return _apart(point, [[_at(x, body, 1) for x in twists] for body in _bodies(run, q)])


def _apart(point: Any, twists: list[list[Array]]) -> Array:
    """Return the separation velocity of points at constant twists of both bodies, m/s."""
    n, first, second = point.normal, point.first, point.second
    (spin, linear), (other_spin, other_linear) = twists
    second_part = dot(n, other_linear) + dot(other_spin, cross(second, n))
    return second_part - dot(n, linear) - dot(spin, cross(first, n))


def _bodies(run: _Run, q: Array) -> tuple[Array, Array]:
    pair = q % run.kind.count
    return jnp.asarray(run.first)[pair], jnp.asarray(run.second)[pair]


def _at(x: Array, index: Array, axis: int = 0, keepdims: bool = False) -> Array:
    return jax.lax.dynamic_index_in_dim(x, index, axis, keepdims=keepdims)


def _plus(sums: Array, places: Array, values: Array) -> Array:
    return sums.at[places].add(values, mode="promise_in_bounds")


def _find(contacts: ManyPairContacts) -> tuple[_Run, ...]:
    """Find the nearest points of all pairs at the start of the step."""
    tree, pairs, h = contacts.tree, contacts.pairs, contacts.h
    # Positions are relative to the root's origin.
    kin = contacts.kin._replace(origin=contacts.places)
    centre, half, radius = placed_boxes(pairs, kin)
    own = contacts.motion(contacts.qd)
    size = jnp.sqrt((half * half).sum(0)) + radius
    offset = centre - contacts.places
    passing = own.linear + cross(own.angular, offset)
    speed = jnp.sqrt(dot(passing, passing)) + jnp.sqrt(dot(own.angular, own.angular)) * size
    approach, margin = h * speed, _MARGIN * (half.min(0) + radius)
    twists = contacts.twists(contacts.qd)
    owners = tree.dof_bodies
    chains = [set(chain_to_root(tree, body)) for body in range(tree.body_count)]
    found, start, points = [], 0, 0
    for run in pairs.runs:
        stop = start + run.count
        first, second = (np.array(x[start:stop], np.int32) for x in (pairs.first, pairs.second))
        count = run.count * KINDS[run.kind][1]
        stiffness = pairs.stiffness[points : points + count]
        placed = (centre, kin.rotation, half, radius), size, approach, margin
        nearest = _nearest(run, first, second, placed, twists, h)
        # The joint axes between the bodies of each pair.
        between = []
        for one, two in zip(first, second, strict=True):
            axes = [k for k, body in enumerate(owners) if body in chains[one] ^ chains[two]]
            between.append([(k, 1.0 if owners[k] in chains[two] else -1.0) for k in axes])
        most = max(map(len, between))
        padded = [path + [(len(owners), 0.0)] * (most - len(path)) for path in between]
        table = np.array(padded).reshape(len(padded), most, 2)
        dofs = table[..., 0].astype(np.int32)
        paths = _Paths(dofs, table[..., 1].astype(np.float32), dofs * (dofs + 1) // 2)
        watched = nearest.watched
        none = jnp.zeros((-len(watched) % _TOGETHER, *watched.shape[1:]), watched.dtype)
        groups = jnp.concatenate([watched, none]).reshape(-1, _TOGETHER, *watched.shape[1:])
        near = groups.max(1)
        found.append(_Run(run, first, second, stiffness, paths, nearest, near))
        start, points = stop, points + count
    return tuple(found)


def _nearest(
    run: Alike,
    first: np.ndarray,
    second: np.ndarray,
    placed: tuple,
    twists: tuple[Array, Array],
    h: float,
) -> _Points:
    """Find the points of the pairs of a run.

    ``placed`` is the boxes of all bodies (`Alike.boxes`), radii of bounding balls, distances that
    bodies move in this step, and margins, m. The twists are those at the start of the step.
    """
    boxes, size, approach, margin = placed
    spin, linear = twists
    find, each = KINDS[run.kind]
    like = margin[0] + approach[0]
    none = jnp.zeros((run.count * each, *like.shape), like.dtype)
    triple = none, none, none
    start = _Points(none, none, none, triple, triple, triple, (none, none))

    def round_(points: _Points, p: Array) -> tuple[_Points, None]:
        bodies = jnp.asarray(first)[p], jnp.asarray(second)[p]
        near = sum(_at(size + 2.0 * approach + margin, body) for body in bodies)
        away = _at(boxes[0], bodies[1], 1) - _at(boxes[0], bodies[0], 1)
        close = dot(away, away) < near * near

        def look(points: _Points) -> _Points:
            own = zip((0, 1), bodies, strict=True)
            found = find(*(run.boxes(boxes, body, side) for side, body in own))
            gap = jnp.concatenate([one.gap for one in found])
            own = [[_at(x, body, 1, True) for x in (spin, linear)] for body in bodies]
            closing = jnp.concatenate([-_apart(one, own) for one in found])
            reach = sum(_at(approach + margin, body) for body in bodies)
            reach = jnp.expand_dims(reach, 0) + h * jnp.maximum(closing, 0.0)
            new = _Points(
                jnp.where(close[None] & (gap < reach), jnp.ones_like(gap), 0.0),
                gap,
                jnp.zeros_like(gap),
                _components([one.normal for one in found]),
                _components([one.first for one in found]),
                _components([one.second for one in found]),
                _components([one.carried for one in found]),
            )
            places = p + run.count * jnp.arange(each)
            return jax.tree.map(lambda x, value: _plus(x, places, value), points, new)

        return jax.lax.cond(jnp.any(close), look, lambda points: points, points), None

    return jax.lax.scan(round_, start, jnp.arange(run.count, dtype=_NO_SIGN))[0]


def _components(vectors: list[Array]) -> Any:
    """Return the first components of all vectors ``(3, 1, *n)``, the second, and so on."""
    return tuple(jnp.concatenate([x[k] for x in vectors]) for k in range(len(vectors[0])))
