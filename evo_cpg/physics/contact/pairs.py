"""Pairs of bodies of one creature that must not pass through each other, and their gaps.

A pair has the ground's contact law (`evo_cpg.physics.contact.contact`) without friction and
restitution. The separation velocity of the nearest points at the end of the step is v_n. The force
is

    f_n = max(0, c (v* - v_n)),      v* = -gap / h, or slowly out of an overlap.

Few pairs are unrolled (`evo_cpg.physics.contact.few_pairs`), many are looped over
(`evo_cpg.physics.contact.many_pairs`).
"""

import itertools
from collections.abc import Iterable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import Condition, Undecidable, all_hold, chosen
from evo_cpg.creature.algebra.linear import cross, dot, expand_dims_like, matvec, skew
from evo_cpg.creature.algebra.numerics import Numbers, is_traced, xp
from evo_cpg.creature.creature import Creature, neutral_pose
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
from evo_cpg.physics.contact.box_separation import separation_of_boxes
from evo_cpg.physics.contact.flat_separation import separation_of_flat
from evo_cpg.physics.contact.separation import (
    RoundedBoxes,
    Separation,
    separation_of_line_and_box,
    separation_of_lines,
    separation_of_rounded,
)
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.tree.per_body import take
from evo_cpg.physics.tree.spatial_algebra import BodyMotion

# c h of a pair, as a multiple of the geometric mean of the two masses.
_STIFFNESS = 60.0

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
# pairs. The animals of the studies have 45 at most, and keep their results to the last bit.
_MOST_WRITTEN_OUT = 60

# Largest sine of the angle between axes that count as parallel.
_PARALLEL = 1e-9


class Alike(NamedTuple):
    """Pairs of one kind.

    Attributes:
        kind: a key of `KINDS`.
        turned: axes of the first and the second body that count as x, y and z.
        count: number of pairs.
    """

    kind: str
    turned: tuple[tuple[int, int, int], tuple[int, int, int]]
    count: int

    def boxes(
        self, centre: Array, axes: Array, half: Array, radius: Array, side: int
    ) -> RoundedBoxes:
        """Return the boxes of the first or the second bodies of some of the pairs.

        Args:
            centre: centres of the boxes, m.
            axes: axes of the boxes, as columns.
            half: half extents, m.
            radius: radii, m.
            side: 0 for the first bodies, 1 for the second.
        """
        order = np.array(self.turned[side])
        return RoundedBoxes(centre, take(axes, order), take(half, order, 0), radius)


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
    """

    first: tuple[int, ...] = eqx.field(static=True)
    second: tuple[int, ...] = eqx.field(static=True)
    runs: tuple[Alike, ...] = eqx.field(static=True)
    centre: Float[Numbers, "3 b"]
    half_extents: Float[Numbers, "3 b"]
    radius: Float[Numbers, " b"]
    stiffness: Float[Numbers, " p"]

    @property
    def owners(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Bodies of every point: in a run, the first points of all pairs, then the next ones."""
        return _owners(self.first, self.second, self.runs)

    @property
    def looped(self) -> bool:
        """True if there are so many pairs that a loop computes them."""
        return len(self.first) > _MOST_WRITTEN_OUT


