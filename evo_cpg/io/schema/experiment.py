"""Schema of the whole file, and sections of a trial: duration, steps, situations and noise."""

import contextlib
from typing import Annotated, Any, Literal

from pydantic import (
    Discriminator,
    Field,
    Tag,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from evo_cpg.io.schema.audit import AuditConfig
from evo_cpg.io.schema.controller import BrainCpgConfig, ControllerConfig
from evo_cpg.io.schema.creature import CreatureConfig
from evo_cpg.io.schema.evolution import EvolutionConfig, RealEvolutionConfig
from evo_cpg.io.schema.plans import PlanConfig
from evo_cpg.io.schema.section import (
    Count,
    Direction,
    Finite,
    NotNegative,
    OpenSection,
    Positive,
    Section,
    pattern,
)
from evo_cpg.io.schema.task import LightConfig, ReachLightConfig, TaskConfig
from evo_cpg.io.schema.world import WorldConfig
from evo_cpg.native.engine import EngineName, InstructionSet

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


TrialsConfig = Annotated[
    Annotated[int, Field(ge=1, le=_MOST_TRIALS), Tag("number")]
    | Annotated[list[SituationConfig], Field(min_length=1, max_length=_MOST_TRIALS), Tag("list")],
    Discriminator(lambda value: "list" if isinstance(value, (list, tuple)) else "number"),
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
        trials: trials over which fitness is averaged: their number, which is one if nothing is
            random, or a list of situations.
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


class CoursesConfig(Section):
    """Courses: what differs between the trials of an individual, and how they count together.

    Attributes:
        draw: range of each number that is drawn, by its key or a pattern of keys, such as
            ``world.water.current.0``; the numbers are uniform and independent.
        every: number of generations after which courses are drawn again, or ``null`` for never.
        score: fitness of several trials: ``mean``, ``worst``, or a quantile, such as 0.25.
    """

    draw: dict[str, tuple[Finite, Finite]] = Field(default_factory=dict)
    every: Count | None = 1
    score: Annotated[
        Annotated[Literal["mean", "worst"], Tag("word")]
        | Annotated[float, Field(ge=0, le=1), Tag("number")],
        Discriminator(lambda value: "word" if isinstance(value, str) else "number"),
    ] = "mean"

    @field_validator("draw")
    @classmethod
    def _rises(cls, draw: dict[str, tuple[Finite, Finite]]) -> dict[str, tuple[Finite, Finite]]:
        for key, (low, high) in draw.items():
            if not low < high:
                raise ValueError(f"{key}: the range must rise, got {low:g} to {high:g}")
        return draw

    @property
    def quantile(self) -> float | None:
        """Quantile of the trials that counts, or None for the mean."""
        return {"mean": None, "worst": 0.0}.get(self.score, self.score)  # pyright: ignore


class ExperimentConfig(Section):
    """A whole experiment, with defaults for every section but the creature.

    Attributes:
        name: name of the run and of its folder.
        seed: seed of all randomness (with several runs, the seed of the first).
        runs: number of independent populations that evolve in parallel, with the seeds ``seed``,
            ``seed + 1`` and so on.
        creature: creature, or the path of its own file.
        world: gravity, water and ground.
        simulation: settings of the trial.
        noise: random disturbances in the trial.
        courses: numbers that are drawn for each trial, and how trials count together.
        controller: nervous system.
        task: task that determines fitness.
        measures: names of measures of gait, such as ``speed``, that are recorded in addition to
            the task's terms (measures on a map's axes are always included).
        evolution: search, by default a genetic algorithm.
        audit: limits for the champion.
        engine: engine of the trials: ``native`` compiles machine code, ``auto`` does so if
            possible, and ``jax`` uses JAX alone, many times slower.
        instruction_set: instruction set of the machine code (``host``: the processor's largest).
    """

    name: Annotated[
        str,
        *pattern(
            r"^[^./\\\x00][^/\\\x00]*$",
            "must be the name of a folder: not empty, without / and \\, not beginning with a dot",
        ),
    ]
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    runs: Annotated[int, Field(ge=1, le=10_000)] = 1
    creature: CreatureConfig
    world: WorldConfig = WorldConfig()
    simulation: SimulationConfig = SimulationConfig()
    noise: NoiseConfig = NoiseConfig()
    courses: CoursesConfig = CoursesConfig()
    controller: ControllerConfig = BrainCpgConfig()
    task: TaskConfig = ReachLightConfig()
    measures: tuple[str, ...] = ()
    evolution: EvolutionConfig = RealEvolutionConfig()
    audit: AuditConfig = AuditConfig()  # pyright: ignore[reportInvalidTypeForm]
    engine: EngineName = "auto"
    instruction_set: InstructionSet = "host"

    @model_validator(mode="before")
    @classmethod
    def _add_plans(cls, data: Any) -> Any:
        """Add the creature that stands for all plans, unless the file has their ancestor."""
        search = data.get("evolution") if isinstance(data, dict) else None
        if not isinstance(search, dict) or search.get("type") != "plans":
            return data
        section = PlanConfig()
        # The section itself reports its errors.
        with contextlib.suppress(ValidationError):
            section = PlanConfig.model_validate(search.get("plan") or {})
        controller = data.get("controller") or {"type": "limb_oscillators"}
        creature = data.get("creature") or section.star()
        return {**data, "creature": creature, "controller": controller}

    @model_validator(mode="before")
    @classmethod
    def _add_rules(cls, data: Any) -> Any:
        """Disqualify by the limits that matter to evolving bodies, unless the file decides."""
        if not isinstance(data, dict):
            return data
        search, audit = (data.get(key) for key in ("evolution", "audit"))
        plans = isinstance(search, dict) and search.get("type") == "plans"
        evolve = plans or (isinstance(search, dict) and search.get("body"))
        if not evolve or not isinstance(audit or {}, dict) or "disqualify" in (audit or {}):
            return data
        rules, world = ["speed", "joint_rate"], data.get("world") or {}
        rules += ["overlap"] * plans
        if plans and isinstance(world, dict) and world.get("ground") is not None:
            rules.append("penetration")
        return {**data, "audit": {**(audit or {}), "disqualify": rules}}

    @property
    def trial_count(self) -> int:
        """Number of trials of every individual.

        It is the number of listed situations. Without a list it is the configured number if
        anything is random, else 1.
        """
        trials = self.simulation.trials
        if isinstance(trials, list):
            return len(trials)
        return 1 if self.silent else trials

    @property
    def silent(self) -> bool:
        """Whether nothing in a trial is random. A user's own task may draw courses."""
        drawn = self.courses.draw or self.task.draws_course
        return self.noise.silent and not (drawn or (self.creature and self.creature.senses.noisy))

    @model_validator(mode="after")
    def _check(self) -> "ExperimentConfig":
        if self.seed + self.runs > 2**31:
            raise ValueError(
                f"runs: the seed of the last of {self.runs} runs must be less than {2**31}, got "
                f"{self.seed + self.runs - 1}"
            )
        settling = getattr(self.task, "settle_seconds", 0.0)
        if settling >= self.simulation.seconds:
            raise ValueError(
                f"task.settle_seconds: {settling:g} s leave nothing of a trial of "
                f"{self.simulation.seconds:g} s"
            )
        # Graded genes are numbers, so both genetic algorithms can evolve them.
        graded = getattr(self.controller, "graded", False)
        genome, given = None if graded else self.controller.genome, self.evolution.type
        # Strategies other than ``real`` and ``bits`` evolve both kinds of genome.
        if genome is not None and given in ("real", "bits") and given != genome:
            raise ValueError(
                f"a controller of type {self.controller.type!r} has a genome of "
                f"{'bits' if genome == 'bits' else 'real numbers'}: set evolution.type to "
                f"{genome!r}, not {given!r}"
                f"{', or controller.graded to true' if genome == 'bits' else ''}"
            )
        return self
