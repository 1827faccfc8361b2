"""A sensor that a creature has beside its eyes, pressure sensors and depth gauges.

A kind of sensor is a class; the config names it in ``creature.sensors``, by the name of a kind that
comes along or as ``my_module:MySensor``. What it reads goes into `Observation.custom`.
"""

import abc

import equinox as eqx
from jaxtyping import Array, Float

from evo_cpg.simulation.snapshot import Forces, Snapshot


class Sensor(eqx.Module):
    """Numbers that the animal senses at the beginning of every control step.

    Subclass it to write one of your own: say how many numbers it gives, and how they come from the
    animal. It is built with the keyword arguments in the config's ``options`` and, where its
    constructor takes them, ``tree`` and ``control_step`` (s). A neural network likes numbers from
    -1 to 1.

    Attributes:
        count: numbers that it gives.

    Example:
        How fast the animal rises::

            class Variometer(Sensor):
                count: int = eqx.field(static=True, default=1)
                full_scale: float = 1.0

                def sense(self, snapshot, forces):
                    return snapshot.state.velocity[5:6] / self.full_scale
    """

    count: eqx.AbstractVar[int]

    @abc.abstractmethod
    def sense(self, snapshot: Snapshot, forces: Forces) -> Float[Array, "count *n"]:
        """The readings.

        Must be a pure JAX function of arrays whose trailing axes are individuals.

        Args:
            snapshot: the animal as it is.
            forces: of motors and ground in the control step before; none at the start.
        """
