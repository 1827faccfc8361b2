"""Points of a creature that are nearest to the ground, or deepest in it.

Every body has a few contact points: the lowest corners of a box or a mesh, the lowest point of each
rim of a cylinder, the ends of a capsule, or the lowest point of a ball or an ellipsoid. Obstacles
add the points of `evo_cpg.physics.contact.obstacles`. The contact laws are in
`evo_cpg.physics.contact.contact`.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import (
    as_matrix_of,
    cross,
    dot,
    expand_dims_like,
    matvec,
    matvec_t,
)
from evo_cpg.creature.algebra.numerics import MixedArray, Numbers, xp
from evo_cpg.creature.per_body import take
from evo_cpg.physics.contact.contact_model import CORNERS, ContactModel, ContactPoints
from evo_cpg.physics.contact.obstacles import meeting_time, obstacle_points, tangent_point
from evo_cpg.physics.contact.separation import RoundedBoxes
from evo_cpg.physics.contact.sweep import Moving, fast_from, moved, time_of_crossing
from evo_cpg.physics.contact.terrain import Plane, nearest
from evo_cpg.physics.tree.kinematics import Kinematics

# Slope up to which corners of a mesh count as low as the lowest one. The corners of a body that
# falls flat at 5 rad/s are found 5 steps ahead.
_TILT = 0.1

# Angle of tilt (rad) below which the points on the rims of an upright cylinder keep their places.
# The lowest of them is at most 5e-5 radii above the lowest point of the rim.
_UPRIGHT = 1e-4

# Angle between the lowest point on a cylinder's lower rim and two more points, which let it stand.
_THIRD = 2 * np.pi / 3

# Squared length (m^2) added under a root, so that the root has a gradient at zero.
_FLOOR = 1e-20


def contact_points(contact_model: ContactModel, kin: Kinematics, h: float = 0.0) -> ContactPoints:
    """Return the contact points of a creature, for a step from the present pose.

    Args:
        contact_model: contact points of the creature.
        kin: kinematics of the creature.
        h: length of the step, s, or 0 for the present pose alone. The chosen corners are the lowest
            ones at the end of the step. Points that may cross the ground within the step
            (`evo_cpg.physics.contact.sweep`) have the gap and the normal of the moment when they
            meet it.
    """
    ground = contact_model.ground
    found = _lowest(contact_model, kin, h)
    if contact_model.solids is not None:
        # A mesh meets obstacles with its corners and with an ellipsoid within it.
        found += _corners_on_obstacles(contact_model, kin, h)
        found += obstacle_points(contact_model.solids, ground, kin, h)
    offset, material, gap, normal, curvature, times = zip(*found, strict=True)
    ahead = None
    if any(time is not None for time in times):
        each = zip(times, gap, strict=True)
        ahead = jnp.concatenate([jnp.zeros_like(g) if t is None else t for t, g in each])
    return ContactPoints(
        jnp.concatenate(offset, 1),
        jnp.concatenate(material, 1),
        jnp.concatenate(gap),
        jnp.concatenate(normal, 1),
        jnp.concatenate(curvature),
        ahead,
    )


def _lowest(contact_model: ContactModel, kin: Kinematics, h: float) -> list[ContactPoints]:
    """Return the lowest points of all bodies, relative to the floor below the bodies' centres."""
    boxes, meshes, cylinders, balls, ellipsoids = _counts(contact_model)
    # A box, a mesh and a cylinder have several contact points, all other parts one.
    cornered = boxes + meshes
    angular = cornered + cylinders
    once = CORNERS * angular + balls + ellipsoids
    bodies = np.array(contact_model.bodies[:once])
    bodies = np.concatenate([bodies[: CORNERS * angular : CORNERS], bodies[CORNERS * angular :]])
    if not len(bodies):
        return []
    rotation, origin = take(kin.rotation, bodies, 2), take(kin.origin, bodies)
    centre = matvec(rotation, expand_dims_like(contact_model.centre, rotation[0]))
    linear, spin = take(kin.linear, bodies), take(kin.angular, bodies)
    floor = (contact_model.ground.floor,)
    above, up = nearest(floor, origin + centre)
    sloping = h > 0 and not isinstance(floor[0], Plane)
    size = expand_dims_like(_sizes(contact_model), above)
    if sloping and angular + ellipsoids:
        # Take the normal where the front of a fast body will meet the ground, such as a cliff.
        least, velocity = fast_from(contact_model.ground.margin, size), linear + cross(spin, centre)
        time = time_of_crossing(floor, origin + centre, velocity, 0.0, least, h, size)
        _, up = nearest(floor, origin + centre + time[None] * velocity)
    # The upward direction h later, relative to the body: d(e . up)/dt = e . (up x w).
    later = up + h * cross(up, spin)
    found = []

    def on_floor(own: slice, offset: Array, radius: Array | float = 0.0) -> ContactPoints:
        """Return the contact points of some bodies, whose points turn with the bodies."""
        each = offset.shape[1] // origin[:, own].shape[1]
        start, v, w = (jnp.repeat(x[:, own], each, 1) for x in (origin, linear, spin))
        point, time = start + offset, None
        if sloping:
            least = fast_from(contact_model.ground.margin, jnp.repeat(size[own], each, 0))
            velocity = v + cross(w, offset)
            time = time_of_crossing(floor, point, velocity, radius, least, h)
            point = point + time[None] * velocity
        gap, normal = nearest(floor, point)
        return ContactPoints(offset, offset, gap, normal, jnp.zeros_like(gap), time)

    if boxes:
        own = slice(boxes)
        offset = _lowest_corners(
            later[:, own], contact_model.boxes, rotation[:, :, own], centre[:, own]
        )
        found.append(on_floor(own, offset))
    if meshes:
        own = slice(boxes, cornered)
        offset = _lowest_of_meshes(
            later[:, own], contact_model.meshes, rotation[:, :, own], centre[:, own]
        )
        found.append(on_floor(own, offset))
    if cylinders:
        own = slice(cornered, angular)
        extent = expand_dims_like(contact_model.cylinders, centre)
        offset, material = _lowest_of_rims(
            rotation[:, :, own], centre[:, own], extent, up[:, own], h * spin[:, own]
        )
        found.append(on_floor(own, offset)._replace(material_offset=material))
    if balls:
        own = slice(angular, angular + balls)
        radii = expand_dims_like(contact_model.radii, above)
        over, normal, time, middle = above[own], up[:, own], None, centre[:, own]
        if sloping:
            *_, over, normal, _, time = on_floor(own, middle, radii)
        # A ball's lowest point stays below its centre.
        offset, gap = middle - radii[None] * normal, over - radii
        found.append(ContactPoints(offset, middle, gap, normal, jnp.zeros_like(gap), time))
    if ellipsoids:
        own = slice(angular + balls, None)
        turned, radii = rotation[:, :, own], expand_dims_like(contact_model.semi_axes, centre)
        touching, curvature = tangent_point(turned, radii, up[:, own], spin[:, own])
        points = on_floor(own, centre[:, own] + touching)
        found.append(points._replace(curvature_acceleration=curvature))
    return found


