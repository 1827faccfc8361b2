"""Everything that a trial needs, and the meaning of the genes, which is defined here only.

A genome is a vector of numbers. At present all of them belong to the controller. Anything else that
evolves is counted, drawn and decoded here, and gets a field of `Phenotype`. Searches, run
folders, commands and the API treat a genome as a vector of `Genome.count` numbers.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from evo_cpg.control.controller import Controller
from evo_cpg.creature.algebra.numerics import Number, Triple
from evo_cpg.native.engine import Engine
from evo_cpg.physics.contact.pairs import Pairs
from evo_cpg.physics.step.world import World
from evo_cpg.simulation.measures import DISPLACEMENT, Measures, RootDisplacement
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.sensors import Sensor, Sensors
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.task import Task


class Phenotype(NamedTuple):
    """Decoded genes of every individual.

    Attributes:
        controller: genes as `Controller.act` takes them, see `Controller.decode`.
    """

    controller: PyTree[Array]


class Genome(NamedTuple):
    """Layout of the genes of an experiment's individuals.

    Attributes:
        controller: controller that the genes belong to.
    """

    controller: Controller

    @property
    def count(self) -> int:
        """Number of genes."""
        return self.controller.gene_count

    @property
    def binary(self) -> bool:
        """Return whether genes are bits, 0 or 1."""
        return self.controller.binary

    def random(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type = jnp.float32
    ) -> Float[Array, "g *n"]:
        """Return genes of a first generation, which a controller may draw as integers or bits."""
        return jnp.asarray(self.controller.random_genes(key, batch, dtype), dtype)

    def decode(self, genes: Float[Array, "g *n"]) -> Phenotype:
        """Return the decoded genes. Called once per trial."""
        return Phenotype(self.controller.decode(genes))

    def misfit(self, genes: Float[np.ndarray, " _"]) -> str | None:
        """Return the reason why genes of one individual do not fit, or None if they fit."""
        if genes.shape == (self.count,):
            return None
        return f"the genome has {genes.size} genes, not {self.count}"


class Rules(eqx.Module):
    """Limits on the motion of an animal. None is no limit.

    Attributes:
        speed: largest speed of the root, m/s.
        power: largest power of all motors together, mean over a control step, W.
        penetration: largest depth of a contact point in the ground, m.
        overlap: largest overlap of two bodies, m.
        pairs: pairs of bodies that are checked for overlap, or None if no bodies can touch.
    """

    speed: Number | None = None
    power: Number | None = None
    penetration: Number | None = None
    overlap: Number | None = None
    pairs: Pairs | None = None


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


def with_displacement(simulation: Simulation) -> Simulation:
    """Return the same trial with the displacement among its terms, as `DISPLACEMENT`."""
    measure = RootDisplacement(lit=simulation.task.light is not None)
    added = Measures((DISPLACEMENT,), (measure,))
    return dataclasses.replace(simulation, measures=simulation.measures | added)
