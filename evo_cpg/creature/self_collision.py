"""Self-collision: pairs of bodies of one creature that must not pass through each other.

The rule includes all pairs except neighbours at a joint, bodies that overlap in the neutral pose,
and bodies that can never meet (`evo_cpg.creature.reach`). Bodies count as their `RoundedBox`.
Bodies that are welded together never touch, and are neighbours of each other's neighbours.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from evo_cpg.creature.algebra.decisions import Condition
from evo_cpg.creature.algebra.numerics import Numbers, is_traced, xp
from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.creature.reach import PIECES, keeps_apart
from evo_cpg.creature.tree import Tree

# Alternating projections that find the nearest points of two boxes, and the gap (m) below which
# boxes count as overlapping.
_PROJECTIONS, TOUCH = 200, 1e-4

# Least sine of the angle between edges that are not parallel.
_PARALLEL = 1e-6

# Numbers of pieces of joint ranges that are tried first, and the factor on the size of bodies in
# these tries. If the enlarged bodies never meet, the same number shows it for similar bodies, too.
_FEWER_PIECES, _SLACK = (1, 8, 27, 125), 1.25

# Pairs of body names.
PairNames = tuple[tuple[str, str], ...]


class PlanPairs(NamedTuple):
    """Pairs of bodies that matter in all creatures of one plan.

    Attributes:
        kept: pairs that must not pass through each other.
        watched: pairs that must not overlap (`evo_cpg.simulation.judge`).
    """

    kept: PairNames = ()
    watched: PairNames = ()


@dataclasses.dataclass(frozen=True)
class SelfCollision:
    """User settings that change the rule, by names of bodies.

    Attributes:
        exclude: pairs of bodies that may pass through each other.
        include: pairs of bodies that must not, even neighbours or bodies that overlap in the
            neutral pose.
        only: the only pairs to consider, collected from several creatures of one plan, or None for
            the rule. Pairs that overlap in the neutral pose may still pass (`passing_at_rest`).
        looped: whether a loop computes the contacts even if there are few pairs.
    """

    exclude: PairNames = ()
    include: PairNames = ()
    only: PairNames | None = None
    looped: bool = False


def colliding_pairs(
    creature: Creature, tree: Tree, settings: SelfCollision
) -> list[tuple[int, int]]:
    """Return the pairs of a tree's bodies that must not pass through each other.

    The creature's numbers must be known, and all names in the settings must exist.
    """
    if settings.only is not None:
        return sorted(_indices(tree.names, settings.only))
    candidates, overlapping = candidate_pairs(creature, tree, settings)
    return [pair for pair in candidates if pair not in overlapping]


def passing_at_rest(
    creature: Creature, tree: Tree, settings: SelfCollision, pairs: Sequence[tuple[int, int]]
) -> Bool[Numbers, " p"]:
    """Return whether pairs may pass because they touch or overlap in the neutral pose.

    The creature's numbers may be traced. All names in the settings must exist.
    """
    included = _indices(tree.names, settings.include)
    ruled = np.array([tuple(sorted(pair)) not in included for pair in pairs], bool)
    centres, rotations = neutral_pose(creature)
    bodies = np.array([creature.body_index(name) for name in tree.names])
    boxes = [creature.bodies[i].shape.rounded_box for i in bodies]
    half = xp.array([box.half_extents for box in boxes])
    radius = xp.array([box.radius for box in boxes])
    turned = rotations[bodies]
    within = xp.array([box.centre for box in boxes])
    middle = centres[bodies] + xp.einsum("bij,bj->bi", turned, within)
    both = np.array(pairs, int).reshape(-1, 2).T
    return touching((middle, turned, half), radius[both[0]] + radius[both[1]], both, ruled)


# Centres (m), rotations and half extents (m) of boxes, the boxes on the first axis.
Boxes = tuple[Float[Numbers, "b 3"], Float[Numbers, "b 3 3"], Float[Numbers, "b 3"]]


def touching(
    boxes: Boxes, radius: Any, pairs: Int[np.ndarray, "2 p"], ruled: Bool[Numbers, " p"]
) -> Bool[Numbers, " p"]:
    """Return whether pairs of rounded boxes touch or overlap. It is False for pairs not ruled.

    Args:
        boxes: the boxes without their radii.
        radius: sum of both radii of each pair, m.
        pairs: indices of the boxes of each pair.
        ruled: pairs to look at. Others cost no time if numbers are traced.
    """
    # The gap along a separating direction is at most the distance, and negative in an overlap. It
    # differs from the distance between corners, which matters if they have a radius.
    least, near = _separating_gaps(boxes, pairs), radius + TOUCH
    unclear = ruled & (radius > 0) & (least >= 0) & (least < near)
    distance = _distances(boxes, pairs, unclear.any())
    return ruled & (least < near) & (~unclear | (distance < near))


def _separating_gaps(boxes: Boxes, pairs: Int[np.ndarray, "2 p"]) -> Float[Numbers, " p"]:
    """Return the largest gaps along face normals and cross products of edges (Gottschalk 1996)."""
    middle, turned, half = boxes
    axes = [xp.swapaxes(turned[own], 1, 2) for own in pairs]
    crossed = xp.cross(axes[0][:, :, None], axes[1][:, None]).reshape(-1, 9, 3)
    every = xp.concatenate([*axes, crossed], 1)
    length = xp.sqrt((every * every).sum(-1))
    # Nearly parallel edges have no cross product.
    every = every / xp.where(length > _PARALLEL, length, 1.0)[..., None]
    gap = xp.abs((every * (middle[pairs[1]] - middle[pairs[0]])[:, None]).sum(-1))
    for own, directions in zip(pairs, axes, strict=True):
        along = xp.abs((every[:, :, None] * directions[:, None]).sum(-1))
        gap = gap - (along * half[own][:, None]).sum(-1)
    return xp.where(length > _PARALLEL, gap, -np.inf).max(-1)


def _distances(boxes: Boxes, pairs: Int[np.ndarray, "2 p"], needed: Any) -> Numbers:
    """Return the distances of boxes by alternating projections, or anything if not needed."""
    frames = [tuple(x[own] for x in boxes) for own in pairs]

    def project(point: Numbers, centre: Numbers, axes: Numbers, most: Numbers) -> Numbers:
        # Sums of products, because XLA computes many small matrix products slowly.
        own = xp.clip((axes * (point - centre)[:, :, None]).sum(1), -most, most)
        return centre + (axes * own[:, None]).sum(2)

    def on_both(_: Any, points: tuple[Numbers, Numbers]) -> tuple[Numbers, Numbers]:
        here = project(points[1], *frames[0])
        return here, project(here, *frames[1])

    points = frames[0][0], frames[1][0]
    if is_traced(points, needed):
        points = jax.lax.fori_loop(0, jnp.where(needed, _PROJECTIONS, 0), on_both, points)
    else:
        for _ in range(_PROJECTIONS if needed else 0):
            points = on_both(_, points)
    return xp.linalg.norm(points[1] - points[0], axis=1)


class LeftOut(NamedTuple):
    """Reasons why pairs of a plan are left out.

    Attributes:
        apart: pairs of bodies that never meet, and the number of pieces of joint ranges that shows
            it.
        others: pairs that are left out because they overlap in the neutral pose, or turn side by
            side about a common axis.
    """

    apart: tuple[tuple[int, int, int], ...]
    others: tuple[tuple[int, int], ...]


def left_out(creature: Creature, tree: Tree, settings: SelfCollision) -> LeftOut:
    """Return the reasons why all pairs except those of ``settings.only`` are left out.

    The creature's numbers must be known.
    """
    assert settings.only is not None
    every = [
        pair
        for pair in _ruled(creature, tree, settings)
        if pair not in _indices(tree.names, settings.only)
    ]
    centre, half = _boxes(creature, tree)
    apart: list[tuple[int, int, int]] = []
    for pieces in (*_FEWER_PIECES, PIECES):
        slack = 1.0 if pieces == PIECES else _SLACK
        are_apart = keeps_apart(tree, (centre, slack * half), pieces)
        shown = [pair for pair in every if are_apart(*pair)]
        apart += [(*pair, pieces) for pair in shown]
        every = [pair for pair in every if pair not in shown]
    return LeftOut(tuple(apart), tuple(every))


def still_apart(creature: Creature, tree: Tree, left: LeftOut) -> list[Condition]:
    """Return whether each pair of ``left.apart`` still never meets. Numbers may be traced."""
    box = _boxes(creature, tree)
    are_apart = {pieces: keeps_apart(tree, box, pieces) for *_, pieces in left.apart}
    return [are_apart[pieces](first, second) for first, second, pieces in left.apart]


def candidate_pairs(
    creature: Creature, tree: Tree, settings: SelfCollision
) -> tuple[list[tuple[int, int]], set[tuple[int, int]]]:
    """Return the pairs that can meet, and those of them that overlap in the neutral pose.

    Neighbours at a joint are not among them. The arguments are those of `colliding_pairs`.
    """
    are_apart = keeps_apart(tree, _boxes(creature, tree))
    candidates = [pair for pair in _ruled(creature, tree, settings) if not are_apart(*pair)]
    passing = passing_at_rest(creature, tree, settings, candidates)
    return candidates, {pair for pair, passes in zip(candidates, passing, strict=True) if passes}


def _ruled(creature: Creature, tree: Tree, settings: SelfCollision) -> list[tuple[int, int]]:
    """Return the pairs that the rule keeps if they can meet and do not overlap in neutral pose.

    Bodies that are welded together never touch. If a joint links two of them, none of the bodies
    welded to one touches one that is welded to the other.
    """
    shaped = [i for i, body in enumerate(creature.bodies_of(tree.names)) if body.shape.exists]
    owners = tree.owners
    every = {
        (one, two) for one, two in itertools.combinations(shaped, 2) if owners[one] != owners[two]
    }
    excluded, included = (_indices(tree.names, x) for x in (settings.exclude, settings.include))
    links = {
        (owners[parent], owners[body]) for body, parent in enumerate(tree.parents) if parent >= 0
    }
    joined = {
        (one, two)
        for one, two in every
        if {(owners[one], owners[two]), (owners[two], owners[one])} & links
    }
    return sorted((every - joined - excluded) | (included & every))


def _boxes(creature: Creature, tree: Tree) -> tuple[Numbers, Numbers]:
    """Return centres and half edges ``(3, b)`` of boxes around bodies, in working frames, m."""
    boxes = [body.shape.rounded_box for body in creature.bodies_of(tree.names)]
    centre = tree.centre + xp.array([box.centre for box in boxes]).T
    return centre, xp.array([box.half_extents + box.radius for box in boxes]).T


def _indices(names: tuple[str, ...], given: tuple[tuple[str, str], ...]) -> set[tuple[int, int]]:
    """Return pairs of names as pairs of indices in ``names``, the lower index first."""
    found = [sorted(map(names.index, pair)) for pair in given]
    return {(first, second) for first, second in found}
