"""Separation of two boxes with sharp edges: gap, normal and nearest points.

The gap is the largest gap along the separating directions (Gottschalk et al. 1996). These are the
face normals of both boxes and the cross products of their edges. The gap is exact if the boxes
overlap, or if a face or an edge is nearest. Between two corners the gap is less than the distance.

If a face is nearest, the boxes touch at the lowest corner of the other box. They also touch at the
far ends of the two edges from this corner that lie on the face. If a box overhangs, each point is
moved to a near place that both boxes share.

Boxes with parallel z axes that overlap along z are a plane problem (`separation_of_flat`), because
all joints between them turn about one common axis. The gap of the two rectangles is the largest gap
along the normals of their four sides. The contact points are both ends of the part of the other
rectangle's lowest edge that lies over the side.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from evo_cpg.creature.algebra.linear import (
    cross,
    dot,
    matvec,
    matvec_t,
    of_each,
    t_matmul,
    where_each,
)
from evo_cpg.physics.contact.separation import (
    PARALLEL,
    RoundedBoxes,
    Separation,
    same,
    smaller,
    unless,
)

# Least excess of the gap of edges over the gap of faces (m, and as a fraction of the smaller box),
# so that rounding does not decide.
_CLEARLY, _CLEAR_FRACTION = 1e-5, 1e-3

# Alternating projections onto both faces that bring an overhanging corner into their overlap.
_PROJECTIONS = 2

# Small number added to the square of a length without unit, so that no divisor is zero.
_FLOOR = 1e-12


def separation_of_boxes(a: RoundedBoxes, b: RoundedBoxes, corners: int = 3) -> list[Separation]:
    """Return the separations of boxes without radius.

    A face on a face has 3 or 4 contact points, as ``corners`` says.
    """
    # The largest gap along a face normal, that normal from a to b, and whether b owns the face.
    away, size = b.centre - a.centre, jnp.abs(t_matmul(a.axes, b.axes))
    along, across = matvec_t(a.axes, away), matvec_t(b.axes, away)
    ours = jnp.abs(along) - a.half_extents - matvec(size, b.half_extents)
    theirs = jnp.abs(across) - b.half_extents - matvec_t(size, a.half_extents)
    best = []
    for box, aside, gaps in ((a, along, ours), (b, across, theirs)):
        normals = jnp.where(aside < 0, -1.0, 1.0)[None] * box.axes
        gap, normal = gaps[0], normals[:, 0]
        for k in (1, 2):
            more = gaps[k] > gap
            gap = jnp.where(more, gaps[k], gap)
            normal = jnp.where(more[None], normals[:, k], normal)
        best.append((gap, normal))
    of_b = best[1][0] > best[0][0]
    gap, normal = where_each(of_b, best[1], best[0])
    clearly = jnp.minimum(_CLEARLY, _CLEAR_FRACTION * smaller(a, b))
    edge, crossing = _best_edges(a, b, gap + clearly)
    over, under = where_each(of_b, a, b), where_each(of_b, b, a)
    outward = jnp.where(of_b[None], -normal, normal)
    lowest = _corner(over, -outward)
    corner = _over_both(outward, under, over, lowest)
    on_face = _on_face(outward, of_b, gap, corner - gap[None] * outward, corner)
    found = [where_each(edge, crossing, on_face)]
    least = same(a, b)
    crossed = edge & (crossing.gap > gap + least)
    # Further contacts at the far ends of edges from the corner, moved over the face. The edges are
    # counted without the steepest one.
    rise = matvec_t(over.axes, outward)
    steep = jnp.argmax(jnp.abs(rise), 0)
    side = jnp.where(rise <= 0, -1.0, 1.0)
    inward = side[None] * over.axes
    left = over.half_extents - side * matvec_t(over.axes, corner - over.centre)
    for which in ((0,), (1,), (0, 1))[: corners - 1]:
        point = corner
        for one in which:
            # Select the axis ``one + 1`` places after the steepest axis, modulo 3.
            after = [jnp.where(steep == (k - 1 - one) % 3, left[k], 0.0) for k in range(3)]
            point = point + matvec(inward, jnp.stack(after))
        point = _over_both(outward, under, over, point)
        displacement, height = point - corner, gap + dot(outward, point - lowest)
        further = _on_face(outward, of_b, height, point - height[None] * outward, point)
        # A contact nearer to the corner than this is missing.
        near = dot(displacement, displacement) < least * least
        found.append(unless(crossed, unless(near, further)))
    return found


def _best_edges(a: RoundedBoxes, b: RoundedBoxes, least: Array) -> tuple[Array, Separation]:
    """Return whether a pair of edges is farther apart than ``least``, and the farthest pair.

    The pair is edge i of a and edge j of b, and a_i x b_j is normal to both. If no pair is farther
    apart than ``least``, the returned pair is meaningless.
    """
    away = b.centre - a.centre
    turn, along = t_matmul(a.axes, b.axes), matvec_t(a.axes, away)
    size, e, f = jnp.abs(turn), a.half_extents, b.half_extents
    best, found = least, jnp.zeros(least.shape, bool)
    edges = a.axes[:, 0], b.axes[:, 0], e[0] + 0 * least, f[0] + 0 * least
    for i in range(3):
        k, m = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            p, q = (j + 1) % 3, (j + 2) % 3
            square = 1.0 - turn[i, j] * turn[i, j]
            parallel = square < PARALLEL
            scale = 1.0 / jnp.sqrt(jnp.where(parallel, 1.0, square))
            edge_distance = along[m] * turn[k, j] - along[k] * turn[m, j]
            covered = e[k] * size[m, j] + e[m] * size[k, j] + f[p] * size[i, q] + f[q] * size[i, p]
            gap = scale * (jnp.abs(edge_distance) - covered)
            better = ~parallel & (gap > best)
            best, found = jnp.where(better, gap, best), better | found
            edges = where_each(better, (a.axes[:, i], b.axes[:, j], e[i], f[j]), edges)
    normal = cross(*edges[:2])
    normal = normal / jnp.sqrt(dot(normal, normal) + _FLOOR)[None]
    normal = jnp.where((dot(normal, away) < 0)[None], -normal, normal)
    # The nearest points of both edges, at most an edge's length from its corner.
    first, second, (d, e, most, farthest) = _corner(a, normal), _corner(b, -normal), edges
    apart = first - second
    both, own, other = dot(d, e), dot(d, apart), dot(e, apart)
    sine = jnp.maximum(1.0 - both * both, PARALLEL)
    s = jnp.clip((both * other - own) / sine, -2 * most, 2 * most)
    t = jnp.clip((other - both * own) / sine, -2 * farthest, 2 * farthest)
    points = first + s[None] * d, second + t[None] * e
    return found, Separation(best, normal, *points, jnp.zeros((2, *best.shape), best.dtype))


def _over_both(normal: Array, under: RoundedBoxes, over: RoundedBoxes, corner: Array) -> Array:
    """Return the place on a box's lowest face, near its corner, that is over the other's face.

    Overlapping boxes that are not parallel have such a corner. Rounding picks the corner of
    parallel boxes.
    """
    upright = jnp.abs(matvec_t(under.axes, normal)) > 0.5
    rise = jnp.abs(matvec_t(over.axes, normal))
    lowest = rise >= rise.max(0)[None]
    start = matvec_t(over.axes, corner - over.centre)
    for _ in range(_PROJECTIONS):
        for box, kept, height in ((under, upright, None), (over, lowest, start)):
            own = matvec_t(box.axes, corner - box.centre)
            extent = box.half_extents
            moved = jnp.where(
                kept, own if height is None else height, jnp.clip(own, -extent, extent)
            )
            corner = corner + matvec(box.axes, moved - own)
    return corner


def _on_face(normal: Array, of_b: Array, gap: Array, below: Array, above: Array) -> Separation:
    """Return the separation of a place on a face and a point above it, along its normal.

    ``of_b`` says whether the face belongs to the second box.
    """
    return Separation(
        gap,
        jnp.where(of_b[None], -normal, normal),
        jnp.where(of_b[None], above, below),
        jnp.where(of_b[None], below, above),
        jnp.stack([jnp.where(of_b, own, 1.0 - own) for own in (0.0, 1.0)]),
    )


def _corner(box: RoundedBoxes, direction: Array) -> Array:
    """Return the corner that lies farthest along a direction."""
    own = matvec_t(box.axes, direction)
    return box.centre + matvec(box.axes, jnp.where(own < 0, -1.0, 1.0) * box.half_extents)


class _Plane(NamedTuple):
    """A rectangle, and another one in the frame of the first.

    Attributes:
        box: the first box.
        place: centre of the other rectangle, m.
        turn: x and y axes of the other rectangle, as columns.
        other: half extents of the other box, m.
        aside: centre of the other box along z, m.
    """

    box: RoundedBoxes
    place: Array
    turn: Array
    other: Array
    aside: Array


def separation_of_flat(a: RoundedBoxes, b: RoundedBoxes) -> list[Separation]:
    """Return the separations of boxes without radius at both ends of the lowest edge."""
    away, turn = b.centre - a.centre, t_matmul(a.axes[:, :2], b.axes[:, :2])
    place, size = matvec_t(a.axes[:, :2], away), jnp.abs(turn)
    back, e, f = matvec_t(turn, place), a.half_extents, b.half_extents
    ours = jnp.abs(place) - e[:2] - matvec(size, f[:2])
    theirs = jnp.abs(back) - f[:2] - matvec_t(size, e[:2])
    of_b = theirs.max(0) > ours.max(0)
    gaps = jnp.where(of_b[None], theirs, ours)
    here = where_each(
        of_b,
        _Plane(b, -back, jnp.swapaxes(turn, 0, 1), a.half_extents, -dot(b.axes[:, 2], away)),
        _Plane(a, place, turn, b.half_extents, dot(a.axes[:, 2], away)),
    )

    # The frame's first axis is now the side's normal, towards the other rectangle.
    second = gaps[1] > gaps[0]
    gap, rise, along = _swapped(second, gaps)[0], *_swapped(second, here.place)
    up, across = _swapped(second, here.turn)
    sign = jnp.where(rise < 0, -1.0, 1.0)
    height, reach = _swapped(second, here.box.half_extents[:2])
    up = sign[None] * up
    corner = jnp.where(up < 0, 1.0, -1.0) * here.other[:2]
    flat = jnp.abs(up[0]) < jnp.abs(up[1])
    lowest = along + dot(across, corner)
    edge = -2.0 * jnp.where(flat, across[0] * corner[0], across[1] * corner[1])
    climb = -2.0 * jnp.where(flat, up[0] * corner[0], up[1] * corner[1])

    # Fractions of the edge up to which it lies over the side, towards both ends.
    places = (
        jnp.clip(lowest + end * edge, -reach, reach)
        for end in (jnp.zeros_like(gap), jnp.ones_like(gap))
    )
    near, far = (jnp.clip((place - lowest) / edge, 0.0, 1.0) for place in places)
    x_axis, y_axis, z_axis = (here.box.axes[:, k] for k in range(3))
    normal, tangent = (
        jnp.where(second[None], *axes) for axes in ((y_axis, x_axis), (x_axis, y_axis))
    )
    normal = sign[None] * normal
    # The points lie in the middle of the overlap along z.
    half, its_half = here.box.half_extents[2], here.other[2]
    middle = 0.5 * (
        jnp.maximum(-half, here.aside - its_half) + jnp.minimum(half, here.aside + its_half)
    )
    base = here.box.centre + middle[None] * z_axis

    found = []
    for fraction, apart in ((near, gap), (far, gap + (far - near) * climb)):
        below = base + height[None] * normal + (lowest + fraction * edge)[None] * tangent
        found.append(_on_face(normal, of_b, apart, below, below + apart[None] * normal))
    missing = jnp.abs((far - near) * edge) < same(a, b)
    return [found[0], unless(missing, found[1])]


def _swapped(second: Array, values: Array) -> Array:
    """Return two values, swapped where ``second`` holds."""
    return jnp.where(of_each(second, values), values[::-1], values)
