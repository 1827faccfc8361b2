"""Sections of the joint between a body and its parent, and of its motors."""

from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from evo_cpg.creature.algebra.numerics import Triple, as_vector, xp
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.axis_kinds import AxisKind, BallComponent, Slide, Turn
from evo_cpg.creature.creature import NO_LIMIT, Actuator, Joint, Muscle, TorqueMotor
from evo_cpg.io.schema.copies import MirrorAxis, moved, opposed, reflected, unit
from evo_cpg.io.schema.section import (
    Direction,
    Finite,
    NotNegative,
    Positive,
    Section,
    Vector,
    by_type,
    section_of,
)

# Largest number of axes of a joint, with which a body moves freely.
_MOST_AXES = 6

# Largest angle of a ball joint, degrees. No rotation has a larger one.
_HALF_TURN = 180.0

AxisName = Literal["x", "y", "z", "-x", "-y", "-z"]

_AXES = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}


def _require_some(gear: float) -> float:
    if gear == 0:
        raise ValueError("must not be 0")
    return gear


ActuatorConfig = section_of(
    Actuator,
    "ActuatorConfig",
    __name__,
    "servo",
    default=True,
    gain=NotNegative,
    torque_limit=Positive | None,
    stiffness=NotNegative,
)
TorqueMotorConfig = section_of(
    TorqueMotor,
    "TorqueMotorConfig",
    __name__,
    "torque",
    gear=Annotated[Finite, AfterValidator(_require_some)],
    torque_limit=Positive | None,
)
MuscleConfig = section_of(
    Muscle,
    "MuscleConfig",
    __name__,
    "muscle",
    hill=bool,
    damping_time=NotNegative,
    **dict.fromkeys(
        ("area", "arm", "fibre_length", "stress", "bend_deg", "tone", "max_speed", "curvature"),
        Positive,
    ),
)

