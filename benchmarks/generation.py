"""A whole training generation of the swimmer: trials of all individuals, then breeding."""

import functools
import statistics

import jax
import numpy as np

from benchmarks.moving import UNIT
from benchmarks.plan import Plan, experiment_of, swimmer_settings
from benchmarks.rows import SECONDS, Row
from benchmarks.timing import Contender, race, seconds
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.experiment import begin, evaluated, next_generation


def measure(plan: Plan) -> list[Row]:
    """Return a row in seconds, and a row in individual physics steps per second."""
    experiment = experiment_of("iwadate2010_swimmer", *swimmer_settings(plan))
    simulation, population = experiment.simulation, experiment.strategy.population
    genes, state = jax.device_get(jax.jit(lambda: begin(experiment))())
    scales = {"energy": np.ones(1, np.float32)}
    trials = compile_trials(simulation, population_mesh())
    judging = jax.jit(functools.partial(evaluated, experiment))
    breeding = jax.jit(functools.partial(next_generation, experiment))

    def live() -> None:
        found = judging(trials(genes), np.int32(0), scales)
        jax.device_get(breeding(genes, found.worth, np.int32(0), state))

    plan.say("generation: compiling")
    first = seconds(live)
    plan.say("generation")
    rate = statistics.median(race([Contender("generation", 1, live)], plan.repeats)["generation"])
    compile_seconds = max(first - 1 / rate, 0.0)
    steps = population * simulation.steps * simulation.substeps
    how = (
        f"{population} individuals of {simulation.world.tree.body_count} bodies, "
        f"{simulation.steps} control steps, {plan.cores} cores, median of {plan.repeats}. "
        "The compile time is the first call less a later one"
    )
    return [
        Row("generation", "time", population, 1 / rate, SECONDS, how, compile_seconds),
        Row("generation", "steps", population, steps * rate, UNIT, how, compile_seconds),
    ]
