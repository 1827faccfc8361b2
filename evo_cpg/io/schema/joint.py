"""Sections of the joint between a body and its parent, and of its motors."""

from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from evo_cpg.creature.algebra.numerics import Number, Triple, as_vector, xp
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.creature import NO_LIMIT, Actuator, AxisKind, Joint, Muscle, TorqueMotor
from evo_cpg.io.schema.copies import MirrorAxis, moved, opposed, reflected, unit
from evo_cpg.io.schema.section import (
    Direction,
    Finite,
    NotNegative,
    Positive,
    Section,
    Vector,
    by_type,
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


class ActuatorConfig(Section):
    """A motor on each axis.

    Attributes:
        type: servo.
        gain: torque per velocity error, N m s/rad; 0 for a spring alone.
        torque_limit: largest torque, N m, unlimited if left out.
        stiffness: torque per angle error, N m/rad; 0 for a pure velocity servo.
    """

    type: Literal["servo"] = "servo"
    gain: NotNegative
    torque_limit: Positive | None = None
    stiffness: NotNegative = 0.0

    def build(self) -> Actuator:
        """Build the motor."""
        limit = float("inf") if self.torque_limit is None else self.torque_limit
        return Actuator(self.gain, limit, self.stiffness)


class TorqueMotorConfig(Section):
    """A motor on each axis whose torque the controller commands.

    Attributes:
        type: torque.
        gear: torque per unit of a controller's output, N m; negative to reverse it. The controller
            ``brain_cpg`` commands ``gear (ML - MR)``, with ML and MR of muscles. Controllers that
            command torques ignore it.
        torque_limit: largest torque, N m, unlimited if left out.
    """

    type: Literal["torque"]
    gear: Finite = 1.0
    torque_limit: Positive | None = None

    @model_validator(mode="after")
    def _check(self) -> "TorqueMotorConfig":
        if self.gear == 0:
            raise ValueError("gear: must not be 0")
        return self

    def build(self) -> TorqueMotor:
        """Build the motor."""
        limit = float("inf") if self.torque_limit is None else self.torque_limit
        return TorqueMotor(self.gear, limit)


class MuscleConfig(Section):
    """Two antagonistic muscles about each axis, after Ekeberg and Hill.

    Attributes:
        type: muscle.
        area: cross-section of the muscle on each side, m^2.
        arm: lever arm of the muscles about the axis, m.
        fibre_length: length of the fibres at the neutral angle, m.
        stress: specific tension, Pa; 140e3 to 300e3 in fish, frogs and salamanders.
        bend_deg: angle that one fully active side holds without load and without Hill's law,
            degrees. It sets the stiffness.
        tone: stiffness of relaxed muscles over the stiffness that one active side adds.
        damping_time: damping over stiffness with one side fully active, s.
        max_speed: largest speed of shortening, fibre lengths per second.
        curvature: k of Hill's curve of force over speed; 0.15 to 0.35 in animals.
        hill: whether force depends on length and speed; false for Ekeberg's muscles.
    """

    type: Literal["muscle"]
    area: Positive
    arm: Positive
    fibre_length: Positive
    stress: Positive = 200e3
    bend_deg: Positive = 45.0
    tone: Positive = 1.0
    damping_time: NotNegative = 0.02
    max_speed: Positive = 5.0
    curvature: Positive = 0.25
    hill: bool = True

    def build(self) -> Muscle:
        """Build the muscles."""
        return self.into(Muscle, bend=xp.deg2rad(self.bend_deg))


_MotorConfig = Annotated[
    Annotated[ActuatorConfig, Tag("servo")]
    | Annotated[TorqueMotorConfig, Tag("torque")]
    | Annotated[MuscleConfig, Tag("muscle")],
    by_type("servo"),
]


def _as_tuple(given: Any) -> Any:
    """Return a list of values of each axis as a tuple, and a value of all axes as it is."""
    return tuple(given) if isinstance(given, list) else given


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


def _kind_of_entry(entry: Any) -> str:
    """Return the tag of an entry of ``axes``."""
    if isinstance(entry, dict):
        return "slide" if "slide" in entry else "turn"
    return {SlideConfig: "slide", TurnConfig: "turn"}.get(type(entry), "direction")


AxisEntry = Annotated[
    Annotated[AxisName | Vector, Tag("direction")]
    | Annotated[TurnConfig, Tag("turn")]
    | Annotated[SlideConfig, Tag("slide")],
    Discriminator(_kind_of_entry),
]


class Axis(NamedTuple):
    """One axis of a joint, however it is written.

    Attributes:
        kind: rotation, displacement, or component of a ball's rotation.
        direction: direction in the body's frame, not normalised.
        place: position of a turning axis in the body's frame, m, or None for the joint's position.
        limits: limits of a slide, m, or None for no limits.
        rest: displacement of a slide at which its spring is relaxed, m.
    """

    kind: AxisKind
    direction: Triple
    place: Triple | None = None
    limits: tuple[float, float] | None = None
    rest: float = 0.0

    @classmethod
    def of(cls, entry: Any) -> "Axis":
        """Return the axis of an entry of ``axes``."""
        if isinstance(entry, Axis):
            return entry
        if isinstance(entry, SlideConfig):
            return cls("slide", _direction(entry.slide), None, entry.limits_m, entry.rest_m)
        if isinstance(entry, TurnConfig):
            return cls("turn", _direction(entry.turn), entry.at)
        return cls("turn", _direction(entry))

    def mirrored(self, axis: MirrorAxis) -> "Axis":
        """Return the mirror image of the axis."""
        image = reflected if self.kind == "slide" else opposed
        place = None if self.place is None else reflected(self.place, axis)
        return self._replace(direction=image(self.direction, axis), place=place)


def _direction(given: Any) -> Triple:
    return _AXES[given] if isinstance(given, str) else given


def _are_independent(axes: list[Axis], joint: Triple) -> bool:
    """Return whether the axes move a body in independent ways.

    Args:
        axes: the axes.
        joint: position of the joint in the body's frame, m.
    """
    arms = [np.subtract(axis.place, joint) if axis.place else np.zeros(3) for axis in axes]
    # Positions in units of the farthest one, so that they count like directions.
    size = max(np.linalg.norm(arms, axis=1).max(), np.finfo(float).tiny)
    columns = [
        np.concatenate([np.zeros(3), axis.direction])
        if axis.kind == "slide"
        else np.concatenate([axis.direction, np.cross(arm / size, axis.direction)])
        for axis, arm in zip(axes, arms, strict=True)
    ]
    return bool(np.linalg.matrix_rank(np.array(columns), tol=1e-6) == len(axes))


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
        each = ("stiffness", "rest_deg", "damping", "armature", "friction_loss")
        axes, ball = self.every_axis, self.axes == "ball"
        for name in (*each, "actuator"):
            given = getattr(self, name)
            if not isinstance(given, list):
                continue
            if ball and name in each:
                raise ValueError(f"{name}: a ball has one value for all directions, not a list")
            if len(given) != len(axes):
                raise ValueError(
                    f"{name} gives {len(given)} values for {len(axes)} axes. "
                    "Give one value for all axes, or one for each"
                )
        limits = self._given_limits()
        if len(limits) != len(axes):
            raise ValueError(
                f"limits_deg gives {len(limits)} pairs for {len(axes)} axes. "
                "Give one pair for all axes, or one for each"
            )
        for lower, upper in filter(None, limits):
            if not lower < upper:
                raise ValueError(f"limits_deg: {lower:g} is not below {upper:g}")
        if ball:
            self._check_ball()
        self._check_kinds(axes, limits)
        if axes and not _are_independent(axes, self.child_at):
            raise ValueError("axes: must be linearly independent and not zero")
        return self

    def _check_ball(self) -> None:
        """Check the values of a ball joint."""
        if np.any(self.rest_deg):
            raise ValueError(
                "rest_deg: must be 0 for a ball, whose spring pulls to the neutral pose"
            )
        if isinstance(self.limits_deg, list):
            raise ValueError("limits_deg: a ball has one pair, such as [0, 60], or null")
        lower, upper = self.limits_deg or (0.0, _HALF_TURN)
        if lower not in (0.0, -upper) or upper > _HALF_TURN:
            raise ValueError(
                f"limits_deg: a ball has one largest angle, up to {_HALF_TURN:g} degrees. Write "
                f"[0, {min(max(abs(lower), abs(upper)), _HALF_TURN):g}], got "
                f"[{lower:g}, {upper:g}]"
            )

    def _check_kinds(self, axes: list[Axis], limits: list[tuple[float, float] | None]) -> None:
        """Check values that only some kinds of axes may have."""
        rest = self.rest_deg if isinstance(self.rest_deg, list) else [0.0] * len(axes)
        for i, (axis, limit, angle, motor) in enumerate(
            zip(axes, limits, rest, self.motors, strict=True)
        ):
            muscular = isinstance(motor, MuscleConfig)
            if axis.kind == "slide" and limit is not None and isinstance(self.limits_deg, list):
                raise ValueError(
                    f"limits_deg: axis {i} slides. Write null for it, and its limits_m in axes"
                )
            if axis.kind == "slide" and angle != 0:
                raise ValueError(
                    f"rest_deg: axis {i} slides. Write 0 for it, and its rest_m in axes"
                )
            if muscular and axis.kind != "turn":
                word = "slides" if axis.kind == "slide" else "is a ball's"
                raise ValueError(
                    f"actuator: muscles turn one axis, and axis {i} {word}. Give it a servo or a "
                    "torque motor"
                )
            if muscular and np.any(self.rest_deg):
                raise ValueError("rest_deg: must be 0 for a joint with muscles")

    @property
    def every_axis(self) -> list[Axis]:
        """The axes, with the three components of a ball."""
        if self.axes == "ball":
            return [Axis("ball", _AXES[name]) for name in "xyz"]
        return list(map(Axis.of, self.axes))

    def _given_limits(self) -> list[tuple[float, float] | None]:
        if isinstance(self.limits_deg, list):
            return self.limits_deg
        return [self.limits_deg] * len(self.every_axis)

    @property
    def limits(self) -> list[tuple[float, float] | None]:
        """Limits of each angle, as pairs, degrees, or None for no limits and for slides."""
        return [
            None if axis.kind == "slide" else pair
            for axis, pair in zip(self.every_axis, self._given_limits(), strict=True)
        ]

    @property
    def motors(self) -> list[_MotorConfig | None]:
        """Motor or muscles of each axis."""
        if isinstance(self.actuator, list):
            return self.actuator
        return [self.actuator] * len(self.every_axis)

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
        """Build the joint on the given parent, in frames at the bodies' centres of mass.

        Args:
            parent: name of the parent.
            parent_centre: centre of mass of the parent in the frame of ``at``, m.
            centre: centre of mass of the body in the frame of ``child_at``, m.
        """
        rotation = euler_to_matrix(*xp.deg2rad(xp.array(self.rotation_deg)))
        axes = self.every_axis
        limits = [_range_of(axis, pair) for axis, pair in zip(axes, self.limits, strict=True)]
        each = isinstance(self.actuator, list)
        motors = tuple(motor and motor.build() for motor in self.motors)
        kinds: tuple[AxisKind, ...] = tuple(axis.kind for axis in axes)
        places = [axis.place and moved(axis.place, centre) for axis in axes]
        return Joint(
            parent=parent,
            parent_anchor=moved(self.at, parent_centre),
            child_anchor=moved(self.child_at, centre),
            axes=tuple(unit(axis.direction) for axis in axes),
            lower=tuple(pair[0] for pair in limits),
            upper=tuple(pair[1] for pair in limits),
            orientation=tuple(map(as_vector, rotation)),
            stiffness=_as_tuple(self.stiffness),
            damping=_as_tuple(self.damping),
            armature=_as_tuple(self.armature),
            friction_loss=_as_tuple(self.friction_loss),
            actuator=motors if each or not motors else motors[0],
            rest=_as_tuple(self._rest()),
            kinds=kinds if any(kind != "turn" for kind in kinds) else None,
            places=tuple(places) if any(places) else None,
        )

    def _rest(self) -> Any:
        """Return the relaxed angle or displacement, for all axes or for each, rad and m."""
        given = self.rest_deg
        if not any(axis.kind == "slide" for axis in self.every_axis):
            return [xp.deg2rad(x) for x in given] if isinstance(given, list) else xp.deg2rad(given)
        every = given if isinstance(given, list) else [given] * len(self.every_axis)
        return [
            axis.rest if axis.kind == "slide" else xp.deg2rad(x)
            for axis, x in zip(self.every_axis, every, strict=True)
        ]


def _range_of(axis: Axis, limits_deg: tuple[float, float] | None) -> tuple[Number, Number]:
    """Return the lower and the upper limit of an axis, rad or m."""
    if axis.kind == "slide":
        return axis.limits or (-NO_LIMIT, NO_LIMIT)
    if limits_deg is None:
        return -NO_LIMIT, NO_LIMIT
    lower, upper = xp.deg2rad(xp.array(limits_deg))
    return (-upper, upper) if axis.kind == "ball" else (lower, upper)
