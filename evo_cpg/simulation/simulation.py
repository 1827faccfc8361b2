"""Everything that a trial needs, and the meaning of the genes, which is defined here only.

A genome is a vector of numbers: the controller's genes come first, then the body's. Anything else
that evolves is counted, drawn and decoded here, and gets a field of `Phenotype`. Searches, run
folders, commands and the API treat a genome as a vector of `Genome.count` numbers.
"""

import abc
import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree, Shaped, UInt32

from evo_cpg.control.controller import Controller
from evo_cpg.creature.algebra.numerics import Number, Triple, xp
from evo_cpg.native.engine import Engine
from evo_cpg.physics.contact.pairs import Pairs
from evo_cpg.physics.step.world import World
from evo_cpg.simulation.imperfect import Imperfection
from evo_cpg.simulation.measures import DISPLACEMENT, Measures, RootDisplacement, RootTravel
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.sensors import Sensor, Sensors
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.task import Task

if TYPE_CHECKING:
    from evo_cpg.simulation.planned import PlanBuilder

# Bits of a body's gene in a binary genome: 256 values between its bounds.
_BITS = 8


class BodyGenes(NamedTuple):
    """Genes of the body: each is a factor between two bounds, which scales some numbers.

    A real-valued gene covers its range from -1 to 1. Beyond, it is mirrored at the bounds, so that
    no mutation is lost and the smallest and the largest factor can be reached. In a binary genome a
    factor has 8 bits, in the Gray code: neighbouring values differ in one bit.

    Attributes:
        names: name of each factor, such as ``tail.length``.
        low: smallest value of each factor.
        high: largest value of each factor.
        logarithmic: whether equal steps of a gene multiply the factor, and do not add to it.
        units: value of the named quantity at a factor of 1: m for a length, or 1.
        binary: whether genes are bits.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    logarithmic: tuple[bool, ...]
    units: tuple[float, ...]
    binary: bool = False

    @property
    def number(self) -> int:
        """Number of genes."""
        return len(self.names) * (_BITS if self.binary else 1)

    def random(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        """Return random genes, spread evenly over their range."""
        genes = jax.random.uniform(key, (self.number, *batch), dtype, -1.0, 1.0)
        return (genes > 0).astype(dtype) if self.binary else genes

    def factors(self, genes: Any) -> Any:
        """Return the factors ``(f, *n)`` of genes ``(g, *n)``, which may be traced."""
        if self.binary:
            code = xp.cumsum(genes.reshape(len(self.names), _BITS, *genes.shape[1:]), 1) % 2
            weights = 2.0 ** np.arange(_BITS)[::-1] / (2**_BITS - 1)
            part = xp.moveaxis(code, 1, -1) @ weights
        else:
            part = 1.0 - xp.abs((genes + 1.0) / 2.0 % 2.0 - 1.0)
        return self.at(part)

    def at(self, part: Any) -> Any:
        """Return the factors ``(f, *n)`` at fractions of their ranges, from 0 to 1."""
        column = (-1, *(1,) * (part.ndim - 1))
        low, high, log = (
            np.array(x).reshape(column) for x in (self.low, self.high, self.logarithmic)
        )
        ratio = np.where(log, high / np.where(log, low, 1.0), 1.0)
        return xp.where(log, low * ratio**part, low + (high - low) * part)


class Phenotype(NamedTuple):
    """Decoded genes of every individual, except those of the body.

    The body's genes become numbers of the simulation before the trial (see `BodyBuilder`).

    Attributes:
        controller: genes as `Controller.act` takes them, see `Controller.decode`.
    """

    controller: PyTree[Array]


class Genome(NamedTuple):
    """Layout of the genes of an experiment's individuals.

    Attributes:
        controller: controller that the first genes belong to.
        body: genes of the body, or None if the body does not evolve.
        plans: builder of the simulations of plans, or None if no plan evolves. A plan's genes
            include those of its controller.
    """

    controller: Controller
    body: BodyGenes | None = None
    plans: "PlanBuilder | None" = None

    @property
    def count(self) -> int:
        """Number of genes."""
        if self.plans:
            return self.plans.layout.count
        return self.controller.gene_count + (self.body.number if self.body else 0)

    @property
    def binary(self) -> bool:
        """Return whether genes are bits, 0 or 1."""
        return self.controller.binary

    def random(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type = jnp.float32
    ) -> Float[Array, "g *n"]:
        """Return genes of a first generation, which a controller may draw as integers or bits."""
        if self.plans:
            return self.plans.random(key, batch, dtype)
        genes = jnp.asarray(self.controller.random_genes(key, batch, dtype), dtype)
        if not self.body:
            return genes
        own = self.body.random(jax.random.fold_in(key, 1), batch, dtype)
        return jnp.concatenate([genes, own])

    def decode(self, genes: Float[Array, "g *n"]) -> Phenotype:
        """Return the decoded genes. Called once per trial."""
        return Phenotype(self.controller.decode(genes[: self.controller.gene_count]))

    def of_body(self, genes: Any) -> Any:
        """Return the genes of the body alone, of genes ``(g, *n)``."""
        return genes[self.controller.gene_count :]

    @property
    def sizes(self) -> tuple[str, ...]:
        """Names of the evolved quantities of the body."""
        return self.body.names if self.body else ()

    def sizes_of(self, genes: Float[np.ndarray, " g"]) -> dict[str, float]:
        """Return the evolved quantities of one individual's body: lengths in m, and factors."""
        if not self.body:
            return {}
        sizes = self.body.factors(self.of_body(genes).astype(float)) * np.array(self.body.units)
        return dict(zip(self.body.names, sizes.tolist(), strict=True))

    def misfit(self, genes: Float[np.ndarray, " _"]) -> str | None:
        """Return the reason why genes of one individual do not fit, or None if they fit."""
        if genes.shape == (self.count,):
            return None
        return f"the genome has {genes.size} genes, not {self.count}"


