"""All that a trial takes but the genes."""

import equinox as eqx

from evo_cpg.control.controller import Controller
from evo_cpg.fusion.engine import Engine
from evo_cpg.physics.world import World
from evo_cpg.simulation.genome import Genome
from evo_cpg.simulation.measures import Measures
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.rules import Rules
from evo_cpg.simulation.sensor import Sensor
from evo_cpg.simulation.sensors import Sensors
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.task import Task
from evo_cpg.spatial.numerics import Number, Triple


class Simulation(eqx.Module):
    """Everything that a trial needs but the genes.

    Attributes:
        world: the creature in its surroundings.
        sensors: where its sensors sit.
        controller: its nervous system.
        task: what it is judged by.
        control_rate: control steps per second, 1/s.
        substeps: physics steps per control step.
        steps: control steps in a trial.
        noise: how much is left to chance.
        situations: what each trial of an individual begins with, or one for all of its trials.
        engine: what computes it.
        rules: what an animal is out for breaking; None where it may do anything.
        extra_sensors: those of the creature's `sensors`, which give `Observation.custom`.
        measures: of gait, beside the task's terms.
    """

    world: World
    sensors: Sensors
    controller: Controller
    task: Task
    control_rate: Number
    substeps: int = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    noise: Noise = Noise()
    situations: tuple[Situation, ...] = (Situation(),)
    engine: Engine = eqx.field(static=True, default=Engine())
    extra_sensors: tuple[Sensor, ...] = ()
    rules: Rules | None = None
    measures: Measures = Measures()

    @property
    def genome(self) -> Genome:
        """Meaning of the genes."""
        return Genome(self.controller)

    @property
    def duration(self) -> float:
        """Of a trial, s."""
        return self.steps / self.control_rate

    @property
    def step_length(self) -> float:
        """Length of a physics step, s."""
        return 1.0 / (self.control_rate * self.substeps)

    @property
    def lights(self) -> tuple[Triple | None, ...]:
        """Where the light is in each situation, m; None for tasks in the dark."""
        return tuple(situation.light or self.task.light for situation in self.situations)
