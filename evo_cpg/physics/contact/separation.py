"""Gaps and nearest points of two bodies: rounded boxes, which include capsules and balls.

Boxes with sharp edges are in `evo_cpg.physics.contact.box_separation`. For all other bodies the gap
is the distance between the boxes minus the radii. For two lines it is found in closed form (Ericson
2005, 5.1.9). For a line and a box the line is searched between its crossings of the faces' planes.
For two boxes the nearest points are found by alternating projections.

A face or a side that lands flat turns about a single contact point. Faces of boxes therefore have
further points along the edges that lie on the other face. Capsules, and boxes that are longest
along x, have one at the far end of the length along which both bodies overlap.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import dot, matvec, matvec_t, t_matmul

# Alternating projections of rounded boxes before extrapolation, and the largest ratio of successive
# changes that extrapolation uses. The distance is within 0.3 mm for 95 % of pairs, 3 mm for 99 %.
_PROJECTIONS, _SHRINKING = 4, 0.97

# Distance (m) from a box below which a point of a line has no direction from the box.
_ON_FACE = 1e-6

# Cosine between a line and a face's normal below which the line never meets the face's plane.
_LEVEL = 1e-9

# 1 - cos^2 of the angle between edges below which they are parallel.
PARALLEL = 1e-4

# 1 - cos^2 below which the ends of lines count, and not the point where they cross: 5 degrees.
_NEARLY_PARALLEL = 7.6e-3

# Distance beyond a face's edge at which a line still lies over the face, as a fraction of the
# radius. It enlarges the gap by 1/200 of the radius at most.
_OVERHANG = 0.1

# Gap (m) of a further point that does not exist, out of reach of the fastest body.
_NOWHERE = 1e4

# Least distance of a further point from the first, in m and as a fraction of the smaller body.
SAME, _SAME_FRACTION = 5e-3, 0.25

# Squared lengths (m^2) that keep divisions finite, and roots differentiable.
_FLOOR, _TINY = 1e-12, 1e-20


class RoundedBoxes(NamedTuple):
    """Rounded boxes in the world: all points within a radius of each box.

    Attributes:
        centre: centres of the boxes, m.
        axes: x, y and z axes of the boxes as columns.
        half_extents: half extents of the boxes, m.
        radius: radii, m.
    """

    centre: Float[Array, "3 p *n"]
    axes: Float[Array, "3 3 p *n"]
    half_extents: Float[Array, "3 p *#n"]
    radius: Float[Array, "p *#n"]


class Separation(NamedTuple):
    """Gap and normal of pairs of bodies, at one point of each body.

    Attributes:
        gap: distance between the bodies, m, negative where they overlap.
        normal: unit vector from the first body to the second.
        first: point of the first body that is nearest to the second, or deepest in it, m.
        second: point of the second body that is nearest to the first, or deepest in it, m.
        carried: fractions of the normal that turn with the first and the second body. A face's
            normal turns with its body alone, a normal between curved surfaces with neither.
    """

    gap: Float[Array, "p *n"]
    normal: Float[Array, "3 p *n"]
    first: Float[Array, "3 p *n"]
    second: Float[Array, "3 p *n"]
    carried: Float[Array, "2 p *n"]


def within(box: RoundedBoxes, point: Array) -> Array:
    """Return the point of a box, without its radius, that is nearest to another point."""
    own = jnp.clip(matvec_t(box.axes, point - box.centre), -box.half_extents, box.half_extents)
    return box.centre + matvec(box.axes, own)


def separation_of_lines(a: RoundedBoxes, b: RoundedBoxes) -> list[Separation]:
    """Return two separations of pairs of lines (capsules, balls).

    The first is at the nearest points. The second is at the far end of the length along which both
    lines overlap.
    """
    d, e = a.axes[:, 0], b.axes[:, 0]
    away = a.centre - b.centre
    both, own, other = dot(d, e), dot(d, away), dot(e, away)
    most, farthest = a.half_extents[0], b.half_extents[0]
    sine = 1.0 - both * both
    s = jnp.where(sine > PARALLEL, (both * other - own) / jnp.maximum(sine, PARALLEL), 0.0)
    s = jnp.clip(s, -most, most)
    t = jnp.clip(both * s + other, -farthest, farthest)
    s = jnp.clip(both * t - own, -most, most)
    end, s = _ends(s, -own, farthest * jnp.abs(both), most, sine)

    found = []
    for here in (s, end):
        there = jnp.clip(both * here + other, -farthest, farthest)
        found.append(_rounded(a, b, a.centre + here[None] * d, b.centre + there[None] * e))
    return [found[0], unless(jnp.abs(end - s) < same(a, b), found[1])]


def _ends(
    near: Array, middle: Array, reach: Array, most: Array, sine: Array
) -> tuple[Array, Array]:
    """Return the far end and the near end of the overlap along the first body's x axis, m.

    The near end is the nearest point, unless the bodies are nearly parallel.

    Args:
        near: nearest point, from the middle of the first body, m.
        middle: middle of the second body, from the middle of the first body, m.
        reach: extent of the second body on either side of its middle, m.
        most: half of the first body's length, m.
        sine: squared sine of the angle between the bodies.
    """
    low = jnp.clip(middle - reach, -most, most)
    high = jnp.clip(middle + reach, -most, most)
    lower = near - low < high - near
    near = jnp.where(sine < _NEARLY_PARALLEL, jnp.where(lower, low, high), near)
    return jnp.where(lower, high, low), near


def same(a: RoundedBoxes, b: RoundedBoxes) -> Array:
    """Return the distance below which a further point counts as the first point, m."""
    return jnp.minimum(SAME, _SAME_FRACTION * smaller(a, b))


def smaller(a: RoundedBoxes, b: RoundedBoxes) -> Array:
    """Return the distance from the middle of the smaller body to its farthest face, m.

    A boulder has a radius and no extents, a block has extents and no radius.
    """
    one, other = (box.half_extents.max(0) + box.radius for box in (a, b))
    return jnp.minimum(one, other)


def unless(missing: Array, point: Separation) -> Separation:
    """Return a further point, moved far away where it is missing."""
    return point._replace(gap=jnp.where(missing, _NOWHERE, point.gap))


def separation_of_line_and_box(a: RoundedBoxes, b: RoundedBoxes) -> list[Separation]:
    """Return the separations of a line (capsule or ball) and a box with or without radius.

    The squared distance of the line's points from the box is convex. It is quadratic between the
    planes of the faces.
    """
    middle, direction = (matvec_t(b.axes, x) for x in (a.centre - b.centre, a.axes[:, 0]))
    most, extent = a.half_extents[0] + 0 * middle[0], b.half_extents

    def slope(s: Array) -> Array:
        point = middle + s[None] * direction
        return dot(point - jnp.clip(point, -extent, extent), direction)

    # The derivative is linear between the planes of the faces. Find the interval of its root.
    low, high = -most, most
    falls, rises = jnp.minimum(slope(low), 0.0), jnp.maximum(slope(high), 0.0)
    level = jnp.abs(direction) < _LEVEL
    for side in (-extent, extent):
        crossing = (side - middle) / jnp.where(level, 1.0, direction)
        crossing = jnp.clip(crossing, -most[None], most[None])
        for k in range(3):
            s, here = crossing[k], slope(crossing[k])
            lower, upper = (here < 0) & (s > low), (here > 0) & (s < high)
            low, falls = jnp.where(lower, s, low), jnp.where(lower, here, falls)
            high, rises = jnp.where(upper, s, high), jnp.where(upper, here, rises)
    # The distance is constant in the interval if the line passes through the box.
    bends = rises - falls > _TINY
    fraction = jnp.where(bends, -falls / jnp.where(bends, rises - falls, 1.0), 0.5)
    s = low + (high - low) * fraction

    near, end = _ends_beside_box(s, middle, direction, extent, most, a.radius + b.radius)
    found = []
    for s in (near, end):
        point = middle + s[None] * direction
        inside = jnp.clip(point, -extent, extent)
        beyond = jnp.abs(point) - extent
        deepest = beyond.max(0)
        # A point in the box leaves it through the nearest face.
        face = jnp.where(beyond >= deepest[None], jnp.where(point < 0, 1.0, -1.0), 0.0)
        buried = (deepest < _ON_FACE)[None]
        apart = jnp.where(buried, face, inside - point)
        length = jnp.sqrt(dot(apart, apart) + _TINY)
        normal = matvec(b.axes, apart / length[None])
        inside = jnp.where(buried & (face != 0), -face * extent, inside)
        gap = jnp.where(deepest < _ON_FACE, deepest, length) - a.radius - b.radius
        first, second = (b.centre + matvec(b.axes, x) for x in (point, inside))
        first, second = first + a.radius[None] * normal, second - b.radius[None] * normal
        none = jnp.zeros((2, *gap.shape), gap.dtype)
        found.append(Separation(gap, normal, first, second, none))
    return [found[0], unless(jnp.abs(end - near) < same(a, b), found[1])]


def _ends_beside_box(
    near: Array, middle: Array, direction: Array, extent: Array, most: Array, radius: Array
) -> tuple[Array, Array]:
    """Return the near and the far end of the part of a line that lies over a face, or in the box.

    The planes of all other faces cut off this part. Planes that the nearest point lies beyond do
    not count. The near end is the nearest point, unless the line is nearly parallel to the face or
    the edge.

    Args:
        near: nearest point, from the middle of the line, m.
        middle: middle of the line in the box's frame, m.
        direction: unit vector along the line in the box's frame.
        extent: half extents of the box, m.
        most: half of the line's length, m.
        radius: sum of both radii, m.
    """
    # If a line leaves a face, its nearest point lies a little beyond the edge.
    margin = _ON_FACE + _OVERHANG * radius
    outside = jnp.abs(middle + near[None] * direction) > extent + margin[None]
    level = jnp.abs(direction) < _LEVEL
    between = ~(outside | level)
    steep = jnp.where(level, 1.0, direction)
    planes = (-extent - middle) / steep, (extent - middle) / steep
    low = jnp.where(between, jnp.minimum(*planes), -most[None]).max(0)
    high = jnp.where(between, jnp.maximum(*planes), most[None]).min(0)
    # Rounding must not make the interval empty.
    low, high = (jnp.clip(low, -most, near), jnp.clip(high, near, most))
    lower = near - low < high - near
    sine = 1.0 - jnp.where(outside, 0.0, direction * direction).max(0)
    bound = jnp.where(outside.sum(0) > 1, PARALLEL, _NEARLY_PARALLEL)
    near = jnp.where(sine < bound, jnp.where(lower, low, high), near)
    return near, jnp.where(lower, high, low)


def separation_of_rounded(a: RoundedBoxes, b: RoundedBoxes) -> list[Separation]:
    """Return the separations of boxes that are longest along x, at least one with a radius."""
    turn = t_matmul(a.axes, b.axes)
    away = matvec_t(a.axes, b.centre - a.centre)

    def project(y: Array) -> tuple[Array, Array]:
        x = jnp.clip(away + matvec(turn, y), -a.half_extents, a.half_extents)
        return x, jnp.clip(matvec_t(turn, x - away), -b.half_extents, b.half_extents)

    y = changed = jnp.zeros_like(away)
    for _ in range(_PROJECTIONS):
        before, last = changed, y
        _, y = project(y)
        changed = y - last
    # Extrapolate to the limit: successive changes have about the same ratio.
    fraction = dot(before, changed) / jnp.maximum(dot(before, before), _FLOOR)
    fraction = jnp.clip(fraction, 0.0, _SHRINKING)
    y = y + (fraction / (1.0 - fraction))[None] * changed
    x, _ = project(jnp.clip(y, -b.half_extents, b.half_extents))
    reach = (b.half_extents * jnp.abs(turn[0])).sum(0)
    parallel = 1.0 - turn[0, 0] * turn[0, 0]
    end, near = _ends(x[0], away[0], reach, a.half_extents[0] + 0 * reach, parallel)

    found = []
    for s in (near, end):
        here = jnp.concatenate([s[None], x[1:]])
        there = jnp.clip(matvec_t(turn, here - away), -b.half_extents, b.half_extents)
        points = a.centre + matvec(a.axes, here), b.centre + matvec(b.axes, there)
        found.append(_rounded(a, b, *points))
    return [found[0], unless(jnp.abs(end - near) < same(a, b), found[1])]


def _rounded(a: RoundedBoxes, b: RoundedBoxes, first: Array, second: Array) -> Separation:
    """Return the separations of the balls around the nearest points of two boxes."""
    direction, centres = second - first, b.centre - a.centre
    square = dot(direction, direction)
    # Overlapping boxes separate along the line of their centres.
    apart = square > _FLOOR
    direction = jnp.where(apart[None], direction, centres)
    length = jnp.sqrt(jnp.where(apart, square, dot(centres, centres) + _FLOOR))
    normal = direction / length[None]
    gap = jnp.where(apart, length, 0.0) - a.radius - b.radius
    touching = first + a.radius[None] * normal, second - b.radius[None] * normal
    return Separation(gap, normal, *touching, jnp.zeros((2, *gap.shape), gap.dtype))
