"""Sensor of a body's velocity in its own axes, like a lateral line or an ear."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import matvec_t
from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.simulation.sensor import Sensor
from evo_cpg.simulation.snapshot import Forces, Snapshot


class VelocitySensor(Sensor):
    """Velocity of the centre of a body's shape in the world, along the body's own x, y and z axes.

    Attributes:
        body: name of the body that carries the sensor.
        full_scale: velocity at which the reading is 1, m/s. Readings are clipped to -1 and 1.
        count: 3.
    """

    body: str = eqx.field(static=True)
    full_scale: Number = 1.0
    count: int = eqx.field(static=True, default=3, init=False)

    def sense(self, snapshot: Snapshot, forces: Forces) -> Float[Array, "3 *n"]:
        """See `Sensor.sense`."""
        del forces
        i = snapshot.body(self.body)
        own = matvec_t(snapshot.rotation[:, :, i], snapshot.velocity[:, i])
        return jnp.clip(own / self.full_scale, -1.0, 1.0)