class NumberBuilder(abc.ABC):
    """Builder of numbers of a simulation that differ from trial to trial.

    All simulations of an experiment have one plan. So one program serves all, and the numbers are
    its inputs. They are functions of the genes of a body, or of the random key of a course.

    Attributes:
        inputs: for each leaf of the simulation that differs, its path and the indices of its
            numbers that differ.
    """

    inputs: tuple[tuple[str, Int[np.ndarray, " _"]], ...]

    @abc.abstractmethod
    def values(self, origin: Shaped[np.ndarray, "b n"]) -> list[Float[np.ndarray, "_ n"]]:
        """Return the values of the inputs, in float64, leaf by leaf.

        The values of a simulation do not depend on the others, to the last bit. They are NaN if it
        does not fit the plan, so that the individual counts as diverged.

        Args:
            origin: genes of bodies, or raw random keys of courses.
        """

    @abc.abstractmethod
    def traced(self, origin: Shaped[Array, " b"]) -> list[Array]:
        """Return the values of the inputs of one simulation as a function of a traced origin."""


class BodyBuilder(NumberBuilder):
    """Builder of the numbers in which evolved bodies differ.

    Attributes:
        genes: genes of the body.
    """

    genes: BodyGenes


class CourseBuilder(NumberBuilder):
    """Builder of the numbers that are drawn for each course."""


class Rules(eqx.Module):
    """Limits on the motion of an animal. None is no limit.

    Attributes:
        speed: largest speed of the root, m/s.
        joint_rate: largest rate of a turning axis, rad/s.
        power: largest power of all motors together, mean over a control step, W.
        penetration: largest depth of a contact point in the ground, m.
        overlap: largest overlap of two bodies, m.
        pairs: pairs of bodies that are checked for overlap, or None if no bodies can touch.
    """

    speed: Number | None = None
    joint_rate: Number | None = None
    power: Number | None = None
    penetration: Number | None = None
    overlap: Number | None = None
    pairs: Pairs | None = None


# Words of a raw random key. A trial has one for its noise, and one after it for its course.
_WORDS = 2


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
        imperfections: imperfections of senses.
        measures: measures of gait, in addition to the task's terms.
        bodies: builder of the bodies, or None if the body does not evolve.
        plans: builder of the simulations of plans, or None if no plan evolves.
        draws: builder of the numbers that are drawn for each course, or None if none is drawn.
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
    imperfections: tuple[Imperfection, ...] = ()
    rules: Rules | None = None
    measures: Measures = Measures()
    bodies: BodyBuilder | None = eqx.field(static=True, default=None)
    plans: "PlanBuilder | None" = eqx.field(static=True, default=None)
    draws: "CourseBuilder | None" = eqx.field(static=True, default=None)

    @property
    def has_own_bodies(self) -> bool:
        """Whether individuals have bodies of their own."""
        return bool(self.bodies or self.plans)

    @property
    def silent(self) -> bool:
        """Whether nothing in a trial is random."""
        return self.noise.silent and not self.draws_course

    @property
    def draws_course(self) -> bool:
        """Whether trials have courses that are drawn."""
        return self.task.draws_course or self.draws is not None

    def noise_keys(self, keys: UInt32[Array, "w *n"] | None) -> UInt32[Array, "2 *n"] | None:
        """Return the part of the trials' random keys for noise, or None without noise."""
        return None if keys is None or self.noise.silent else keys[:_WORDS]

    def course_keys(self, keys: Any) -> Any:
        """Return the part of the trials' random keys for courses, or None if none is drawn."""
        return None if keys is None or not self.draws_course else keys[_WORDS:]

    @property
    def genome(self) -> Genome:
        """Layout of the genes."""
        return Genome(self.controller, self.bodies and self.bodies.genes, self.plans)

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

    @property
    def goals(self) -> tuple[Triple | None, ...]:
        """Light at rest in each situation, m, towards which displacement counts, or None."""
        return (None,) * len(self.situations) if self.task.moves_light else self.lights


def with_displacement(simulation: Simulation) -> Simulation:
    """Return the same trial with the displacement among its terms, as `DISPLACEMENT`."""
    task = simulation.task
    measure = RootTravel() if task.moves_light else RootDisplacement(lit=task.light is not None)
    added = Measures((DISPLACEMENT,), (measure,))
    return dataclasses.replace(simulation, measures=simulation.measures | added)
