"""Separation of two boxes with parallel z axes that overlap along z.

All joints between the boxes turn about one common axis, so the problem is plane. The gap of the two
rectangles is the largest gap along the normals of their four sides. The contact points are both
ends of the part of the other rectangle's lowest edge that lies over the side.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from evo_cpg.creature.algebra.linear import (
    dot,
    matvec,
    matvec_t,
    of_each,
    t_matmul,
    transpose,
    where_each,
)
from evo_cpg.physics.contact.separation import RoundedBoxes, Separation, same, unless


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
        _Plane(b, -back, transpose(turn), a.half_extents, -dot(b.axes[:, 2], away)),
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

    def fraction(end: Array) -> Array:
        """Return the fraction of the edge up to which it lies over the side, towards one end."""
        place = jnp.clip(lowest + end * edge, -reach, reach)
        return jnp.clip((place - lowest) / edge, 0.0, 1.0)

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

    def at(fraction: Array, gap: Array) -> Separation:
        below = base + height[None] * normal + (lowest + fraction * edge)[None] * tangent
        above = below + gap[None] * normal
        return Separation(
            gap,
            jnp.where(of_b[None], -normal, normal),
            jnp.where(of_b[None], above, below),
            jnp.where(of_b[None], below, above),
            jnp.stack([jnp.where(of_b, own, 1.0 - own) for own in (0.0, 1.0)]),
        )

    near, far = fraction(jnp.zeros_like(gap)), fraction(jnp.ones_like(gap))
    missing = jnp.abs((far - near) * edge) < same(a, b)
    return [at(near, gap), unless(missing, at(far, gap + (far - near) * climb))]


def _swapped(second: Array, values: Array) -> Array:
    """Return two values, swapped where ``second`` holds."""
    return jnp.where(of_each(second, values), values[::-1], values)