def make_pairs(creature: Creature, tree: Tree, settings: SelfCollision) -> Pairs | None:
    """Return the pairs of bodies that may touch and must not pass, or None if there are none.

    If the pairs are those of a whole plan (``settings.only``), pairs that may pass through each
    other in this creature have zero stiffness and no force.
    """
    boxes = [body.shape.rounded_box for body in creature.bodies_of(tree.names)]

    def in_order(pair: tuple[int, int]) -> tuple[int, int]:
        """Return a pair with a line as its first body, if it has one."""
        first, second = pair
        return (second, first) if _is_line(boxes[second]) else pair

    def choose() -> tuple[tuple[int, ...], tuple[int, ...], tuple[Alike, ...]]:
        found = colliding_pairs(creature, tree, settings)
        cases = sorted((*_case(tree, turned, boxes, *pair), pair) for pair in map(in_order, found))
        if settings.only is None:
            cases = [case for case in cases if not _passes(case, turned, centres, boxes)]
        first, second = zip(*(pair for *_, pair in cases), strict=True) if cases else ((), ())
        groups = itertools.groupby(cases, lambda case: case[:2])
        return first, second, tuple(Alike(*case, len(list(same))) for case, same in groups)

    def still(made: tuple[tuple[int, ...], tuple[int, ...], tuple[Alike, ...]]) -> Condition:
        """Return whether each pair still has its recorded kind with the present numbers."""
        if settings.only is None and is_traced(tree, boxes):
            raise Undecidable("traced numbers cannot decide which limbs can touch")
        kinds = [run for run in made[2] for _ in range(run.count)]
        treated = zip(kinds, *made[:2], strict=True)
        return all_hold(_still(tree, turned, boxes, *each) for each in treated)

    def why() -> tuple[LeftOut, list]:
        """Return the reasons why the other pairs are left out."""
        left = left_out(creature, tree, settings)
        cases = [(*_case(tree, turned, boxes, *in_order(pair)), pair) for pair in left.others]
        return left, [case for case in cases if _passes(case, turned, centres, boxes)]

    def stay_left_out(reasons: tuple[LeftOut, list]) -> Condition:
        left, beside = reasons
        passing = [pair for pair in left.others if pair not in [pair for *_, pair in beside]]
        holds = [_passes(case, turned, centres, boxes) for case in beside]
        if passing:
            holds.append(passing_at_rest(creature, tree, settings, passing).all())
        return all_hold([still_apart(creature, tree, left), *holds])

    order = np.array([creature.body_index(name) for name in tree.names])
    places, turned = (each[order] for each in neutral_pose(creature))
    centres = [
        place + turn @ box.centre for place, turn, box in zip(places, turned, boxes, strict=True)
    ]
    first, second, runs = chosen(choose, still)
    if settings.only is not None:
        chosen(why, stay_left_out)
    if not first:
        return None
    one, two = (tree.rigid_mass[np.array(bodies)] for bodies in _owners(first, second, runs))
    # A fixed root without mass counts like the limb that touches it.
    one, two = xp.where(one > 0, one, two), xp.where(two > 0, two, one)
    stiffness = _STIFFNESS * xp.sqrt(one * two)
    if settings.only is not None:
        pairs = list(zip(first, second, strict=True))
        passing = passing_at_rest(creature, tree, settings, pairs)
        of_pair, _ = _owners(tuple(range(len(pairs))), second, runs)
        stiffness = xp.where(passing[np.array(of_pair)], 0.0, stiffness)
    return Pairs(
        first,
        second,
        runs,
        tree.centre + xp.array([box.centre for box in boxes]).T,
        xp.array([box.half_extents for box in boxes]).T,
        xp.array([box.radius for box in boxes]),
        stiffness,
    )


