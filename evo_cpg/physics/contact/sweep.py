"""Time at which a fast part meets the ground within a step.

The contact law approximates the ground near a point by a plane, and ignores ground beyond the
margin. A part that moves farther in a step may end up on the other side of an obstacle. Its plane
is therefore taken where the part first meets the ground.

- Blocks, boulders and parts are convex. A gap along any direction is a lower bound: a part and an
  obstacle cannot meet before the part has moved that far. Conservative advancement (Mirtich 1996)
  repeats this move until contact, however thin the obstacle is. A plane always separates both, so
  few rounds are enough.
- The surface of a floor with slopes is sampled along the path of a point. Bisection then narrows
  the first interval in which the point gets deeper into the floor.

Parts move at their velocities at the start of the step. Slow parts take no round and stay in place.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import cross, dot, matvec, matvec_t
from evo_cpg.creature.algebra.numerics import is_traced
from evo_cpg.native.fuse import while_each
from evo_cpg.physics.contact.separation import RoundedBoxes, within
from evo_cpg.physics.contact.terrain import GroundPart, nearest

# A part is fast if it moves farther in a step than this fraction of the margin, or of `_SIZES`
# times its own size. The rest of the margin is for parts that speed up within the step.
_FAST, _SIZES = 0.8, 4.0

# Gap that counts as contact, as a fraction of the displacement that makes a part fast.
_CLOSE = 0.02

# Largest number of rounds of conservative advancement.
_ROUNDS = 12

# Samples on the path of a point, and halvings of the interval of the first crossing.
_SAMPLES, _HALVINGS = 16, 6

# Squared length (m^2) or speed (m^2/s^2) added under roots, and least divisor.
_FLOOR = 1e-30


class Moving(NamedTuple):
    """Pose and velocity of parts of a creature.

    Attributes:
        at: the parts as rounded boxes. The half extents of an ellipsoid are its semi-axes.
        origin: origins of their bodies, m.
        linear: velocity of the origin, m/s.
        angular: angular velocity, rad/s.
    """

    at: RoundedBoxes
    origin: Float[Array, "3 p *n"]
    linear: Float[Array, "3 p *n"]
    angular: Float[Array, "3 p *n"]


class PartShapes(NamedTuple):
    """Whether parts are ellipsoids, and the meshes around these. Other parts are rounded boxes.

    Attributes:
        ellipsoids: whether the parts are ellipsoids.
        corners: corners of meshes around the ellipsoids, along their axes, m. Ellipsoids without a
            mesh have zeros. None if there is no mesh.
    """

    ellipsoids: bool
    corners: Float[Array, "3 c p *#n"] | None


def fast_from(
    margin: Float[Array, ""] | float, size: Float[Array, "p *#n"]
) -> Float[Array, "p *#n"]:
    """Return the displacement in a step from which a part is fast, m."""
    return _FAST * jnp.minimum(margin, _SIZES * size)


def moved(parts: Moving, time: Float[Array, "p *n"]) -> Moving:
    """Return the parts after a time (s) at constant velocities.

    The rotation is Cayley's, which keeps axes at right angles. It is 2 % too small at 0.5 rad.
    """
    at, w, half = parts.at, parts.angular, 0.5 * time
    once = 2.0 * half / (1.0 + half * half * dot(w, w))
    twice = half * once
    turns = []
    for x in (*(at.axes[:, k] for k in range(3)), at.centre - parts.origin):
        # The change of a vector by the rotation. Vector products do not depend on time.
        across = cross(w, x)
        turns.append(once[None] * across + twice[None] * cross(w, across))
    displacement = time[None] * parts.linear
    axes = jnp.stack([at.axes[:, k] + turns[k] for k in range(3)], 1)
    centre = at.centre + (displacement + turns[3])
    return parts._replace(
        at=at._replace(centre=centre, axes=axes), origin=parts.origin + displacement
    )


def times_of_contact(
    parts: Moving,
    outline: PartShapes,
    obstacles: RoundedBoxes,
    margin: Float[Array, ""] | float,
    h: float,
) -> tuple[Float[Array, "k p *n"], Float[Array, "k p *n"]]:
    """Return when each part's plane with each obstacle is taken in a step, s, and the distance.

    The time of slow parts is 0. The second result is the distance (m) that a fast part moves until
    it touches the obstacle.

    The obstacles, on the first axes of the arrays, are blocks without radius and boulders without
    extent.
    """
    parts, outline, obstacles = _held((parts, outline, obstacles))
    # Distance from a part's centre to its farthest point, without its radius.
    half = parts.at.half_extents
    size = half.max(0) if outline.ellipsoids else _length(half)
    if outline.ellipsoids and outline.corners is not None:
        size = jnp.maximum(size, jnp.sqrt(dot(outline.corners, outline.corners)).max(0))
    least = fast_from(margin, size + parts.at.radius)
    # The offset of a ball at its body's origin is 0, so turning does not make it fast.
    offset = parts.at.centre - parts.origin
    speed = _length(parts.linear + cross(parts.angular, offset)) + size * _length(parts.angular)
    none = jnp.zeros((len(obstacles.radius), *speed.shape), speed.dtype)
    going = none + (h * speed > least).astype(speed.dtype)[None]

    def beside(_: None, given: tuple) -> tuple[None, tuple]:
        obstacle, time, going, last = given
        now = moved(parts, time)
        normal, gap = _apart_along(now.at, outline, obstacle)
        velocity = now.linear + cross(now.angular, now.at.centre - now.origin)
        spin = size * _length(cross(now.angular, normal))
        closing = spin - dot(normal, velocity)
        ahead = jnp.where(closing > 0, gap / jnp.maximum(closing, _FLOOR), 0.0)
        meets = (gap <= _CLOSE * least) | (closing <= 0)
        later = jnp.minimum(time + ahead, h)
        goes_on = (going > 0) & ~meets
        last = jnp.where(going > 0, gap, last)
        time = jnp.where(goes_on, later, time)
        return None, (time, (goes_on & (time < h)).astype(time.dtype), last)

    def closer(given: tuple) -> tuple:
        *found, count = given
        _, found = jax.lax.scan(beside, None, (obstacles, *found))
        return *found, count + 1

    start = none, going, none, jnp.zeros(none.shape[2:], jnp.int32)
    time, _, gap, _ = while_each(
        lambda given: (given[1] > 0).any((0, 1)) & (given[-1] < _ROUNDS), closer, start
    )
    return time, gap + time * speed[None]


def time_of_crossing(
    floor: tuple[GroundPart, ...],
    points: Float[Array, "3 p *n"],
    velocity: Float[Array, "3 p *n"],
    radius: Float[Array, "p *#n"] | float,
    least: Float[Array, "p *#n"],
    h: float,
    beyond: Float[Array, "p *#n"] | float = 0.0,
) -> Float[Array, "p *n"]:
    """Return the time at which points on straight paths get deeper into a floor, s, or 0.

    Points have radii (m) and are fast from the displacement ``least`` (m) in a step on. The path is
    sampled ``beyond`` (m) the step.
    """
    floor, points, velocity, radius, least = _held((floor, points, velocity, radius, least))

    speed = _length(velocity)
    fast, end = h * speed > least, h + beyond / speed
    none = jnp.zeros_like(points[0])

    def closer(given: tuple) -> tuple:
        low, high, deepest, count = given
        found = high > 0
        time = jnp.where(found, 0.5 * (low + high), low + end / _SAMPLES)
        here = nearest(floor, points + time[None] * velocity)[0] - radius
        # The first round stores the initial depth of each point.
        depth = jnp.minimum(nearest(floor, points + none[None] * velocity)[0] - radius, 0.0)
        deepest = jnp.where(count == 0, depth - _CLOSE * least, deepest)
        meets = (here < deepest) & (time < (1 + 0.5 / _SAMPLES) * end)
        high = jnp.where(meets & fast, time, high)
        return jnp.where(meets, low, time), high, deepest, count + 1

    start = none, none, none, jnp.zeros(none.shape[1:], jnp.int32)
    return while_each(
        lambda given: fast.any(0) & (given[-1] < _SAMPLES + _HALVINGS), closer, start
    )[1]


def _held(values: Any) -> Any:
    """Return values without derivatives, because loops of unknown length have none."""
    return jax.tree.map(lambda x: jax.lax.stop_gradient(x) if is_traced(x) else x, values)


def _apart_along(
    parts: RoundedBoxes, outline: PartShapes, obstacle: RoundedBoxes
) -> tuple[Float[Array, "3 p *n"], Float[Array, "p *n"]]:
    """Return a direction from an obstacle to parts, and the gap along that direction, m.

    The direction has the largest gap of three kinds: the direction between near points, the
    obstacle's axes, and the normal at the near point of an ellipsoid.
    """
    to = obstacle.axes
    first = within(obstacle, parts.centre)
    own = within(parts, first)
    displacement = own - within(obstacle, own)
    away = parts.centre - obstacle.centre
    along = matvec_t(to, away)
    directions = [
        displacement,
        *(jnp.where(along[k] < 0, -1.0, 1.0)[None] * to[:, k] for k in range(3)),
    ]
    if outline.ellipsoids:
        square = parts.half_extents * parts.half_extents
        bent = matvec(parts.axes, matvec_t(parts.axes, first - parts.centre) / square)
        directions.append(-bent)
    best, gap = directions[0], None
    for direction in directions:
        normal = direction / _length(direction)[None]
        theirs = dot(obstacle.half_extents, jnp.abs(matvec_t(to, normal))) + obstacle.radius
        # Extent of the parts from their centres against the direction.
        own = matvec_t(parts.axes, normal)
        if outline.ellipsoids:
            ours = _length(parts.half_extents * own)
        else:
            ours = dot(parts.half_extents, jnp.abs(own)) + parts.radius
        if outline.ellipsoids and outline.corners is not None:
            ours = jnp.maximum(ours, -(outline.corners * own[:, None]).sum(0).min(0))
        here = dot(normal, away) - ours - theirs
        if gap is None:
            best, gap = normal, here
        else:
            best = jnp.where((here > gap)[None], normal, best)
            gap = jnp.maximum(here, gap)
    assert gap is not None
    return best, gap


def _length(vector: Float[Array, "3 *rest"]) -> Float[Array, "*rest"]:
    return jnp.sqrt(dot(vector, vector) + _FLOOR)
