"""The ground, and the places of a creature that may touch it.

Of every body a few places count: the corners of a box or a mesh that lie lowest, the ends of a
capsule, the lowest point of a ball or an ellipsoid. What holds there is in
`evo_cpg.physics.contact`.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.creature import Creature
from evo_cpg.creature.mesh import ConvexMesh
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Sphere
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.kinematics import Kinematics
from evo_cpg.physics.per_body import take
from evo_cpg.physics.terrain import Part, Plane, nearest
from evo_cpg.spatial.choices import chosen
from evo_cpg.spatial.linear import cross, dot, expand_dims_like, matvec, matvec_t
from evo_cpg.spatial.numerics import Number, Numbers, xp
from evo_cpg.spatial.partly import PartlyTraced

# How two materials' values become one. The factors 0.6 x 0.9 and 0.3 x 0.9 of Fukui 2003 suggest
# products for restitution; PhysX averages unless told otherwise, Havok is believed to take the
# geometric mean of frictions and the larger restitution.
Combination = Literal["multiply", "average", "geometric", "min", "max"]

# c h of a point: so many times the geometric mean of its body's mass and the creature's. A rigid
# body loses (1 + e) / 61 of the speed of its rebound. Depth hardly depends on it: of the points of
# tumbling quadrupeds 0.70, 0.75 and 0.77 % are more than 1 mm deep with 50, 60 and 100.
_STIFFNESS = 60.0

# Corners of the lowest face of a box, and those of a mesh that count.
_CORNERS = 4

# Slope up which corners of a mesh count as lying beside the lowest one: of a body that falls flat
# at 5 rad/s they are found 5 steps ahead.
_TILT = 0.1

_UP = (0.0, 0.0, 1.0)

# Squared length (m^2) added under a root so that it has a gradient at zero.
_FLOOR = 1e-20


class Ground(eqx.Module):
    """What the creature stands on: its material and its shape.

    Attributes:
        restitution: of its material.
        static_friction: of its material.
        dynamic_friction: of its material.
        restitution_rule: how the body's and the ground's restitution combine.
        friction_rule: how their frictions combine.
        floor: its shape.
        obstacles: what stands on it; of several the nearest counts.
        margin: points nearer than this are watched for an impact within the next step, m; it does
            not hold bodies off the ground.
        stribeck_speed: sliding speed at which friction has gone half of the way from static to
            dynamic, m/s.
    """

    restitution: Number = 0.5
    static_friction: Number = 0.8
    dynamic_friction: Number = 0.8
    restitution_rule: Combination = eqx.field(static=True, default="multiply")
    friction_rule: Combination = eqx.field(static=True, default="geometric")
    floor: Part = Plane()
    obstacles: tuple[Part, ...] = ()
    margin: Number = 0.05
    stribeck_speed: Number = 0.01

    @property
    def layers(self) -> tuple[tuple[Part, ...], ...]:
        """What a point can touch at the same time: the floor, and an obstacle."""
        return ((self.floor,), self.obstacles) if self.obstacles else ((self.floor,),)

    @property
    def level(self) -> Number | None:
        """Height of ground that is flat and level, m; None for any other."""
        floor = self.floor
        if isinstance(floor, Plane) and not self.obstacles and chosen(lambda: floor.normal == _UP):
            return floor.height
        return None


class Footing(NamedTuple):
    """The places of a creature that may touch the ground, and what holds for each of them.

    Of a box only the four corners of the face that looks down most count: the other four are at
    least a third of the box's height above them. They come first, then four corners of each mesh
    (see `_lowest_of_meshes`), then the balls (the ends of capsules, and spheres), then the
    ellipsoids. Where there are obstacles all come twice, for what they touch of the floor and for
    what they touch of an obstacle.

    Attributes:
        ground: that they may touch.
        bodies: index in the tree of the body that each place belongs to.
        boxes: half edges, m, one column for the four places of each box.
        meshes: corners of each mesh, m; meshes with fewer have the last one several times.
        radii: of the balls, m.
        semi_axes: of the ellipsoids, m.
        centre: of each box and mesh (once), ball and ellipsoid in the body's working frame, m.
        restitution: of the body on this ground, for every place.
        static_friction: likewise.
        dynamic_friction: likewise.
        stiffness: c h, kg.
    """

    ground: Ground
    bodies: tuple[int, ...]
    boxes: Float[np.ndarray, "3 boxes"]
    meshes: Float[np.ndarray, "3 corners meshes"]
    radii: Float[np.ndarray, " balls"]
    semi_axes: Float[np.ndarray, "3 ellipsoids"]
    centre: Float[np.ndarray, "3 parts"]
    restitution: Float[np.ndarray, " p"]
    static_friction: Float[np.ndarray, " p"]
    dynamic_friction: Float[np.ndarray, " p"]
    stiffness: Float[np.ndarray, " p"]


def make_footing(creature: Creature, tree: Tree, ground: Ground) -> Footing:
    """Find the places of a creature that may touch the ground.

    Raises:
        TypeError: a body has a shape without places.
    """
    boxes, meshes, balls, ellipsoids = [], [], [], []
    for i, name in enumerate(tree.names):
        shape, centre = creature.bodies[creature.body_index(name)].shape, tree.com[:, i]
        if isinstance(shape, Box):
            boxes.append((i, centre, shape.half_extents))
        elif isinstance(shape, ConvexMesh):
            meshes.append((i, centre, shape.corners))
        elif isinstance(shape, Capsule):
            end = xp.array([shape.length / 2, 0.0, 0.0])
            balls += [(i, centre - end, shape.radius), (i, centre + end, shape.radius)]
        elif isinstance(shape, Sphere):
            balls.append((i, centre, shape.radius))
        elif isinstance(shape, Ellipsoid):
            ellipsoids.append((i, centre, shape.half_extents))
        else:
            raise TypeError(f"no contact points for a {type(shape).__name__}")
    bodies = [i for i, *_ in boxes + meshes for _ in range(_CORNERS)]
    bodies += [i for i, *_ in balls + ellipsoids]
    bodies = bodies * len(ground.layers)
    materials = [creature.bodies[creature.body_index(tree.names[i])].material for i in bodies]

    def pairs(rule: Combination, name: str) -> Numbers:
        theirs = getattr(ground, name)
        return xp.array([combine(rule, getattr(own, name), theirs) for own in materials])

    def sizes(parts: list) -> Numbers:
        return xp.array([size for *_, size in parts], float)

    return Footing(
        ground,
        tuple(bodies),
        sizes(boxes).reshape(-1, 3).T,
        _equally_many([corners for *_, corners in meshes]),
        sizes(balls),
        sizes(ellipsoids).reshape(-1, 3).T,
        xp.array([centre for _, centre, _ in boxes + meshes + balls + ellipsoids]).T,
        pairs(ground.restitution_rule, "restitution"),
        pairs(ground.friction_rule, "static_friction"),
        pairs(ground.friction_rule, "dynamic_friction"),
        _STIFFNESS * xp.sqrt(tree.mass.sum() * tree.mass[np.array(bodies)]),
    )


def combine(rule: Combination, first: Number, second: Number) -> Number:
    """One value for a pair of materials."""
    return {
        "multiply": first * second,
        "average": (first + second) / 2,
        "geometric": xp.sqrt(first * second),
        "min": xp.minimum(first, second),
        "max": xp.maximum(first, second),
    }[rule]


def clearance(footing: Footing, kin: Kinematics) -> Float[Array, "p *n"]:
    """Distance of every place from the ground, m; negative inside of it."""
    return lowest_points(footing, kin).gap


class LowestPoints(NamedTuple):
    """The point of each place that is lowest as the ground lies below its centre.

    Attributes:
        arm: from the body's origin to the point, world axes, m.
        spoke: from the body's origin to what turns with the body there: a ball's lowest point
            keeps below its centre, all others' are points of the body.
        gap: the point's distance from the ground, m.
        normal: of the ground.
        bend: normal acceleration of the lowest point because it moves along the surface, m/s^2.
    """

    arm: Float[Array, "3 p *n"]
    spoke: Float[Array, "3 p *n"]
    gap: Float[Array, "p *n"]
    normal: Float[Array, "3 p *n"]
    bend: Float[Array, "p *n"]


def lowest_points(footing: Footing, kin: Kinematics, h: float = 0.0) -> LowestPoints:
    """See `LowestPoints`.

    Args:
        footing: the places.
        kin: kinematics of the creature.
        h: corners are those that will be lowest after so many seconds.
    """
    boxes, meshes, balls, ellipsoids = (
        part.shape[-1] for part in (footing.boxes, footing.meshes, footing.radii, footing.semi_axes)
    )
    # A box and a mesh have several places, all others one.
    angular = boxes + meshes
    once = len(footing.bodies) // len(footing.ground.layers)
    bodies = np.array(footing.bodies[:once])
    bodies = np.concatenate([bodies[: _CORNERS * angular : _CORNERS], bodies[_CORNERS * angular :]])
    rotation, origin = take(kin.rotation, bodies, 2), take(kin.origin, bodies)
    centre = matvec(rotation, expand_dims_like(footing.centre, rotation[0]))
    spin = take(kin.angular, bodies)
    found = []
    for parts in footing.ground.layers:
        above, up = _surface(parts, origin + centre)
        # As a body sees it h later; d(e . up)/dt = e . (up x w).
        later = up + h * cross(up, spin)
        if boxes:
            own = slice(boxes)
            arm = _lowest_corners(later[:, own], footing.boxes, rotation[:, :, own], centre[:, own])
            corner = jnp.repeat(origin[:, own], _CORNERS, 1) + arm
            found.append(_points(arm, arm, *_surface(parts, corner)))
        if meshes:
            own = slice(boxes, angular)
            turned = rotation[:, :, own]
            inward = matvec_t(turned, later[:, own])
            lowest = _lowest_of_meshes(footing.meshes, inward)
            arm = jnp.repeat(centre[:, own], _CORNERS, 1) + matvec(
                jnp.repeat(turned, _CORNERS, 2), lowest
            )
            corner = jnp.repeat(origin[:, own], _CORNERS, 1) + arm
            found.append(_points(arm, arm, *_surface(parts, corner)))
        if balls:
            own = slice(angular, angular + balls)
            radii = expand_dims_like(footing.radii, above)
            arm = centre[:, own] - radii[None] * up[:, own]
            found.append(_points(arm, centre[:, own], above[own] - radii, up[:, own]))
        if ellipsoids:
            own = slice(angular + balls, None)
            turned, radii = rotation[:, :, own], expand_dims_like(footing.semi_axes, centre)
            stretched = radii * matvec_t(turned, up[:, own])
            length = jnp.sqrt(dot(stretched, stretched))
            spoke = -matvec(turned, radii * stretched / length[None])
            arm = centre[:, own] + spoke
            gap, normal = _surface(parts, origin[:, own] + arm)
            # Its height over the lowest point is s = |A R^T n|, and s'' that of a point of the body
            # and k . B k - s'^2, over s, with k = n x w and B = R A^2 R^T.
            slide = cross(up[:, own], spin[:, own])
            across = radii * matvec_t(turned, slide)
            rate = dot(slide, spoke)
            bend = (rate * rate - dot(across, across)) / length
            found.append(LowestPoints(arm, arm, gap, normal, bend))
    arm, spoke, gap, normal, bend = zip(*found, strict=True)
    return LowestPoints(
        jnp.concatenate(arm, 1),
        jnp.concatenate(spoke, 1),
        jnp.concatenate(gap),
        jnp.concatenate(normal, 1),
        jnp.concatenate(bend),
    )


def _points(arm: Array, spoke: Array, gap: Array, normal: Array) -> LowestPoints:
    """Corners and balls: what is lowest there moves with the body, or with its centre."""
    return LowestPoints(arm, spoke, gap, normal, jnp.zeros_like(gap))


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


def _equally_many(corners: list[np.ndarray]) -> np.ndarray:
    """Corners ``(k, 3)`` of several meshes as one array ``(3, most, meshes)``."""
    if not corners:
        return np.zeros((3, 0, 0))
    most = max(map(len, corners))
    padded = [np.concatenate([c, np.repeat(c[-1:], most - len(c), 0)]) for c in corners]
    return np.array(padded).reshape(-1, most, 3).T
