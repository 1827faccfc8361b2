"""The shape of the ground, as signed distances.

Every part returns the signed distance of points and its normal. One contact code
(`evo_cpg.physics.contact.contact`) therefore handles slopes, relief, shores and obstacles. It
evaluates the distance at the centres and the lowest points of bodies.

Distances to planes, spheres and blocks are exact. The distance to a surface z = H(x, y) is of first
order, ``(z - H) / sqrt(1 + |grad H|^2)``. It is exact on the surface. Its error away from the
surface, where nothing touches, is the curvature times the squared distance.
"""

import abc
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import array_of, dot, expand_dims_like
from evo_cpg.creature.algebra.numerics import Number, Triple, xp

# Squared length (m^2) added under roots, so that the roots have gradients at zero.
_FLOOR = 1e-18

Axis = Literal["x", "y"]


class GroundPart(eqx.Module):
    """A solid part of the ground, at rest.

    Attributes:
        convex: whether the part lies behind the plane through the nearest point of any point
            outside (False unless overridden).
    """

    convex = False

    @abc.abstractmethod
    def distance(
        self, point: Float[Array, "3 *rest"]
    ) -> tuple[Float[Array, "*rest"], Float[Array, "3 *#rest"]]:
        """Return the signed distance of points, m, positive outside, and the normal there."""


class Plane(GroundPart):
    """Flat ground, level or sloping.

    Attributes:
        normal: unit vector out of the ground.
        height: height of the plane above the world's origin, along the normal, m.
    """

    normal: Triple = (0.0, 0.0, 1.0)
    height: Number = 0.0

    convex = True

    def distance(self, point: Array) -> tuple[Array, Array]:
        """Return the signed distance and the normal (see `GroundPart.distance`)."""
        normal = array_of(self.normal)
        normal = expand_dims_like(normal / xp.linalg.norm(normal), point)
        return dot(normal, point) - self.height, normal


class Shore(GroundPart):
    """Level ground, a slope, and level ground again: land that runs into water.

    Attributes:
        axis: axis along which the height changes.
        start: start of the slope on that axis, m.
        stop: end of the slope on that axis, m, larger than ``start``.
        start_height: height of the ground before the slope, m.
        stop_height: height of the ground behind the slope, m.
    """

    axis: Axis = eqx.field(static=True, default="x")
    start: Number = 0.0
    stop: Number = 1.0
    start_height: Number = 0.0
    stop_height: Number = -1.0

    def distance(self, point: Array) -> tuple[Array, Array]:
        """Return the signed distance and the normal (see `GroundPart.distance`)."""
        along = point["xy".index(self.axis)]
        slope = (self.stop_height - self.start_height) / (self.stop - self.start)
        inside = jnp.clip(along, self.start, self.stop)
        height = self.start_height + slope * (inside - self.start)
        steepness = jnp.where((along > self.start) & (along < self.stop), slope, 0.0)
        none = jnp.zeros_like(along)
        gradient = (steepness, none) if self.axis == "x" else (none, steepness)
        return _above(point, height, *gradient)


class Relief(GroundPart):
    """Heights on a regular grid, bilinear in between, and constant beyond its edges.

    Attributes:
        heights: heights above the world's origin, m. The first axis is x.
        corner: x and y of the first height, m.
        spacing: spacing of the grid, m.
    """

    heights: Float[np.ndarray, "nx ny"]
    corner: tuple[float, float] = eqx.field(static=True, default=(0.0, 0.0))
    spacing: float = eqx.field(static=True, default=0.1)

    def distance(self, point: Array) -> tuple[Array, Array]:
        """Return the signed distance and the normal (see `GroundPart.distance`)."""
        heights, cells = jnp.asarray(self.heights, point.dtype), []
        for value, first, count in zip(point, self.corner, heights.shape, strict=False):
            steps = (value - first) / self.spacing
            inside = jnp.clip(steps, 0.0, count - 1.0)
            cell = jnp.clip(jnp.floor(inside).astype(jnp.int32), 0, count - 2)
            on_grid = (steps > 0) & (steps < count - 1)
            cells.append((cell, inside - cell, on_grid))
        (i, u, on_x), (j, v, on_y) = cells
        a, b = heights[i, j], heights[i + 1, j]
        c, d = heights[i, j + 1], heights[i + 1, j + 1]
        near, far = a + u * (b - a), c + u * (d - c)
        along_x = jnp.where(on_x, ((1 - v) * (b - a) + v * (d - c)) / self.spacing, 0.0)
        along_y = jnp.where(on_y, (far - near) / self.spacing, 0.0)
        return _above(point, near + v * (far - near), along_x, along_y)


class Boulder(GroundPart):
    """A sphere, above the ground or partly buried.

    Attributes:
        centre: centre of the sphere, m.
        radius: radius of the sphere, m.
    """

    centre: Triple
    radius: Number

    convex = True

    def distance(self, point: Array) -> tuple[Array, Array]:
        """Return the signed distance and the normal (see `GroundPart.distance`)."""
        away = point - expand_dims_like(array_of(self.centre), point)
        length = jnp.sqrt(dot(away, away) + _FLOOR)
        return length - self.radius, away / length[None]


class Block(GroundPart):
    """An upright box: a wall, a step, a pillar.

    Attributes:
        centre: centre of the box, m.
        half_extents: half edges along x, y and z before the rotation, m.
        heading: rotation about z, rad.
    """

    centre: Triple
    half_extents: Triple
    heading: Number = 0.0

    convex = True

    def distance(self, point: Array) -> tuple[Array, Array]:
        """Return the signed distance and the normal (see `GroundPart.distance`)."""
        away = point - expand_dims_like(array_of(self.centre), point)
        c, s = xp.cos(self.heading), xp.sin(self.heading)
        own = jnp.stack([c * away[0] + s * away[1], c * away[1] - s * away[0], away[2]])
        beyond = jnp.abs(own) - expand_dims_like(array_of(self.half_extents), own)
        deepest = beyond.max(0)
        outside = jnp.maximum(beyond, 0.0)
        length = jnp.sqrt(dot(outside, outside) + _FLOOR)
        # A point inside leaves the block through the nearest face.
        face = jnp.where(beyond >= deepest[None], 1.0, 0.0)
        outward = jnp.where((deepest > 0)[None], outside / length[None], face)
        outward = (
            outward / jnp.sqrt(dot(outward, outward) + _FLOOR)[None] * jnp.where(own < 0, -1.0, 1.0)
        )
        normal = jnp.stack(
            [c * outward[0] - s * outward[1], s * outward[0] + c * outward[1], outward[2]]
        )
        return jnp.where(deepest > 0, length, deepest), normal


Obstacle = Block | Boulder


def nearest(
    parts: tuple[GroundPart, ...], point: Float[Array, "3 *rest"]
) -> tuple[Float[Array, "*rest"], Float[Array, "3 *rest"]]:
    """Return the signed distance of points from the nearest part, m, and that part's normal."""
    gap, normal = parts[0].distance(point)
    for part in parts[1:]:
        other, direction = part.distance(point)
        closer = other < gap
        gap = jnp.where(closer, other, gap)
        normal = jnp.where(closer[None], direction, normal)
    return gap, jnp.broadcast_to(normal, point.shape)


def _above(point: Array, height: Array, along_x: Array, along_y: Array) -> tuple[Array, Array]:
    """Return the distance from a surface of given height and derivatives, and its normal."""
    upward = 1.0 / jnp.sqrt(1.0 + along_x * along_x + along_y * along_y)
    normal = jnp.stack([-along_x * upward, -along_y * upward, upward])
    return (point[2] - height) * upward, normal
