"""Which bodies of a creature can come near each other, whatever its joints do within their limits.

Interval arithmetic: the box around a body is carried from joint to joint, by rotations of which
only a range of the angle is known, to the frame of the body from which both chains of joints
start. What is found apart there never meets; what is not may or may not. Ranges are cut into
pieces, because a box around all that a limb reaches is far larger than the limb.
"""

import functools
from collections.abc import Iterable

import numpy as np

from evo_cpg.creature.tree import Tree

# Joints give way: limits count as wider by this, rad.
_GIVE = 0.15

# Pieces into which the ranges of a chain of joints are cut, all together.
_PIECES = 400

Interval = tuple[np.ndarray, np.ndarray]


def pairs_that_can_meet(
    tree: Tree, pairs: Iterable[tuple[int, int]], box: tuple[np.ndarray, np.ndarray]
) -> list[tuple[int, int]]:
    """Those of some pairs of bodies that may touch, as far as boxes around them tell.

    Args:
        tree: the creature, of known numbers.
        pairs: indices of bodies.
        box: centres and half edges ``(3, b)`` of boxes around all bodies, in their working
            frames, m.
    """

    @functools.cache
    def swept(body: int, common: int) -> Interval:
        chain = chain_to_root(tree, body)
        centre, half = (x[:, body] for x in box)
        return _swept(tree, chain[: chain.index(common)], (centre - half, centre + half))

    def can_meet(first: int, second: int) -> bool:
        common = max({*chain_to_root(tree, first)} & {*chain_to_root(tree, second)})
        (low, high), (other_low, other_high) = (swept(body, common) for body in (first, second))
        apart = (low[:, :, None] > other_high[:, None]) | (other_low[:, None] > high[:, :, None])
        return not apart.any(0).all()

    return [pair for pair in pairs if can_meet(*pair)]


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
            low, high = _times(_turns(tree.joint_axes[:, i], edges), (low, high))
        fixed = tree.joint_orientation[:, :, body]
        low, high = _times((fixed[..., None], fixed[..., None]), (low, high))
        offset = tree.joint_offset[:, body, None]
        low, high = low + offset, high + offset
    return low, high


def _turns(axis: np.ndarray, edges: np.ndarray) -> Interval:
    """Ranges ``(3, 3, k)`` of rotations about an axis between k + 1 angles: Rodrigues' formula."""
    x, y, z = axis
    along = np.outer(axis, axis)[..., None]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])[..., None]
    across = [(np.eye(3)[..., None] - along) * c for c in _range(np.cos, 0.0, edges)]
    turning = [cross * s for s in _range(np.sin, np.pi / 2, edges)]
    return (
        along + np.minimum(*across) + np.minimum(*turning),
        along + np.maximum(*across) + np.maximum(*turning),
    )


def _range(wave: np.ufunc, crest: float, edges: np.ndarray) -> Interval:
    """Ranges of a cosine or sine, whose crest lies at some angle, between angles."""
    least, most = edges[:-1], edges[1:]
    ends = np.sort([wave(least), wave(most)], 0)

    def holds(angle: float) -> np.ndarray:
        """Whether an angle, or one that is whole turns from it, lies between."""
        return np.floor((most - angle) / (2 * np.pi)) > np.floor((least - angle) / (2 * np.pi))

    return np.where(holds(crest + np.pi), -1.0, ends[0]), np.where(holds(crest), 1.0, ends[1])


def _times(matrix: Interval, vector: Interval) -> Interval:
    """Matrices ``(3, 3, k)`` times vectors ``(3, n)``, all of them ranges: ``(3, k n)``."""
    products = [m[..., None] * v[None, :, None] for m in matrix for v in vector]
    return tuple(end(products, 0).sum(1).reshape(3, -1) for end in (np.min, np.max))  # pyright: ignore
