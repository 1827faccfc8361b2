"""Everything that a trial needs except the genes."""

import equinox as eqx

from evo_cpg.control.controller import Controller
from evo_cpg.creature.algebra.numerics import Number, Triple
from evo_cpg.native.engine import Engine
from evo_cpg.physics.step.world import World
from evo_cpg.simulation.genome import Genome
from evo_cpg.simulation.measures import Measures
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.rules import Rules
from evo_cpg.simulation.sensor import Sensor
from evo_cpg.simulation.sensors import Sensors
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.task import Task


class Simulation(eqx.Module):
    """Everything that a trial needs except the genes.

    Attributes:
        world: the creature and its environment.
        sensors: places of the creature's sensors.
        controller: nervous system of the creature.
        task: task that the trial is scored by.
        control_rate: control steps per second, 1/s.
        substeps: physics steps per control step.
        steps: control steps in a trial.
        noise: sizes of the noise.
        situations: initial situation (pose and light) of each trial of an individual, or one for
            all trials.
        engine: engine that computes the trial.
        rules: rules that disqualify an animal, or None for no rules.
        extra_sensors: sensors in the creature's `sensors`, which return `Observation.custom`.
        measures: measures of gait, in addition to the task's terms.
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
        """Layout of the genes."""
        return Genome(self.controller)

    @property
    def duration(self) -> float:
        """Duration of a trial, s."""
        return self.steps / self.control_rate

    @property
    def step_length(self) -> float:
        """Length of a physics step, s."""
        return 1.0 / (self.control_rate * self.substeps)

    @property
    def lights(self) -> tuple[Triple | None, ...]:
        """Place of the light in each situation, m, or None for tasks in the dark."""
        return tuple(situation.light or self.task.light for situation in self.situations)
