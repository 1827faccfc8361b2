"""Contact with the ground: it holds, lets slide and throws back.

Each point of a body that may touch the ground obeys, with its velocity v *after* the forces have
acted (the mean over the step, so that h v is the point's way),

    f_n = max(0, c (v* - v_n)),      v* = max(v_gap, v_bounce),
    f_t = -c v_t                     while |f_t| <= mu_s f_n         (it sticks)
    f_t = -mu(|v_t|) f_n v_t/|v_t|   else                            (it slides)

with c so stiff that v_n = v* but for a per cent. ``v_gap = -gap / h`` lets a point that is still
above the ground come just down to it, so nothing falls through and nothing hovers; below the ground
it is a slow way out. ``v_bounce`` is the restitution times the speed of approach, where the point
would hit within the step. Friction falls from static to dynamic with the sliding speed (Stribeck),
``mu = mu_d + (mu_s - mu_d) / (1 + (v / v_s)^2)``.

Differs from a spring and damper under each point, of which a step of 1/240 s cannot return more
than 0.68 of the speed: here the step is told the velocity at its end.

The laws have kinks; `evo_cpg.physics.passes` finds the motion that obeys them, with lines in their
place (a `ContactLaw` holds their slopes). What is imposed in the end has ``f_n >= 0`` and
``|f_t| <= mu_s f_n``: no contact ever pulls and no friction leaves its cone, converged or not. The
contact of an edge or a face is that of its corners. Bodies of one creature do not touch each other,
nor do creatures.

Vectors of the laws are in the ground's own frame: two tangents, then the normal.
"""

import functools
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
from evo_cpg.fusion.kernels import symmetric, together, unfused
from evo_cpg.physics.articulated import Accelerations, Inertia, Wrench, add_to_bodies
from evo_cpg.physics.kinematics import Kinematics, take
from evo_cpg.physics.terrain import Part, Plane, nearest
from evo_cpg.spatial.linear import (
    cross,
    dot,
    lift,
    matmul,
    matmul_t,
    matvec,
    matvec_t,
    skew,
    transpose,
)

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

# Share of a penetration that is undone in a step, and the fastest way out (m/s).
_PUSH_SHARE, _PUSH_SPEED = 0.2, 0.5

# Below the first speed of approach (m/s) nothing bounces, above twice that everything does.
_BOUNCE_SPEED = 0.1

# v* of a point that is not to be held, m/s; infinity would spoil gradients.
_OUT_OF_REACH = -1e4

# 1 + z of a normal below which the ground is a ceiling, whose tangents are not exact.
_CEILING = 1e-2

# Squared speed (m^2/s^2) and force (N^2) added under roots so that they have gradients at rest.
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

    restitution: float = 0.5
    static_friction: float = 0.8
    dynamic_friction: float = 0.8
    restitution_rule: Combination = eqx.field(static=True, default="multiply")
    friction_rule: Combination = eqx.field(static=True, default="geometric")
    floor: Part = Plane()
    obstacles: tuple[Part, ...] = ()
    margin: float = 0.05
    stribeck_speed: float = 0.01

    @property
    def layers(self) -> tuple[tuple[Part, ...], ...]:
        """What a point can touch at the same time: the floor, and an obstacle."""
        return ((self.floor,), self.obstacles) if self.obstacles else ((self.floor,),)

    @property
    def level(self) -> float | None:
        """Height of ground that is flat and level, m; None for any other."""
        floor = self.floor
        if isinstance(floor, Plane) and floor.normal == (0.0, 0.0, 1.0) and not self.obstacles:
            return float(floor.height)
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


class Contacts(NamedTuple):
    """Where the places touch, or would, and what holds throughout one step.

    Velocities are those of the lowest points, in the ground's frame, in m/s.

    Attributes:
        arm: from the body's origin to the lowest point, world axes, m.
        coasting: their mean over the step, if the recursion's accelerations were zero.
        wanted: v*; far below any velocity where the point is out of reach.
        push: the part of it that lifts a point out of the ground.
        frame: rows are two tangents and the normal of the ground at every place.
    """

    arm: Float[Array, "3 p *n"]
    coasting: Float[Array, "3 p *n"]
    wanted: Float[Array, "p *n"]
    push: Float[Array, "p *n"]
    frame: Float[Array, "3 3 p *n"]


