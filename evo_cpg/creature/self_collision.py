"""Which bodies of one creature are kept from passing through each other.

All but neighbours at a joint, bodies that already overlap in the neutral pose, and those that can
never meet (`evo_cpg.creature.reach`). Bodies count as their `RoundedBox`.
"""

import dataclasses
import itertools
from collections.abc import Iterable

import numpy as np

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.creature.reach import pairs_that_can_meet
from evo_cpg.creature.tree import Tree

# Projections by which the nearest points of two boxes are found, and what they must come nearer
# each other than to overlap, m.
_PROJECTIONS, _TOUCH = 200, 1e-4

# Names of two bodies each.
PairNames = tuple[tuple[str, str], ...]


@dataclasses.dataclass(frozen=True)
class SelfCollision:
    """What a user changes about the rule, by names of bodies.

    Attributes:
        exclude: pairs of bodies that may pass through each other.
        include: pairs that may not, although they are neighbours or overlap in the neutral pose.
        only: instead of the rule, all pairs that may not.
    """

    exclude: PairNames = ()
    include: PairNames = ()
    only: PairNames | None = None


def colliding_pairs(creature: Creature, tree: Tree, wanted: SelfCollision) -> list[tuple[int, int]]:
    """Pairs of a tree's bodies that are to be kept apart.

    Args:
        creature: of known numbers.
        tree: its bodies in order.
        wanted: what differs from the rule; all names exist.
    """
    if wanted.only is not None:
        return sorted(_indices(tree.names, wanted.only))
    candidates, overlapping = _candidates(creature, tree, wanted)
    return [pair for pair in candidates if pair not in overlapping]


def pairs_that_touch_at_rest(
    creature: Creature, tree: Tree, wanted: SelfCollision
) -> list[tuple[int, int]]:
    """Pairs that the rule lets pass because they touch or overlap in the neutral pose.

    Neighbours at a joint are not among them. See `colliding_pairs` for the arguments.
    """
    return sorted(_candidates(creature, tree, wanted)[1])


def colliding_pairs_of_all(
    creatures: Iterable[tuple[Creature, Tree]], wanted: SelfCollision
) -> PairNames:
    """Pairs of bodies that are to be kept apart in creatures of one plan, by names.

    Those that may meet in any of them, without those that overlap in the neutral pose of any.

    Args:
        creatures: of known numbers, and their trees.
        wanted: what differs from the rule; all names exist.
    """
    meeting, passing, names = set(), set(), tuple[str, ...]()
    for creature, tree in creatures:
        candidates, overlapping = _candidates(creature, tree, wanted)
        meeting.update(candidates)
        passing |= overlapping
        names = tree.names
    return tuple((names[first], names[second]) for first, second in sorted(meeting - passing))


def _candidates(
    creature: Creature, tree: Tree, wanted: SelfCollision
) -> tuple[list[tuple[int, int]], set[tuple[int, int]]]:
    """Pairs that can meet, and those of them that pass because they overlap from the start."""
    every = set(itertools.combinations(range(len(tree.names)), 2))
    excluded, included = (_indices(tree.names, x) for x in (wanted.exclude, wanted.include))
    joined = {(parent, body) for body, parent in enumerate(tree.parents) if parent >= 0}
    boxes = [creature.bodies[creature.body_index(name)].shape.rounded_box for name in tree.names]
    centre = tree.com + np.array([box.centre for box in boxes]).T
    half = np.array([box.half_extents + box.radius for box in boxes]).T
    wanted_pairs = sorted((every - joined - excluded) | included)
    candidates = pairs_that_can_meet(tree, wanted_pairs, (centre, half))
    return candidates, _overlapping(creature, tree, candidates) - included


def _indices(names: tuple[str, ...], given: tuple[tuple[str, str], ...]) -> set[tuple[int, int]]:
    """Pairs of indices, the lower one first."""
    found = [sorted(map(names.index, pair)) for pair in given]
    return {(first, second) for first, second in found}


def _overlapping(
    creature: Creature, tree: Tree, pairs: list[tuple[int, int]]
) -> set[tuple[int, int]]:
    """Those of some pairs that touch in the neutral pose, by projections onto either in turn."""
    centres, rotations = neutral_pose(creature)
    bodies = np.array([creature.body_index(name) for name in tree.names])
    boxes = [creature.bodies[i].shape.rounded_box for i in bodies]
    half = np.array([box.half_extents for box in boxes])
    radius = np.array([box.radius for box in boxes])
    turned = rotations[bodies]
    middle = centres[bodies] + np.einsum("bij,bj->bi", turned, [box.centre for box in boxes])
    first, second = np.array(pairs, int).reshape(-1, 2).T

    def project(point: np.ndarray, body: np.ndarray) -> np.ndarray:
        own = np.einsum("pij,pi->pj", turned[body], point - middle[body])
        return middle[body] + np.einsum(
            "pij,pj->pi", turned[body], np.clip(own, -half[body], half[body])
        )

    there = middle[second]
    for _ in range(_PROJECTIONS):
        here = project(there, first)
        there = project(here, second)
    gap = np.linalg.norm(there - here, axis=1) - radius[first] - radius[second]
    return {pair for pair, distance in zip(pairs, gap, strict=True) if distance < _TOUCH}