def _corners_on_obstacles(
    contact_model: ContactModel, kin: Kinematics, h: float
) -> list[ContactPoints]:
    """Return the corners of meshes that are lowest relative to the nearest obstacle."""
    boxes, meshes, *_ = _counts(contact_model)
    ground, solids = contact_model.ground, contact_model.solids
    if not meshes or solids is None:
        return []
    bodies = np.array(contact_model.bodies[CORNERS * boxes : CORNERS * (boxes + meshes) : CORNERS])
    rotation, origin = take(kin.rotation, bodies, 2), take(kin.origin, bodies)
    centre = matvec(
        rotation, expand_dims_like(contact_model.centre[:, boxes:], rotation[0])[:, :meshes]
    )
    spin, time = take(kin.angular, bodies), None
    if h > 0:
        place = np.array([solids.ellipsoids.bodies.index(body) for body in bodies])
        time = take(meeting_time(solids, ground, kin, h), place, 0)
        none = jnp.zeros_like(origin)
        at = RoundedBoxes(origin + centre, rotation, none, none[0])
        now = moved(Moving(at, origin, take(kin.linear, bodies), spin), time)
        rotation, origin, centre = now.at.axes, now.origin, now.at.centre - now.origin
        time = jnp.repeat(time, CORNERS, 0)
    _, up = nearest(ground.obstacles, origin + centre)
    later = up + h * cross(up, spin)
    offset = _lowest_of_meshes(later, contact_model.meshes, rotation, centre)
    gap, normal = nearest(ground.obstacles, jnp.repeat(origin, CORNERS, 1) + offset)
    return [ContactPoints(offset, offset, gap, normal, jnp.zeros_like(gap), time)]


def _counts(contact_model: ContactModel) -> tuple[int, ...]:
    """Return the numbers of boxes, meshes, cylinders, balls and ellipsoids."""
    model = contact_model
    kinds = model.boxes, model.meshes, model.cylinders, model.radii, model.semi_axes
    return tuple(kind.shape[-1] for kind in kinds)


def _sizes(contact_model: ContactModel) -> Numbers:
    """Return the largest radii about their centres of the parts that `_counts` counts, m."""
    boxes, meshes, cylinders = (
        xp.sqrt((x * x).sum(0))
        for x in (contact_model.boxes, contact_model.meshes, contact_model.cylinders)
    )
    ends = (
        meshes.max(0, initial=0.0),
        cylinders,
        contact_model.radii,
        contact_model.semi_axes.max(0, initial=0.0),
    )
    return xp.concatenate([boxes, *ends])


def clearance(contact_model: ContactModel, kin: Kinematics) -> Float[Array, "p *n"]:
    """Return the distance of every contact point from the ground, m, negative inside it."""
    return contact_points(contact_model, kin).gap


