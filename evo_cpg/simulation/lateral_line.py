"""Sense of the flow at the skin, as of a fish's lateral line.

Free neuromasts of a lateral line sense the velocity of the water relative to the skin. Canal
neuromasts sense how it changes along the skin. Both exist here (`FlowSensor.reading`).
"""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import array_of, cross, expand_dims_like, matvec, matvec_t
from evo_cpg.creature.algebra.numerics import Number, Triple, xp
from evo_cpg.simulation.sensors import Sensor
from evo_cpg.simulation.snapshot import Forces, Snapshot


class FlowSensor(Sensor):
    """Velocity of the water relative to a place on a body, along the body's own x, y and z axes.

    The body does not disturb this flow, as in the drag laws. Above the water's surface, and without
    water, readings are 0.

    Attributes:
        body: name of the body that carries the sensor.
        position: place of the sensor from the centre of the body's shape, along its own axes, m.
        reading: ``velocity``, or its ``gradient``: the change of the velocity along ``axis``,
            divided by the distance, from two places half a ``spacing`` before and behind.
        axis: direction of the gradient in the body's own axes.
        spacing: distance of both places, m.
        full_scale: velocity (m/s) or gradient (1/s) at which the reading is 1. Readings are clipped
            to -1 and 1.
        count: 3.
    """

    body: str = eqx.field(static=True)
    position: Triple = (0.0, 0.0, 0.0)
    reading: Literal["velocity", "gradient"] = eqx.field(static=True, default="velocity")
    axis: Triple = (1.0, 0.0, 0.0)
    spacing: Number = 0.05
    full_scale: Number = 1.0
    count: int = eqx.field(static=True, default=3, init=False)

    def sense(self, snapshot: Snapshot, forces: Forces) -> Float[Array, "3 *n"]:
        """See `Sensor.sense`."""
        del forces
        here = array_of(self.position)
        if self.reading == "velocity":
            found = self._flow(snapshot, here[:, None])[:, 0]
        else:
            axis = array_of(self.axis)
            half = 0.5 * self.spacing * axis / xp.linalg.norm(axis)
            behind, before = (here - half)[:, None], (here + half)[:, None]
            both = self._flow(snapshot, xp.concatenate([behind, before], 1))
            found = (both[:, 1] - both[:, 0]) / self.spacing
        return jnp.clip(found / self.full_scale, -1.0, 1.0)

    def _flow(self, snapshot: Snapshot, places: Array | np.ndarray) -> Float[Array, "3 k *n"]:
        """Return the relative velocity of the water at places on the body, in its own axes, m/s."""
        i, water = snapshot.body(self.body), snapshot.world.water
        rotation = snapshot.rotation[:, :, i : i + 1]
        lever = matvec(rotation, expand_dims_like(places, snapshot.position))
        place = snapshot.position[:, i : i + 1] + lever
        if water is None:
            return jnp.zeros_like(place)
        turning = cross(snapshot.angular_velocity[:, i : i + 1], lever)
        skin = snapshot.velocity[:, i : i + 1] + turning
        flow = water.velocity(place) - skin
        if water.surface is not None:
            flow = jnp.where(place[2] < water.surface, flow, 0.0)
        return matvec_t(rotation, flow)