# Pyright cannot follow classes that are created at import.
_MotorConfig = Annotated[
    Annotated[ActuatorConfig, Tag("servo")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[TorqueMotorConfig, Tag("torque")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[MuscleConfig, Tag("muscle")],  # pyright: ignore[reportInvalidTypeForm]
    by_type("servo"),
]


# Numbers of a joint that are one for all axes, or a list with one for each.
_NUMBERS = ("stiffness", "rest_deg", "damping", "armature", "friction_loss")


class TurnConfig(Section):
    """A turning axis with a place of its own.

    Attributes:
        turn: axis in this body's frame: x, y, z, -x, -y, -z or a vector.
        at: position of the axis in this body's frame, m; the joint's ``child_at`` if left out.
    """

    turn: AxisName | Vector
    at: Vector | None = None


class SlideConfig(Section):
    """An axis along which the body slides.

    Attributes:
        slide: direction in this body's frame: x, y, z, -x, -y, -z or a vector.
        limits_m: lower and upper limit, m; null for no limits.
        rest_m: displacement at which the passive spring is relaxed, m.
    """

    slide: AxisName | Vector
    limits_m: tuple[Finite, Finite] | None = None
    rest_m: Finite = 0.0

    @model_validator(mode="after")
    def _check(self) -> "SlideConfig":
        if self.limits_m is not None and not self.limits_m[0] < self.limits_m[1]:
            raise ValueError(f"limits_m: {self.limits_m[0]:g} is not below {self.limits_m[1]:g}")
        return self


def _key_of_entry(entry: Any) -> str:
    """Return the tag of an entry of ``axes``: its first key that names a kind of axis."""
    keys = entry if isinstance(entry, dict) else getattr(type(entry), "model_fields", ())
    named = (key for key in ("slide", "turn") if key in keys)
    return next(named, "turn" if isinstance(entry, dict) else "direction")


AxisEntry = Annotated[
    Annotated[AxisName | Vector, Tag("direction")]
    | Annotated[TurnConfig, Tag("turn")]
    | Annotated[SlideConfig, Tag("slide")],
    Discriminator(_key_of_entry),
]


class JointAxis(NamedTuple):
    """One axis of a joint, however it is written.

    Attributes:
        kind: its kind.
        direction: direction in the body's frame, not normalised.
        place: position of a turning axis in the body's frame, m, or None for the joint's position.
        limits: limits of a coordinate in m, or None for no limits.
        rest: coordinate in m at which its spring is relaxed.
    """

    kind: AxisKind
    direction: Triple
    place: Triple | None = None
    limits: tuple[float, float] | None = None
    rest: float = 0.0

    def mirrored(self, axis: MirrorAxis) -> "JointAxis":
        """Return the mirror image of the axis."""
        image = opposed if self.kind.rotation else reflected
        place = None if self.place is None else reflected(self.place, axis)
        direction = image(self.direction, axis)
        return self._replace(kind=self.kind.mirrored(), direction=direction, place=place)


class JointConfig(Section):
    """The joint between a body and its parent.

    Attributes:
        parent: name of the parent body.
        at: position of the joint in the parent's frame, m.
        child_at: position of the joint in this body's frame, m.
        axes: up to 6 axes in this body's own frame, which move it in this order: x, y, z, -x, -y,
            -z or a vector to turn about, ``{turn: y, at: [0, 0, 0.1]}`` for an axis at another
            place, ``{slide: x}`` for a slide. An empty list welds the body to its parent.
            ``ball`` turns it in any direction.
        limits_deg: lower and upper limit of the angles, for all axes or one pair for each (null for
            a slide), degrees; null for no limits; ``[0, 60]`` limits the whole angle of a ball.
        rotation_deg: roll, pitch and yaw of this body relative to its parent at rest, degrees,
            about the parent's x, then y, then z. ``[0, 40, 90]`` points the x axis of a leg to the
            left and 40 degrees down.
        stiffness: stiffness of the passive spring, N m/rad, or N/m for a slide; one for all axes or
            a list, as below.
        rest_deg: angle at which that spring is relaxed, degrees; only without muscles.
        damping: passive damping, N m s/rad, or N s/m.
        armature: rotor inertia, kg m^2, or kg.
        friction_loss: torque of dry friction, N m, or N.
        actuator: motors or muscles, for all axes or a list with one or null for each, without which
            the joint is passive.
    """

    parent: str
    at: Vector
    child_at: Vector
    axes: Literal["ball"] | Annotated[list[AxisEntry], Field(max_length=_MOST_AXES)]
    limits_deg: tuple[Finite, Finite] | list[tuple[Finite, Finite] | None] | None = (-60.0, 60.0)
    rotation_deg: Annotated[Vector, Direction()] = (0.0, 0.0, 0.0)
    stiffness: NotNegative | list[NotNegative] = 0.0
    rest_deg: Finite | list[Finite] = 0.0
    damping: NotNegative | list[NotNegative] = 0.0
    armature: NotNegative | list[NotNegative] = 0.0
    friction_loss: NotNegative | list[NotNegative] = 0.0
    actuator: _MotorConfig | list[_MotorConfig | None] | None = None

    @model_validator(mode="after")
    def _check(self) -> "JointConfig":
        axes, ball = self.every_axis, self.axes == "ball"
        for name in (*_NUMBERS, "actuator", "limits_deg"):
            given, what = getattr(self, name), "pairs" if name == "limits_deg" else "values"
            if not isinstance(given, list):
                continue
            if ball and name in _NUMBERS:
                raise ValueError(f"{name}: a ball has one value for all directions, not a list")
            if len(given) != len(axes):
                raise ValueError(
                    f"{name} gives {len(given)} {what} for {len(axes)} axes. "
                    f"Give one {what[:-1]} for all axes, or one for each"
                )
        for lower, upper in filter(None, self.each("limits_deg")):
            if not lower < upper:
                raise ValueError(f"limits_deg: {lower:g} is not below {upper:g}")
        if ball:
            if np.any(self.rest_deg):
                raise ValueError(
                    "rest_deg: must be 0 for a ball, whose spring pulls to the neutral pose"
                )
            if isinstance(self.limits_deg, list):
                raise ValueError("limits_deg: a ball has one pair, such as [0, 60], or null")
            lower, upper = self.limits_deg or (0.0, _HALF_TURN)
            if lower not in (0.0, -upper) or upper > _HALF_TURN:
                raise ValueError(
                    f"limits_deg: a ball has one largest angle, up to {_HALF_TURN:g} degrees. "
                    f"Write [0, {min(max(abs(lower), abs(upper)), _HALF_TURN):g}], got "
                    f"[{lower:g}, {upper:g}]"
                )
        for i, (axis, motor) in enumerate(zip(axes, self.each("actuator"), strict=True)):
            rest = self.rest_deg[i] if isinstance(self.rest_deg, list) else 0.0
            limits = self.limits_deg[i] if isinstance(self.limits_deg, list) else None
            if axis.kind.unit == "m" and limits is not None:
                raise ValueError(
                    f"limits_deg: axis {i} slides. Write null for it, and its limits_m in axes"
                )
            if axis.kind.unit == "m" and rest != 0:
                raise ValueError(
                    f"rest_deg: axis {i} slides. Write 0 for it, and its rest_m in axes"
                )
            if isinstance(motor, MuscleConfig):
                if axis.kind != Turn():
                    raise ValueError(
                        f"actuator: muscles turn one axis, and axis {i} {axis.kind.motion}. Give "
                        "it a servo or a torque motor"
                    )
                if np.any(self.rest_deg):
                    raise ValueError("rest_deg: must be 0 for a joint with muscles")
        if not axes:
            return self
        arms = [np.subtract(x.place, self.child_at) if x.place else np.zeros(3) for x in axes]
        # Positions in units of the farthest one, so that they count like directions.
        size = max(np.linalg.norm(arms, axis=1).max(), np.finfo(float).tiny)
        rows = []
        for axis, arm in zip(axes, arms, strict=True):
            direction = np.array(axis.direction, float)
            turning = axis.kind.rotation * direction
            moving = np.cross(turning, -arm / size) + axis.kind.translation * direction
            rows.append(np.concatenate([turning, moving]))
        if np.linalg.matrix_rank(np.array(rows), tol=1e-6) != len(axes):
            raise ValueError("axes: must be linearly independent and not zero")
        return self

    def each(self, name: str) -> list[Any]:
        """Return the value of each axis."""
        given = getattr(self, name)
        return given if isinstance(given, list) else [given] * len(self.every_axis)

    @property
    def every_axis(self) -> list[JointAxis]:
        """The axes, with the three components of a ball."""
        if self.axes == "ball":
            return [JointAxis(BallComponent(), _AXES[name]) for name in "xyz"]
        found: list[JointAxis] = []
        for entry in self.axes:
            if isinstance(entry, JointAxis):
                # A mirrored joint holds axes already.
                found.append(entry)
                continue
            written: list[Any] = [Turn(), entry]
            if isinstance(entry, TurnConfig):
                written[1:] = entry.turn, entry.at
            elif isinstance(entry, SlideConfig):
                written = [Slide(), entry.slide, None, entry.limits_m, entry.rest_m]
            kind, given, *others = written
            direction = _AXES[given] if isinstance(given, str) else given
            found.append(JointAxis(kind, direction, *others))
        return found

    @property
    def limits(self) -> list[tuple[float, float] | None]:
        """Limits of each angle, as pairs, degrees, or None for no limits and for slides."""
        every = zip(self.every_axis, self.each("limits_deg"), strict=True)
        return [None if axis.kind.unit == "m" else pair for axis, pair in every]

    def turned(self, angle_deg: float) -> "JointConfig":
        """Return the joint, turned with its limb about the parent's vertical axis."""
        if not angle_deg:
            return self
        roll, pitch, yaw = self.rotation_deg
        at = euler_to_matrix(0.0, 0.0, np.deg2rad(angle_deg)) @ xp.array(self.at)
        update = {"at": as_vector(at), "rotation_deg": (roll, pitch, yaw + angle_deg)}
        return self.model_copy(update=update)

    def mirrored(self, axis: MirrorAxis) -> "JointConfig":
        """Return the mirror image of the joint, with parent and child mirrored in their frames.

        Equal angles then give mirrored poses, so the limits do not change.
        """
        return self.model_copy(
            update={
                "at": reflected(self.at, axis),
                "child_at": reflected(self.child_at, axis),
                "axes": [each.mirrored(axis) for each in self.every_axis],
                "rotation_deg": opposed(self.rotation_deg, axis),
            }
        )

    def build(self, parent: str, parent_centre: np.ndarray, centre: np.ndarray) -> Joint:
        """Build the joint on the given parent, in frames at the centres of the bodies' shapes.

        The centres are in the frames of ``at`` and ``child_at``, m.
        """
        rotation = euler_to_matrix(*xp.deg2rad(xp.array(self.rotation_deg)))
        axes, limits, rest = self.every_axis, [], []
        for axis, pair, angle in zip(axes, self.limits, self.each("rest_deg"), strict=True):
            if axis.kind.unit == "m":
                limits.append(axis.limits or (-NO_LIMIT, NO_LIMIT))
                rest.append(axis.rest)
                continue
            rest.append(xp.deg2rad(angle))
            lower, upper = (-NO_LIMIT, NO_LIMIT) if pair is None else xp.deg2rad(xp.array(pair))
            limits.append((-upper if axis.kind.at_once else lower, upper))
        motors = tuple(motor and motor.build() for motor in self.each("actuator"))
        places = [axis.place and moved(axis.place, centre) for axis in axes]
        numbers = {name: getattr(self, name) for name in _NUMBERS if name != "rest_deg"}
        return Joint(
            parent=parent,
            parent_anchor=moved(self.at, parent_centre),
            child_anchor=moved(self.child_at, centre),
            axes=tuple(unit(axis.direction) for axis in axes),
            lower=tuple(pair[0] for pair in limits),
            upper=tuple(pair[1] for pair in limits),
            orientation=tuple(map(as_vector, rotation)),
            actuator=motors if isinstance(self.actuator, list) or not motors else motors[0],
            rest=tuple(rest),
            kinds=tuple(axis.kind for axis in axes),
            places=tuple(places) if any(places) else None,
            **{name: tuple(x) if isinstance(x, list) else x for name, x in numbers.items()},
        )
