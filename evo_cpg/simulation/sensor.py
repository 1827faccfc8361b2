"""Interface of further sensors, in addition to eyes, pressure sensors and depth gauges.

A kind of sensor is a class. The config names the class in ``creature.sensors``, as a built-in kind
or as ``my_module:MySensor``. Its readings go into `Observation.custom`.
"""

import abc

import equinox as eqx
from jaxtyping import Array, Float

from evo_cpg.simulation.snapshot import Forces, Snapshot


class Sensor(eqx.Module):
    """Readings that the animal senses at the start of every control step.

    Subclass it to write your own sensor: declare the number of readings, and compute them in
    `sense`. The sensor is built with the keyword arguments in the config's ``options``. It also
    gets ``tree`` and ``control_step`` (s) if its constructor takes them. Readings from -1 to 1 suit
    a neural network best.

    Attributes:
        count: number of readings.

    Example:
        Vertical speed of the animal::

            class Variometer(Sensor):
                count: int = eqx.field(static=True, default=1)
                full_scale: float = 1.0

                def sense(self, snapshot, forces):
                    return snapshot.state.linear_velocity[2:] / self.full_scale
    """

    count: eqx.AbstractVar[int]

    @abc.abstractmethod
    def sense(self, snapshot: Snapshot, forces: Forces) -> Float[Array, "count *n"]:
        """Return the readings.

        Must be a pure JAX function of arrays whose trailing axes are individuals.

        Args:
            snapshot: the animal at this instant.
            forces: forces of motors and ground in the last control step, zero at the start.
        """
