"""Contact points of a creature with blocks and boulders: on edges, sides, corners and ends.

Blocks are boxes and boulders are balls. Their nearest points are therefore computed like those of
two bodies of a creature (`evo_cpg.physics.contact.separation`). Each part has contact with the two
nearest obstacles of each kind, at the few deepest points.

A plane separates an ellipsoid with the centre c, axes R and semi-axes A from an obstacle. The plane
passes through the point q and has the normal n towards the ellipsoid:

    gap = n . (c - q) - |A R^T n|.

The nearest point to a ball is the root of one equation (Eberly 2013). For a box, q is the point of
the box with the least |A^-1 R^T (q - c)|, which is 1 on the surface of the ellipsoid. The box lies
behind the tangent plane at q of the ellipsoid scaled up to q. This gap is exact at contact, and
never greater than the distance. Neither is the distance of the box from the ball around the
ellipsoid. The larger of both is taken.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import (
    array_of,
    as_matrix_of,
    cross,
    dot,
    expand_dims_like,
    matmul,
    matvec,
    matvec_t,
    t_matmul,
    where_each,
)
from evo_cpg.creature.algebra.numerics import xp
from evo_cpg.creature.per_body import take
from evo_cpg.physics.contact.box_separation import separation_of_boxes
from evo_cpg.physics.contact.contact_model import NEAREST, ContactPoints, Ground, Parts, Solids
from evo_cpg.physics.contact.separation import (
    RoundedBoxes,
    Separation,
    separation_of_line_and_box,
    separation_of_lines,
    within,
)
from evo_cpg.physics.contact.sweep import Moving, PartShapes, moved, times_of_contact
from evo_cpg.physics.contact.terrain import Block, Boulder, Obstacle
from evo_cpg.physics.tree.kinematics import Kinematics

# A part keeps its points with the smallest gaps. Each further point on one obstacle counts as this
# much farther away (m), so that a part that lies on two obstacles has points on both. The same
# number is a weight in the choice of a part's nearest obstacles. It multiplies the distance from
# the part's centre to the obstacle, which decides between obstacles that overlap.
_BEHIND = 1e-3

# Squared length (m^2), or another quantity, added under roots and to divisors that may be zero.
_FLOOR = 1e-20


def obstacle_points(
    solids: Solids, ground: Ground, kin: Kinematics, h: float
) -> list[ContactPoints]:
    """Return the points at which parts may touch obstacles, in the order of `ContactModel`.

    Fast parts meet the obstacles in their way instead of passing through them.
    """
    found = []
    for kind, parts, most in zip(Solids._fields[:4], solids[:4], solids.points, strict=True):
        if not parts.bodies:
            continue
        candidates = []
        for is_block, near in _near_obstacles(parts, kind == "ellipsoids", ground, kin, h):
            points = _touching(kind, near.parts, near.obstacle, is_block)
            candidates += [
                (point.gap + rank * _BEHIND, point._replace(ahead=near.time))
                for rank, point in enumerate(points)
            ]
        found += [point for _, point in _smallest(candidates, most)]
    return found


def meeting_time(solids: Solids, ground: Ground, kin: Kinematics, h: float) -> Float[Array, "p *n"]:
    """Return when each ellipsoid, or the mesh around it, meets its nearest obstacle, s."""
    best = None
    for _, near in _near_obstacles(solids.ellipsoids, True, ground, kin, h):
        new = near.distance, near.time
        best = new if best is None else where_each(near.distance < best[0], new, best)
    assert best is not None
    return best[1]


class _Near(NamedTuple):
    """One obstacle for each part, and the parts at the time of contact.

    Attributes:
        distance: approximate distance that each part moves until contact, m.
        obstacle: obstacles as rounded boxes.
        time: time within the step at which the contact plane is taken, s.
        parts: parts at that time.
    """

    distance: Float[Array, "p *n"]
    obstacle: RoundedBoxes
    time: Float[Array, "p *n"]
    parts: Moving


def _near_obstacles(
    parts: Parts, ellipsoids: bool, ground: Ground, kin: Kinematics, h: float
) -> list[tuple[bool, _Near]]:
    """Place parts of a creature, and return blocks (with True) and boulders near each of them."""
    bodies = np.array(parts.bodies)
    rotation, origin = take(kin.rotation, bodies, 2), take(kin.origin, bodies)
    centre = origin + matvec(rotation, expand_dims_like(parts.centre, origin))
    axes = rotation
    if parts.axes is not None:
        axes = matmul(rotation, expand_dims_like(parts.axes, rotation))
    half = expand_dims_like(parts.half_extents, origin) + 0 * centre
    radius = expand_dims_like(parts.radius, origin[0]) + 0 * centre[0]
    speeds = take(kin.linear, bodies), take(kin.angular, bodies)
    placed = Moving(RoundedBoxes(centre, axes, half, radius), origin, *speeds)
    corners = None if parts.corners is None else as_matrix_of(parts.corners, origin)
    outline = PartShapes(ellipsoids, corners)
    # Each obstacle is one box for all parts and individuals: constants cost no operation.
    point = jnp.zeros((3, *(1 for _ in origin.shape[1:])), origin.dtype)
    found = []
    for kind in (Block, Boulder):
        alike = [obstacle for obstacle in ground.obstacles if isinstance(obstacle, kind)]
        if not alike:
            continue
        boxes = [_as_box(obstacle, centre) for obstacle in alike]
        distances = []
        for box in boxes:
            # An approximate distance, by alternating projections.
            first = within(box, centre)
            own = within(placed.at, first)
            separation, sunk = within(box, own) - own, first - centre
            gap = jnp.sqrt(dot(separation, separation) + _FLOOR) - radius - box.radius
            # This term ranks overlapping obstacles: nearer to the part's centre comes first.
            distances.append(gap + _BEHIND * jnp.sqrt(dot(sunk, sunk) + _FLOOR))
        times = [jnp.zeros_like(distance) for distance in distances]
        if h > 0:
            single = [_as_box(obstacle, point) for obstacle in alike]
            stacked = jax.tree.map(lambda *each: jnp.stack(each), *single)
            times, swept = times_of_contact(placed, outline, stacked, ground.margin, h)
            distances = [
                jnp.where(t > 0, new, distance)
                for t, new, distance in zip(times, swept, distances, strict=True)
            ]
        near = _smallest(list(zip(distances, boxes, times, strict=True)), NEAREST)
        for away, box, time in near:
            found.append((kind is Block, _Near(away, box, time, moved(placed, time))))
    return found


def _smallest(candidates: list[tuple], count: int) -> list[tuple]:
    """Return the tuples whose first elements are smallest, for each part."""
    best = candidates[:0]
    for new in candidates:
        for k, old in enumerate(best) if len(candidates) > count else ():
            better = new[0] < old[0]
            best[k], new = where_each(better, new, old), where_each(better, old, new)
        if len(best) < count:
            best.append(new)
    return best


def _as_box(obstacle: Obstacle, like: Float[Array, "3 p *n"]) -> RoundedBoxes:
    """Return a block without radius, or a boulder without extent."""
    none = jnp.zeros_like(like[0])
    one = none + 1.0
    centre = expand_dims_like(array_of(obstacle.centre), like) + 0 * like
    if isinstance(obstacle, Block):
        turn = xp.cos(obstacle.heading), xp.sin(obstacle.heading)
        c, s = (expand_dims_like(array_of(x), none) + none for x in turn)
        half, radius = expand_dims_like(array_of(obstacle.half_extents), like) + 0 * like, none
    else:
        c, s, half = one, none, jnp.zeros_like(like)
        radius = expand_dims_like(array_of(obstacle.radius), none) + none
    rows = [[c, -s, none], [s, c, none], [none, none, one]]
    axes = jnp.stack([jnp.stack(row) for row in rows])
    return RoundedBoxes(centre, axes, half, radius)


def _touching(
    kind: str, parts: Moving, obstacle: RoundedBoxes, is_block: bool
) -> list[ContactPoints]:
    """Return the contact points of parts of a kind (`Solids`) with a block or a boulder each."""
    at = parts.at
    if kind == "ellipsoids":
        gap, normal = (
            nearest_to_box(*at[:3], obstacle)
            if is_block
            else nearest_to_ball(*at[:3], obstacle.centre, obstacle.radius)
        )
        touching, curvature = tangent_point(at.axes, at.half_extents, normal, parts.angular)
        offset = at.centre + touching - parts.origin
        return [ContactPoints(offset, offset, gap, normal, curvature)]
    if kind == "boxes" and is_block:
        corner, *beside, across = separation_of_boxes(obstacle, at, corners=4)
        found = [corner, across, *beside]
    elif kind == "boxes":
        # The normal on a face turns with the box.
        one, *_ = separation_of_line_and_box(obstacle, at)
        found = [one._replace(carried=jnp.ones_like(one.carried))]
    elif is_block:
        # The line is the first body there, and the second here.
        found = [
            Separation(gap, -normal, second, first, carried[::-1])
            for gap, normal, first, second, carried in separation_of_line_and_box(at, obstacle)
        ][: 1 if kind == "balls" else 2]
    else:
        found = separation_of_lines(obstacle, at)[:1]
    points = []
    for gap, normal, _, place, carried in found:
        offset = place - parts.origin
        velocity = parts.linear + cross(parts.angular, offset)
        turning = carried[1][None] * parts.angular
        # A turning normal points at a different place of a sliding surface.
        curvature = -2.0 * dot(cross(normal, turning), velocity)
        material = offset + at.radius[None] * normal
        points.append(ContactPoints(offset, material, gap, normal, curvature))
    return points


def tangent_point(
    axes: Float[Array, "3 3 p *n"],
    semi_axes: Float[Array, "3 p *#n"],
    normal: Float[Array, "3 p *n"],
    angular: Float[Array, "3 p *n"],
) -> tuple[Float[Array, "3 p *n"], Float[Array, "p *n"]]:
    """Return the vector from an ellipsoid's centre to the point that a tangent plane touches.

    The second result is the point's surface-curvature acceleration along the normal, m/s^2.
    """
    stretched = semi_axes * matvec_t(axes, normal)
    length = jnp.sqrt(dot(stretched, stretched) + _FLOOR)
    touching = -matvec(axes, semi_axes * stretched / length[None])
    # The centre's height over the plane is s = |A R^T n|. Its second derivative s'' is that of a
    # body point plus (k . B k - s'^2) / s, with k = n x w and B = R A^2 R^T.
    slide = cross(normal, angular)
    across = semi_axes * matvec_t(axes, slide)
    rate = dot(slide, touching)
    return touching, (rate * rate - dot(across, across)) / length


# Newton steps for the nearest point to a ball's centre. The worst error of 6000 gaps was 2e-7 m,
# from the surface to 30 semi-axes away, for an ellipsoid of 0.15, 0.06 and 0.02 m.
_ROOT_STEPS = 5

# Rounds for the point of a box. One of 2000 random pairs was wrong after one round, none after 2.
_ROUNDS = 2

# Squared distance, in semi-axes, below which a point counts as the centre.
_AT_CENTRE = 1e-4


def nearest_to_ball(
    centre: Float[Array, "3 p *n"],
    axes: Float[Array, "3 3 p *n"],
    semi_axes: Float[Array, "3 p *#n"],
    ball: Float[Array, "3 p *n"],
    radius: Float[Array, "p *#n"],
) -> tuple[Array, Array]:
    """Return the gap to balls, m, and the unit vector from a ball to the ellipsoid.

    A ball's centre inside an ellipsoid leaves along the gradient of the ellipsoid's equation, to
    first order.
    """
    own = matvec_t(axes, ball - centre)
    square = semi_axes * semi_axes
    scaled = semi_axes * own
    t = 0.0 * own[0]
    for _ in range(_ROOT_STEPS):
        # Solve |p(t)| = 1 with p = A y / (t + A^2), by the secular equation 1 / |p| = 1.
        p = scaled / (t[None] + square)
        length = dot(p, p) + _FLOOR
        derivative = (p * p / (t[None] + square)).sum(0) + _FLOOR
        t = jnp.maximum(t + (jnp.sqrt(length) - 1.0) * length / derivative, 0.0)
    displacement = square * own / (t[None] + square) - own
    apart = jnp.sqrt(dot(displacement, displacement) + _FLOOR)
    steep = own / square
    steepness, level = jnp.sqrt(dot(steep, steep) + _FLOOR), jnp.sqrt(dot(own, steep) + _FLOOR)
    inside = level < 1.0
    normal = jnp.where(inside[None], -steep / steepness[None], displacement / apart[None])
    depth = (1.0 - level) * level / steepness
    return jnp.where(inside, -depth, apart) - radius, matvec(axes, normal)


def nearest_to_box(
    centre: Float[Array, "3 p *n"],
    axes: Float[Array, "3 3 p *n"],
    semi_axes: Float[Array, "3 p *#n"],
    box: RoundedBoxes,
) -> tuple[Array, Array]:
    """Return the gap to boxes without radius, m, and the unit vector from box to ellipsoid."""
    turned = t_matmul(axes, box.axes) / semi_axes[:, None]
    metric = t_matmul(turned, turned)
    here = matvec_t(box.axes, centre - box.centre)
    inside = jnp.abs(here) - box.half_extents
    # The point with the least (point - here) . metric (point - here): coordinate descent finds the
    # coordinates that are held at a face, and elimination solves for the others.
    extent = box.half_extents
    point = jnp.clip(here, -extent, extent)
    diagonal = jnp.stack([metric[i, i] for i in range(3)])
    for _ in range(_ROUNDS):
        for i in range(3):
            gradient = dot(metric[i], point - here)
            moved_to = jnp.clip(point[i] - gradient / diagonal[i], -extent[i], extent[i])
            point = jnp.stack([moved_to if k == i else point[k] for k in range(3)])
        held = (jnp.abs(point) >= extent) & (matvec(metric, point - here) * point < 0)
        for _ in range(3):
            # A coordinate that would leave the box is held at the face. Solve for the others again.
            ahead = point - _solve_free(metric, matvec(metric, point - here), held)
            point = jnp.clip(jnp.where(held, point, ahead), -extent, extent)
            held = held | (jnp.abs(ahead) > extent)
    displacement = here - point
    pull = matvec(metric, displacement)
    # A centre inside the box leaves through the nearest face.
    face = jnp.where(inside >= inside.max(0)[None], jnp.where(here < 0, -1.0, 1.0), 0.0)
    buried = dot(displacement, pull) < _AT_CENTRE
    point = jnp.where(buried[None], face * box.half_extents, point)
    pull = jnp.where(buried[None], face, pull)
    normal = pull / jnp.sqrt(dot(pull, pull) + _FLOOR)[None]
    reach = semi_axes * matvec(matmul(jnp.swapaxes(axes, 0, 1), box.axes), normal)
    gap = dot(normal, here - point) - jnp.sqrt(dot(reach, reach) + _FLOOR)
    # Far away, the plane may pass close by the ellipsoid. The ball around it then tells more.
    outside = jnp.maximum(inside, 0.0)
    apart = jnp.sqrt(dot(outside, outside) + _FLOOR) - semi_axes.max(0)
    gap = jnp.where(inside.max(0) > 0, jnp.maximum(gap, apart), gap)
    return gap, matvec(box.axes, normal)


def _solve_free(metric: Array, gradient: Array, held: Array) -> Array:
    """Return the step to the minimum with some coordinates held, by elimination."""
    free = jnp.where(held, 0.0, 1.0)
    gradient = free * gradient

    def entry(i: int, k: int) -> Array:
        own = free[i] * metric[i, k] * free[k]
        return own + (1.0 - free[i]) * metric[i, i] if i == k else own

    a, b, c = entry(0, 0), entry(0, 1), entry(0, 2)
    d, e, f = entry(1, 1), entry(1, 2), entry(2, 2)
    ratio, other = b / a, c / a
    d, e, f = d - ratio * b, e - ratio * c, f - other * c
    second, third = gradient[1] - ratio * gradient[0], gradient[2] - other * gradient[0]
    z = (third - e / d * second) / (f - e * e / d)
    y = (second - e * z) / d
    return jnp.stack([(gradient[0] - b * y - c * z) / a, y, z])
