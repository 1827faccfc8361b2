"""What a configuration file may say: SI units, angles in degrees where ``_deg`` says so."""

import dataclasses
import typing
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, create_model, model_validator

from evo_cpg.config.creature_schema import (
    CreatureConfig,
    Finite,
    NotNegative,
    Positive,
    Section,
    Share,
    Vector,
)
from evo_cpg.control.brain_cpg import BrainCpgSettings
from evo_cpg.control.postures import PostureSettings
from evo_cpg.evolution.bits import BitGenetics
from evo_cpg.evolution.generation import RealGenetics
from evo_cpg.physics.contact import Combination
from evo_cpg.physics.fluid import DragLaw
from evo_cpg.simulation.walk import Heading

# Far beyond what anybody waits for, and within 32 bits.
Count = Annotated[int, Field(ge=1, le=1_000_000)]


class WaterConfig(Section):
    """Water around the whole creature.

    Attributes:
        density: kg/m^3.
        form_drag: C_d of the normal velocity at every surface point.
        skin_drag: C_f of the tangential velocity.
        current: velocity of the water, m/s.
        law: ``normal`` splits the drag as above; ``isotropic`` is eq. 8 to the letter.
        sheltered: leave out faces that other bodies cover at rest.
        points: ``quadrature`` places the points evenly; ``random`` draws them once, as the paper
            says, from ``points_seed``.
        form_resolution: points for form drag: its square on each face of a box.
        skin_resolution: points for skin friction, likewise.
        random_points: points on each body when they are random.
        points_seed: seed of random points.
    """

    density: Positive = 1000.0
    form_drag: NotNegative = 1.0
    skin_drag: NotNegative = 0.02
    current: Vector = (0.0, 0.0, 0.0)
    law: DragLaw = "normal"
    sheltered: bool = True
    points: Literal["quadrature", "random"] = "quadrature"
    form_resolution: Annotated[int, Field(ge=1, le=32)] = 2
    skin_resolution: Annotated[int, Field(ge=1, le=32)] = 1
    random_points: Annotated[int, Field(ge=1, le=10_000)] = 32
    points_seed: Annotated[int, Field(ge=0)] = 0


class GroundConfig(Section):
    """Flat, level ground at height 0.

    Attributes:
        restitution: of the ground's material.
        static_friction: of the ground's material.
        dynamic_friction: of the ground's material.
        restitution_rule: how the body's and the ground's restitution combine.
        friction_rule: how their frictions combine.
        margin: points nearer than this are watched for an impact, m.
        stribeck_speed: sliding speed at which friction is half-way from static to dynamic, m/s.
    """

    restitution: Share = 0.5
    static_friction: NotNegative = 0.8
    dynamic_friction: NotNegative = 0.8
    restitution_rule: Combination = "multiply"
    friction_rule: Combination = "geometric"
    margin: Positive = 0.05
    stribeck_speed: Positive = 0.01


class WorldConfig(Section):
    """Gravity (m/s^2, downwards), water (none: ``water: null``) and ground (none unless given)."""

    gravity: NotNegative = 9.81
    water: WaterConfig | None = WaterConfig()
    ground: GroundConfig | None = None


class SimulationConfig(Section):
    """A trial: control steps of ``1 / control_rate_hz`` s with ``substeps`` physics steps each.

    Attributes:
        control_rate_hz: control steps per second, 1/s.
        substeps: physics steps in a control step.
        steps: control steps.
        start_clearance: of the creature's lowest point above the ground at the start, m.
        trials: of every individual, over which its fitness is averaged; one without noise.
    """

    control_rate_hz: Positive = 60.0
    substeps: Count = 2
    steps: Count = 2000
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


class CustomConfig(Section):
    """A class of your own: ``type: my_module:MyClass``, built with ``options``."""

    type: Annotated[str, Field(pattern=r"^[\w.]+:\w+$")]
    options: dict[str, Any] = Field(default_factory=dict)


class LightConfig(Section):
    """Where the light is, seen from the root at the start.

    Attributes:
        distance: m.
        bearing_deg: to the left of straight ahead, degrees.
        elevation_deg: above the horizon, degrees.
    """

    distance: Positive = 8.0
    bearing_deg: Finite = 30.0
    elevation_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0

    def position(self) -> tuple[float, float, float]:
        """Place of the light, m."""
        bearing, elevation = np.deg2rad([self.bearing_deg, self.elevation_deg])
        level = self.distance * np.cos(elevation)
        return (
            float(level * np.cos(bearing)),
            float(level * np.sin(bearing)),
            float(self.distance * np.sin(elevation)),
        )


