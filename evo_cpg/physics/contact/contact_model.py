"""Ground, and the contact points of a creature on the ground.

`evo_cpg.physics.contact.contact_points` finds the places of the points.
`evo_cpg.physics.contact.contact` has the contact laws.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.contact.terrain import Block, Boulder, GroundPart, Obstacle, Plane

# Rules that combine the values of two materials. The factors 0.6 x 0.9 and 0.3 x 0.9 of Fukui 2003
# suggest products for restitution. PhysX averages by default. Havok is believed to use the
# geometric mean of frictions and the larger restitution.
Combination = Literal["multiply", "average", "geometric", "min", "max"]

# c h of a point, relative to the geometric mean of its body's mass and the creature's mass. A rigid
# body loses (1 + e) / 61 of the speed of its rebound. Depth hardly depends on this value: 0.70,
# 0.75 and 0.77 % of the points of tumbling quadrupeds are more than 1 mm deep with 50, 60 and 100.
STIFFNESS = 60.0

# Contact points of a box (corners of its lowest face), a mesh and a cylinder.
CORNERS = 4

# Nearest obstacles of each kind that a part of a creature may touch.
NEAREST = 2

# Most contact points of a box, a line, a ball and an ellipsoid with all obstacles at the same time,
# and with one block. One boulder gives one point.
_POINTS, _ON_BLOCK = (4, 2, 2, 2), (4, 2, 1, 1)

_UP = (0.0, 0.0, 1.0)


class Ground(eqx.Module):
    """Material and shape of the ground.

    Attributes:
        margin: distance from which points are checked for an impact within the next step, m. The
            margin does not hold bodies off the ground. Fast points are checked from farther away.
        stribeck_speed: sliding speed at which friction is halfway between static and dynamic, m/s.
    """

    restitution: Number = 0.5
    static_friction: Number = 0.8
    dynamic_friction: Number = 0.8
    restitution_rule: Combination = eqx.field(static=True, default="multiply")
    friction_rule: Combination = eqx.field(static=True, default="geometric")
    floor: GroundPart = Plane()
    obstacles: tuple[Obstacle, ...] = ()
    margin: Number = 0.05
    stribeck_speed: Number = 0.01

    @property
    def level(self) -> Number | None:
        """Height of flat and level ground, m, or None for any other ground."""
        floor = self.floor
        if isinstance(floor, Plane) and not self.obstacles and chosen(lambda: floor.normal == _UP):
            return floor.height
        return None


class Parts(NamedTuple):
    """All solid parts of one kind in a creature, for example all boxes.

    Attributes:
        bodies: index in the tree of each part's body.
        centre: centre of each part in the body's working frame, m.
        axes: axes as columns in the body's working frame, or None if all are the frame's axes.
        half_extents: half extents of a box or of a line along x, or semi-axes of an ellipsoid, m.
        radius: radius of rounding, m. A part is all points within this distance of its box, line,
            centre (ball) or ellipsoid.
        corners: corners of meshes around ellipsoids, along the axes, m. A part without a mesh has
            zeros. None without any mesh.
    """

    bodies: tuple[int, ...]
    centre: Float[Numbers, "3 p"]
    axes: Float[np.ndarray, "3 3 p"] | None
    half_extents: Float[Numbers, "3 p"]
    radius: Float[Numbers, " p"]
    corners: Float[np.ndarray, "3 c p"] | None = None


class Solids(NamedTuple):
    """Solid parts of a creature for contact with obstacles.

    A mesh is represented by an ellipsoid within it. The corners of the mesh are separate contact
    points.

    Attributes:
        lines: centre lines of capsules.
        ellipsoids: ellipsoids of bodies and within meshes.
        points: for each kind, the number of points that one part may touch with at the same time.
    """

    boxes: Parts
    lines: Parts
    balls: Parts
    ellipsoids: Parts
    points: tuple[int, int, int, int]


class ContactModel(NamedTuple):
    """Contact points of a creature and their constants.

    A box has only four contact points: the corners of the face that looks down most. The other four
    corners are at least a third of the box's height above them. The order of points on the floor is
    boxes, meshes, cylinders (`evo_cpg.physics.contact.contact_points`), balls (ends of capsules,
    and spheres), ellipsoids. Obstacles add the corners of meshes again, then the points of
    `Solids` by kind: the first points of all parts, then their second points.

    Attributes:
        bodies: index in the tree of each contact point's body.
        boxes: half edges, m, one column for the four contact points of each box.
        meshes: corners of each mesh, m. Shorter lists repeat the last corner.
        cylinders: half length and radius of each cylinder along x, m.
        solids: parts that may touch obstacles, or None without obstacles.
        centre: centre of each box, mesh and cylinder (once), ball and ellipsoid, body's working
            frame, m.
        restitution: restitution of the body on this ground, for every contact point.
        static_friction: static friction of the body on this ground, for every contact point.
        dynamic_friction: dynamic friction of the body on this ground, for every contact point.
        stiffness: c h of every contact point, kg.
    """

    ground: Ground
    bodies: tuple[int, ...]
    boxes: Float[np.ndarray, "3 boxes"]
    meshes: Float[np.ndarray, "3 corners meshes"]
    cylinders: Float[np.ndarray, "2 cylinders"]
    radii: Float[np.ndarray, " balls"]
    semi_axes: Float[np.ndarray, "3 ellipsoids"]
    solids: Solids | None
    centre: Float[np.ndarray, "3 parts"]
    restitution: Float[np.ndarray, " p"]
    static_friction: Float[np.ndarray, " p"]
    dynamic_friction: Float[np.ndarray, " p"]
    stiffness: Float[np.ndarray, " p"]


class ContactPoints(NamedTuple):
    """Present contact points: the points nearest to the ground, or deepest in it.

    Attributes:
        offset: vector from the body's origin to the point, world axes, m.
        material_offset: vector from the body's origin to the material point that turns with the
            body, m. This is the centre for a ball, whose lowest point stays below the centre.
        gap: distance of the point from the ground, m.
        normal: normal away from the ground, or normal of the body if its face meets an edge.
        curvature_acceleration: acceleration along the normal from the point's motion along the
            surface, m/s^2.
        ahead: time within the step to which these values belong, s. It is 0 except for fast points
            (`evo_cpg.physics.contact.sweep`), and None if it is 0 for all points.
    """

    offset: Float[Array, "3 p *n"]
    material_offset: Float[Array, "3 p *n"]
    gap: Float[Array, "p *n"]
    normal: Float[Array, "3 p *n"]
    curvature_acceleration: Float[Array, "p *n"]
    ahead: Float[Array, "p *n"] | None = None


def make_contact_model(creature: Creature, tree: Tree, ground: Ground) -> ContactModel:
    """Return the contact points of a creature on a ground."""
    found: dict[str, list] = {"box": [], "mesh": [], "cylinder": [], "ball": [], "ellipsoid": []}
    every = creature.bodies_of(tree.names)
    for i, body in enumerate(every):
        for part in body.shape.floor_parts():
            centre = tree.centre[:, i]
            place = centre if part.centre is None else centre + part.centre
            found[part.kind].append((i, place, part.size))
    boxes, meshes, cylinders, balls, ellipsoids = found.values()
    corners, of_meshes, rims = (
        [i for i, *_ in parts for _ in range(CORNERS)] for parts in (boxes, meshes, cylinders)
    )
    bodies = corners + of_meshes + rims + [i for i, *_ in balls + ellipsoids]
    solids = None
    if ground.obstacles:
        solids = _make_solids(creature, tree, ground.obstacles)
        bodies += of_meshes
        for parts, count in zip(solids[:4], solids.points, strict=True):
            bodies += count * parts.bodies
    materials = [every[i].material for i in bodies]

    def pairs(rule: Combination, name: str) -> Numbers:
        theirs = getattr(ground, name)
        return xp.array([combine(rule, getattr(own, name), theirs) for own in materials])

    def sizes(parts: list) -> Numbers:
        return xp.array([size for *_, size in parts], float)

    return ContactModel(
        ground,
        tuple(bodies),
        sizes(boxes).reshape(-1, 3).T,
        _equally_many([corners for *_, corners in meshes]),
        sizes(cylinders).reshape(-1, 2).T,
        sizes(balls),
        sizes(ellipsoids).reshape(-1, 3).T,
        solids,
        xp.array([centre for part in found.values() for _, centre, _ in part]).T,
        pairs(ground.restitution_rule, "restitution"),
        pairs(ground.friction_rule, "static_friction"),
        pairs(ground.friction_rule, "dynamic_friction"),
        STIFFNESS * xp.sqrt(tree.mass.sum() * tree.rigid_mass[np.array(bodies)]),
    )


def combine(rule: Combination, first: Number, second: Number) -> Number:
    """Return the combined value of a pair of materials."""
    return {
        "multiply": first * second,
        "average": (first + second) / 2,
        "geometric": xp.sqrt(first * second),
        "min": xp.minimum(first, second),
        "max": xp.maximum(first, second),
    }[rule]


def _make_solids(creature: Creature, tree: Tree, obstacles: tuple[Obstacle, ...]) -> Solids:
    own: dict[str, list] = {"box": [], "line": [], "ball": [], "ellipsoid": []}
    for i, body in enumerate(creature.bodies_of(tree.names)):
        for part in body.shape.obstacle_parts():
            own[part.kind].append((i, part))

    kinds = []
    for found in own.values():
        bodies = tuple(body for body, _ in found)
        centre = xp.array([part.centre for _, part in found], float).reshape(-1, 3).T
        turned = any(part.axes is not None for _, part in found)
        axes = [np.eye(3) if part.axes is None else part.axes for _, part in found]
        kinds.append(
            Parts(
                bodies,
                tree.centre[:, np.array(bodies, int)] + centre,
                np.stack(axes, -1) if turned else None,
                xp.array([part.half_extents for _, part in found], float).reshape(-1, 3).T,
                xp.array([part.radius for _, part in found], float),
            )
        )
    blocks, boulders = (
        min(NEAREST, sum(isinstance(x, kind) for x in obstacles)) for kind in (Block, Boulder)
    )
    of_box, of_line, of_ball, of_ellipsoid = (
        min(most, blocks * each + boulders) for most, each in zip(_POINTS, _ON_BLOCK, strict=True)
    )
    points = of_box, of_line, of_ball, of_ellipsoid
    boxes, lines, balls, ellipsoids = kinds
    outlines = [part.corners for _, part in own["ellipsoid"]]
    if any(outline is not None for outline in outlines):
        none = np.zeros((1, 3))
        corners = _equally_many([none if outline is None else outline for outline in outlines])
        ellipsoids = ellipsoids._replace(corners=corners)
    return Solids(boxes, lines, balls, ellipsoids, points)


def _equally_many(corners: list[np.ndarray]) -> np.ndarray:
    """Return the corners ``(k, 3)`` of several meshes as one array ``(3, most, meshes)``."""
    if not corners:
        return np.zeros((3, 0, 0))
    most = max(map(len, corners))
    padded = [np.concatenate([c, np.repeat(c[-1:], most - len(c), 0)]) for c in corners]
    return np.array(padded).reshape(-1, most, 3).T
