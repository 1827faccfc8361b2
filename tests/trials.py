"""A swimmer of two bodies with eyes and a sine wave as controller."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from creatures import AXES, in_water
from evo_cpg.control.controller import Command, Controller
from evo_cpg.creature.creature import Actuator, Body, Creature, Joint, LightSensor, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree
from evo_cpg.evolution.genetics import RealGenetics
from evo_cpg.simulation.sensors import place_sensors
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task
from evo_cpg.simulation.tasks import ReachLight
from evo_cpg.training.checkpoint import Checkpoint
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.train import TIMING_COLUMNS, train


class SineController(Controller):
    """Controller of one wave for all joints. Its genes are amplitude (rad/s) and frequency (Hz)."""

    gene_count: int = eqx.field(static=True, default=2)

    def random_genes(self, key, batch, dtype):
        return 1.0 + jax.random.uniform(key, (self.gene_count, *batch), dtype)

    def initial_state(self, batch, dtype):
        return jnp.zeros(batch, dtype)

    def act(self, decoded, state, observation):
        amplitude, frequency = decoded
        wave = jnp.sin(2 * jnp.pi * frequency * state)
        signal = wave[None] * jnp.ones_like(observation.joint_angle)
        return state + 1 / 60, Command(amplitude[None] * signal, signal)


def swimmer(eyes: tuple[LightSensor, ...]) -> Creature:
    """Return a pair whose list of bodies begins with the tail, although the head is the root."""
    flesh = Material(1000.0)
    joint = Joint(
        parent="head",
        parent_anchor=(-0.11, 0.0, 0.0),
        child_anchor=(0.11, 0.0, 0.0),
        axes=(AXES["z"],),
        lower=(-1.0,),
        upper=(1.0,),
        actuator=Actuator(20.0),
    )
    box = Box((0.2, 0.1, 0.1))
    return Creature(
        "pair", (Body("tail", box, flesh, joint), Body("head", box, flesh)), eyes, ("head",)
    )


class OneTerm(Task):
    """Task with a single term, which is its fitness."""

    name: str = eqx.field(static=True)
    light: None = eqx.field(default=None, init=False)

    def begin(self, batch, dtype, steps):
        return jnp.zeros(batch, dtype)

    def update(self, tally, transition, steps):
        return tally

    def terms(self, tally, steps):
        return {self.name: tally}

    def fitness(self, terms, scales):
        return terms[self.name]


EYES = (
    LightSensor("head", (0.1, 0.0, 0.0), (1.0, 0.0, 0.0), np.pi),
    LightSensor("tail", (-0.1, 0.0, 0.02), (0.0, 1.0, 0.0), np.pi / 2),
)


def experiment(
    steps: int = 90, population: int = 11, eyes: tuple[LightSensor, ...] = EYES, seed: int = 0
) -> ExperimentParts:
    """Return an experiment of the pair: a light ahead to the left, one substep per control step."""
    creature = swimmer(eyes)
    simulation = Simulation(
        world=in_water(creature, resolution=1),
        sensors=place_sensors(creature, build_tree(creature)),
        controller=SineController(),
        task=ReachLight((3.0, 1.0, 0.5)),
        control_rate=60.0,
        substeps=1,
        steps=steps,
    )
    return ExperimentParts(
        "pair", creature, simulation, RealGenetics(population, 2, 0.5, 0.2, 0.5, 0.5, 8.0), 2, seed
    )


def folder_at(path) -> RunFolder:
    """Return the run folder at a path, which begins a run if it is new."""
    folder = RunFolder(path)
    if not folder.config.exists():
        folder.create("", {})
    return folder


def evolve(made: ExperimentParts, path) -> tuple[RunFolder, Checkpoint]:
    """Evolve an experiment in a folder, or continue its run there."""
    folder = folder_at(path)
    return folder, train(made, folder)


def untimed(rows) -> list[dict[str, float]]:
    """Return rows of metrics.csv without the columns that measure time."""
    return [{k: v for k, v in row.items() if k not in TIMING_COLUMNS} for row in rows]
