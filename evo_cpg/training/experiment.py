"""Parts of a generation besides its trials: random keys, and the step of the search.

An experiment may hold several runs: independent populations of equal size, each with its own seed.
The population axis is ordered by run, then by individual, then by trial. Run ``r`` draws the random
numbers that a single run with the seed ``seed + r`` would draw.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, PyTree, Shaped, UInt32

from evo_cpg.creature.creature import Creature
from evo_cpg.evolution.strategy import Births, Evaluation, Strategy
from evo_cpg.simulation.judge import Outcome, no_terms, score
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.task import Task
from evo_cpg.training.checkpoint import Champion

# Tags that keep the random streams of one seed apart.
_FIRST_POPULATION, _GENERATIONS, _TRIALS = 0, 1, 2
# Tag 3 belongs to `evo_cpg.training.ascent`.
_STRATEGY, _ASKS, _COURSES = 4, 5, 6


# Columns of metrics.csv for any strategy. Only several runs have the column ``run``.
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


FIRST_ROUND = 2**30
"""Number of the first generation whose random numbers serve other purposes than evolution, such as
the choice of the champion. No run reaches it."""


class Learning(NamedTuple):
    """Settings of gradient ascent in the course of evolution (see `evo_cpg.training.ascent`).

    Attributes:
        every: number of generations between two ascents.
        learners: number of individuals that climb in each run: elites, the best first, then
            children.
        steps: number of moves of each.
        inherited: whether offspring inherit the result.
    """

    every: int
    learners: int
    steps: int
    inherited: bool = True


class ExperimentParts(NamedTuple):
    """Experiment that a config file describes.

    Attributes:
        name: name of the run.
        creature: simulated animal.
        simulation: simulation of a trial.
        strategy: search, such as a genetic algorithm.
        generations: number of generations.
        seed: seed of all random draws, for the first run.
        runs: number of independent populations.
        trials: number of trials of every individual, over which the fitness is averaged: one in
            each situation, or any number in the only situation.
        learning: settings of the elites' ascent, or None for evolution alone.
        new_courses: number of generations after which courses are drawn again, or None for never.
        quantile: quantile of an individual's trials that is its fitness, 0 for the worst, or None
            for the mean.
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
    new_courses: int | None = 1
    quantile: float | None = None


class Evaluated(NamedTuple):
    """Results of the trials of one generation. The first axis of every array is the run.

    Attributes:
        worth: what the strategy is told.
        alive: False where an individual diverged.
        scales: task's scales.
    """

    worth: Evaluation
    alive: Bool[Any, "runs n"]
    scales: dict[str, Float[Any, " runs"]]


class Generation(NamedTuple):
    """What follows from the results of one generation of every run.

    Attributes:
        best: index of the fittest individual in each run.
        next_genes: population of the next generation, run by run.
        state: strategy's state. The first axis of every array is the run.
        metrics: strategy's metrics, by name.
        births: origin of the next generation, or None (see `Strategy.births`).
    """

    best: Int[Array, " runs"]
    next_genes: Float[Array, "g all"]
    state: PyTree[Array]
    metrics: dict[str, Float[Array, " runs"]]
    births: Births | None


def begin(
    experiment: ExperimentParts, start: Float[Array, "g all"] | None = None
) -> tuple[Float[Array, "g all"], PyTree[Array]]:
    """Return the population of generation 0, run by run, and the strategy's state.

    The initial genomes are random if none are given.
    """
    genome, strategy = experiment.simulation.genome, experiment.strategy
    size = (strategy.population,)

    def of_run(seed: Array, given: Array | None) -> tuple[Float[Array, "g n"], PyTree[ArrayLike]]:
        if given is None:
            given = genome.random(_stream(seed, _FIRST_POPULATION), size)
        state = strategy.init(_stream(seed, _STRATEGY), given)
        next_genes, state = strategy.ask(jax.random.fold_in(_stream(seed, _ASKS), 0), state)
        return jnp.asarray(next_genes, given.dtype), state

    given = None if start is None else start.reshape(len(start), experiment.runs, -1)
    seeds = experiment.seed + jnp.arange(experiment.runs)
    genes, state = jax.vmap(of_run, in_axes=(0, 1), out_axes=(1, 0))(seeds, given)
    return genes.reshape(len(genes), -1), state


