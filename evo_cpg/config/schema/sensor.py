"""Sensors beside eyes, pressure sensors and depth gauges."""

from typing import Annotated, ClassVar, Literal

from pydantic import Tag

from evo_cpg.config.schema.choice import CustomConfig, by_type
from evo_cpg.config.schema.section import Positive, Section
from evo_cpg.simulation.sensor import Sensor
from evo_cpg.simulation.velocity_sensor import VelocitySensor


class VelocitySensorConfig(Section):
    """Velocity of a body along its own axes.

    Attributes:
        type: ``velocity``.
        body: that carries it.
        full_scale: velocity at which it reads 1, m/s.
    """

    type: Literal["velocity"] = "velocity"
    body: str
    full_scale: Positive = 1.0

    # Keys whose values are names of bodies.
    body_keys: ClassVar[tuple[str, ...]] = ("body",)

    def build(self) -> Sensor:
        """Build the sensor."""
        return VelocitySensor(self.body, self.full_scale)


SensorConfig = Annotated[
    Annotated[VelocitySensorConfig, Tag("velocity")] | Annotated[CustomConfig, Tag("custom")],
    by_type(None),
]
