"""Places of joint axes in a body, as numbers that exist in any body, and directions of their parts.

The *part* of an axis is the body that it moves. The *limb* is the part with all that hangs on it.
All numbers are ratios or logarithms, so that they hardly depend on the size of the animal.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.algebra.numerics import Numbers, xp
from evo_cpg.creature.tree import Tree

PLACE = (
    "reach", "length", "breadth", "depth", "limb", "range", "straight", "part", "sweep", "servo",
    "size",
)  # fmt: skip
"""Numbers of a place.

They are the distance from the joint to the part's centre, the part's extent along and across the
motion, the number of joints to the root, the limb's volume as a fraction of all, half the range of
angles, the cosine between the part and its parent, the part's fraction of the volume, whether the
axis sweeps the part (1) or rolls it (0), the logarithm of the motor's rate to move the limb, and
the logarithm of the animal's size.
"""

# Angles beyond this count as unlimited, rad or m.
_WIDEST = 1.5
# Added to lengths and masses, so that none is 0.
_TINY = 1e-6


class Directions(NamedTuple):
    """Directions of the parts of all axes, in the axes of the parts, and ranges of the angles.

    Attributes:
        sweep: motion of the part's centre when the axis turns to positive angles: a unit vector,
            or 0 if the axis only rolls the part.
        along: unit vector from the joint to the part's centre.
        middle: middle of the range of angles, rad.
        half: half of this range, rad.
    """

    sweep: Float[Numbers, "3 d"]
    along: Float[Numbers, "3 d"]
    middle: Float[Numbers, " d"]
    half: Float[Numbers, " d"]


def directions(tree: Tree) -> Directions:
    """Return the directions of a creature's parts. Slides sweep their part along themselves."""
    bodies, axes = np.array(tree.dof_bodies), tree.joint_axes
    if tree.walk is not None:
        axes = axes * tree.walk.turns[None]
    along = _unit(tree.centre[:, bodies])
    sweep = _unit(xp.where(tree.slides[None], axes, xp.cross(axes, along, axis=0)))
    lower, upper = xp.maximum(tree.lower, -_WIDEST), xp.minimum(tree.upper, _WIDEST)
    return Directions(sweep, along, 0.5 * (lower + upper), xp.maximum(0.5 * (upper - lower), _TINY))


def places(tree: Tree) -> Float[Numbers, "p d"]:
    """Return the place of each axis: the numbers of `PLACE`."""
    bodies, above = np.array(tree.dof_bodies), _above(tree)
    own, part = directions(tree), tree.volume[bodies]
    total, centre = tree.volume.sum(), tree.centre
    size = (total + _TINY**3) ** (1 / 3)
    # The square root of 0 has no derivative.
    squares = (centre * centre).sum(0) + _TINY**2
    extent = _extents(tree)[:, bodies] / size
    limb, moved = above.T @ tree.volume, above.T @ tree.mass
    inertia = moved * (squares + _TINY)
    offset, turn = tree.joint_offset[:, bodies], tree.joint_orientation[:, :, bodies]
    straight = (_unit(offset) * (turn * own.along[None]).sum(1)).sum(0)
    servo = xp.maximum(tree.servo_gain, _TINY) / (inertia[bodies] + _TINY)
    numbers = (
        2 * xp.sqrt(squares[bodies]) / size - 1,
        6 * (xp.abs(own.along) * extent).sum(0) - 2,
        6 * (xp.abs(own.sweep) * extent).sum(0) - 1,
        above.sum(1)[bodies] / 2 - 1.5,
        2 * limb[bodies] / total - 0.5,
        own.half - 0.6,
        straight,
        4 * part / total - 0.5,
        (own.sweep * own.sweep).sum(0),
        xp.log(servo) / 4 - 1,
        xp.zeros_like(part) + 3 * xp.log(size) + 4,
    )
    return xp.stack(numbers)


def _above(tree: Tree) -> Float[Numbers, "b b"]:
    """Return 1 where the second body is an ancestor of the first or the first itself, else 0."""
    if tree.walk is not None:
        return xp.asarray(tree.walk.above)
    above = np.eye(tree.body_count)
    for body, parent in enumerate(tree.parents):
        if parent >= 0:
            above[body] += above[parent]
    return above


def _extents(tree: Tree) -> Float[Numbers, "3 b"]:
    """Return the standard deviations of the mass of each body along its own axes, m."""
    mass, com = tree.mass + _TINY, tree.com
    moments = xp.stack([tree.inertia[k, k] for k in range(3)]) / mass[None]
    squares = com * com
    moments = moments - (squares.sum(0)[None] - squares)
    return xp.sqrt(xp.maximum(0.5 * moments.sum(0)[None] - moments, _TINY**2))


def _unit(vectors: Float[Numbers, "3 k"]) -> Float[Numbers, "3 k"]:
    """Return unit vectors, and 0 for vectors of no length."""
    return vectors / xp.sqrt((vectors * vectors).sum(0) + _TINY**2)[None]
