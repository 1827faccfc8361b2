"""Sections of a trial: its duration, its steps, and its noise."""

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator

from evo_cpg.io.schema.section import (
    Count,
    Finite,
    NotNegative,
    OpenSection,
    Positive,
    Section,
)
from evo_cpg.io.schema.task import LightConfig
from evo_cpg.io.schema.typical import Direction

_MOST_TRIALS = 10_000
MOST_STEPS = 1_000_000


class SituationConfig(OpenSection):
    """Initial situation of one trial. Open keys keep the values for all trials.

    Attributes:
        start: x and y of the root's centre at the start, m.
        start_heading_deg: rotation to the left at the start, degrees.
        light: light of the trial; its open keys are those of the task's light.
    """

    start: tuple[Finite, Finite] | None = None
    start_heading_deg: Annotated[Finite | None, Direction()] = None
    light: LightConfig | None = None


def _number_or_list(value: Any) -> str:
    return "list" if isinstance(value, (list, tuple)) else "number"


TrialsConfig = Annotated[
    Annotated[int, Field(ge=1, le=_MOST_TRIALS), Tag("number")]
    | Annotated[list[SituationConfig], Field(min_length=1, max_length=_MOST_TRIALS), Tag("list")],
    Discriminator(_number_or_list),
]


class SimulationConfig(Section):
    """A trial: control steps of ``1 / control_rate_hz`` s with ``substeps`` physics steps each.

    Attributes:
        control_rate_hz: control steps per second, 1/s.
        substeps: number of physics steps in a control step.
        seconds: duration, s, rounded to whole control steps (at least one).
        start: x and y of the root's centre at the start, m.
        start_heading_deg: rotation to the left at the start, degrees.
        start_clearance: distance of the creature's nearest point from the ground at the start, m.
        start_pose: ``neutral``, or ``settled``: the pose at rest after it is let down.
        trials: trials over which fitness is averaged: their number, which without noise is one,
            or a list of situations.
    """

    control_rate_hz: Positive = 60.0
    substeps: Count = 2
    seconds: Annotated[Positive, Field(validate_default=True)] = 2000 / 60
    start: tuple[Finite, Finite] = (0.0, 0.0)
    start_heading_deg: Annotated[Finite, Direction()] = 0.0
    start_clearance: NotNegative = 0.0
    start_pose: Literal["neutral", "settled"] = "neutral"
    trials: TrialsConfig = 1

    @property
    def situations(self) -> list[SituationConfig]:
        """Situations of the trials, or empty if only a number of trials is given."""
        return self.trials if isinstance(self.trials, list) else []

    @property
    def steps(self) -> int:
        """Number of control steps."""
        return max(1, round(self.seconds * self.control_rate_hz))

    @field_validator("seconds")
    @classmethod
    def _is_countable(cls, seconds: float, info: ValidationInfo) -> float:
        steps = round(seconds * info.data.get("control_rate_hz", 0.0))
        if steps > MOST_STEPS:
            raise ValueError(f"{seconds:g} s have {steps} control steps. Allowed: {MOST_STEPS}")
        return seconds

    @field_validator("trials", mode="before")
    @classmethod
    def _is_no_mapping(cls, trials: Any) -> Any:
        if isinstance(trials, dict):
            raise ValueError("must be a number, or a list of situations")
        return trials


class NoiseConfig(Section):
    """Random disturbances in a trial (default: none).

    Attributes:
        joint_angle_deg: standard deviation of every joint angle at the start, degrees; slides start
            without noise.
        tilt_deg: standard deviation of the root's roll and of its pitch at the start, degrees.
        push: standard deviation of a random walk of the root's velocity in each direction, m/s per
            square root of a second.
        friction: largest fraction by which the ground's friction of a trial differs from its value.
    """

    joint_angle_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    tilt_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    push: NotNegative = 0.0
    friction: Annotated[float, Field(ge=0, lt=1)] = 0.0

    @property
    def silent(self) -> bool:
        """Return whether all disturbances are 0."""
        return not any(self.model_dump().values())
