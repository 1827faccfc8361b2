"""Outlines of bodies, with round ends straightened at the joints between bodies in line.

Two bodies in line form one outline. The flow passes the narrow waist between two round ends and
does not enter it. Each of the two ends is therefore replaced by a straight side, from the widest
cross-section of the body to a plane between the bodies:

                 ___________                  ______.______
    two bodies  (_____)(_____)    outline    (______.______)

The plane divides the distance between the two widest cross-sections in proportion to the lengths of
the ends. It lies in the middle if one end is flat. Ends that overlap shorten the sides. The change
of width at the plane has no area, because the outline of a tapered body is smooth.

`_in_line` is a weight between 0 and 1. It falls to 0 as the bodies turn, move apart or differ in
width. An end of weight w keeps the fraction 1 - w of its area, and its side gets the fraction w of
its length. Areas are continuous in the geometry.

Surface points on an outline (`outline_surface`):

- Each round end has its tip and rings around the axis, a Gauss-Radau rule. It is a rule over the
  directions halfway between those of the points and those of the normals, so that slender
  ellipsoids need few points. Half-balls need a single ring at the default resolutions.
- The side has Gauss-Legendre points along the axis and a ring around it.
- A body with flat ends has the points of its shape. Its sides are stretched.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Number, Numbers, smooth_step, xp
from evo_cpg.creature.creature import Creature, joint_places
from evo_cpg.creature.shapes import Barrel, Shape, Surface

# Bounds between which bodies cease to be in line. Cosine of the angle between their axes.
_TURN = (0.9, 0.72)

# The same for the sideways offset of the axes, and for the gap between the ends, as multiples of
# the smaller radius.
_OFFSET, _GAP = (0.5, 1.0), (1.0, 3.0)

# The same for the overlap, as a fraction of the shorter body, and for the ratio of the widths.
_OVERLAP, _WIDTHS = (0.25, 0.5), (1.7, 3.0)

# Fraction by which an axis may miss the largest one and still be taken, and number of squarings of
# a matrix that leave only its main axis.
_TIE, _SQUARINGS = 1e-6, 5

# Weight that keeps a mean defined if all other weights are 0.
_SLIGHT = 1e-9

# Least size, so that a body without extent has no area (m).
_LEAST = 1e-12


# Cosine between the normal of a flat end and the axis: a face at the first value belongs to the
# end, and at the second to the side.
_FACING = (0.9, 0.6)

# Places along the axis of a half-ball, and weights, of a ring and the tip. They give the area, form
# drag along the axis, and skin friction along the axis exactly: w (1 - x^3) = 3/4 and
# w (1 - x^2)^(3/2) = 3 pi / 16.
_BALL_PLACES = np.array([0.44775115257259673, 1.0])
_BALL_WEIGHTS = np.array([0.823963622929168, 0.176036377070832])


@dataclasses.dataclass(frozen=True)
class BodyOutline:
    """Outline of a body.

    Attributes:
        barrel: the body as a cylinder with two ends.
        covered: fraction of the front and the rear end that the outline leaves out, ``(2,)``.
        extension: change of the side's length at the front and the rear, m, ``(2,)``.
    """

    barrel: Barrel
    covered: Float[Numbers, " 2"]
    extension: Float[Numbers, " 2"]


class _End(NamedTuple):
    """End of a body in the world.

    Attributes:
        centre: centre of the widest cross-section, m.
        outward: unit vector along the axis out of the body.
        across: half axes of the cross-section as columns, unit vectors ``(3, 2)``.
        widths: lengths of these half axes, m.
        tip: length of the end, m.
        whole: length of the whole body, m.
        in_front: whether this is the front end, which points along the axis.
    """

    centre: Numbers
    outward: Numbers
    across: Numbers
    widths: Numbers
    tip: Number
    whole: Number
    in_front: Number


def outlines(
    creature: Creature, pose: tuple[Numbers, Numbers]
) -> tuple[list[BodyOutline], Float[Numbers, "b b"]]:
    """Return the outline of each body, and the weight with which every two bodies are in line.

    The pose is that of `neutral_pose`.
    """
    links = joint_places(creature, pose)
    barrels = [_barrel(creature, pose, i, links) for i in range(len(creature.bodies))]
    # For each neighbour of a body: whether it lies in front, the weight with which the two are in
    # line, and the length of the straightened end.
    beside: list[list[tuple[Number, Number, Number]]] = [[] for _ in barrels]
    table = np.zeros((len(barrels), len(barrels)))
    for bodies, place in links.items():
        if all(barrels[i].ends == "flat" for i in bodies):
            continue
        ends = []
        for i in bodies:
            barrel, axes = barrels[i], pose[1][i] @ barrels[i].axes
            in_front = axes[:, 0] @ (place - pose[0][i]) > 0
            outward = axes[:, 0] * xp.where(in_front, 1.0, -1.0)
            ends.append(
                _End(
                    pose[0][i] + outward * barrel.length / 2,
                    outward,
                    axes[:, 1:],
                    xp.maximum(barrel.half_axes[1:], _LEAST),
                    barrel.half_axes[0],
                    barrel.length + 2 * barrel.half_axes[0],
                    in_front,
                )
            )
        weight, apart = _in_line(*ends)
        flat = any(barrels[i].ends == "flat" for i in bodies)
        for i, end in zip(bodies, ends, strict=True):
            part = 0.5 if flat else end.tip / (ends[0].tip + ends[1].tip)
            beside[i].append((end.in_front, weight, apart * part))
        pair = np.zeros((len(barrels), len(barrels)))
        pair[bodies, bodies[::-1]] = 1.0
        table = table + pair * weight
    made = []
    for barrel, near in zip(barrels, beside, strict=True):
        covered, extension = [], []
        for front in (True, False):
            weights = [xp.where(side == front, weight, 0.0) for side, weight, _ in near]
            kept, total, lengths = 1.0, 0.0, 0.0
            for weight, (_, _, length) in zip(weights, near, strict=True):
                kept, total = kept * (1 - weight), total + weight
                lengths = lengths + weight * length
            covered.append(1.0 - kept)
            extension.append((1.0 - kept) * lengths / xp.maximum(total, _LEAST))
        made.append(BodyOutline(barrel, xp.array(covered), xp.array(extension)))
    return made, table


def fade(x: Number, full: float, none: float) -> Number:
    """Return a smooth step from 1 at one bound to 0 at the other."""
    return smooth_step((x - none) / (full - none))


def _barrel(
    creature: Creature,
    pose: tuple[Numbers, Numbers],
    body: int,
    links: dict[tuple[int, int], Numbers],
) -> Barrel:
    """Return a body as a cylinder along its axis nearest to the line through its neighbours.

    The line is the main axis of the directions to the joints, weighted by the neighbours' volumes.
    """
    shape, own = creature.bodies[body].shape, [link for link in links if body in link]
    if not own:
        return shape.barrel(np.eye(3)[0])
    centres, rotations = pose
    spread = _SLIGHT * np.eye(3)
    for link in own:
        other = creature.bodies[sum(link) - body].shape
        size = xp.minimum(other.volume / xp.maximum(shape.volume, _LEAST**3), 1.0)
        direction = rotations[body].T @ (links[link] - centres[body])
        squared = xp.maximum(direction @ direction, _LEAST**2)
        spread = spread + size * xp.outer(direction, direction) / squared
    nearest = chosen(
        lambda: np.argmax(xp.diag(spread)),
        lambda axis: spread[axis, axis] >= xp.max(xp.diag(spread)) * (1 - _TIE),
    )
    # Powers of a symmetric matrix converge to its main axis.
    for _ in range(_SQUARINGS):
        spread = spread @ spread / xp.trace(spread @ spread)
    return shape.barrel(spread[:, nearest])


def _in_line(one: _End, two: _End) -> tuple[Number, Number]:
    """Return the weight with which two bodies are in line, and the distance of their middles.

    The distance is that of the widest cross-sections, along the mean axis, m.
    """
    cosine = -(one.outward @ two.outward)
    mean = one.outward - two.outward
    axis = mean / xp.sqrt(xp.maximum(mean @ mean, _LEAST))
    offset = two.centre - one.centre
    apart = offset @ axis
    sideways = offset - apart * axis
    radii = [xp.sqrt(xp.prod(end.widths)) for end in (one, two)]
    radius = xp.minimum(*radii)
    weight = fade(cosine, *_TURN)
    weight = weight * fade(xp.sqrt(sideways @ sideways + _LEAST**2) / radius, *_OFFSET)
    weight = weight * fade((apart - one.tip - two.tip) / radius, *_GAP)
    shorter = xp.maximum(xp.minimum(one.whole, two.whole), _LEAST)
    weight = weight * fade(-apart / shorter, *_OVERLAP)
    for k in (0, 1):
        # Half width of the other cross-section along a vector that is nearly in its plane.
        parts, squares = xp.square(one.across[:, k] @ two.across), xp.square(two.widths)
        width = xp.sqrt((parts @ squares + _SLIGHT * squares.mean()) / (parts.sum() + _SLIGHT))
        ratio = one.widths[k] / width
        weight = weight * fade(xp.maximum(ratio, 1 / ratio), *_WIDTHS)
    return weight, apart


def outline_surface(
    shape: Shape, outline: BodyOutline, resolution: int
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
    # The front half of an ellipsoid: rings around its axis, then its tip. Let g be a unit vector of
    # the product rule and S the roots of the half axes. The point is S^2 q for the unit vector q
    # along S g, and the normal is along g / S.
    places, weights = _end_rule(balls, resolution)
    rings = [np.column_stack([np.full(count, x), np.sqrt(1 - x * x) * around]) for x in places]
    directions = np.concatenate([*rings[:-1], np.eye(3)[:1]])
    counts = np.full(len(places), count)
    counts[-1] = 1
    solid = np.repeat(2 * np.pi * weights / counts, counts)
    placed, normals, stretch, length = _halfway(directions, half_axes)
    areas = solid * xp.prod(xp.sqrt(half_axes)) ** 3 * (stretch / length**3)[:, 0]
    end = Surface(placed * half_axes, normals, areas)
    parts = [
        Surface(
            (end.points + xp.array([barrel.length / 2, 0.0, 0.0])) * sign,
            end.normals * sign,
            end.areas * (1 - each),
        )
        for sign, each in zip(np.array([[1, 1, 1], [-1, 1, 1]]), covered, strict=True)
    ]
    front, rear = barrel.length / 2 + outline.extension
    # An elliptic cylinder along x.
    section = half_axes[1:]
    placed, normals, stretch, length = _halfway(around, section)
    lines = 2 * np.pi / count * xp.prod(xp.sqrt(section)) ** 3 * (stretch / length**2)[:, 0]
    nodes, weights = np.polynomial.legendre.leggauss(resolution)
    extent = xp.maximum(front + rear, 0.0)
    places = np.repeat(nodes, count)[:, None] * extent / 2 + (front - rear) / 2
    points = xp.concatenate([places, xp.tile(placed * section, (resolution, 1))], 1)
    normals = xp.tile(normals, (resolution, 1))
    normals = xp.concatenate([np.zeros((resolution * count, 1)), normals], 1)
    areas = np.repeat(weights / 2, count) * extent * xp.tile(lines, resolution)
    parts.append(Surface(points, normals, areas))
    points, normals, areas = (xp.concatenate(columns) for columns in zip(*parts, strict=True))
    on_body = np.arange(len(areas)) < 2 * len(end.areas)
    return Surface(points @ barrel.axes.T, normals @ barrel.axes.T, areas), on_body


def _flat_surface(surface: Surface, outline: BodyOutline) -> Surface:
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