class ReachLightConfig(Section):
    """Iwadate 2010, eqs. 9 and 10, on normalised terms: a > c > b.

    Attributes:
        type: ``reach_light``.
        light: the goal.
        distance_weight: a.
        light_weight: c.
        energy_weight: b.
        final_seconds: time at the end over which the distance is averaged, s.
    """

    type: Literal["reach_light"] = "reach_light"
    light: LightConfig = LightConfig()
    distance_weight: NotNegative = 1.0
    light_weight: NotNegative = 0.5
    energy_weight: NotNegative = 0.2
    final_seconds: Positive = 1.0

    @model_validator(mode="after")
    def _check(self) -> "ReachLightConfig":
        if not self.distance_weight > self.light_weight > self.energy_weight:
            raise ValueError(
                "eq. 10 asks for distance_weight > light_weight > energy_weight, got "
                f"{self.distance_weight:g}, {self.light_weight:g}, {self.energy_weight:g}"
            )
        return self


class DistanceConfig(Section):
    """Fukui 2003: distance moved, whatever the posture.

    Attributes:
        type: ``distance``.
        heading: ``any`` direction, or ``forward``.
    """

    type: Literal["distance"] = "distance"
    heading: Heading = "any"


class WalkConfig(Section):
    """Distance, less what running has and walking has not; weights in torso lengths of way.

    Attributes:
        type: ``walk``.
        heading: ``any`` direction, or ``forward``.
        distance_weight: of the distance, in torso lengths.
        tilt_weight: of the torso's tilt: 0 upright, 1 on the side, 2 on the back.
        bounce_weight: of the standard deviation of its height, in torso lengths.
        airborne_weight: of the share of time in which nothing touches the ground.
    """

    type: Literal["walk"] = "walk"
    heading: Heading = "any"
    distance_weight: NotNegative = 1.0
    tilt_weight: NotNegative = 20.0
    bounce_weight: NotNegative = 20.0
    airborne_weight: NotNegative = 10.0


def _section_of(settings: type, name: str, kind: str) -> type[Section]:
    """The configuration section of a settings dataclass, which keeps keys and defaults."""
    hints = typing.get_type_hints(settings)
    fields: dict[str, Any] = {"type": (Literal[kind], kind)}
    for field in dataclasses.fields(settings):
        default = field.default
        if default is dataclasses.MISSING:
            assert field.default_factory is not dataclasses.MISSING
            default = field.default_factory()
        fields[field.name] = (hints[field.name], default)
    return create_model(name, __base__=Section, __doc__=settings.__doc__, **fields)


BrainCpgConfig = _section_of(BrainCpgSettings, "BrainCpgConfig", "brain_cpg")
PosturesConfig = _section_of(PostureSettings, "PosturesConfig", "postures")


def _kind(default: str):
    def kind(value: Any) -> str:
        written = value.get("type", default) if isinstance(value, dict) else None
        given = getattr(value, "type", default) if written is None else written
        return "custom" if isinstance(given, str) and ":" in given else str(given)

    return kind


class EvolutionConfig(Section):
    """The genetic algorithm on real-valued genomes.

    Attributes:
        type: ``real``.
        generations: to evolve.
        population: individuals.
        elites: best individuals that pass on unchanged.
        parent_fraction: best part of the population that may become parents; the chance falls
            linearly with the rank.
        crossover_probability: that two parents' genomes are cut at one place and rejoined.
        mutation_rate: probability that a gene changes.
        mutation_sigma: standard deviation of a change.
        gene_bound: largest magnitude of a gene.
    """

    type: Literal["real"] = "real"
    generations: Count = 50
    population: Annotated[int, Field(ge=2, le=1_000_000)] = 200
    elites: Annotated[int, Field(ge=0)] = 20
    parent_fraction: Annotated[float, Field(gt=0, le=1)] = 0.5
    crossover_probability: Share = 0.2
    mutation_rate: Share = 0.05
    mutation_sigma: NotNegative = 0.5
    gene_bound: Positive = 8.0

    def build(self) -> RealGenetics:
        """The settings of the generation step."""
        return RealGenetics(
            population=self.population,
            elite_count=self.elites,
            parent_fraction=self.parent_fraction,
            crossover_probability=self.crossover_probability,
            mutation_rate=self.mutation_rate,
            mutation_sigma=self.mutation_sigma,
            gene_bound=self.gene_bound,
        )

    @model_validator(mode="after")
    def _check(self) -> "EvolutionConfig":
        if self.elites >= self.population:
            raise ValueError(
                f"elites: must be fewer than the population of {self.population}, got {self.elites}"
            )
        return self


