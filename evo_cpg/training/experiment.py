"""One generation of an experiment: the trials on all devices, then a step of the search.

An experiment may hold several runs: independent populations of the same size, each with its own
seed. On the population axis they stand side by side, run by run, and within a run individual by
individual; where an individual is tried several times, its trials are neighbours. Run ``r`` draws
the random numbers that a lone run with the seed ``seed + r`` would draw.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, PyTree, Shaped, UInt32

from evo_cpg.creature.creature import Creature
from evo_cpg.evolution.strategy import Evaluation, Strategy
from evo_cpg.simulation.batched import BatchedSimulation, Inputs
from evo_cpg.simulation.judge import Outcome, no_terms, score
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.devices import Layout, layout, run_in_blocks, sharded

# Tags that keep the random streams of one seed apart.
_FIRST_POPULATION, _GENERATIONS, _TRIALS = 0, 1, 2
# 3 is that of `evo_cpg.training.memetic`.
_STRATEGY, _ASKS = 4, 5


# Columns of metrics.csv whatever evolves; the one of the run only where there are several.
TABLE_COLUMNS = (
    "generation",
    "run",
    "best",
    "mean",
    "median",
    "worst",
    "diverged",
    "champion",
    "seconds",
    "steps_per_second",
)


class Learning(NamedTuple):
    """Steps uphill within a generation; see `evo_cpg.training.memetic`.

    Attributes:
        every: so many generations some elites learn.
        elites: how many of each run, the best first.
        steps: moves of each.
    """

    every: int
    elites: int
    steps: int


class Experiment(NamedTuple):
    """What a config file describes.

    Attributes:
        name: of the run.
        creature: the animal.
        simulation: the trial.
        strategy: the search, such as a genetic algorithm.
        generations: to evolve.
        seed: of all randomness; of the first run where there are several.
        runs: independent populations side by side.
        trials: of every individual, over which its fitness is averaged; as many as the simulation
            has situations, or any number of trials of the only one.
        learning: of the elites; None to leave all to evolution.
    """

    name: str
    creature: Creature
    simulation: Simulation
    strategy: Strategy
    generations: int
    seed: int
    runs: int = 1
    trials: int = 1
    learning: Learning | None = None


class Generation(NamedTuple):
    """What came out of one generation of every run.

    Attributes:
        fitness: of every individual, the mean over its trials; -inf where it diverged in any.
        terms: the task's terms, likewise averaged.
        alive: False where an individual diverged.
        scales: the task's scales.
        best: index of the fittest within its run.
        best_genes: its genome.
        next_genes: the population of the next generation, all runs side by side.
        state: what the strategy remembers; of every array the first axis is that of the runs.
        metrics: what it says of itself.
    """

    fitness: Float[Array, "runs n"]
    terms: dict[str, Float[Array, "runs n"]]
    alive: Bool[Array, "runs n"]
    scales: dict[str, Float[Array, " runs"]]
    best: Int[Array, " runs"]
    best_genes: Float[Array, "runs g"]
    next_genes: Float[Array, "g all"]
    state: PyTree[Array]
    metrics: dict[str, Float[Array, " runs"]]


def begin(
    experiment: Experiment, start: Float[Array, "g all"] | None = None
) -> tuple[Float[Array, "g all"], PyTree[Array]]:
    """The population of generation 0, all runs side by side, and what the strategy remembers.

    Args:
        experiment: what is evolved.
        start: genomes to begin with instead of random ones.
    """
    genome, strategy = experiment.simulation.genome, experiment.strategy
    size = (strategy.population,)

    def of_run(seed: Array, given: Array | None) -> tuple[Float[Array, "g n"], PyTree[ArrayLike]]:
        if given is None:
            given = genome.random(_stream(seed, _FIRST_POPULATION), size)
        state = strategy.init(_stream(seed, _STRATEGY), given)
        next_genes, state = strategy.ask(_ask_key(seed, 0), state)
        return jnp.asarray(next_genes, given.dtype), state

    given = None if start is None else start.reshape(len(start), experiment.runs, -1)
    genes, state = jax.vmap(of_run, in_axes=(0, 1), out_axes=(1, 0))(_seeds(experiment), given)
    return genes.reshape(len(genes), -1), state


def first_population(experiment: Experiment) -> Float[Array, "g n"]:
    """The population of generation 0 of every run, see `begin`."""
    return begin(experiment)[0]


def trial_keys(
    experiment: Experiment,
    generation: ArrayLike,
    run: Int[np.ndarray, " n"],
    individual: Int[np.ndarray, " n"],
    trial: Int[np.ndarray, " n"],
) -> UInt32[Array, "w n"] | None:
    """Raw random keys for the noise of some trials; None where there is no noise.

    Args:
        experiment: whose seed they come from.
        generation: number of the generation, from 0.
        run: number of the run of each trial.
        individual: index within the run.
        trial: number of the trial among those of the individual.
    """
    if experiment.simulation.noise.silent:
        return None

    def of_trial(seed: ArrayLike, individual: ArrayLike, trial: ArrayLike) -> Array:
        key = _stream(seed, _TRIALS)
        for number in (generation, individual, trial):
            key = jax.random.fold_in(key, number)
        return jax.random.key_data(key)

    return jax.vmap(of_trial, out_axes=1)(_seeds(experiment)[run], individual, trial)


def champion_keys(experiment: Experiment, champion: Champion) -> UInt32[Array, "w trials"] | None:
    """The keys that an individual's trials had, see `trial_keys`."""
    trials = np.arange(experiment.trials)
    run, individual = (np.full_like(trials, i) for i in (champion.run, champion.index))
    return trial_keys(experiment, champion.generation, run, individual, trials)


