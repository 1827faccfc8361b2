"""Pairs of bodies of one creature that must not pass through each other, and their gaps.

A pair has the ground's contact law (`evo_cpg.physics.contact.contact`) without friction and
restitution. The separation velocity of the nearest points at the end of the step is v_n. The force
is

    f_n = max(0, c (v* - v_n)),      v* = -gap / h, or slowly out of an overlap.

Both bodies belong to one tree, so the motion of its root does not change their separation. All
velocities and accelerations here may therefore be those of a tree whose root is at rest.

Few pairs are unrolled (`evo_cpg.physics.contact.pair_contacts`), many are looped over
(`evo_cpg.physics.contact.many_pairs`).
"""

import functools
import itertools
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import Condition, Undecidable, all_hold, chosen
from evo_cpg.creature.algebra.linear import cross, dot, expand_dims_like, matvec, skew
from evo_cpg.creature.algebra.numerics import Numbers, is_traced, xp
from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.creature.per_body import take
from evo_cpg.creature.reach import chain_to_root
from evo_cpg.creature.self_collision import (
    LeftOut,
    SelfCollision,
    colliding_pairs,
    left_out,
    passing_at_rest,
    still_apart,
)
from evo_cpg.creature.shapes import RoundedBox
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.contact.box_separation import separation_of_boxes, separation_of_flat
from evo_cpg.physics.contact.separation import (
    RoundedBoxes,
    Separation,
    separation_of_line_and_box,
    separation_of_lines,
    separation_of_rounded,
)
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.tree.spatial_algebra import BodyMotion

# c h of a pair, as a multiple of the geometric mean of the two masses.
PAIR_STIFFNESS = 60.0

# Kinds of pairs: the function that finds their nearest points, and the number of points of a pair.
KINDS = {
    "lines": (separation_of_lines, 2),
    "flat": (separation_of_flat, 2),
    "boxes": (separation_of_boxes, 3),
    "line and box": (separation_of_line_and_box, 2),
    "rounded": (separation_of_rounded, 2),
}

# Largest drift of a touching pair (m) in a step that needs no update of its velocity-product bias.
LARGEST_DRIFT = 2e-4

# Largest number of pairs that are unrolled. `evo_cpg.physics.contact.many_pairs` loops over more
# pairs. A trial of the quadruped with its 10 pairs takes 1.6 times as long with loops.
_MOST_WRITTEN_OUT = 60

# Largest sine of the angle between axes that count as parallel.
_PARALLEL = 1e-9


class Alike(NamedTuple):
    """Pairs of one kind.

    Attributes:
        kind: a key of `KINDS`.
        turned: axes of the first and the second body that count as x, y and z.
    """

    kind: str
    turned: tuple[tuple[int, int, int], tuple[int, int, int]]
    count: int

    def boxes(
        self, placed: tuple[Array, ...], bodies: np.ndarray | Array, side: int
    ) -> RoundedBoxes:
        """Return the boxes of the first (side 0) or the second bodies (side 1) of some pairs.

        ``placed`` is centres, axes as columns, half extents and radii of all bodies' boxes, m. The
        bodies are a list of indices, or one index that may be traced.
        """
        known = isinstance(bodies, np.ndarray)
        pick: Callable[..., Array] = take if known else jax.lax.dynamic_index_in_dim
        order = np.array(self.turned[side])
        axes = zip(placed, (1, 2, 1, 0), strict=True)
        centre, turned, half, radius = (pick(x, bodies, axis) for x, axis in axes)
        return RoundedBoxes(centre, take(turned, order), take(half, order, 0), radius)


