"""Sections of sensors: eyes, depth gauges, and other sensors with a ``type``."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, Tag, model_validator

from evo_cpg.io.schema.section import (
    VIEW,
    CustomConfig,
    DescribedSection,
    Positive,
    Section,
    Vector,
    by_type,
)
from evo_cpg.simulation.sensors import VelocitySensor


class LightSensorConfig(Section):
    """A directional eye (Iwadate 2010, eq. 1).

    Attributes:
        body: name of the body that carries it (with placeholders, one on each copy).
        position: position in the frame of the body, m.
        axis: viewing direction in the frame of the body.
        field_of_view_deg: full opening angle, degrees.
    """

    body: str
    position: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (1.0, 0.0, 0.0)
    field_of_view_deg: Annotated[float, Field(gt=0, le=360), VIEW] = 180.0

    # Keys whose values are names of bodies.
    body_keys: ClassVar[tuple[str, ...]] = ("body",)

    @model_validator(mode="after")
    def _check(self) -> "LightSensorConfig":
        if not any(self.axis):
            raise ValueError("axis: must not be the zero vector")
        return self


class DepthSensorConfig(Section):
    """A depth gauge, which reads 0 at the water's surface and above, and 1 at a given depth.

    Attributes:
        body: name of the body that carries it (with placeholders, one on each copy).
        position: position in the frame of the body, m.
        full_scale: depth at which and below which it reads 1, m.
    """

    body: str
    position: Vector = (0.0, 0.0, 0.0)
    full_scale: Positive = 1.0

    body_keys: ClassVar[tuple[str, ...]] = ("body",)


class VelocitySensorConfig(DescribedSection):
    """Velocity of a body along its own axes.

    Attributes:
        type: ``velocity``.
        body: name of the body that carries it.
        full_scale: velocity at which it reads 1, m/s.
    """

    type: Literal["velocity"] = "velocity"
    body: str
    full_scale: Positive = 1.0

    body_keys: ClassVar[tuple[str, ...]] = ("body",)
    described = VelocitySensor


SensorConfig = Annotated[
    Annotated[VelocitySensorConfig, Tag("velocity")] | Annotated[CustomConfig, Tag("custom")],
    by_type(None),
]
