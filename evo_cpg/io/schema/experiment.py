"""Schema of the whole file."""

from typing import Annotated

from pydantic import Field, model_validator

from evo_cpg.io.schema.audit import AuditConfig
from evo_cpg.io.schema.controller import BrainCpgConfig, ControllerConfig
from evo_cpg.io.schema.creature import CreatureConfig
from evo_cpg.io.schema.evolution import EvolutionConfig, RealEvolutionConfig
from evo_cpg.io.schema.section import Section, pattern
from evo_cpg.io.schema.task import ReachLightConfig, TaskConfig
from evo_cpg.io.schema.trial import NoiseConfig, SimulationConfig
from evo_cpg.io.schema.world import WorldConfig
from evo_cpg.native.engine import EngineName, InstructionSet


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
    controller: ControllerConfig = BrainCpgConfig()
    task: TaskConfig = ReachLightConfig()
    measures: tuple[str, ...] = ()
    evolution: EvolutionConfig = RealEvolutionConfig()
    audit: AuditConfig = AuditConfig()  # pyright: ignore[reportInvalidTypeForm]
    engine: EngineName = "auto"
    instruction_set: InstructionSet = "host"

    @property
    def trial_count(self) -> int:
        """Number of trials of every individual.

        It is the number of listed situations. Without a list it is the configured number with
        noise, and 1 without noise.
        """
        trials = self.simulation.trials
        if isinstance(trials, list):
            return len(trials)
        return 1 if self.noise.silent else trials

    @model_validator(mode="after")
    def _check(self) -> "ExperimentConfig":
        if self.seed + self.runs > 2**31:
            raise ValueError(
                f"runs: the seed of the last of {self.runs} runs must be less than {2**31}, got "
                f"{self.seed + self.runs - 1}"
            )
        genome, given = self.controller.genome, self.evolution.type
        # Strategies other than ``real`` and ``bits`` evolve both kinds of genome.
        if genome is not None and given in ("real", "bits") and given != genome:
            raise ValueError(
                f"a controller of type {self.controller.type!r} has a genome of "
                f"{'bits' if genome == 'bits' else 'real numbers'}: set evolution.type to "
                f"{genome!r}, not {given!r}"
                f"{', or controller.graded to true' if genome == 'bits' else ''}"
            )
        return self