class ContactLaw(NamedTuple):
    """Lines in the place of the laws: ``f_t = -s_t v_t`` and ``f_n = s_n (v* - v_n)``.

    Attributes:
        tangential: s_t, N s/m.
        normal: s_n, N s/m; 0 where the point does not touch.
    """

    tangential: Float[Array, "p *n"]
    normal: Float[Array, "p *n"]


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
            end = np.array([shape.length / 2, 0, 0])
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

    def pairs(rule: Combination, name: str) -> np.ndarray:
        theirs = getattr(ground, name)
        return np.array([combine(rule, getattr(own, name), theirs) for own in materials])

    def sizes(parts: list) -> np.ndarray:
        return np.array([size for *_, size in parts], float)

    return Footing(
        ground,
        tuple(bodies),
        sizes(boxes).reshape(-1, 3).T,
        _equally_many([corners for *_, corners in meshes]),
        sizes(balls),
        sizes(ellipsoids).reshape(-1, 3).T,
        np.array([centre for _, centre, _ in boxes + meshes + balls + ellipsoids]).T,
        pairs(ground.restitution_rule, "restitution"),
        pairs(ground.friction_rule, "static_friction"),
        pairs(ground.friction_rule, "dynamic_friction"),
        _STIFFNESS * np.sqrt(tree.mass.sum() * tree.mass[bodies]),
    )


def combine(rule: Combination, first: float, second: float) -> float:
    """One value for a pair of materials."""
    return {
        "multiply": first * second,
        "average": (first + second) / 2,
        "geometric": float(np.sqrt(first * second)),
        "min": min(first, second),
        "max": max(first, second),
    }[rule]


def find_contacts(footing: Footing, kin: Kinematics, h: float) -> Contacts:
    """The lowest point of every place, and the normal velocity that it should come to.

    Args:
        footing: the places.
        kin: kinematics of the creature at the start of the step.
        h: s.
    """
    bodies = np.array(footing.bodies)
    ground = footing.ground
    arm, spoke, gap, normal = _lowest_points(footing, kin)
    frame = _frame(normal)
    angular, linear = take(kin.angular, bodies), take(kin.linear, bodies)
    velocity = linear + cross(angular, arm)
    # A ball's lowest point keeps below its centre: only the centre's way round is centripetal.
    turning = cross(angular, linear + cross(angular, spoke))
    drift = take(kin.bias_linear, bodies) + cross(take(kin.bias_angular, bodies), arm) + turning

    velocity, coasting = (matvec(frame, v) for v in (velocity, velocity + 0.5 * h * drift))
    approach = -velocity[2]
    push = jnp.clip(-_PUSH_SHARE / h * gap, 0.0, _PUSH_SPEED)
    share = jnp.clip(approach / _BOUNCE_SPEED - 1.0, 0.0, 1.0)
    bounce = lift(footing.restitution, approach) * share * approach
    rest = jnp.where(gap > 0, -gap / h, push)
    bounces = (gap <= h * approach) & (bounce > 0)
    wanted = jnp.where(bounces, jnp.maximum(rest, bounce), rest)
    wanted = jnp.where(gap < ground.margin, wanted, _OUT_OF_REACH)
    return Contacts(arm, coasting, wanted, push, frame)


def clearance(footing: Footing, kin: Kinematics) -> Float[Array, "p *n"]:
    """Distance of every place from the ground, m; negative inside of it."""
    return _lowest_points(footing, kin)[2]


def first_law(gravity: float, footing: Footing, contacts: Contacts, h: float) -> ContactLaw:
    """A guess: what lies on the ground stays and sticks there, what slides has no friction yet."""
    v = contacts.coasting
    stiffness = lift(footing.stiffness / h, v[2])
    # What gravity adds in a step decides for those that rest.
    fall = 2 * h * gravity
    touches = contacts.wanted > v[2] - fall
    sticks = touches & (v[0] * v[0] + v[1] * v[1] < fall * fall)
    return ContactLaw(jnp.where(sticks, stiffness, 0.0), jnp.where(touches, stiffness, 0.0))