def trial_keys(
    experiment: ExperimentParts,
    generation: ArrayLike,
    run: Int[np.ndarray, " n"],
    individual: Int[np.ndarray, " n"],
    trial: Int[np.ndarray, " n"],
) -> UInt32[Array, "w n"] | None:
    """Return raw random keys for the noise and the courses of trials, or None without either.

    All individuals of a generation have equal courses, so that none is fitter by luck. Courses
    change every ``new_courses`` generations. From `FIRST_ROUND` on, each individual has its own.

    Args:
        experiment: experiment whose seed is used.
        generation: number of the generation, from 0.
        run: number of the run of each trial.
        individual: index of the individual within the run.
        trial: number of the trial of the individual.
    """
    if experiment.simulation.silent:
        return None

    fresh, every = jnp.asarray(generation) >= FIRST_ROUND, experiment.new_courses
    epoch = jnp.where(fresh, generation, 0 if every is None else jnp.asarray(generation) // every)

    def of_trial(seed: ArrayLike, individual: ArrayLike, trial: ArrayLike) -> Array:
        noise = _key(seed, _TRIALS, generation, individual, trial)
        course = _key(seed, _COURSES, epoch, jnp.where(fresh, individual, 0), trial)
        return jnp.concatenate([noise, course])

    seeds = experiment.seed + jnp.arange(experiment.runs)
    return jax.vmap(of_trial, out_axes=1)(seeds[run], individual, trial)


def champion_keys(
    experiment: ExperimentParts, champion: Champion
) -> UInt32[Array, "w trials"] | None:
    """Return the random keys of an individual's trials, see `trial_keys`."""
    trials = np.arange(experiment.trials)
    run, individual = (np.full_like(trials, i) for i in (champion.run, champion.index))
    return trial_keys(experiment, champion.generation, run, individual, trials)


def generation_keys(
    experiment: ExperimentParts, generation: ArrayLike
) -> UInt32[Array, "w n"] | None:
    """Return `trial_keys` of a generation's trials, in the order of the population axis."""
    places = np.indices((experiment.runs, experiment.strategy.population, experiment.trials))
    run, individual, trial = places.reshape(3, -1)
    return trial_keys(experiment, generation, run, individual, trial)


def situation_numbers(experiment: ExperimentParts) -> Int[np.ndarray, " trials"] | None:
    """Return the situation number of each trial, or None if there is one situation."""
    several = len(experiment.simulation.situations) > 1
    return np.arange(experiment.trials) if several else None


def placeholder_scales(experiment: ExperimentParts) -> dict[str, tuple[float, ...]]:
    """Return ones as scales of each run, until generation 0 measures them."""
    simulation = experiment.simulation
    shapes = jax.eval_shape(lambda: simulation.task.scales(no_terms(simulation)))
    return dict.fromkeys(shapes, (1.0,) * experiment.runs)


def evaluated(
    experiment: ExperimentParts,
    outcome: Outcome,
    index: ArrayLike,
    scales: dict[str, Float[Array, " runs"]],
) -> Evaluated:
    """Judge every individual of every run by the outcome of its trials.

    Args:
        experiment: experiment that evolves.
        outcome: outcome of the trials, in the order of the population axis.
        index: number of the generation, from 0.
        scales: task's scales. They are ignored in generation 0, which measures them.
    """
    simulation = experiment.simulation
    task = simulation.task

    def of_run(outcome: Outcome, scales: dict[str, Array]) -> Evaluated:
        measured = task.scales(
            {
                name: jnp.where(outcome.alive, term, jnp.nan).reshape(-1)
                for name, term in outcome.terms.items()
            }
        )
        scales = {name: jnp.where(index == 0, measured[name], scales[name]) for name in measured}
        fitness, mean = judge(task, outcome, scales, experiment.quantile)
        about = mean.terms, descriptors(simulation, mean.terms)
        worth = Evaluation(fitness, *about, judge_each(task, outcome, scales))
        return Evaluated(worth, mean.alive, scales)

    places = experiment.runs, -1, experiment.trials
    return jax.vmap(of_run)(jax.tree.map(lambda x: x.reshape(places), outcome), scales)


def next_generation(
    experiment: ExperimentParts,
    genes: Float[Array, "g n"],
    worth: Evaluation,
    index: ArrayLike,
    state: PyTree[Array],
) -> Generation:
    """Tell the strategy of every run the results, and ask it for the next population.

    Args:
        experiment: experiment that evolves.
        genes: populations, run by run.
        worth: results, see `evaluated`.
        index: number of the generation, from 0. It alone selects the random stream, so a resumed
            run draws the numbers of an uninterrupted run.
        state: strategy's state.
    """
    strategy = experiment.strategy

    def of_run(seed: Array, genes: Array, worth: Evaluation, state: PyTree[Array]) -> Generation:
        key = jax.random.fold_in(_stream(seed, _GENERATIONS), index)
        updated = strategy.tell(key, state, genes, worth)
        ask_key = jax.random.fold_in(_stream(seed, _ASKS), index + 1)
        next_genes, state = strategy.ask(ask_key, updated)
        best = jnp.argmax(worth.fitness)
        next_genes = jnp.asarray(next_genes, genes.dtype)
        metrics, births = strategy.metrics(state), strategy.births(key, genes, worth)
        return Generation(best, next_genes, state, metrics, births)

    runs, gene_count = experiment.runs, len(genes)
    result = jax.vmap(of_run, in_axes=(0, 1, 0, 0))(
        experiment.seed + jnp.arange(runs), genes.reshape(gene_count, runs, -1), worth, state
    )
    next_genes = jnp.moveaxis(result.next_genes, 0, 1).reshape(gene_count, -1)
    return result._replace(next_genes=next_genes)


def descriptors(
    simulation: Simulation, terms: dict[str, Float[Array, " n"]]
) -> dict[str, Float[Array, " n"]]:
    """Return the task's behaviour descriptors and the gait measures."""
    measured = {name: terms[name] for name in simulation.measures.names}
    return {**simulation.task.descriptors(terms), **measured}


def judge(
    task: Task, outcome: Outcome, scales: dict[str, Float[Array, ""]], quantile: float | None = None
) -> tuple[Float[Array, " *n"], Outcome]:
    """Return every individual's fitness and mean outcome over its trials.

    Args:
        task: task that defines the fitness.
        outcome: outcome of all trials, with the trials of an individual on the last axis.
        scales: task's scales.
        quantile: quantile of the trials that counts, 0 for the worst, or None for their mean.

    Returns:
        The fitness and the mean outcome. The mean fitness is -inf if the individual diverged or
        broke a rule in any trial.
    """
    fitness = jnp.moveaxis(judge_each(task, outcome, scales), 0, -1)
    terms = {name: mean_of_trials(term) for name, term in outcome.terms.items()}
    whole = mean_of_trials(fitness)
    if quantile is not None:
        # The trial at or below the quantile. A mean of two trials would be undefined at -inf.
        whole = jnp.sort(fitness, -1)[..., int(quantile * (fitness.shape[-1] - 1))]
    return whole, Outcome(terms, outcome.alive.all(-1))


def mean_of_trials(values: Shaped[Array, "*n trials"]) -> Float[Array, " *n"]:
    """Return the mean over trials. The mean of Boolean values is the fraction with True."""
    values = values.astype(jnp.result_type(values, float))
    # Add trials in turn. The order in which `mean` adds, and so its rounding, would depend on the
    # number of individuals, and a replay has only one.
    trials = values.shape[-1]
    return sum((values[..., i] for i in range(1, trials)), values[..., 0]) * (1 / trials)


def judge_each(
    task: Task, outcome: Outcome, scales: dict[str, Float[Array, ""]]
) -> Float[Array, "trials *n"]:
    """Return the fitness in each trial, or -inf if the individual diverged or broke a rule."""
    return jax.vmap(lambda trial: score(task, trial, scales), in_axes=-1)(outcome)


def _key(seed: ArrayLike, tag: int, *numbers: ArrayLike) -> UInt32[Array, " w"]:
    """Return the raw random key of one run for one purpose and some numbers."""
    key = _stream(seed, tag)
    for number in numbers:
        key = jax.random.fold_in(key, number)
    return jax.random.key_data(key)


def _stream(seed: ArrayLike, tag: int) -> Shaped[Array, ""]:
    """Return the random key of one run for one purpose."""
    return jax.random.fold_in(jax.random.key(seed), tag)
