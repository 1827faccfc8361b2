"""The points of a creature that are nearest to the ground, or deepest in it.

Of every body a few points count: the corners of a box or a mesh that lie lowest, the ends of a
capsule, the lowest point of a ball or an ellipsoid; and where there are obstacles, those of
`evo_cpg.physics.obstacles`. What holds there is in `evo_cpg.physics.contact`.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.physics.footing import CORNERS, ContactPoints, Footing
from evo_cpg.physics.kinematics import Kinematics
from evo_cpg.physics.obstacles import obstacle_points, tangent_point
from evo_cpg.physics.per_body import take
from evo_cpg.physics.terrain import Part, nearest
from evo_cpg.spatial.linear import cross, dot, expand_dims_like, matvec, matvec_t
from evo_cpg.spatial.partly import PartlyTraced

# Slope up which corners of a mesh count as lying beside the lowest one: of a body that falls flat
# at 5 rad/s they are found 5 steps ahead.
_TILT = 0.1

# Squared length (m^2) added under a root so that it has a gradient at zero.
_FLOOR = 1e-20


def contact_points(footing: Footing, kin: Kinematics, h: float = 0.0) -> ContactPoints:
    """See `ContactPoints`.

    Args:
        footing: what may touch.
        kin: kinematics of the creature.
        h: corners are those that will be lowest after so many seconds.
    """
    ground = footing.ground
    found = _lowest(footing, kin, (ground.floor,), h)
    if footing.solids is not None:
        # A mesh meets them with its corners and with an ellipsoid within it.
        found += _lowest(footing, kin, ground.obstacles, h, meshes_only=True)
        found += obstacle_points(footing.solids, ground.obstacles, kin)
    arm, spoke, gap, normal, bend = zip(*found, strict=True)
    return ContactPoints(
        jnp.concatenate(arm, 1),
        jnp.concatenate(spoke, 1),
        jnp.concatenate(gap),
        jnp.concatenate(normal, 1),
        jnp.concatenate(bend),
    )


def _lowest(
    footing: Footing,
    kin: Kinematics,
    parts: tuple[Part, ...],
    h: float,
    meshes_only: bool = False,
) -> list[ContactPoints]:
    """The points that are lowest as the nearest of some parts lies below their body's centre."""
    boxes, meshes, balls, ellipsoids = (
        part.shape[-1] for part in (footing.boxes, footing.meshes, footing.radii, footing.semi_axes)
    )
    # A box and a mesh have several contact points, all others one.
    angular = boxes + meshes
    once = CORNERS * angular + balls + ellipsoids
    bodies = np.array(footing.bodies[:once])
    bodies = np.concatenate([bodies[: CORNERS * angular : CORNERS], bodies[CORNERS * angular :]])
    counted = slice(boxes, angular) if meshes_only else slice(0, None)
    if not len(bodies[counted]):
        return []
    rotation, origin = take(kin.rotation, bodies, 2), take(kin.origin, bodies)
    centre = matvec(rotation, expand_dims_like(footing.centre, rotation[0]))
    spin = take(kin.angular, bodies)
    above, up = _surface(parts, origin + centre)
    # As a body sees it h later; d(e . up)/dt = e . (up x w).
    later = up + h * cross(up, spin)
    found = []
    if boxes and not meshes_only:
        own = slice(boxes)
        arm = _lowest_corners(later[:, own], footing.boxes, rotation[:, :, own], centre[:, own])
        corner = jnp.repeat(origin[:, own], CORNERS, 1) + arm
        found.append(_material(arm, *_surface(parts, corner)))
    if meshes:
        own = slice(boxes, angular)
        turned = rotation[:, :, own]
        inward = matvec_t(turned, later[:, own])
        lowest = _lowest_of_meshes(footing.meshes, inward)
        arm = jnp.repeat(centre[:, own], CORNERS, 1) + matvec(
            jnp.repeat(turned, CORNERS, 2), lowest
        )
        corner = jnp.repeat(origin[:, own], CORNERS, 1) + arm
        found.append(_material(arm, *_surface(parts, corner)))
    if meshes_only:
        return found
    if balls:
        own = slice(angular, angular + balls)
        radii = expand_dims_like(footing.radii, above)
        arm = centre[:, own] - radii[None] * up[:, own]
        found.append(_material(arm, above[own] - radii, up[:, own], centre[:, own]))
    if ellipsoids:
        own = slice(angular + balls, None)
        turned, radii = rotation[:, :, own], expand_dims_like(footing.semi_axes, centre)
        spoke, bend = tangent_point(turned, radii, up[:, own], spin[:, own])
        arm = centre[:, own] + spoke
        gap, normal = _surface(parts, origin[:, own] + arm)
        found.append(ContactPoints(arm, arm, gap, normal, bend))
    return found


def _material(arm: Array, gap: Array, normal: Array, spoke: Array | None = None) -> ContactPoints:
    """Corners and balls: what is lowest there moves with the body, or with its centre."""
    return ContactPoints(arm, arm if spoke is None else spoke, gap, normal, jnp.zeros_like(gap))


def clearance(footing: Footing, kin: Kinematics) -> Float[Array, "p *n"]:
    """Distance of every contact point from the ground, m; negative inside of it."""
    return contact_points(footing, kin).gap


def _surface(parts: tuple[Part, ...], point: Float[Array, "3 p *n"]) -> tuple[Array, Array]:
    """Distance of points from the nearest part and its normal there."""
    gap, normal = nearest(parts, point)
    return gap, jnp.broadcast_to(normal, point.shape)


def _lowest_corners(
    up: Array,
    half_edges: np.ndarray | Array | PartlyTraced,
    rotation: Float[Array, "3 3 b *n"],
    centre: Array,
) -> Float[Array, "3 c *n"]:
    """Corners, box by box, of the face on the end of the half edge that reaches down most."""
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


def _lowest_of_meshes(meshes: np.ndarray, up: Float[Array, "3 m *n"]) -> Float[Array, "3 c *n"]:
    """Four corners of each mesh, mesh by mesh: the lowest one, and those that it may stand on.

    Height above the lowest corner counts against a corner, divided by a slope. The second is
    farthest from the first, third and fourth are farthest from their line on either side. Where
    none lies low enough, the first is taken again.
    """
    corners = expand_dims_like(meshes, up, up.ndim + 1)
    rise = (corners * up[:, None]).sum(0)
    rise = (rise - rise.min(0, keepdims=True)) / _TILT
    table = jnp.asarray(np.swapaxes(meshes, 0, 2), up.dtype)
    mesh = jnp.arange(len(table)).reshape(-1, *(1,) * (up.ndim - 2))

    def best(score: Array) -> Array:
        return jnp.moveaxis(table[mesh, jnp.argmax(score, 0)], -1, 0)

    first = best(-rise)
    way = corners - first[:, None]
    second = best(jnp.sqrt(jnp.maximum(dot(way, way) - (_TILT * rise) ** 2, 0.0)) - rise)
    edge = second - first
    across = cross(up, edge)
    across = across / jnp.sqrt(dot(across, across) + _FLOOR)[None]
    aside = (way * across[:, None]).sum(0)
    four = jnp.stack([first, second, best(aside - rise), best(-aside - rise)], 2)
    return jax.lax.stop_gradient(four).reshape(3, -1, *up.shape[2:])
