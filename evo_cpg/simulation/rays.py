"""Sense of distance along rays, as of whiskers, echoes or a range finder.

A ray ends where it first meets the ground or an obstacle. It is followed from part to part of the
ground: a part that is convex lies behind the plane through its nearest point, so a step to this
plane never passes it (Newton's method). The step towards other parts is their distance (Hart 1996,
"Sphere tracing").
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import array_of, dot, expand_dims_like, matvec
from evo_cpg.creature.algebra.numerics import Number, Triple, xp
from evo_cpg.physics.contact.terrain import GroundPart
from evo_cpg.simulation.sensors import Sensor
from evo_cpg.simulation.snapshot import Forces, Snapshot

# Steps along a ray. Newton's method needs about five, and rays that graze the ground need more.
_STEPS = 16
# Cosine below which a ray does not approach a plane.
_ALONG = 1e-6


class RaySensor(Sensor):
    """Nearness of the ground along rays: 1 at contact, 0 if nothing is within the range.

    The rays are in the plane of the body's ``axis`` and y axis, evenly spread about ``axis``.

    Attributes:
        body: name of the body that carries the sensor.
        position: start of the rays from the centre of the body's shape, along its own axes, m.
        axis: direction of the middle of the rays in the body's own axes, not along y.
        count: number of rays, 1 to 16.
        spread_deg: angle between the first and the last ray, degrees. The first is on the side
            of -y.
        range: longest distance that the rays reach, m.
    """

    body: str = eqx.field(static=True)
    position: Triple = (0.0, 0.0, 0.0)
    axis: Triple = (1.0, 0.0, 0.0)
    count: int = eqx.field(static=True, default=5)
    spread_deg: Number = 120.0
    range: Number = 1.0

    @property
    def directions(self) -> Float[Any, "3 rays"]:
        """Unit vectors of the rays in the frame of the body."""
        ahead = array_of(self.axis)
        ahead = ahead / xp.linalg.norm(ahead)
        aside = xp.array([0.0, 1.0, 0.0]) - ahead[1] * ahead
        aside = aside / xp.linalg.norm(aside)
        half = xp.deg2rad(self.spread_deg) / 2 if self.count > 1 else 0.0
        angles = half * np.linspace(-1.0, 1.0, self.count)
        return ahead[:, None] * xp.cos(angles) + aside[:, None] * xp.sin(angles)

    def sense(self, snapshot: Snapshot, forces: Forces) -> Float[Array, "rays *n"]:
        """See `Sensor.sense`."""
        del forces
        i, ground = snapshot.body(self.body), snapshot.world.ground
        rotation = snapshot.rotation[:, :, i : i + 1]
        heading = matvec(rotation, expand_dims_like(self.directions, snapshot.position))
        if ground is None:
            return jnp.zeros_like(heading[0])
        lever = matvec(rotation, expand_dims_like(array_of(self.position)[:, None], heading))
        start = snapshot.position[:, i : i + 1] + lever
        distance = along_rays((ground.floor, *ground.obstacles), start, heading, self.range)
        return jnp.clip(1.0 - distance / self.range, 0.0, 1.0)


def along_rays(
    parts: tuple[GroundPart, ...],
    start: Float[Array, "3 #r *n"],
    heading: Float[Array, "3 r *n"],
    most: Number,
) -> Float[Array, "r *n"]:
    """Return the distance along each ray to the first solid part, at most about ``most``, m.

    Args:
        parts: parts of the ground.
        start: where the rays start.
        heading: unit vectors of the rays.
        most: distance beyond which a ray ends.
    """

    def advance(_: int, travelled: Array) -> Array:
        place = start + travelled[None] * heading
        steps = []
        for part in parts:
            gap, normal = part.distance(place)
            approach = -dot(jnp.broadcast_to(normal, place.shape), heading)
            if part.convex:
                away = approach < _ALONG
                gap = jnp.where(away, most, gap) / jnp.where(away, 1.0, approach)
            steps.append(gap)
        nearest = jnp.stack(steps).min(0)
        return jnp.minimum(travelled + jnp.maximum(nearest, 0.0), most)

    return jax.lax.fori_loop(0, _STEPS, advance, jnp.zeros_like(heading[0]))
