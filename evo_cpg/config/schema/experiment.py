"""The whole file."""

from typing import Annotated

from pydantic import Field, model_validator

from evo_cpg.config.schema.audit import AuditConfig
from evo_cpg.config.schema.controller import BrainCpgConfig, ControllerConfig
from evo_cpg.config.schema.creature import CreatureConfig
from evo_cpg.config.schema.evolution import EvolutionConfig, RealEvolutionConfig
from evo_cpg.config.schema.section import Section, pattern
from evo_cpg.config.schema.task import ReachLightConfig, TaskConfig
from evo_cpg.config.schema.trial import NoiseConfig, SimulationConfig
from evo_cpg.config.schema.world import WorldConfig
from evo_cpg.fusion.engine import EngineName, InstructionSet


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
        measures: of gait, to be had beside the task's terms, by their names, such as ``speed``.
            Those of a map's axes need not be said here.
        evolution: the search, by default a genetic algorithm.
        audit: what is asked of the champion.
        engine: what computes the trials: ``auto`` and ``native`` take machine code made on the
            spot, the first only where it can be had; ``jax`` takes JAX alone, many times slower.
        instruction_set: of the machine code; ``host`` is the largest that this processor has.
    """

    name: Annotated[
        str,
        *pattern(
            r"^[^./\\\x00][^/\\\x00]*$",
            "must be the name of a folder: not empty, without / and \\, no dot at its beginning",
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
        """Trials of every individual; without noise, one in each situation."""
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
        # Other strategies take whatever the genome is made of.
        if genome is not None and given in ("real", "bits") and given != genome:
            raise ValueError(
                f"a controller of type {self.controller.type!r} has a genome of "
                f"{'bits' if genome == 'bits' else 'real numbers'}: set evolution.type to "
                f"{genome!r}, not {given!r}"
                f"{', or controller.graded to true' if genome == 'bits' else ''}"
            )
        return self
