"""Which bodies of a creature can come near each other, whatever its joints do within their limits.

Interval arithmetic: the box around a body is carried from joint to joint, by rotations of which
only a range of the angle is known, to the frame of the body from which both chains of joints
start. What is found apart there never meets; what is not may or may not. Ranges are cut into
pieces, because a box around all that a limb reaches is far larger than the limb.
"""

import itertools

import numpy as np

from evo_cpg.creature.tree import Tree

# Joints give way: limits count as wider by this, rad.
_GIVE = 0.15

# Pieces into which the ranges of a chain of joints are cut, all together.
_PIECES = 400

Interval = tuple[np.ndarray, np.ndarray]


def can_meet(tree: Tree, first: int, second: int, box: tuple[np.ndarray, np.ndarray]) -> bool:
    """Whether two bodies may touch, as far as boxes around them tell.

    Args:
        tree: the creature, of known numbers.
        first: index of one body.
        second: of another.
        box: centres and half edges ``(3, b)`` of boxes around all bodies, in their working
            frames, m.
    """
    chains = [chain_to_root(tree, body) for body in (first, second)]
    common = max(set(chains[0]) & set(chains[1]))
    ranges = []
    for body, chain in zip((first, second), chains, strict=True):
        centre, half = (x[:, body] for x in box)
        ranges.append(_swept(tree, chain[: chain.index(common)], (centre - half, centre + half)))
    (low, high), (other_low, other_high) = ranges
    apart = (low[:, :, None] > other_high[:, None]) | (other_low[:, None] > high[:, :, None])
    return not apart.any(0).all()


def chain_to_root(tree: Tree, body: int) -> list[int]:
    """A body, its parent, and so on to the root."""
    chain = [body]
    while tree.parents[chain[-1]] >= 0:
        chain.append(tree.parents[chain[-1]])
    return chain


def _swept(tree: Tree, chain: list[int], box: Interval) -> Interval:
    """Ranges ``(3, pieces)`` of the coordinates of a box's points, beyond all joints of a chain."""
    axes = [tree.dof_bodies.count(body) for body in chain]
    pieces = max(1, int(_PIECES ** (1 / max(1, sum(axes)))))
    low, high = (x[:, None] for x in box)
    for body in chain:
        dofs = [i for i, owner in enumerate(tree.dof_bodies) if owner == body]
        for i in reversed(dofs):
            edges = np.linspace(tree.lower[i] - _GIVE, tree.upper[i] + _GIVE, pieces + 1)
            turns = [_turn(tree.joint_axes[:, i], *range_) for range_ in itertools.pairwise(edges)]
            parts = [_times(turn, (low, high)) for turn in turns]
            low, high = (np.concatenate(sides, 1) for sides in zip(*parts, strict=True))
        fixed = tree.joint_orientation[:, :, body]
        low, high = _times((fixed, fixed), (low, high))
        offset = tree.joint_offset[:, body, None]
        low, high = low + offset, high + offset
    return low, high


def _turn(axis: np.ndarray, least: float, most: float) -> Interval:
    """Least and largest elements of rotations ``(3, 3)`` about an axis, by Rodrigues' formula."""
    x, y, z = axis
    along = np.outer(axis, axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    cosines, sines = _range(np.cos, 0.0, least, most), _range(np.sin, np.pi / 2, least, most)
    across = [(np.eye(3) - along) * c for c in cosines]
    turning = [cross * s for s in sines]
    return (
        along + np.minimum(*across) + np.minimum(*turning),
        along + np.maximum(*across) + np.maximum(*turning),
    )


def _range(wave: np.ufunc, crest: float, least: float, most: float) -> tuple[float, float]:
    """Range of a cosine or sine, whose crest lies at some angle, over a range of angles."""
    ends = wave(least), wave(most)
    high = any(least <= crest + 2 * np.pi * k <= most for k in (-1, 0, 1))
    low = any(least <= crest + np.pi * k <= most for k in (-1, 1))
    return (-1.0 if low else min(ends)), (1.0 if high else max(ends))


def _times(matrix: Interval, vector: Interval) -> Interval:
    """A matrix ``(3, 3)`` times vectors ``(3, n)``, all of them ranges."""
    products = [m[:, :, None] * v[None] for m in matrix for v in vector]
    return np.min(products, 0).sum(1), np.max(products, 0).sum(1)
