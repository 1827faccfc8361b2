"""Outline of a slender chain: its length, its mean widths, and how box-like it is.

The drag of a body depends on the shape of its whole chain. The outline has three axes: the
centreline, and two across it that all bodies of the chain boxy in the neutral pose.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.creature.shapes import Shape
from evo_cpg.creature.slender import SlenderChain

# Volume over that of the bounding box, up to which a shape counts as round (a cylinder), and from
# which it is a box.
_ROUND_FILL, _BOX_FILL = 0.25 * np.pi, 1.0

# Least length, so that a body without size has an outline, m.
_TINY = 1e-9


class Outline(NamedTuple):
    """Outline of a chain of bodies.

    Attributes:
        chain: the bodies, from the nose to the tail.
        axes: axes of the outline in each body's frame, as columns. The first is the principal axis
            along the centreline.
        halves: half sizes of each body along its axes, m.
        sizes: length of the chain and its mean widths along the other axes, m.
        volume: volume of the bodies, m^3.
        sharpness: 1 for boxes, 0 for shapes that fill no more of their bounding box than a
            cylinder.
        blunt: whether each body is a cylinder with flat ends.
    """

    chain: SlenderChain
    axes: Float[np.ndarray, "n 3 3"]
    halves: Float[Numbers, "n 3"]
    sizes: Float[Numbers, " 3"]
    volume: Number
    sharpness: Number
    blunt: tuple[bool, ...]

    @property
    def bluntness(self) -> Float[Numbers, " 3"] | None:
        """Fraction of the length in cylinders with their axis along each axis of the outline.

        None if there are no cylinders.
        """
        if not any(self.blunt):
            return None
        lengths = xp.maximum(self.halves[:, 0], _TINY)
        along = np.square(self.axes[:, 0]) * np.array(self.blunt)[:, None]
        return lengths @ along / lengths.sum()


def outline(creature: Creature, chain: SlenderChain) -> Outline:
    """Return the outline of a chain of a creature."""
    shapes = [creature.bodies[body].shape for body in chain.bodies]
    axes = chosen(lambda: _axes(creature, chain, shapes), lambda _: True)
    halves = xp.stack([_halves(shape, turn) for shape, turn in zip(shapes, axes, strict=True)])
    if len(shapes) == 1:
        lengths, sizes = 2 * halves[:, 0], 2 * halves[0]
    else:
        lengths = chain.lengths
        total = xp.maximum(lengths.sum(), _TINY)
        across = 2 * (lengths[:, None] * halves[:, 1:]).sum(0) / total
        sizes = xp.array([total, across[0], across[1]])
    volumes = xp.array([shape.volume for shape in shapes])
    fill = volumes / (8 * xp.maximum(xp.prod(halves, 1), _TINY**3))
    boxy = xp.clip((fill - _ROUND_FILL) / (_BOX_FILL - _ROUND_FILL), 0.0, 1.0)
    sharpness = (lengths * boxy).sum() / xp.maximum(lengths.sum(), _TINY)
    blunt = tuple(shape.blunt for shape in shapes)
    sizes = xp.maximum(sizes, _TINY)
    return Outline(chain, axes, halves, sizes, volumes.sum(), sharpness, blunt)


def _halves(shape: Shape, axes: np.ndarray) -> Numbers:
    """Return half the extent of a shape along each axis, m."""
    return xp.array([0.5 * axis @ (shape.support(axis) - shape.support(-axis)) for axis in axes.T])


def _axes(creature: Creature, chain: SlenderChain, shapes: list[Shape]) -> np.ndarray:
    """Return the principal axes of each body in the order of the outline's axes."""
    _, rotations = neutral_pose(creature)
    ordered = []
    for body, shape, tangent in zip(chain.bodies, shapes, chain.tangents, strict=True):
        _, axes = shape.stretch
        first = int(np.argmax(np.abs(tangent @ axes)))
        second, third = ((first + 1) % 3, (first + 2) % 3)
        if ordered:
            shared = rotations[chain.bodies[0]] @ ordered[0][:, 1]
            along = np.abs(shared @ rotations[body] @ axes)
            if along[third] > along[second]:
                second, third = third, second
        ordered.append(axes[:, [first, second, third]])
    return np.stack(ordered)
