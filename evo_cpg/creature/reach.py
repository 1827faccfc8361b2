"""Bounds on the reach of bodies: pairs that never meet within the limits of their joints.

Interval arithmetic moves the box around a body from joint to joint, with rotations by a range of
angles. It ends in the frame of the body from which both chains of joints start. Boxes that are
apart in that frame never meet. Boxes that overlap may or may not meet. Ranges are cut into pieces,
because a box around the whole reach of a limb is far larger than the limb.
"""

import functools
from collections.abc import Callable

import numpy as np

from evo_cpg.creature.algebra.decisions import Condition, decided
from evo_cpg.creature.algebra.numerics import Numbers, xp
from evo_cpg.creature.creature import NO_LIMIT
from evo_cpg.creature.tree import Tree

# Widening of joint limits, because loads push joints beyond their soft limits: an angle (rad), and
# for a slide a fraction of its range, which has no common size in m.
_GIVE = 0.15

# Ranges of the elements of all rotation matrices.
_ANY_ROTATION = -np.ones((3, 3, 1)), np.ones((3, 3, 1))

# Number of pieces into which all ranges of a chain of joints are cut.
PIECES = 400

Interval = tuple[Numbers, Numbers]


def keeps_apart(
    tree: Tree, box: tuple[Numbers, Numbers], pieces: int = PIECES
) -> Callable[[int, int], Condition]:
    """Return a function of two bodies: whether boxes around them show that they never touch.

    Args:
        tree: the creature.
        box: centres and half edges ``(3, b)`` of boxes around all bodies, in their working
            frames, m.
        pieces: number of pieces into which all ranges of a chain of joints are cut. The function is
            faster with fewer pieces, but returns False more often.
    """

    @functools.cache
    def swept(body: int, common: int) -> Interval:
        """Return ranges ``(3, pieces)`` of a box's coordinates in the frame of a body before it."""
        chain = chain_to_root(tree, body)
        chain = chain[: chain.index(common)]
        axes = sum(tree.dof_bodies.count(each) for each in chain)
        most = max(1, int(pieces ** (1 / max(1, axes))))
        centre, half = (x[:, body, None] for x in box)
        low, high = centre - half, centre + half
        for each in chain:
            dofs = [i for i, owner in enumerate(tree.dof_bodies) if owner == each]
            for i in reversed(dofs):
                if not tree.dof_kinds[i].at_once:
                    low, high = _moved(tree, i, most, (low, high))
                elif i in tree.balls:
                    # The axes of a ball are one rotation, in any direction.
                    low, high = _times(_ANY_ROTATION, (low, high))
            fixed = tree.joint_orientation[:, :, each, None]
            low, high = _times((fixed, fixed), (low, high))
            offset = tree.joint_offset[:, each, None]
            low, high = low + offset, high + offset
        return low, high

    def are_apart(first: int, second: int) -> Condition:
        common = max({*chain_to_root(tree, first)} & {*chain_to_root(tree, second)})
        (low, high), (other_low, other_high) = (swept(body, common) for body in (first, second))
        apart = (low[:, :, None] > other_high[:, None]) | (other_low[:, None] > high[:, :, None])
        return apart.any(0).all()

    return are_apart


def chain_to_root(tree: Tree, body: int) -> list[int]:
    """Return a body, its parent, and so on to the root."""
    chain = [body]
    while tree.parents[chain[-1]] >= 0:
        chain.append(tree.parents[chain[-1]])
    return chain


def _moved(tree: Tree, axis: int, pieces: int, box: Interval) -> Interval:
    """Return ranges of a box's coordinates that an axis moves, for each piece of its range.

    An axis without limits turns all the way round, and reaches everything along itself.
    """
    kind, direction = tree.dof_kinds[axis], tree.joint_axes[:, axis]
    lower, upper = tree.lower[axis], tree.upper[axis]
    ends = (-NO_LIMIT, NO_LIMIT) if kind.translation else (-np.pi, np.pi)
    if not decided(lambda: upper >= NO_LIMIT):
        give = _GIVE if kind.rotation else _GIVE * (upper - lower)
        ends = lower - give, upper + give
    edges = xp.linspace(*ends, pieces + 1)
    low, high = (x[:, None] for x in box)
    if kind.rotation:
        place = 0.0 if tree.joint_places is None else tree.joint_places[:, axis, None]
        # Ranges ``(3, 3, k)`` of the elements of all rotations between two successive angles, by
        # Rodrigues' formula.
        x, y, z = direction
        along = xp.outer(direction, direction)[..., None]
        cross = xp.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])[..., None]
        across = [(np.eye(3)[..., None] - along) * c for c in _range(xp.cos, 0.0, edges)]
        turning = [cross * s for s in _range(xp.sin, np.pi / 2, edges)]
        least = along + xp.minimum(*across) + xp.minimum(*turning)
        most = along + xp.maximum(*across) + xp.maximum(*turning)
        turned = _times((least, most), (box[0] - place, box[1] - place))
        low, high = ((x + place).reshape(3, pieces, -1) for x in turned)
    if kind.translation:
        along = kind.translation * direction[:, None]
        shift = xp.sort(xp.array([along * edges[:-1], along * edges[1:]]), 0)
        low, high = low + shift[0][:, :, None], high + shift[1][:, :, None]
    return low.reshape(3, -1), high.reshape(3, -1)


def _range(wave: Callable[[Numbers], Numbers], crest: float, edges: Numbers) -> Interval:
    """Return ranges of a cosine or sine between angles, with its crest at a given angle."""
    least, most = edges[:-1], edges[1:]
    ends = xp.sort(xp.array([wave(least), wave(most)]), 0)
    # Whether the trough and the crest, up to whole turns, are in a range.
    trough, peak = (
        xp.floor((most - angle) / (2 * np.pi)) > xp.floor((least - angle) / (2 * np.pi))
        for angle in (crest + np.pi, crest)
    )
    return xp.where(trough, -1.0, ends[0]), xp.where(peak, 1.0, ends[1])


def _times(matrix: Interval, vector: Interval) -> Interval:
    """Multiply matrices ``(3, 3, k)`` by vectors ``(3, n)``, all of them ranges: ``(3, k n)``."""
    products = xp.stack([m[..., None] * v[None, :, None] for m in matrix for v in vector])
    return tuple(end(0).sum(1).reshape(3, -1) for end in (products.min, products.max))  # pyright: ignore
