"""The ground, and the contact points of a creature: those that may touch it.

Where they are is found in `evo_cpg.physics.contact_points`, what holds there in
`evo_cpg.physics.contact`.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.creature import Creature
from evo_cpg.creature.shapes import ObstaclePart
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.terrain import Block, Boulder, Obstacle, Part, Plane
from evo_cpg.spatial.decisions import chosen
from evo_cpg.spatial.numerics import Number, Numbers, xp

# How two materials' values become one. The factors 0.6 x 0.9 and 0.3 x 0.9 of Fukui 2003 suggest
# products for restitution; PhysX averages unless told otherwise, Havok is believed to take the
# geometric mean of frictions and the larger restitution.
Combination = Literal["multiply", "average", "geometric", "min", "max"]

# c h of a point: so many times the geometric mean of its body's mass and the creature's. A rigid
# body loses (1 + e) / 61 of the speed of its rebound. Depth hardly depends on it: of the points of
# tumbling quadrupeds 0.70, 0.75 and 0.77 % are more than 1 mm deep with 50, 60 and 100.
STIFFNESS = 60.0

# Corners of the lowest face of a box, and those of a mesh that count.
CORNERS = 4

# Obstacles of each kind that count for a part of a creature: those nearest to it.
NEAREST = 2

# Points that a box, a line, a ball and an ellipsoid may touch obstacles with at the same time, and
# those that each has with one block; with one boulder it has one.
_POINTS, _ON_BLOCK = (4, 2, 2, 2), (4, 2, 1, 1)

_UP = (0.0, 0.0, 1.0)


class Ground(eqx.Module):
    """What the creature stands on: its material and its shape.

    Attributes:
        restitution: of its material.
        static_friction: of its material.
        dynamic_friction: of its material.
        restitution_rule: how the body's and the ground's restitution combine.
        friction_rule: how their frictions combine.
        floor: its shape.
        obstacles: what stands on it.
        margin: points nearer than this are watched for an impact within the next step, m; it does
            not hold bodies off the ground. Points that are fast are watched from farther away.
        stribeck_speed: sliding speed at which friction has gone half of the way from static to
            dynamic, m/s.
    """

    restitution: Number = 0.5
    static_friction: Number = 0.8
    dynamic_friction: Number = 0.8
    restitution_rule: Combination = eqx.field(static=True, default="multiply")
    friction_rule: Combination = eqx.field(static=True, default="geometric")
    floor: Part = Plane()
    obstacles: tuple[Obstacle, ...] = ()
    margin: Number = 0.05
    stribeck_speed: Number = 0.01

    @property
    def level(self) -> Number | None:
        """Height of ground that is flat and level, m; None for any other."""
        floor = self.floor
        if isinstance(floor, Plane) and not self.obstacles and chosen(lambda: floor.normal == _UP):
            return floor.height
        return None


class Parts(NamedTuple):
    """Parts of a creature of one kind.

    Attributes:
        bodies: index in the tree of the body that each belongs to.
        centre: in the body's working frame, m.
        axes: there, as columns; None where all are the frame's.
        half_extents: of a box, of a line along x, or semi-axes of an ellipsoid, m.
        radius: of the ball that sweeps them, m.
        corners: of meshes around ellipsoids, along the axes, m; zeros where there is no mesh, and
            None where there are no meshes at all.
    """

    bodies: tuple[int, ...]
    centre: Float[Numbers, "3 p"]
    axes: Float[np.ndarray, "3 3 p"] | None
    half_extents: Float[Numbers, "3 p"]
    radius: Float[Numbers, " p"]
    corners: Float[np.ndarray, "3 c p"] | None = None


class Solids(NamedTuple):
    """A creature as obstacles meet it: with edges and sides.

    A mesh is an ellipsoid that lies within it; its corners are contact points of their own.

    Attributes:
        boxes: with sharp edges.
        lines: of capsules.
        balls: spheres.
        ellipsoids: of bodies, and within meshes.
        points: how many points each of a kind may touch obstacles with at the same time.
    """

    boxes: Parts
    lines: Parts
    balls: Parts
    ellipsoids: Parts
    points: tuple[int, int, int, int]

    @property
    def bodies(self) -> tuple[int, ...]:
        """Of every contact point: of a kind the first points of all parts, then the next."""
        found = ()
        for parts, count in zip(self[:4], self.points, strict=True):
            found += count * parts.bodies
        return found


class ContactModel(NamedTuple):
    """The contact points of a creature, and what holds for each of them.

    Of a box only the four corners of the face that looks down most count: the other four are at
    least a third of the box's height above them. They come first, then four corners of each mesh
    (`evo_cpg.physics.contact_points`), then the balls (the ends of capsules, and spheres), then
    the ellipsoids. Where there are obstacles the corners of meshes come again, and then the points
    that other parts may touch obstacles with (`Solids`).

    Attributes:
        ground: that they may touch.
        bodies: index in the tree of the body that each contact point belongs to.
        boxes: half edges, m, one column for the four contact points of each box.
        meshes: corners of each mesh, m; meshes with fewer have the last one several times.
        radii: of the balls, m.
        semi_axes: of the ellipsoids, m.
        solids: what may touch obstacles; None where there are none.
        centre: of each box and mesh (once), ball and ellipsoid in the body's working frame, m.
        restitution: of the body on this ground, for every contact point.
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
    solids: Solids | None
    centre: Float[np.ndarray, "3 parts"]
    restitution: Float[np.ndarray, " p"]
    static_friction: Float[np.ndarray, " p"]
    dynamic_friction: Float[np.ndarray, " p"]
    stiffness: Float[np.ndarray, " p"]


