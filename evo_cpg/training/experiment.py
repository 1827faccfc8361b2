"""One generation of an experiment: the trials on all devices, then the genetic algorithm."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.creature import Creature
from evo_cpg.evolution.generation import Genetics
from evo_cpg.simulation.rollout import Outcome, Simulation, record, rollout, score
from evo_cpg.training.devices import LANES, POPULATION_AXIS, fast_jit

# Tags that keep the random streams of one seed apart.
_FIRST_POPULATION, _GENERATIONS = 0, 1


class Experiment(NamedTuple):
    """What a config file describes.

    Attributes:
        name: of the run.
        creature: the animal.
        simulation: the trial.
        genetics: the genetic algorithm.
        generations: to evolve.
        seed: of all randomness.
    """

    name: str
    creature: Creature
    simulation: Simulation
    genetics: Genetics
    generations: int
    seed: int


class Generation(NamedTuple):
    """What came out of one generation.

    Attributes:
        fitness: of every individual; -inf where it diverged.
        terms: the task's terms.
        alive: False where an individual diverged.
        scales: the task's yardsticks.
        best: index of the fittest.
        best_genes: its genome.
        next_genes: the population of the next generation.
    """

    fitness: Float[Array, " n"]
    terms: dict[str, Float[Array, " n"]]
    alive: Bool[Array, " n"]
    scales: dict[str, Float[Array, ""]]
    best: Array
    best_genes: Float[Array, " g"]
    next_genes: Float[Array, "g n"]


def first_population(experiment: Experiment) -> Float[Array, "g n"]:
    """Random genomes of generation 0."""
    key = jax.random.fold_in(jax.random.key(experiment.seed), _FIRST_POPULATION)
    size = (experiment.genetics.population,)
    return experiment.simulation.controller.random_genes(key, size, jnp.float32)


def compile_trials(
    simulation: Simulation, mesh: Mesh
) -> Callable[[Float[np.ndarray, "g n"]], Outcome]:
    """One trial of every individual of a population, sharded over the devices of the mesh.

    The devices never talk to each other: each gets its part of the population from the host and
    gives its results back. A program in which they exchange results deadlocked when two of them
    were in flight, and XLA ends the process when one device keeps the other waiting for 40 s.

    Returns:
        A function of host arrays, compiled at its first call.
    """
    genes_sharding = NamedSharding(mesh, PartitionSpec(None, POPULATION_AXIS))
    trials = fast_jit(
        jax.shard_map(
            functools.partial(rollout, simulation),
            mesh=mesh,
            in_specs=genes_sharding.spec,
            out_specs=PartitionSpec(POPULATION_AXIS),
            check_vma=False,
        )
    )

    def run(genes: Float[np.ndarray, "g n"]) -> Outcome:
        count = genes.shape[1]
        padded = np.pad(genes, ((0, 0), (0, padding(count, mesh))), mode="edge")
        outcome = trials(jax.device_put(padded, genes_sharding))
        return jax.tree.map(lambda x: np.asarray(x)[:count], outcome)

    return run


def breed(
    experiment: Experiment,
    genes: Float[Array, "g n"],
    outcome: Outcome,
    index: Array,
    scales: dict[str, Float[Array, ""]],
) -> Generation:
    """The generation step: score and rank a population and breed the next one.

    Args:
        experiment: what is evolved.
        genes: the population.
        outcome: of its trials.
        index: number of the generation, from 0; it alone selects the random stream, so a resumed
            run draws the same numbers as one that was never stopped.
        scales: the task's yardsticks; measured anew, and these ignored, in generation 0.
    """
    task = experiment.simulation.task
    measured = task.scales(
        {name: jnp.where(outcome.alive, term, jnp.nan) for name, term in outcome.terms.items()}
    )
    scales = {name: jnp.where(index == 0, measured[name], scales[name]) for name in measured}
    fitness = score(task, outcome, scales)
    key = jax.random.fold_in(jax.random.key(experiment.seed), _GENERATIONS)
    key = jax.random.fold_in(key, index)
    children = experiment.genetics.next_generation(key, genes, fitness)
    best = jnp.argmax(fitness)
    return Generation(fitness, outcome.terms, outcome.alive, scales, best, genes[:, best], children)


def replay(
    simulation: Simulation, mesh: Mesh, genes: Float[Array, " g"], population: int
) -> tuple[Outcome, dict[str, Array]]:
    """One individual's trial, step by step, with as many neighbours as it had in training.

    Compiled code may round differently for different array lengths; with equal ones the numbers
    are those of the training run.
    """
    lanes = (population + padding(population, mesh)) // mesh.size
    crowd = jnp.broadcast_to(genes[:, None], (genes.shape[0], lanes))
    outcome = jax.tree.map(lambda x: x[0], rollout(simulation, crowd))
    return outcome, record(simulation, crowd)


def padding(count: int, mesh: Mesh) -> int:
    """How many individuals are added to a population so that every device gets full vectors."""
    return -count % (mesh.size * LANES)