def _lowest_corners(
    up: Array,
    half_edges: np.ndarray | Array | MixedArray,
    rotation: Float[Array, "3 3 b *n"],
    centre: Array,
) -> Float[Array, "3 c *n"]:
    """Return the corners, box by box, of the face at the half edge that reaches down most."""
    edges = rotation * expand_dims_like(half_edges[None], rotation)
    rise = [dot(edges[:, i], up) for i in range(3)]
    x, y, z = (jnp.abs(height) for height in rise)
    first = (x >= y) & (x >= z)
    second = ~first & (y >= z)

    def choose(*options: Array) -> Array:
        return jnp.where(first[None], options[0], jnp.where(second[None], options[1], options[2]))

    down = [
        jnp.where((height > 0)[None], -edges[:, i], edges[:, i]) for i, height in enumerate(rise)
    ]
    middle = centre + choose(*down)
    left = choose(edges[:, 1], edges[:, 2], edges[:, 0])
    ahead = choose(edges[:, 2], edges[:, 0], edges[:, 1])
    signs = (
        middle + left + ahead,
        middle + left - ahead,
        middle - left + ahead,
        middle - left - ahead,
    )
    corners = jnp.stack(signs, 2)
    return corners.reshape(3, -1, *corners.shape[3:])


def _lowest_of_rims(
    rotation: Float[Array, "3 3 c *n"], centre: Array, size: Array, up: Array, turn: Array
) -> tuple[Float[Array, "3 p *n"], Float[Array, "3 p *n"]]:
    """Return points on the rims of cylinders along x, and the material points that turn with them.

    The four points of a cylinder are the lowest ones of the lower and of the upper rim, and two
    more on the lower rim. The lowest point of a rim stays below the axis of a lying cylinder, and
    turns with an upright one.

    The size is half length and radius, ``(2, c, *n)``, m, and ``turn`` the rotation of the bodies
    until the end of the step, rad.
    """
    half, radius = size
    axis = rotation[:, 0]
    # Where the axis points at the end of the step. Rolling does not move the lowest points.
    later = axis + cross(turn, axis)
    rise = dot(later, up)
    level = up - rise[None] * later
    level = level - dot(level, axis)[None] * axis
    level = level + (_UPRIGHT * rise * rise)[None] * rotation[:, 1]
    down = level * (-1.0 / jnp.sqrt(dot(level, level) + _FLOOR))[None]
    aside = cross(axis, down)
    end = (half * jnp.where(rise > 0, -1.0, 1.0))[None] * axis
    arm = radius[None] * down
    third = radius[None] * (np.cos(_THIRD) * down)
    swing = radius[None] * (np.sin(_THIRD) * aside)
    lower, upper = centre + end, centre - end
    points = lower + arm, upper + arm, lower + third + swing, lower + third - swing
    turning = (dot(axis, up) ** 2)[None] * arm
    materials = lower + turning, upper + turning, *points[2:]
    points, materials = (jnp.stack(vectors, 2) for vectors in (points, materials))
    shape = 3, -1, *points.shape[3:]
    return points.reshape(shape), materials.reshape(shape)


def _lowest_of_meshes(
    up: Array, meshes: np.ndarray, rotation: Float[Array, "3 3 m *n"], centre: Array
) -> Float[Array, "3 c *n"]:
    """Return four corners of each mesh, mesh by mesh: the lowest one and its support corners.

    Height above the lowest corner, divided by a slope, lowers a corner's score. The second corner
    is farthest from the first. The third and fourth are farthest from their line on either side. If
    no other corner lies low enough, the first corner is repeated.
    """
    up, corners = matvec_t(rotation, up), as_matrix_of(meshes, up)
    rise = (corners * up[:, None]).sum(0)
    rise = (rise - rise.min(0, keepdims=True)) / _TILT
    table = jnp.asarray(np.swapaxes(meshes, 0, 2), up.dtype)
    mesh = jnp.arange(len(table)).reshape(-1, *(1,) * (up.ndim - 2))

    def best(score: Array) -> Array:
        return jnp.moveaxis(table[mesh, jnp.argmax(score, 0)], -1, 0)

    first = best(-rise)
    edges = corners - first[:, None]
    second = best(jnp.sqrt(jnp.maximum(dot(edges, edges) - (_TILT * rise) ** 2, 0.0)) - rise)
    edge = second - first
    across = cross(up, edge)
    across = across / jnp.sqrt(dot(across, across) + _FLOOR)[None]
    aside = (edges * across[:, None]).sum(0)
    four = jnp.stack([first, second, best(aside - rise), best(-aside - rise)], 2)
    lowest = jax.lax.stop_gradient(four).reshape(3, -1, *up.shape[2:])
    return jnp.repeat(centre, CORNERS, 1) + matvec(jnp.repeat(rotation, CORNERS, 2), lowest)