class ContactPoints(NamedTuple):
    """Where the contact points are now: what is nearest to the ground, or deepest in it.

    Attributes:
        offset: from the body's origin to the point, world axes, m.
        material_offset: from the body's origin to what turns with the body there. The lowest point
            of a ball stays below its centre; all others are points of the body.
        gap: the point's distance from the ground, m.
        normal: of the ground, or of the body where its face meets an edge; away from the ground.
        curvature_acceleration: along the normal, because the point moves along the surface, m/s^2.
        ahead: time (s) within the step at which all of this is so: 0 but for what moves fast
            (`evo_cpg.physics.sweep`); None where it is 0 of all points.
    """

    offset: Float[Array, "3 p *n"]
    material_offset: Float[Array, "3 p *n"]
    gap: Float[Array, "p *n"]
    normal: Float[Array, "3 p *n"]
    curvature_acceleration: Float[Array, "p *n"]
    ahead: Float[Array, "p *n"] | None = None


def make_contact_model(creature: Creature, tree: Tree, ground: Ground) -> ContactModel:
    """Find the contact points of a creature."""
    found: dict[str, list] = {"box": [], "mesh": [], "ball": [], "ellipsoid": []}
    every = creature.bodies_of(tree.names)
    for i, body in enumerate(every):
        for part in body.shape.floor_parts():
            centre = tree.com[:, i]
            place = centre if part.centre is None else centre + part.centre
            found[part.kind].append((i, place, part.size))
    boxes, meshes, balls, ellipsoids = found.values()
    corners = [i for i, *_ in boxes for _ in range(CORNERS)]
    of_meshes = [i for i, *_ in meshes for _ in range(CORNERS)]
    bodies = corners + of_meshes + [i for i, *_ in balls + ellipsoids]
    solids = None
    if ground.obstacles:
        solids = _make_solids(creature, tree, ground.obstacles)
        bodies += [*of_meshes, *solids.bodies]
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
        sizes(balls),
        sizes(ellipsoids).reshape(-1, 3).T,
        solids,
        xp.array([centre for _, centre, _ in boxes + meshes + balls + ellipsoids]).T,
        pairs(ground.restitution_rule, "restitution"),
        pairs(ground.friction_rule, "static_friction"),
        pairs(ground.friction_rule, "dynamic_friction"),
        STIFFNESS * xp.sqrt(tree.mass.sum() * tree.mass[np.array(bodies)]),
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


def _make_solids(creature: Creature, tree: Tree, obstacles: tuple[Obstacle, ...]) -> Solids:
    own: dict[str, list] = {"box": [], "line": [], "ball": [], "ellipsoid": []}
    for i, body in enumerate(creature.bodies_of(tree.names)):
        for part in body.shape.obstacle_parts():
            own[part.kind].append((i, part))

    def parts(found: list[tuple[int, ObstaclePart]]) -> Parts:
        bodies = tuple(body for body, _ in found)
        centre = xp.array([part.centre for _, part in found], float).reshape(-1, 3).T
        turned = any(part.axes is not None for _, part in found)
        axes = [np.eye(3) if part.axes is None else part.axes for _, part in found]
        return Parts(
            bodies,
            tree.com[:, np.array(bodies, int)] + centre,
            np.stack(axes, -1) if turned else None,
            xp.array([part.half_extents for _, part in found], float).reshape(-1, 3).T,
            xp.array([part.radius for _, part in found], float),
        )

    blocks, boulders = (
        min(NEAREST, sum(isinstance(x, kind) for x in obstacles)) for kind in (Block, Boulder)
    )
    of_box, of_line, of_ball, of_ellipsoid = (
        min(most, blocks * each + boulders) for most, each in zip(_POINTS, _ON_BLOCK, strict=True)
    )
    points = of_box, of_line, of_ball, of_ellipsoid
    boxes, lines, balls, ellipsoids = map(parts, own.values())
    outlines = [part.corners for _, part in own["ellipsoid"]]
    if any(outline is not None for outline in outlines):
        none = np.zeros((1, 3))
        corners = _equally_many([none if outline is None else outline for outline in outlines])
        ellipsoids = ellipsoids._replace(corners=corners)
    return Solids(boxes, lines, balls, ellipsoids, points)


def _equally_many(corners: list[np.ndarray]) -> np.ndarray:
    """Corners ``(k, 3)`` of several meshes as one array ``(3, most, meshes)``."""
    if not corners:
        return np.zeros((3, 0, 0))
    most = max(map(len, corners))
    padded = [np.concatenate([c, np.repeat(c[-1:], most - len(c), 0)]) for c in corners]
    return np.array(padded).reshape(-1, most, 3).T