class Pairs(eqx.Module):
    """Pairs of bodies that may touch, and the rounded boxes of all bodies.

    Attributes:
        first: index in the tree of one body of each pair.
        second: index in the tree of the other body.
        runs: consecutive pairs of one kind.
        centre: centre of every body's box in the body's working frame, m.
        half_extents: half extents of every body's box, m.
        radius: radius of every body's box, m.
        stiffness: c h of every point, kg.
        always_looped: whether a loop computes even few pairs.
    """

    first: tuple[int, ...] = eqx.field(static=True)
    second: tuple[int, ...] = eqx.field(static=True)
    runs: tuple[Alike, ...] = eqx.field(static=True)
    centre: Float[Numbers, "3 b"]
    half_extents: Float[Numbers, "3 b"]
    radius: Float[Numbers, " b"]
    stiffness: Float[Numbers, " p"]
    always_looped: bool = eqx.field(static=True, default=False)

    @property
    def owners(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Bodies of every point: in a run, the first points of all pairs, then the next ones."""
        return _of_points(self.first, self.runs), _of_points(self.second, self.runs)

    @property
    def pair_stiffness(self) -> Float[Numbers, " p"]:
        """Stiffness of each pair's points, kg. Pairs without it meet only in other creatures."""
        points = _of_points(tuple(range(len(self.first))), self.runs)
        return self.stiffness[np.unique(points, return_index=True)[1]]

    @property
    def looped(self) -> bool:
        """True if a loop computes the pairs."""
        return self.always_looped or len(self.first) > _MOST_WRITTEN_OUT


class _Case(NamedTuple):
    """A pair of bodies, with its kind and axes as in `Alike`. A line comes first in its pair."""

    kind: str
    turned: tuple[tuple[int, int, int], tuple[int, int, int]]
    pair: tuple[int, int]


class _NeutralPose(NamedTuple):
    """Boxes of a creature's bodies in the neutral pose. The numbers may be traced.

    Attributes:
        boxes: rounded boxes of its bodies.
        turned: rotations ``(b, 3, 3)`` of its bodies.
        centres: centres of the boxes, m.
    """

    tree: Tree
    boxes: list[RoundedBox]
    turned: Numbers
    centres: list[Numbers]

    def case(self, pair: tuple[int, int]) -> _Case:
        """Return the kind and the axes of a pair. The numbers must be known."""
        lines = [not self.boxes[body].half_extents[1:].any() for body in pair]
        if lines[1]:
            pair, lines = (pair[1], pair[0]), lines[::-1]
        both, plain = [self.boxes[body] for body in pair], (0, 1, 2)
        if any(box.radius > 0 for box in both):
            if lines[0]:
                return _Case("lines" if lines[1] else "line and box", (plain, plain), pair)
            longest = (int(np.argmax(box.half_extents)) for box in both)
            one, two = ((x, (x + 1) % 3, (x + 2) % 3) for x in longest)
            return _Case("rounded", (one, two), pair)
        return self.case_of_boxes(pair)

    def case_of_boxes(self, pair: tuple[int, int]) -> _Case:
        """Return the axes of two boxes without radius, whose sizes may be traced."""
        tree, plain = self.tree, (0, 1, 2)
        chains = [set(chain_to_root(tree, body)) for body in pair]
        dofs = [i for i, body in enumerate(tree.dof_bodies) if body in chains[0] ^ chains[1]]
        boxes = _Case("boxes", (plain, plain), pair)
        if any(kind.at_once or kind.translation for kind in (tree.dof_kinds[i] for i in dofs)):
            return boxes
        # All joints between the boxes must turn about one axis of both.
        axes = np.array([self.turned[tree.dof_bodies[i]] @ tree.joint_axes[:, i] for i in dofs])
        if np.linalg.norm(np.cross(axes, axes[0]), axis=1).max() > _PARALLEL:
            return boxes
        across = [np.linalg.norm(np.cross(self.turned[k].T, axes[:1]), axis=1) for k in pair]
        common = [np.flatnonzero(sines < _PARALLEL).tolist() for sines in across]
        if not all(common):
            return boxes
        one, two = (((z + 1) % 3, (z + 2) % 3, z) for (z,) in common)
        return _Case("flat", (one, two), pair)

    def keeps(self, case: _Case) -> Condition:
        """Return whether a pair still has its kind and axes with the present numbers."""
        both = [self.boxes[body] for body in case.pair]
        if case.kind in ("flat", "boxes"):
            return self.case_of_boxes(case.pair) == case
        if case.kind == "rounded":
            # The axis that counts as x must be the longest.
            halves = zip(both, case.turned, strict=True)
            return all_hold(
                (box.half_extents[order[0]] >= box.half_extents).all() for box, order in halves
            )
        lines = both if case.kind == "lines" else both[:1]
        return all_hold((box.half_extents[1:] == 0).all() for box in lines)

    def passes(self, case: _Case) -> Condition:
        """Return whether two boxes turn about a common axis, always apart along that axis."""
        if case.kind != "flat":
            return False
        (first, second), (order, other_order) = case.pair, case.turned
        aside = self.turned[first][:, order[2]] @ (self.centres[second] - self.centres[first])
        sides = self.boxes[first].half_extents[order[2]]
        return abs(aside) > sides + self.boxes[second].half_extents[other_order[2]]


def make_pairs(creature: Creature, tree: Tree, settings: SelfCollision) -> Pairs | None:
    """Return the pairs of bodies that may touch and must not pass, or None if there are none.

    If the pairs are those of a whole plan (``settings.only``), pairs that may pass through each
    other in this creature have zero stiffness and no force.

    The pairs and their kinds are decisions by known numbers, which a build with traced numbers
    replays (`evo_cpg.creature.algebra.decisions`).
    """
    boxes = [body.shape.rounded_box for body in creature.bodies_of(tree.names)]
    order = np.array([creature.body_index(name) for name in tree.names])
    places, turned = (each[order] for each in neutral_pose(creature))
    placed = zip(places, turned, boxes, strict=True)
    pose = _NeutralPose(tree, boxes, turned, [at + turn @ box.centre for at, turn, box in placed])
    whole_plan = settings.only is not None

    def choose() -> tuple[_Case, ...]:
        cases = sorted(map(pose.case, colliding_pairs(creature, tree, settings)))
        return tuple(case for case in cases if whole_plan or not pose.passes(case))

    def still(cases: tuple[_Case, ...]) -> Condition:
        if not whole_plan and is_traced(tree, boxes):
            raise Undecidable("traced numbers cannot decide which limbs can touch")
        return all_hold(map(pose.keeps, cases))

    cases = chosen(choose, still)
    if whole_plan:
        # Decide why the other pairs are left out, so that a replay checks it.
        def why() -> tuple[LeftOut, list[_Case]]:
            left = left_out(creature, tree, settings)
            return left, [pose.case((one, two)) for one, two, *_ in (*left.apart, *left.others)]

        def still_out(reasons: tuple[LeftOut, list[_Case]]) -> Condition:
            left, every = reasons
            if not every:
                return True
            # In another body, a pair may be left out for another reason.
            pairs = [(one, two) for one, two, *_ in (*left.apart, *left.others)]
            passing = passing_at_rest(creature, tree, settings, pairs)
            apart = [*still_apart(creature, tree, left), *(False for _ in left.others)]
            each = zip(apart, passing, map(pose.passes, every), strict=True)
            return all_hold(one | two | three for one, two, three in each)

        chosen(why, still_out)
    if not cases:
        return None
    groups = itertools.groupby(cases, lambda case: case[:2])
    runs = tuple(Alike(*case, len(list(same))) for case, same in groups)
    pairs = [case.pair for case in cases]
    first, second = zip(*pairs, strict=True)
    one, two = (tree.rigid_mass[np.array(_of_points(x, runs))] for x in (first, second))
    # A fixed root without mass counts like the limb that touches it.
    one, two = xp.where(one > 0, one, two), xp.where(two > 0, two, one)
    stiffness = PAIR_STIFFNESS * xp.sqrt(one * two)
    if whole_plan:
        passing = passing_at_rest(creature, tree, settings, pairs)
        of_pair = _of_points(tuple(range(len(pairs))), runs)
        stiffness = xp.where(passing[np.array(of_pair)], 0.0, stiffness)
    return Pairs(
        first,
        second,
        runs,
        tree.centre + xp.array([box.centre for box in boxes]).T,
        xp.array([box.half_extents for box in boxes]).T,
        xp.array([box.radius for box in boxes]),
        stiffness,
        settings.looped,
    )


def _of_points(each: tuple[int, ...], runs: tuple[Alike, ...]) -> tuple[int, ...]:
    """Return a number of every pair for its points, in the order of `Pairs.owners`."""
    found, start = (), 0
    for run in runs:
        found += each[start : start + run.count] * KINDS[run.kind][1]
        start += run.count
    return found


def placed_boxes(pairs: Pairs, kin: Kinematics) -> tuple[Array, Array, Array]:
    """Return centres ``(3, b, *n)``, half extents and radii of all bodies' boxes, m."""
    centre = kin.origin + matvec(kin.rotation, expand_dims_like(pairs.centre, kin.origin))
    half = expand_dims_like(pairs.half_extents, kin.origin)
    return centre, half, expand_dims_like(pairs.radius, kin.origin[0])


def acceleration_field(
    motion: Kinematics | BodyMotion,
) -> tuple[Float[Array, "3 b *n"], Float[Array, "3 3 b *n"]]:
    """Return a and A of all bodies at constant joint rates.

    The point of a body at the offset r from its origin has the acceleration ``a + A r``.
    """
    spin = motion.angular
    square = dot(spin, spin)
    a = motion.bias_linear + cross(spin, motion.linear)
    A = skew(motion.bias_angular) + spin[:, None] * spin[None]
    return a, A - square[None, None] * expand_dims_like(np.eye(3), A)


class PointMotion(NamedTuple):
    """Motion of a body's point of a pair at constant joint rates, ``(3, p, *n)``.

    Attributes:
        angular: angular velocity of the body, rad/s.
        velocity: velocity of the point, m/s.
        acceleration: acceleration of the point, m/s^2.
    """

    angular: Array
    velocity: Array
    acceleration: Array


def parting_acceleration(normal: Array, carried: Array, points: Iterable[PointMotion]) -> Array:
    """Return the separation acceleration of points along their normals, m/s^2."""
    turning, both = jnp.zeros_like(normal), []
    for fraction, point in zip(carried, points, strict=True):
        turning = turning + fraction[None] * point.angular
        both.append(point)
    first, second = both
    parting = second.velocity - first.velocity
    # A turning normal points at a different place of a sliding surface.
    along = dot(normal, second.acceleration - first.acceleration)
    return along - 2.0 * dot(cross(normal, turning), parting)


def separations(pairs: Pairs, kin: Kinematics) -> Separation:
    """Return the separations at all points of all pairs, in the world frame."""
    return _of_runs(pairs, kin, lambda kind: KINDS[kind][0])


def gaps_of_pairs(pairs: Pairs, kin: Kinematics) -> Float[Array, "p *n"]:
    """Return the gap of each pair, m, negative where its rounded boxes overlap."""

    def least(kind: str) -> Callable[..., list[Array]]:
        # Boxes are never nearer than at their first point.
        few = {"corners": 1} if kind == "boxes" else {}
        find = functools.partial(KINDS[kind][0], **few)
        return lambda a, b: [functools.reduce(jnp.minimum, [x.gap for x in find(a, b)])]

    return _of_runs(pairs, kin, least)


def _of_runs(pairs: Pairs, kin: Kinematics, finder: Callable[[str], Callable[..., list]]) -> Any:
    """Return what the finder of each kind finds for all pairs, joined along their axis."""
    centre, half, radius = placed_boxes(pairs, kin)
    placed = centre, kin.rotation, half, radius
    found, start = [], 0
    for run in pairs.runs:
        bodies = [np.array(x[start : start + run.count]) for x in (pairs.first, pairs.second)]
        find = finder(run.kind)
        if pairs.looped:
            found += _one_by_one(run, find, bodies, placed)
        else:
            found += find(*(run.boxes(placed, own, side) for side, own in enumerate(bodies)))
        start += run.count
    axis = 1 - kin.origin.ndim
    return jax.tree.map(lambda *parts: jnp.concatenate(parts, axis), *found)


def _one_by_one(
    run: Alike, find: Callable[..., list], bodies: list[np.ndarray], placed: tuple[Array, ...]
) -> list:
    """Return what is found for the pairs of a run, in a loop over the pairs."""

    def look(carry: None, pair: Array) -> tuple[None, list]:
        boxes = (run.boxes(placed, pair[side], side) for side in range(2))
        return carry, find(*boxes)

    _, found = jax.lax.scan(look, None, jnp.asarray(np.stack(bodies, 1), jnp.int32))

    def together(x: Array) -> Array:
        """Move the axis of pairs behind the components, in place of the one pair."""
        axis = x.ndim - (placed[0].ndim - 2) - 1
        return jnp.moveaxis(x.squeeze(axis), 0, axis - 1)

    return jax.tree.map(together, found)
