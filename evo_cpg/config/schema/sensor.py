"""Sensors beside eyes, pressure sensors and depth gauges."""

from typing import Annotated, Literal

from pydantic import Tag

from evo_cpg.config.schema.choice import CustomConfig, by_type
from evo_cpg.config.schema.section import Positive, Section


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


SensorConfig = Annotated[
    Annotated[VelocitySensorConfig, Tag("velocity")] | Annotated[CustomConfig, Tag("custom")],
    by_type(None),
]
