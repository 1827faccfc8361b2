"""Section of a fixed tendon."""

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import Field, Tag, model_validator

from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.creature.axis_kinds import body_and_axis
from evo_cpg.creature.creature import NO_LIMIT, Tendon
from evo_cpg.io.schema.copies import Copy, copies_named, fill, placeholders
from evo_cpg.io.schema.joint import ActuatorConfig, TorqueMotorConfig
from evo_cpg.io.schema.section import Finite, NotNegative, PrintedName, Section, by_type

# Pyright cannot follow classes that are created at import.
_MotorConfig = Annotated[
    Annotated[ActuatorConfig, Tag("servo")]  # pyright: ignore[reportInvalidTypeForm]
    | Annotated[TorqueMotorConfig, Tag("torque")],  # pyright: ignore[reportInvalidTypeForm]
    by_type("servo"),
]


class TendonConfig(Section):
    """A fixed tendon: springs, limits and a motor on a weighted sum of joint angles, its length.

    The length is 0 in the neutral pose. It is in rad with pure numbers as coefficients, and in m
    with lever arms (m).

    A placeholder in the tendon's name makes one tendon for each of its values. A placeholder that
    only a joint's name contains stands for all of these joints.

    Attributes:
        name: unique name, which may contain ``{i}``, ``{j}`` or ``{side}``.
        joints: coefficient of each joint axis that it spans, by the axis's name, ``body.axis``.
        stiffness: stiffness of the spring, force per length.
        rest: length at which that spring is relaxed, or the shortest and the longest one.
        damping: damping, force per rate of length.
        armature: inertia of a rotor that turns with the length, kg m^2 (kg with lever arms).
        friction_loss: force of dry friction.
        limits: lower and upper limit of the length.
        actuator: motor that pulls, a servo or a torque motor. It follows the command of the first
            joint here that has no motor of its own and serves no other tendon.
    """

    name: PrintedName
    joints: Annotated[dict[str, Finite], Field(min_length=1)]
    stiffness: NotNegative = 0.0
    rest: Finite | tuple[Finite, Finite] = 0.0
    damping: NotNegative = 0.0
    armature: NotNegative = 0.0
    friction_loss: NotNegative = 0.0
    limits: tuple[Finite, Finite] | None = None
    actuator: _MotorConfig | None = None

    @model_validator(mode="after")
    def _check(self) -> "TendonConfig":
        for name, coefficient in self.joints.items():
            if coefficient == 0:
                raise ValueError(f"joints: the coefficient of {name!r} must not be 0")
            if not body_and_axis(name)[0]:
                raise ValueError(f"joints: {name!r} must be a body and an axis, such as tail1.z")
        shortest, longest = self.resting
        if shortest > longest:
            raise ValueError(f"rest: {shortest:g} is above {longest:g}")
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            raise ValueError(f"limits: {self.limits[0]:g} is not below {self.limits[1]:g}")
        return self

    @property
    def resting(self) -> tuple[float, float]:
        """Shortest and longest length at which the spring is relaxed."""
        return self.rest if isinstance(self.rest, tuple) else (self.rest, self.rest)

    def build(self, bodies: Sequence[Copy]) -> list[Tendon]:
        """Build the tendon, or one for each value of the placeholders in its name."""
        placeholder_names = placeholders(self.name)
        values: list[dict[str, str]] = [] if placeholder_names else [{}]
        for joint in self.joints if placeholder_names else ():
            for copy in copies_named(body_and_axis(joint)[0], bodies):
                marks = {mark: copy.marks[mark] for mark in placeholder_names if mark in copy.marks}
                if placeholders(joint) >= placeholder_names and marks not in values:
                    values.append(marks)
        lower, upper = self.limits or (-NO_LIMIT, NO_LIMIT)
        motor: Any = self.actuator
        tendons = []
        for marks in values:
            joints: list[tuple[str, Number]] = []
            for joint, coefficient in self.joints.items():
                given, axis = body_and_axis(joint)
                body = fill(given, marks)
                names = [copy.name for copy in copies_named(body, bodies)]
                joints += [(f"{name}.{axis}", coefficient) for name in names or [body]]
            tendon = self.into(
                Tendon,
                name=fill(self.name, marks),
                joints=tuple(joints),
                rest=self.resting,
                lower=lower,
                upper=upper,
                actuator=motor and motor.build(),
            )
            tendons.append(tendon)
        return tendons
