"""Surface points on the outline of a body (`evo_cpg.creature.outline`).

- Each round end has its tip and rings around the axis, a Gauss-Radau rule. It is a rule over the
  directions halfway between those of the points and those of the normals, so that slender
  ellipsoids need few points. Half-balls need a single ring at the default resolutions.
- The side has Gauss-Legendre points along the axis and a ring around it.
- A body with flat ends has the points of its shape. Its sides are stretched.
"""

import numpy as np
from jaxtyping import Bool

from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.outline import Outline, fade
from evo_cpg.creature.shapes import Shape, Surface

# Cosine between the normal of a flat end and the axis: a face at the first value belongs to the
# end, and at the second to the side.
_FACING = (0.9, 0.6)

# Places along the axis of a half-ball, and weights, of a ring and the tip. They give the area, form
# drag along the axis, and skin friction along the axis exactly: w (1 - x^3) = 3/4 and
# w (1 - x^2)^(3/2) = 3 pi / 16.
_BALL_PLACES = np.array([0.44775115257259673, 1.0])
_BALL_WEIGHTS = np.array([0.823963622929168, 0.176036377070832])

# Least size, so that a body without extent has no area (m).
_LEAST = 1e-12


def outline_surface(
    shape: Shape, outline: Outline, resolution: int
) -> tuple[Surface, Bool[np.ndarray, " n"]]:
    """Return points on the outline of a body in its frame, and whether each lies on the body.

    Other points lie on straightened ends or sides.

    Args:
        shape: shape of the body.
        outline: its outline.
        resolution: about half the number of points along the axis of each part.
    """
    barrel, covered = outline.barrel, outline.covered
    if barrel.ends == "flat":
        surface = _flat_surface(shape.surface(resolution), outline)
        return surface, np.ones(len(surface.areas), bool)
    balls = barrel.ends == "ball"
    count = 2 * resolution + 4 if balls else max(4 * resolution, 8)
    half_axes = xp.maximum(barrel.half_axes, _LEAST)
    angles = (np.arange(count) + 0.5) * 2 * np.pi / count
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    end = _end_surface(half_axes, *_end_rule(balls, resolution), around)
    parts = [
        Surface(
            (end.points + xp.array([barrel.length / 2, 0.0, 0.0])) * sign,
            end.normals * sign,
            end.areas * (1 - each),
        )
        for sign, each in zip(np.array([[1, 1, 1], [-1, 1, 1]]), covered, strict=True)
    ]
    front, rear = barrel.length / 2 + outline.extension
    parts.append(_side_surface(half_axes[1:], -rear, front, resolution, around))
    points, normals, areas = (xp.concatenate(columns) for columns in zip(*parts, strict=True))
    on_body = np.arange(len(areas)) < 2 * len(end.areas)
    return Surface(points @ barrel.axes.T, normals @ barrel.axes.T, areas), on_body


def _flat_surface(surface: Surface, outline: Outline) -> Surface:
    """Return the points of a body with flat ends, with covered ends and longer sides."""
    axis, length = outline.barrel.axes[:, 0], xp.maximum(outline.barrel.length, _LEAST)
    facing, along = surface.normals @ axis, surface.points @ axis
    front, rear = (fade(sign * facing, *_FACING) for sign in (1, -1))
    side = fade(xp.abs(facing), 1 - _FACING[0], 1 - _FACING[1])
    ahead, behind = outline.extension
    growth = (ahead + behind) / length
    shift = side * (along * growth + (ahead - behind) / 2)
    kept = (1 - outline.covered[0] * front) * (1 - outline.covered[1] * rear)
    return surface._replace(
        points=surface.points + shift[:, None] * axis,
        areas=surface.areas * kept * (1 + side * growth),
    )


def _end_rule(balls: bool, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of rings along the axis from 0 to the tip at 1, and weights that add to 1.

    The tip comes last.
    """
    if balls and resolution <= 2:
        return _BALL_PLACES, _BALL_WEIGHTS
    rings = resolution - 1 if balls else resolution + 1
    legendre = np.polynomial.Legendre.basis
    nodes = (legendre(rings) - legendre(rings + 1)).roots()
    nodes = np.sort(nodes.real)
    nodes[-1] = 1.0
    weights = (1 + nodes) / ((rings + 1) * legendre(rings)(nodes)) ** 2
    return (nodes + 1) / 2, weights / 2


def _end_surface(
    half_axes: Numbers, places: np.ndarray, weights: np.ndarray, around: np.ndarray
) -> Surface:
    """Return points on the front half of an ellipsoid: rings around its axis, then its tip.

    Let g be a unit vector of the product rule and S the roots of the half axes. The point is
    S^2 q for the unit vector q along S g, and the normal is along g / S.
    """
    rings = [
        np.column_stack([np.full(len(around), x), np.sqrt(1 - x * x) * around]) for x in places
    ]
    directions = np.concatenate([*rings[:-1], np.eye(3)[:1]])
    counts = np.full(len(places), len(around))
    counts[-1] = 1
    solid = np.repeat(2 * np.pi * weights / counts, counts)
    placed, normals, stretch, length = _halfway(directions, half_axes)
    areas = solid * xp.prod(xp.sqrt(half_axes)) ** 3 * (stretch / length**3)[:, 0]
    return Surface(placed * half_axes, normals, areas)


def _halfway(
    directions: np.ndarray, half_axes: Numbers
) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """Return points between the directions of points and of normals of an ellipsoid or ellipse.

    Returns:
        The points over the half axes, the unit normals there, and two columns of lengths for the
        areas: of the gradients, and of the directions times the square roots of the half axes.
    """
    stretched = directions * xp.sqrt(half_axes)
    length = xp.linalg.norm(stretched, axis=-1, keepdims=True)
    placed = stretched / length
    scaled = placed / half_axes
    stretch = xp.linalg.norm(scaled, axis=-1, keepdims=True)
    return placed, scaled / stretch, stretch, length


def _side_surface(
    half_axes: Numbers, rear: Number, front: Number, rings: int, around: np.ndarray
) -> Surface:
    """Return points on an elliptic cylinder along x."""
    placed, normals, stretch, length = _halfway(around, half_axes)
    lines = 2 * np.pi / len(around) * xp.prod(xp.sqrt(half_axes)) ** 3 * (stretch / length**2)[:, 0]
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    count, extent = len(around), xp.maximum(front - rear, 0.0)
    places = np.repeat(nodes, count)[:, None] * extent / 2 + (front + rear) / 2
    points = xp.concatenate([places, xp.tile(placed * half_axes, (rings, 1))], 1)
    normals = xp.tile(normals, (rings, 1))
    normals = xp.concatenate([np.zeros((rings * count, 1)), normals], 1)
    return Surface(points, normals, np.repeat(weights / 2, count) * extent * xp.tile(lines, rings))
