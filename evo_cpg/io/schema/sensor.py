"""Sections of sensors: eyes, depth gauges, and other sensors with a ``type``."""

import functools
from typing import Annotated, ClassVar

from pydantic import AfterValidator, Field, Tag, model_validator

from evo_cpg.control.feedback import LONGEST_DELAY
from evo_cpg.io.schema.section import (
    VIEW,
    CustomConfig,
    DescribedSection,
    NotNegative,
    OpenSection,
    Positive,
    Section,
    Vector,
    by_type,
    section_of,
)
from evo_cpg.simulation.inertial import AccelerationSensor, RotationSensor
from evo_cpg.simulation.lateral_line import FlowSensor
from evo_cpg.simulation.rays import RaySensor
from evo_cpg.simulation.sensors import LoadSensor, VelocitySensor


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


class ImperfectionConfig(Section):
    """How a sense differs from the truth.

    Attributes:
        noise: standard deviation of the noise of each sample, in the unit of the reading.
        delay: time from the sense to the controller, s, 0 to 1; until then it reads 0.
        rate_hz: samples per second, held in between; ``control_rate_hz`` must be a multiple; a
            null samples in each control step.
        silent: whether all readings are 0, so that the other keys have no effect.
    """

    noise: NotNegative = 0.0
    delay: Annotated[float, Field(ge=0, le=LONGEST_DELAY)] = 0.0
    rate_hz: Positive | None = None
    silent: bool = False


class SensesConfig(OpenSection):
    """Imperfections of senses. A sense that is left out is perfect.

    Attributes:
        light: eyes.
        vertical: attitude of the eyes: the cosine and the sine of their angle to the vertical.
        pressure: pressure sensors.
        depth: depth gauges.
        joint_angle: angles of the joints, rad or m.
        joint_rate: rates of the joints, rad/s or m/s.
        load: loads of limbs in the feedback, and sensors of type ``load``.
        velocity: sensors of this type.
        acceleration: sensors of this type.
        rotation: sensors of this type.
        flow: sensors of this type.
        rays: sensors of this type.
        own: sensors of your own.
    """

    light: ImperfectionConfig | None = None
    vertical: ImperfectionConfig | None = None
    pressure: ImperfectionConfig | None = None
    depth: ImperfectionConfig | None = None
    joint_angle: ImperfectionConfig | None = None
    joint_rate: ImperfectionConfig | None = None
    load: ImperfectionConfig | None = None
    velocity: ImperfectionConfig | None = None
    acceleration: ImperfectionConfig | None = None
    rotation: ImperfectionConfig | None = None
    flow: ImperfectionConfig | None = None
    rays: ImperfectionConfig | None = None
    own: ImperfectionConfig | None = None

    @property
    def noisy(self) -> bool:
        """Whether any sense has noise."""
        return any(one is not None and one.noise and not one.silent for _, one in self)


class _OfBody(DescribedSection):
    """A sensor on a body, with the fields of its class in `evo_cpg.simulation`."""

    body_keys: ClassVar[tuple[str, ...]] = ("body",)


def _not_zero(axis: Vector) -> Vector:
    if not any(axis):
        raise ValueError("must not be the zero vector")
    return axis


def _not_along_y(axis: Vector) -> Vector:
    if not (axis[0] or axis[2]):
        raise ValueError("must not be along y, because the rays spread towards y")
    return axis


_kind = functools.partial(section_of, module=__name__, base=_OfBody, body=str)
VelocitySensorConfig = _kind(
    VelocitySensor, "VelocitySensorConfig", kind="velocity", default=True, full_scale=Positive
)
AccelerationSensorConfig = _kind(
    AccelerationSensor, "AccelerationSensorConfig", kind="acceleration", full_scale=Positive
)
RotationSensorConfig = _kind(
    RotationSensor, "RotationSensorConfig", kind="rotation", full_scale=Positive
)
LoadSensorConfig = _kind(LoadSensor, "LoadSensorConfig", kind="load", full_scale=Positive)
FlowSensorConfig = _kind(
    FlowSensor,
    "FlowSensorConfig",
    kind="flow",
    position=Vector,
    axis=Annotated[Vector, AfterValidator(_not_zero)],
    spacing=Positive,
    full_scale=Positive,
)
RaySensorConfig = _kind(
    RaySensor,
    "RaySensorConfig",
    kind="rays",
    position=Vector,
    axis=Annotated[Vector, AfterValidator(_not_along_y)],
    count=Annotated[int, Field(ge=1, le=16)],
    spread_deg=Annotated[float, Field(ge=0, le=360)],
    range=Positive,
)

SensorConfig = Annotated[
    Annotated[VelocitySensorConfig, Tag("velocity")]
    | Annotated[AccelerationSensorConfig, Tag("acceleration")]
    | Annotated[RotationSensorConfig, Tag("rotation")]
    | Annotated[LoadSensorConfig, Tag("load")]
    | Annotated[FlowSensorConfig, Tag("flow")]
    | Annotated[RaySensorConfig, Tag("rays")]
    | Annotated[CustomConfig, Tag("custom")],
    by_type(None),
]


def kind_of(sensor: Section) -> str:
    """Return the kind of an entry of ``sensors``: its type, or ``own`` for a class of your own."""
    return "own" if isinstance(sensor, CustomConfig) else str(getattr(sensor, "type", ""))