def _owners(
    first: tuple[int, ...], second: tuple[int, ...], runs: tuple[Alike, ...]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the bodies of every point, in the order of `Pairs.owners`."""

    def repeated(bodies: tuple[int, ...]) -> tuple[int, ...]:
        found, start = (), 0
        for run in runs:
            found += bodies[start : start + run.count] * KINDS[run.kind][1]
            start += run.count
        return found

    return repeated(first), repeated(second)


def _is_line(box: RoundedBox) -> bool:
    """Return whether a box extends along x alone, or not at all."""
    return not box.half_extents[1:].any()


def _case(
    tree: Tree, turned: np.ndarray, boxes: list[RoundedBox], first: int, second: int
) -> tuple[str, tuple[tuple[int, int, int], tuple[int, int, int]]]:
    """Return the kind of a pair, and its `Alike.turned`.

    Args:
        tree: the creature, of known numbers.
        turned: rotations ``(b, 3, 3)`` of its bodies in the neutral pose.
        boxes: rounded boxes of its bodies.
        first: first body.
        second: second body.
    """
    plain = (0, 1, 2)
    both = boxes[first], boxes[second]
    if any(box.radius > 0 for box in both):
        if _is_line(both[0]):
            return ("lines" if _is_line(both[1]) else "line and box"), (plain, plain)
        longest = (int(np.argmax(box.half_extents)) for box in both)
        one, two = ((x, (x + 1) % 3, (x + 2) % 3) for x in longest)
        return "rounded", (one, two)
    chains = [set(chain_to_root(tree, body)) for body in (first, second)]
    dofs = [i for i, body in enumerate(tree.dof_bodies) if body in chains[0] ^ chains[1]]
    if any(kind.at_once or kind.translation for kind in (tree.dof_kinds[i] for i in dofs)):
        return "boxes", (plain, plain)
    axes = np.array([turned[tree.dof_bodies[i]] @ tree.joint_axes[:, i] for i in dofs])
    common = [
        np.flatnonzero(np.linalg.norm(np.cross(turned[body].T, axes[:1]), axis=1) < _PARALLEL)
        for body in (first, second)
    ]
    if np.linalg.norm(np.cross(axes, axes[0]), axis=1).max() > _PARALLEL or not all(
        map(len, common)
    ):
        return "boxes", (plain, plain)
    one, two = (((z + 1) % 3, (z + 2) % 3, z) for (z,) in map(np.ndarray.tolist, common))
    return "flat", (one, two)


def _still(
    tree: Tree, turned: Numbers, boxes: list[RoundedBox], run: Alike, first: int, second: int
) -> Condition:
    """Return whether a pair still fits the kind and the axes of a run (see `_case`)."""
    both = boxes[first], boxes[second]
    if run.kind in ("flat", "boxes"):
        return _case(tree, turned, boxes, first, second) == run[:2]
    if run.kind == "rounded":
        # The axis that counts as x must be the longest.
        halves = zip(both, run.turned, strict=True)
        return all_hold(
            (box.half_extents[order[0]] >= box.half_extents).all() for box, order in halves
        )
    lines = both if run.kind == "lines" else both[:1]
    return all_hold((box.half_extents[1:] == 0).all() for box in lines)


def _passes(
    case: tuple[str, tuple[tuple[int, int, int], ...], tuple[int, int]],
    turned: Numbers,
    centres: list[Numbers],
    boxes: list[RoundedBox],
) -> Condition:
    """Return whether two boxes turn about a common axis, always apart along that axis.

    Args:
        case: kind and axes of the pair, and the pair.
        turned: rotations ``(b, 3, 3)`` of the bodies in the neutral pose.
        centres: centres of the boxes in the neutral pose, m.
        boxes: rounded boxes of the bodies.
    """
    kind, (order, other_order), (first, second) = case
    if kind != "flat":
        return False
    aside = turned[first][:, order[2]] @ (centres[second] - centres[first])
    sides = boxes[first].half_extents[order[2]] + boxes[second].half_extents[other_order[2]]
    return abs(aside) > sides


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
    """Return the separation acceleration of points along their normals, m/s^2.

    Args:
        normal: unit vector from the first body to the second.
        carried: fractions of the normal that turn with each body.
        points: motion of the first body's point, and of the second body's point.
    """
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
    centre, half, radius = placed_boxes(pairs, kin)
    found, start = [], 0
    for run in pairs.runs:
        chosen = [
            np.array(bodies[start : start + run.count]) for bodies in (pairs.first, pairs.second)
        ]
        find, _ = KINDS[run.kind]
        if pairs.looped:
            found += _one_by_one(run, chosen, (centre, kin.rotation, half, radius))
        else:
            sides = [
                run.boxes(
                    take(centre, own),
                    take(kin.rotation, own, 2),
                    take(half, own),
                    take(radius, own, 0),
                    side,
                )
                for side, own in enumerate(chosen)
            ]
            found += find(*sides)
        start += run.count
    axis = 1 - kin.origin.ndim
    return jax.tree.map(lambda *parts: jnp.concatenate(parts, axis), *found)


def _one_by_one(
    run: Alike, chosen: list[np.ndarray], placed: tuple[Array, Array, Array, Array]
) -> list[Separation]:
    """Return the separations of the pairs of a run, in a loop over the pairs.

    Args:
        run: kind of the pairs.
        chosen: first and second body of each pair.
        placed: centres, axes, half extents and radii of all bodies' boxes.
    """

    def of(body: Array, side: int) -> RoundedBoxes:
        centre, axes, half, radius = (
            jax.lax.dynamic_index_in_dim(x, body, axis)
            for x, axis in zip(placed, (1, 2, 1, 0), strict=True)
        )
        return run.boxes(centre, axes, half, radius, side)

    def look(carry: None, bodies: Array) -> tuple[None, list[Separation]]:
        return carry, KINDS[run.kind][0](of(bodies[0], 0), of(bodies[1], 1))

    _, found = jax.lax.scan(look, None, jnp.asarray(np.stack(chosen, 1), jnp.int32))

    def together(x: Array) -> Array:
        """Move the axis of pairs behind the components, in place of the one pair."""
        axis = x.ndim - (placed[0].ndim - 2) - 1
        return jnp.moveaxis(x.squeeze(axis), 0, axis - 1)

    return jax.tree.map(together, found)
