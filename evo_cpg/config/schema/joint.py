"""Sections of the joint between a body and its parent, and of its motors."""

from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, Tag, model_serializer, model_validator

from evo_cpg.config.schema.choice import by_type
from evo_cpg.config.schema.copies import MirrorAxis
from evo_cpg.config.schema.frames import moved, opposed, reflected, unit
from evo_cpg.config.schema.section import Finite, NotNegative, Positive, Section, Vector
from evo_cpg.config.schema.typical import Direction
from evo_cpg.creature.creature import NO_LIMIT, Actuator, Joint, Muscle, TorqueMotor
from evo_cpg.spatial.numerics import as_vector, xp
from evo_cpg.spatial.rotation import euler_to_matrix

# Smallest distance of the middle one of three joint angles from the angle at which the axes lie in
# one plane. Axes at right angles do so at 90 degrees, where the first and the last axis coincide.
_SINGULARITY_MARGIN_DEG = 5.0

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
        gain: torque per velocity error, N m s/rad; 0 only with a stiffness.
        torque_limit: largest torque, N m, unlimited if left out.
        stiffness: torque per angle error, N m/rad; 0 for a pure velocity servo.
    """

    # Run folders of version 1.0 have no such key.
    type: Literal["servo"] = Field("servo", exclude=True)
    gain: NotNegative
    torque_limit: Positive | None = None
    stiffness: NotNegative = 0.0

    @model_validator(mode="after")
    def _check(self) -> "ActuatorConfig":
        if self.gain == 0 and self.stiffness == 0:
            raise ValueError("gain: must be greater than 0 without a stiffness, got 0")
        return self

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


def _require_regular(directions: np.ndarray, lower: float, upper: float) -> None:
    """Check that three axes stay independent while the middle axis turns.

    The volume that the axes span is a cosine of the angle of the middle axis.

    Args:
        directions: directions of the axes ``(3, 3)``.
        lower: lower limit of the middle axis, degrees.
        upper: upper limit of the middle axis, degrees.

    Raises:
        ValueError: the axes reach a common plane, or nearly so.
    """
    first, middle, last = directions / np.linalg.norm(directions, axis=1)[:, None]
    across = np.cross(middle, last)
    cosine, sine = first @ across, first @ np.cross(middle, across)
    margin = _SINGULARITY_MARGIN_DEG
    if np.hypot(cosine, sine) < np.sin(np.radians(margin)):
        raise ValueError(
            f"axes: the middle one of three must be at least {margin:g} degrees from the others"
        )
    # First angle of the middle axis, from the margin below its lower limit on, at which the three
    # axes lie in one plane, degrees.
    plane = np.degrees(np.arctan2(sine, cosine)) + 90.0
    plane += 180.0 * np.ceil((lower - margin - plane) / 180.0 + 1e-9)
    if plane < upper + margin - 1e-6:
        near = plane - 180.0 if lower + upper < 2 * plane else plane
        raise ValueError(
            f"limits_deg: the three axes lie in one plane if the middle one turns by {plane:.4g} "
            f"degrees. Allowed for it: {near + margin:.4g} to "
            f"{near + 180.0 - margin:.4g}, got {lower:g} to {upper:g}"
        )


def _as_tuple(given: Any) -> Any:
    """Return a list of values of each axis as a tuple, and a value of all axes as it is."""
    return tuple(given) if isinstance(given, list) else given


class JointConfig(Section):
    """The joint between a body and its parent.

    Attributes:
        parent: name of the parent body.
        at: position of the joint in the parent's frame, m.
        child_at: position of the joint in this body's frame, m.
        axes: up to 3 axes in this body's own frame, which turn in this order: x, y, z, -x, -y, -z
            or a vector. An empty list welds the body to its parent.
        limits_deg: lower and upper limit, for all axes or one pair for each, degrees; the middle
            one of three axes at right angles turns by at most 85; null for no limits.
        rotation_deg: roll, pitch and yaw of this body relative to its parent at rest, degrees,
            about the parent's x, then y, then z. ``[0, 40, 90]`` points the x axis of a leg to the
            left and 40 degrees down.
        stiffness: stiffness of the passive spring, N m/rad; one for all axes or a list, as below.
        rest_deg: angle at which that spring is relaxed, degrees; only without muscles.
        damping: passive damping, N m s/rad.
        armature: rotor inertia, kg m^2.
        friction_loss: torque of dry friction, N m.
        actuator: motors or muscles, for all axes or a list with one or null for each, without which
            the joint is passive.
    """

    parent: str
    at: Vector
    child_at: Vector
    axes: Annotated[list[AxisName | Vector], Field(max_length=3)]
    limits_deg: tuple[Finite, Finite] | list[tuple[Finite, Finite] | None] | None = (-60.0, 60.0)
    rotation_deg: Annotated[Vector, Direction()] = (0.0, 0.0, 0.0)
    stiffness: NotNegative | list[NotNegative] = 0.0
    rest_deg: Finite | list[Finite] = 0.0
    damping: NotNegative | list[NotNegative] = 0.0
    armature: NotNegative | list[NotNegative] = 0.0
    friction_loss: NotNegative | list[NotNegative] = 0.0
    actuator: _MotorConfig | list[_MotorConfig | None] | None = None

    @model_serializer(mode="wrap")
    def _leave_out(self, write: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        # Run folders of version 1.0 have no such keys.
        new = "rest_deg", "friction_loss"
        return {name: x for name, x in write(self).items() if name not in new or x != 0.0}

    @model_validator(mode="after")
    def _check(self) -> "JointConfig":
        limits = self.limits
        for name in ("stiffness", "rest_deg", "damping", "armature", "friction_loss", "actuator"):
            given = getattr(self, name)
            if isinstance(given, list) and len(given) != len(self.axes):
                raise ValueError(
                    f"{name} gives {len(given)} values for {len(self.axes)} axes. "
                    "Give one value for all axes, or one for each"
                )
        muscular = any(isinstance(motor, MuscleConfig) for motor in self.motors)
        if muscular and np.any(self.rest_deg):
            raise ValueError("rest_deg: must be 0 for a joint with muscles")
        if len(limits) != len(self.axes):
            raise ValueError(
                f"limits_deg gives {len(limits)} pairs for {len(self.axes)} axes. "
                "Give one pair for all axes, or one for each"
            )
        for lower, upper in filter(None, limits):
            if not lower < upper:
                raise ValueError(f"limits_deg: {lower:g} is not below {upper:g}")
        directions = np.array(self.directions)
        if len(directions) and np.linalg.matrix_rank(directions, tol=1e-6) < len(directions):
            raise ValueError("axes: must be linearly independent and not zero")
        if len(self.axes) == 3:
            _require_regular(directions, *limits[1] or (-180.0, 180.0))
        return self

    @property
    def limits(self) -> list[tuple[float, float] | None]:
        """Limits of each axis, as pairs, degrees, or None for no limits."""
        if isinstance(self.limits_deg, list):
            return self.limits_deg
        return [self.limits_deg] * len(self.axes)

    @property
    def motors(self) -> list[_MotorConfig | None]:
        """Motor or muscles of each axis."""
        if isinstance(self.actuator, list):
            return self.actuator
        return [self.actuator] * len(self.axes)

    @property
    def directions(self) -> list[tuple[float, ...]]:
        """The axes as vectors, not normalised."""
        return [_AXES[axis] if isinstance(axis, str) else axis for axis in self.axes]

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
                "axes": [opposed(direction, axis) for direction in self.directions],
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
        limits = [
            (-NO_LIMIT, NO_LIMIT) if pair is None else tuple(xp.deg2rad(xp.array(pair)))
            for pair in self.limits
        ]
        each = isinstance(self.actuator, list)
        motors = tuple(motor and motor.build() for motor in self.motors)
        return Joint(
            parent=parent,
            parent_anchor=moved(self.at, parent_centre),
            child_anchor=moved(self.child_at, centre),
            axes=tuple(unit(axis) for axis in self.directions),
            lower=tuple(pair[0] for pair in limits),
            upper=tuple(pair[1] for pair in limits),
            orientation=tuple(map(as_vector, rotation)),
            stiffness=_as_tuple(self.stiffness),
            damping=_as_tuple(self.damping),
            armature=_as_tuple(self.armature),
            friction_loss=_as_tuple(self.friction_loss),
            actuator=motors if each or not motors else motors[0],
            rest=_as_tuple(
                [xp.deg2rad(x) for x in self.rest_deg]
                if isinstance(self.rest_deg, list)
                else xp.deg2rad(self.rest_deg)
            ),
        )