class BitEvolutionConfig(Section):
    """The genetic algorithm on bits of Fukui 2003, chapter 3, whose numbers are the defaults.

    Attributes:
        type: ``bits``.
        generations: to evolve.
        population: individuals.
        elites: best individuals that pass on unchanged; children fill the other places.
        best_copies: how many of the kept places hold the best individual.
        rank_probabilities: that a parent is of each rank, best first.
        mutation_probability: that a child mutates.
        mutated_genes: fewest and most genes that a mutation changes.
        mutation: whether a changed gene is drawn anew or flipped.
    """

    type: Literal["bits"] = "bits"
    generations: Count = 500
    population: Annotated[int, Field(ge=2, le=1_000_000)] = 15
    elites: Annotated[int, Field(ge=0)] = 7
    best_copies: Count = 1
    rank_probabilities: tuple[Share, ...] = BitGenetics().rank_probabilities
    mutation_probability: Share = 0.5
    mutated_genes: tuple[Count, Count] = (2, 30)
    mutation: Literal["redraw", "flip"] = "redraw"

    def build(self) -> BitGenetics:
        """The settings of the generation step.

        Raises:
            ValueError: values that do not go together.
        """
        fewest, most = self.mutated_genes
        return BitGenetics(
            population=self.population,
            elite_count=self.elites,
            best_copies=self.best_copies,
            rank_probabilities=self.rank_probabilities,
            mutation_probability=self.mutation_probability,
            mutated_genes_min=fewest,
            mutated_genes_max=most,
            mutation=self.mutation,
        )

    @model_validator(mode="after")
    def _check(self) -> "BitEvolutionConfig":
        self.build()
        return self


class ExperimentConfig(Section):
    """A whole experiment; every section but the creature has defaults.

    Attributes:
        name: of the run, and of its folder.
        seed: of all randomness; of the first run where there are several.
        runs: independent populations that evolve side by side, with the seeds ``seed``,
            ``seed + 1`` and so on.
        creature: the animal, or the path of its own file.
        world: gravity, water and ground.
        simulation: the trial.
        noise: what is left to chance in it.
        controller: the nervous system.
        task: what the animals are judged by.
        evolution: the genetic algorithm.
    """

    name: Annotated[str, Field(pattern=r"^[^./\\][^/\\]*$")]
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    runs: Annotated[int, Field(ge=1, le=10_000)] = 1
    creature: CreatureConfig
    world: WorldConfig = WorldConfig()
    simulation: SimulationConfig = SimulationConfig()
    noise: NoiseConfig = NoiseConfig()
    # BrainCpgConfig is a class made while this file runs, which pyright cannot follow.
    controller: Annotated[
        Annotated[BrainCpgConfig, Tag("brain_cpg")]  # pyright: ignore[reportInvalidTypeForm]
        | Annotated[PosturesConfig, Tag("postures")]  # pyright: ignore[reportInvalidTypeForm]
        | Annotated[CustomConfig, Tag("custom")],
        Discriminator(_kind("brain_cpg")),
    ] = BrainCpgConfig()
    task: Annotated[
        Annotated[ReachLightConfig, Tag("reach_light")]
        | Annotated[DistanceConfig, Tag("distance")]
        | Annotated[WalkConfig, Tag("walk")]
        | Annotated[CustomConfig, Tag("custom")],
        Discriminator(_kind("reach_light")),
    ] = ReachLightConfig()
    evolution: Annotated[
        Annotated[EvolutionConfig, Tag("real")] | Annotated[BitEvolutionConfig, Tag("bits")],
        Discriminator(_kind("real")),
    ] = EvolutionConfig()

    @model_validator(mode="after")
    def _check(self) -> "ExperimentConfig":
        if self.seed + self.runs > 2**31:
            raise ValueError(
                f"runs: the seed of the last of {self.runs} runs must be less than {2**31}, got "
                f"{self.seed + self.runs - 1}"
            )
        wanted = {"postures": "bits", "brain_cpg": "real"}.get(self.controller.type)
        if wanted not in (None, self.evolution.type):
            raise ValueError(
                f"a controller of type {self.controller.type!r} has a genome of "
                f"{'bits' if wanted == 'bits' else 'real numbers'}: set evolution.type to "
                f"{wanted!r}, not {self.evolution.type!r}"
            )
        return self
