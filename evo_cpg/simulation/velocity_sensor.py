"""How fast a body moves through the world, in its own axes: what a lateral line or an ear feels."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.simulation.sensor import Sensor
from evo_cpg.simulation.snapshot import Forces, Snapshot
from evo_cpg.spatial.linear import matvec_t
from evo_cpg.spatial.numerics import Number


class VelocitySensor(Sensor):
    """Velocity of a body's centre of mass along its own x, y and z.

    Attributes:
        body: that carries it.
        full_scale: velocity at which it reads 1, m/s; beyond it stays there.
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