def next_law(
    footing: Footing,
    contacts: Contacts,
    law: ContactLaw,
    velocity: Float[Array, "3 p *n"],
    h: float,
) -> ContactLaw:
    """Lines that meet the laws at the velocity found with the last ones.

    Tangents for the normal forces, secants for friction, under the normal forces found.
    """
    stiffness = lift(footing.stiffness / h, law.normal)
    short = contacts.wanted - velocity[2]
    speed = _length(velocity)
    static, dynamic = (
        lift(mu, speed) for mu in (footing.static_friction, footing.dynamic_friction)
    )
    ratio = speed / footing.ground.stribeck_speed
    friction = dynamic + (static - dynamic) / (1.0 + ratio * ratio)
    limit = jnp.where(law.normal > 0, friction * law.normal * jnp.maximum(short, 0.0), 0.0)
    return ContactLaw(jnp.minimum(stiffness, limit / speed), jnp.where(short > 0, stiffness, 0.0))


def line_force(
    contacts: Contacts, law: ContactLaw, velocity: Float[Array, "3 p *n"]
) -> Float[Array, "3 p *n"]:
    """What the lines give at some velocity, N."""
    touches = law.normal > 0
    support = jnp.where(touches, law.normal * (contacts.wanted - velocity[2]), 0.0)
    return jnp.stack([-law.tangential * velocity[0], -law.tangential * velocity[1], support])


def imposed_force(
    footing: Footing, contacts: Contacts, law: ContactLaw, velocity: Float[Array, "3 p *n"]
) -> Float[Array, "3 p *n"]:
    """The forces found last, cut back to what the ground can give, N."""
    force = line_force(contacts, law, velocity)
    support = jnp.maximum(force[2], 0.0)
    limit = lift(footing.static_friction, support) * support
    share = jnp.minimum(limit / _length(force), 1.0)
    return jnp.stack([share * force[0], share * force[1], support])


def work_share(
    contacts: Contacts,
    force: Float[Array, "3 p *n"],
    velocity: Float[Array, "3 p *n"],
    without: Float[Array, "3 p *n"],
) -> Float[Array, "*n"]:
    """Share of imposed forces with which the ground does no work on the creature.

    Ground that rests cannot. Contact forces F that change the points' velocities at the end of the
    step from v_0 to v_1 add ``h F . (v_0 + v_1) / 2`` to the kinetic energy. Lifting points out of
    the ground is allowed for.

    Args:
        contacts: of this step.
        force: imposed on the points, N.
        velocity: of the points at the end of the step under them.
        without: the same without contact forces.
    """
    lost = 2.0 * (force[2] * contacts.push - (force * without).sum(0)).sum(0)
    growth = (force * (velocity - without)).sum((0, 1))
    return jnp.clip(lost / jnp.maximum(growth, _FLOOR), 0.0, 1.0)


def contact_equations(
    footing: Footing, contacts: Contacts, law: ContactLaw, inertia: Inertia, bias: Wrench, h: float
) -> tuple[Inertia, Wrench]:
    """The equations of the bodies with the contacts' lines in them."""
    turn = transpose(contacts.frame)
    diagonal = jnp.stack([law.tangential, law.tangential, law.normal])
    slope = symmetric(h * matmul_t(turn * diagonal[None], turn))
    shift = skew(contacts.arm)
    mixed = matmul(shift, slope)
    blocks = symmetric(matmul_t(mixed, shift)), mixed, slope
    loaded = pressed(footing, contacts, line_force(contacts, law, contacts.coasting), bias)
    totals = [[jnp.take(whole, i, 2) for i in range(whole.shape[2])] for whole in inertia]
    for total, block in zip(totals, blocks, strict=True):
        add_to_bodies(total, footing.bodies, block, 2)
    stiffened, loaded = together((Inertia(*(jnp.stack(total, 2) for total in totals)), loaded))
    return stiffened, loaded


def pressed(
    footing: Footing, contacts: Contacts, force: Float[Array, "3 p *n"], bias: Wrench
) -> Wrench:
    """The bodies' bias wrenches with given contact forces (N, ground's frame)."""
    force = matvec_t(contacts.frame, force)
    parts = cross(contacts.arm, force), force
    wrench = []
    for whole, part in zip(bias, parts, strict=True):
        totals = [whole[:, i] for i in range(whole.shape[1])]
        add_to_bodies(totals, footing.bodies, -part, 1)
        wrench.append(jnp.stack(totals, 1))
    return Wrench(*wrench)