def generation_keys(experiment: Experiment, generation: ArrayLike) -> UInt32[Array, "w n"] | None:
    """`trial_keys` of all trials of a generation, in the order of the population axis."""
    places = np.indices((experiment.runs, experiment.strategy.population, experiment.trials))
    run, individual, trial = places.reshape(3, -1)
    return trial_keys(experiment, generation, run, individual, trial)


def situation_numbers(experiment: Experiment) -> Int[np.ndarray, " trials"] | None:
    """Of the trials of an individual; None where all have the same situation."""
    several = len(experiment.simulation.situations) > 1
    return np.arange(experiment.trials) if several else None


def placeholder_scales(experiment: Experiment) -> dict[str, tuple[float, ...]]:
    """Return ones for the scales of each run, which generation 0 will measure."""
    simulation = experiment.simulation
    shapes = jax.eval_shape(lambda: simulation.task.scales(no_terms(simulation)))
    return dict.fromkeys(shapes, (1.0,) * experiment.runs)


def compile_trials(
    simulation: Simulation, mesh: Mesh, width: int | None = None, inputs: Inputs | None = None
) -> Callable[..., Outcome]:
    """One trial of every individual of a population, in chunks on the devices of the mesh.

    The host feeds the devices block by block rather than having them loop over chunks: their memory
    and the compiled program are then the same however large the population is, and no device ever
    holds more of it than two chunks.

    The devices never talk to each other: each gets its part of a block from the host and gives its
    results back. A program in which they exchange results deadlocked when two of them were in
    flight, and XLA ends the process when one device keeps the other waiting for 40 s.

    Args:
        simulation: the trial.
        mesh: the devices.
        width: individuals in a chunk; None for what suits the population.
        inputs: numbers of the simulation in which individuals differ.

    Returns:
        A function of the host arrays that `rollout` takes, compiled at its first call. Next comes
        the number of trials of each individual; the keys and numbers are then those of trials, of
        which an individual's are neighbours, and so are the results. The last are the values of
        the inputs.
    """

    def rollouts(values: Any, genes: Array, keys: Array | None, trial: Array | None) -> Outcome:
        own = BatchedSimulation(simulation, inputs, values) if inputs else simulation
        return rollout(own, genes, keys, trial)

    @functools.cache
    def program(busy: Mesh) -> Callable[..., Outcome]:
        return sharded(rollouts, busy, (2, 2, 2, 1), 1)

    def run(
        genes: Float[np.ndarray, "g individuals"],
        keys: UInt32[np.ndarray, "w n"] | None = None,
        trial: Int[np.ndarray, " n"] | None = None,
        trials: int = 1,
        values: tuple[Float[np.ndarray, "_ individuals"], ...] | None = None,
    ) -> Outcome:
        # Not in the precision that the host has them in.
        own = jax.tree.map(lambda x: x.astype(genes.dtype), values)

        def pick(numbers: Int[np.ndarray, " block"]) -> tuple:
            of_individuals = jax.tree.map(lambda x: x[:, numbers // trials], (own, genes))
            return *of_individuals, *jax.tree.map(lambda x: x[..., numbers], (keys, trial))

        count = genes.shape[1] * trials
        spread = Layout(mesh, width) if width else layout(count, mesh)
        return run_in_blocks(program(spread.mesh), spread, count, pick)

    return run


def breed(
    experiment: Experiment,
    genes: Float[Array, "g n"],
    outcome: Outcome,
    index: Array,
    scales: dict[str, Float[Array, " runs"]],
    state: PyTree[Array],
) -> Generation:
    """The generation step of every run: score its population and ask for the next one.

    Args:
        experiment: what is evolved.
        genes: the populations.
        outcome: of their trials.
        index: number of the generation, from 0; it alone selects the random stream, so a resumed
            run draws the same numbers as one that was never stopped.
        scales: the task's scales; measured anew, and these ignored, in generation 0.
        state: what the strategy remembers.
    """
    simulation, strategy = experiment.simulation, experiment.strategy
    task = simulation.task

    def of_run(
        seed: Array, genes: Array, outcome: Outcome, scales: dict[str, Array], state: PyTree[Array]
    ) -> Generation:
        measured = task.scales(
            {
                name: jnp.where(outcome.alive, term, jnp.nan).reshape(-1)
                for name, term in outcome.terms.items()
            }
        )
        scales = {name: jnp.where(index == 0, measured[name], scales[name]) for name in measured}
        fitness, mean = judge(task, outcome, scales)
        key = jax.random.fold_in(_stream(seed, _GENERATIONS), index)
        about = mean.terms, descriptors(simulation, mean.terms)
        worth = Evaluation(fitness, *about, judge_each(task, outcome, scales))
        updated = strategy.tell(key, state, genes, worth)
        next_genes, state = strategy.ask(_ask_key(seed, index + 1), updated)
        best = jnp.argmax(fitness)
        found = fitness, mean.terms, mean.alive, scales, best, genes[:, best]
        next_genes = jnp.asarray(next_genes, genes.dtype)
        return Generation(*found, next_genes, state, strategy.metrics(state))

    runs, gene_count = experiment.runs, len(genes)
    places = (runs, experiment.strategy.population, experiment.trials)
    result = jax.vmap(of_run, in_axes=(0, 1, 0, 0, 0))(
        _seeds(experiment),
        genes.reshape(gene_count, runs, -1),
        jax.tree.map(lambda x: x.reshape(places), outcome),
        scales,
        state,
    )
    next_genes = jnp.moveaxis(result.next_genes, 0, 1).reshape(gene_count, -1)
    return result._replace(next_genes=next_genes)


def descriptors(
    simulation: Simulation, terms: dict[str, Float[Array, " n"]]
) -> dict[str, Float[Array, " n"]]:
    """Of the terms, those that say how an animal behaves: the task's and the measures of gait."""
    measured = {name: terms[name] for name in simulation.measures.names}
    return {**simulation.task.descriptors(terms), **measured}


def judge(
    task: Task, outcome: Outcome, scales: dict[str, Float[Array, ""]]
) -> tuple[Float[Array, " *n"], Outcome]:
    """What every individual's trials amount to.

    Args:
        task: what they are judged by.
        outcome: of all trials; the last axis is the trials of one individual.
        scales: the task's scales.

    Returns:
        The mean fitness, -inf for an individual that diverged in any trial, and the mean outcome.
    """

    def mean(values: Shaped[Array, "*n trials"]) -> Float[Array, " *n"]:
        # Of truth values: the share of trials.
        values = values.astype(jnp.result_type(values, float))
        # One after the other: the order in which `mean` adds, and with it the rounding, would
        # depend on how many individuals there are, and a replay has but one.
        trials = values.shape[-1]
        return sum((values[..., i] for i in range(1, trials)), values[..., 0]) * (1 / trials)

    fitness = jnp.moveaxis(judge_each(task, outcome, scales), 0, -1)
    terms = {name: mean(term) for name, term in outcome.terms.items()}
    return mean(fitness), Outcome(terms, outcome.alive.all(-1))


def judge_each(
    task: Task, outcome: Outcome, scales: dict[str, Float[Array, ""]]
) -> Float[Array, "trials *n"]:
    """Fitness in each of the trials that `judge` takes together; -inf where it diverged."""
    return jax.vmap(lambda trial: score(task, trial, scales), in_axes=-1)(outcome)


def _seeds(experiment: Experiment) -> Int[Array, " runs"]:
    return experiment.seed + jnp.arange(experiment.runs)


def _ask_key(seed: ArrayLike, generation: ArrayLike) -> Shaped[Array, ""]:
    return jax.random.fold_in(_stream(seed, _ASKS), generation)


def _stream(seed: ArrayLike, tag: int) -> Shaped[Array, ""]:
    """The random key of one run for one purpose."""
    return jax.random.fold_in(jax.random.key(seed), tag)
