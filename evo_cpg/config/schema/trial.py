"""How long a trial takes, in which steps, and what is left to chance in it."""

from typing import Annotated

from pydantic import Field

from evo_cpg.config.schema.section import Count, Finite, NotNegative, Positive, Section


class SimulationConfig(Section):
    """A trial: control steps of ``1 / control_rate_hz`` s with ``substeps`` physics steps each.

    Attributes:
        control_rate_hz: control steps per second, 1/s.
        substeps: physics steps in a control step.
        steps: control steps.
        start: x and y of the root's centre at the start, m.
        start_heading_deg: by which it is turned to the left at the start, degrees.
        start_clearance: of the creature above the ground at the start, m.
        trials: of every individual, over which its fitness is averaged; one without noise.
    """

    control_rate_hz: Positive = 60.0
    substeps: Count = 2
    steps: Count = 2000
    start: tuple[Finite, Finite] = (0.0, 0.0)
    start_heading_deg: Finite = 0.0
    start_clearance: NotNegative = 0.0
    trials: Annotated[int, Field(ge=1, le=10_000)] = 1


class NoiseConfig(Section):
    """What is left to chance in a trial; nothing unless given.

    Attributes:
        joint_angle_deg: standard deviation of every joint angle at the start, degrees.
        tilt_deg: standard deviation of the root's roll and of its pitch at the start, degrees.
        push: random walk of the root's velocity in each direction, m/s per square root of a
            second.
    """

    joint_angle_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    tilt_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    push: NotNegative = 0.0