def end_velocity(
    footing: Footing, contacts: Contacts, found: Accelerations, h: float
) -> Float[Array, "3 p *n"]:
    """Velocity of every place at the end of the step, ground's frame, m/s."""
    bodies = np.array(footing.bodies)
    change = take(found.linear, bodies) + cross(take(found.angular, bodies), contacts.arm)
    return contacts.coasting + h * matvec(contacts.frame, change)


def _frame(normal: Float[Array, "3 p *n"]) -> Float[Array, "3 3 p *n"]:
    """Rows: two tangents and the normal of the ground; the world's axes where it is level."""
    # The rotation that takes z to the normal the short way, transposed; not for a ceiling.
    x, y, z = normal
    k = 1.0 / jnp.maximum(1.0 + z, _CEILING)
    return jnp.stack(
        [
            jnp.stack([1 - k * x * x, -k * x * y, -x]),
            jnp.stack([-k * x * y, 1 - k * y * y, -y]),
            normal,
        ]
    )


def _lowest_points(
    footing: Footing, kin: Kinematics
) -> tuple[
    Float[Array, "3 p *n"], Float[Array, "3 p *n"], Float[Array, "p *n"], Float[Array, "3 p *n"]
]:
    """The point of each place that is lowest as the ground lies below its centre.

    Returns:
        From the body's origin to the point and to the place's centre, world axes; the point's
        distance from the ground; the ground's normal.
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
    centre = matvec(rotation, lift(footing.centre, rotation[0]))
    found = []
    for parts in footing.ground.layers:
        above, up = _surface(parts, origin + centre)
        if boxes:
            own = slice(boxes)
            arm = _lowest_corners(up[:, own], footing.boxes, rotation[:, :, own], centre[:, own])
            corner = jnp.repeat(origin[:, own], _CORNERS, 1) + arm
            found.append((arm, arm, *_surface(parts, corner)))
        if meshes:
            own = slice(boxes, angular)
            turned = rotation[:, :, own]
            inward = matvec_t(turned, up[:, own])
            lowest = unfused(functools.partial(_lowest_of_meshes, footing.meshes), inward)
            arm = jnp.repeat(centre[:, own], _CORNERS, 1) + matvec(
                jnp.repeat(turned, _CORNERS, 2), lowest
            )
            corner = jnp.repeat(origin[:, own], _CORNERS, 1) + arm
            found.append((arm, arm, *_surface(parts, corner)))
        if balls:
            own = slice(angular, angular + balls)
            radii = lift(footing.radii, above)
            arm = centre[:, own] - radii[None] * up[:, own]
            found.append((arm, centre[:, own], above[own] - radii, up[:, own]))
        if ellipsoids:
            own = slice(angular + balls, None)
            turned, radii = rotation[:, :, own], lift(footing.semi_axes, centre)
            stretched = radii * matvec_t(turned, up[:, own])
            length = jnp.sqrt(dot(stretched, stretched))
            arm = centre[:, own] - matvec(turned, radii * stretched / length[None])
            found.append((arm, centre[:, own], *_surface(parts, origin[:, own] + arm)))
    arm, spoke, gap, normal = zip(*found, strict=True)
    return (
        jnp.concatenate(arm, 1),
        jnp.concatenate(spoke, 1),
        jnp.concatenate(gap),
        jnp.concatenate(normal, 1),
    )


def _surface(parts: tuple[Part, ...], point: Float[Array, "3 p *n"]) -> tuple[Array, Array]:
    """Distance of points from the nearest part and its normal there."""
    gap, normal = nearest(parts, point)
    return gap, jnp.broadcast_to(normal, point.shape)


def _lowest_corners(
    up: Array, half_edges: np.ndarray, rotation: Float[Array, "3 3 b *n"], centre: Array
) -> Float[Array, "3 c *n"]:
    """Corners, box by box, of the face on the end of the half edge that reaches down most."""
    edges = rotation * lift(half_edges[None], rotation)
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
    corners = lift(meshes, up, up.ndim + 1)
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


def _length(vector: Float[Array, "3 p *n"]) -> Float[Array, "p *n"]:
    """Of the tangential part."""
    return jnp.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + _FLOOR)
