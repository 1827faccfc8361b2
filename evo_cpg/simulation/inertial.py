"""Senses of acceleration and rotation, as of the inner ear or of an inertial measurement unit."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import matvec_t
from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.simulation.sensors import Sensor
from evo_cpg.simulation.snapshot import Forces, Snapshot


class AccelerationSensor(Sensor):
    """Acceleration of a body's centre minus gravity, along the body's own x, y and z axes.

    So it reads +9.81 m/s^2 upward at rest, and 0 in free fall. It is the mean over the last control
    step, and the acceleration is 0 before the first one.

    Attributes:
        body: name of the body that carries the sensor.
        full_scale: acceleration at which the reading is 1, m/s^2. Readings are clipped to -1 and 1.
        count: 3.
    """

    body: str = eqx.field(static=True)
    full_scale: Number = 20.0
    count: int = eqx.field(static=True, default=3, init=False)

    uses_acceleration = True

    def sense(self, snapshot: Snapshot, forces: Forces) -> Float[Array, "3 *n"]:
        """See `Sensor.sense`."""
        i = snapshot.body(self.body)
        assert forces.acceleration is not None
        felt = forces.acceleration[:, i].at[2].add(snapshot.world.gravity)
        own = matvec_t(snapshot.rotation[:, :, i], felt)
        return jnp.clip(own / self.full_scale, -1.0, 1.0)


class RotationSensor(Sensor):
    """Angular velocity of a body, along its own x, y and z axes.

    Attributes:
        body: name of the body that carries the sensor.
        full_scale: angular velocity at which the reading is 1, rad/s. Readings are clipped to -1
            and 1.
        count: 3.
    """

    body: str = eqx.field(static=True)
    full_scale: Number = 10.0
    count: int = eqx.field(static=True, default=3, init=False)

    def sense(self, snapshot: Snapshot, forces: Forces) -> Float[Array, "3 *n"]:
        """See `Sensor.sense`."""
        del forces
        i = snapshot.body(self.body)
        own = matvec_t(snapshot.rotation[:, :, i], snapshot.angular_velocity[:, i])
        return jnp.clip(own / self.full_scale, -1.0, 1.0)
