"""The one way to run individuals: genomes, their trials, and observers that follow the trials.

`compile_trials` runs any genomes with any observers. Training, replays, films, audits and probes
are all made of it. `compile_evaluation` adds the fitness of individuals of an experiment, and
`compile_replay` the motion of one individual.

Compiled code may round differently for other array lengths, or if an array is a constant. So a
replay has chunks as wide as in training, and the same arguments: then the numbers are equal, too.
"""

import concurrent.futures
import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int, UInt32

from evo_cpg.native.machine_constants import LANES
from evo_cpg.simulation.batched import BatchedSimulation, inputs_of
from evo_cpg.simulation.judge import JUDGE, Outcome, no_terms, score
from evo_cpg.simulation.recording import Recorder, Recording, as_recording
from evo_cpg.simulation.rollout import Observers, rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.devices import (
    Layout,
    chunk_width,
    layout,
    placed,
    population_mesh,
    run_in_blocks,
    sharded,
)
from evo_cpg.training.experiment import (
    ExperimentParts,
    champion_keys,
    judge,
    placeholder_scales,
    situation_numbers,
    trial_keys,
)


class Replay(NamedTuple):
    """Results of a replayed individual.

    Attributes:
        fitness: mean fitness over its trials.
        terms: means of the task's terms and of the measures over its trials.
        frames: arrays of the recorded trial by name, see `evo_cpg.simulation.recording.Recorder`.
        recording: motion in the recorded trial.
    """

    fitness: float
    terms: dict[str, float]
    frames: dict[str, Any]
    recording: Recording


def compile_trials(
    simulation: Simulation,
    mesh: Mesh,
    width: int | None = None,
    inputs: Any = None,
    observers: Observers = JUDGE,
    ahead: tuple | None = None,
) -> Callable[..., Any]:
    """Return a function that runs the trials of individuals, in chunks on the mesh's devices.

    The host feeds the devices block by block. The devices do not loop over chunks. So their memory
    and the compiled program do not depend on the number of individuals. A device never holds more
    than two chunks.

    The devices never communicate: each gets its part of a block from the host and returns its
    results. A program in which devices exchange results deadlocked with two programs in flight.
    XLA also ends the process when one device keeps another waiting for 40 s.

    Args:
        simulation: simulation of a trial.
        mesh: the devices.
        width: number of trials in a chunk, or None to choose it from the number of all trials.
        inputs: numbers of the simulation in which individuals differ (`Inputs` or `PlanInputs`),
            or None if only their genes do. Then genes of the body, if there are any, give the
            values.
        observers: observers of the trials, see `rollout`. Each result has the trials on the last
            axis. An observer that keeps a number of individuals keeps as many of every block.
        ahead: arguments of the function for which it is compiled now and not at its first call.
            Only their shapes and types matter.

    Returns:
        A function of the host arrays that `rollout` takes. The next argument is the number of
        trials of each individual. Keys, numbers and results have one entry for each trial. The
        trials of an individual are next to each other. The last argument holds the values of the
        inputs.
    """
    if simulation.plans and not inputs:
        return _compile_trials_of_plans(simulation, mesh, width, observers)
    whole = simulation
    simulation = dataclasses.replace(whole, bodies=None, draws=None)
    # Values come from a program of their own, in float64 and for any number of simulations, so that
    # all programs of the trials get the same bits.
    builder, kept = None if inputs else whole.bodies or whole.draws, []
    if builder:
        inputs, kept = inputs_of(builder, simulation)

    def rollouts(values: Any, genes: Array, keys: Array | None, trial: Array | None) -> Any:
        own = BatchedSimulation(simulation, inputs, values) if inputs else simulation
        return rollout(own, genes, keys, trial, observers)

    def prepared(
        genes: Float[np.ndarray, "g individuals"],
        keys: UInt32[np.ndarray, "w n"] | None = None,
        trial: Int[np.ndarray, " n"] | None = None,
        trials: int = 1,
        values: tuple[Float[np.ndarray, "_ individuals"], ...] | None = None,
    ) -> tuple[Layout, int, Callable[..., tuple]]:
        count = genes.shape[1] * trials
        owners = np.arange(count) // trials
        if builder:
            origin = whole.genome.of_body(genes)
            if whole.draws:
                # Individuals share courses.
                own = np.asarray(whole.course_keys(keys))
                origin, owners = np.unique(own, axis=1, return_inverse=True)
            found = builder.values(origin)
            values = tuple(found[i] for i in kept)
        # The host's values may have another precision than the genes.
        own = jax.tree.map(lambda x: np.asarray(x, genes.dtype), values)

        def pick(numbers: Int[np.ndarray, " block"]) -> tuple:
            numbered = jax.tree.map(lambda x: x[:, owners.reshape(-1)[numbers]], own)
            rest = jax.tree.map(lambda x: x[..., numbers], (keys, trial))
            return numbered, genes[:, numbers // trials], *rest

        return Layout(mesh, width) if width else layout(count, mesh), count, pick

    compiled: dict[Mesh, Callable] = {}
    ranks = 2, 2, 2, 1
    if ahead is not None:
        spread, _, pick = prepared(*ahead)
        block = placed(pick(np.zeros(spread.block, int)), spread.mesh)
        program = sharded(rollouts, spread.mesh, ranks)
        compiled[spread.mesh] = program.lower(*block).compile()

    def run(*given: Any) -> Any:
        spread, count, pick = prepared(*given)
        if spread.mesh not in compiled:
            compiled[spread.mesh] = sharded(rollouts, spread.mesh, ranks)
        return run_in_blocks(compiled[spread.mesh], spread, count, pick)

    return run


def compile_plan_trials(
    simulation: Simulation,
    size: int,
    mesh: Mesh,
    width: int | None = None,
    observers: Observers = JUDGE,
    ahead: tuple | None = None,
) -> Callable[..., Any]:
    """Return the function of `compile_trials` for plans in the program for some bodies.

    The function takes the controller's genes and the inputs of `PlanBuilder.given`.
    """
    assert simulation.plans is not None
    inputs = simulation.plans.inputs(size)
    common = {name: getattr(simulation, name) for name in _OF_TRIALS}
    star = dataclasses.replace(inputs.common, **common)
    return compile_trials(star, mesh, width, inputs, observers, ahead)


def _compile_trials_of_plans(
    simulation: Simulation, mesh: Mesh, width: int | None, observers: Observers
) -> Callable[..., Any]:
    """Return the function of `compile_trials` for plans, which run in several programs.

    Plans of similar size share a vector, in the smallest program for the largest of them. The
    first call for a population compiles all programs, so that no later call does. Recorded plans
    run together, in their order and in chunks of the width, because observers choose lanes.
    """
    plans, programs = simulation.plans, {}
    assert plans is not None
    recorded = any(one.every_step for one in jax.tree.leaves(observers))

    def program(size: int, given: tuple) -> None:
        chunk = width if recorded and width else LANES
        programs[size] = compile_plan_trials(simulation, size, mesh, chunk, observers, given)

    def run(
        genes: Float[np.ndarray, "g individuals"],
        keys: UInt32[np.ndarray, "w n"] | None = None,
        trial: Int[np.ndarray, " n"] | None = None,
        trials: int = 1,
        values: None = None,
    ) -> Any:
        assert values is None, "genes alone determine a plan"
        found = plans.developed(genes)
        count = len(found[0])
        fits = np.searchsorted(plans.sizes, found[0] + 1)

        def of(individuals: np.ndarray, size: int) -> tuple:
            own = (individuals[:, None] * trials + np.arange(trials)).reshape(-1)
            rows, values = plans.given(found, individuals, size)
            noise = jax.tree.map(lambda x: x[..., own], (keys, trial))
            return rows.astype(genes.dtype), *noise, trials, (values,)

        order = np.arange(count) if recorded else np.argsort(found[0], kind="stable")
        if recorded:
            vectors = [order]
        elif plans.joins_vectors:
            lanes = max(1, LANES // trials)
            vectors = [order[k : k + lanes] for k in range(0, count, lanes)]
        else:
            vectors = np.split(order, np.flatnonzero(np.diff(fits[order])) + 1)
        largest = np.array([fits[vector].max() for vector in vectors])
        whole = count > LANES and not recorded
        needed = {*plans.sizes} if whole else {plans.sizes[i] for i in largest}
        missing = sorted(needed - programs.keys(), reverse=True)
        with concurrent.futures.ThreadPoolExecutor(_COMPILERS) as pool:
            # `list` raises the errors of the threads.
            list(pool.map(lambda size: program(size, of(np.zeros(1, int), size)), missing))
        results, places = [], []
        for number in np.unique(largest):
            own = np.concatenate([v for v, n in zip(vectors, largest, strict=True) if n == number])
            size = plans.sizes[number]
            results.append(programs[size](*of(own, size)))
            places.append((own[:, None] * trials + np.arange(trials)).reshape(-1))
        if recorded:
            return results[0]
        back = np.argsort(np.concatenate(places))
        return jax.tree.map(lambda *parts: np.concatenate(parts, -1)[..., back], *results)

    return run


# Programs that are compiled at a time.
_COMPILERS = 2

# Parts of a simulation of plans that do not depend on the plan.
_OF_TRIALS = ("task", "steps", "substeps", "noise", "rules", "measures", "engine")


def compile_evaluation(
    experiment: ExperimentParts,
    mesh: Mesh,
    devices: int,
    recorder: Recorder | None = None,
    ahead: bool = False,
) -> Callable[[Float[np.ndarray, "g n"], Champion], tuple[Any, Outcome, dict[str, np.ndarray]]]:
    """Return a function that evaluates genomes under the noise of a champion.

    The function also uses the champion's normalisation constants (`Champion.scales`), so that a
    genome's fitness can be compared with the champion's.

    Args:
        experiment: experiment of the genomes.
        mesh: the devices.
        devices: number of devices that shared the population in training.
        recorder: observer that records some of the trials, or None.
        ahead: whether to compile now for one genome.

    Returns:
        A function of genomes and the champion. It returns the fitness and the mean outcome of each
        genome, and the frames of the recorder.
    """
    simulation, trials = experiment.simulation, experiment.trials
    count = experiment.runs * experiment.strategy.population * trials
    numbers, width = situation_numbers(experiment), chunk_width(count, devices)
    genes = np.zeros((simulation.genome.count, 1), np.float32)
    scales = {name: np.float32(1.0) for name in placeholder_scales(experiment)}
    given = None
    if ahead:
        origin = Champion(genes[:, 0], 0.0, 0, {}, {}, 0, 0)
        given = genes, jax.device_get(champion_keys(experiment, origin)), numbers, trials
    observers = JUDGE if recorder is None else (JUDGE, recorder)
    run_trials = compile_trials(simulation, mesh, width, None, observers, given)
    # Compile `judge` too, as in training: compiled code may fuse a multiplication and an addition,
    # with one rounding instead of two.
    assess = jax.jit(functools.partial(judge, simulation.task, quantile=experiment.quantile))
    if ahead:
        shapes = jax.eval_shape(lambda: no_terms(simulation, (1, trials)))
        terms = jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), shapes)
        assess(Outcome(terms, jnp.ones((1, trials), bool)), scales)

    def evaluate(genes: Float[np.ndarray, "g n"], champion: Champion) -> tuple:
        count = genes.shape[1]
        keys, own = jax.tree.map(
            lambda x: np.tile(x, count),
            (jax.device_get(champion_keys(experiment, champion)), numbers),
        )
        found = run_trials(genes, keys, own, trials)
        outcome, frames = (found, {}) if recorder is None else found
        outcome = jax.tree.map(lambda x: x.reshape(count, trials), outcome)
        scales = {name: np.float32(value) for name, value in champion.scales.items()}
        return *jax.device_get(assess(outcome, scales)), frames

    return evaluate


def compile_replay(
    experiment: ExperimentParts, devices: int, recorded: int = 0, full: bool = False
) -> Callable[[Champion], Replay]:
    """Compile a function that repeats an individual's trials with their original noise.

    It is compiled before there is a champion. The program of the training trials cannot record: it
    computes a whole trial as one piece of native code that returns only final results. The frames
    of all its individuals would take hundreds of megabytes. A recording runs a trial step by step.

    Args:
        experiment: experiment in which the individual evolved.
        devices: number of devices that shared the population in training.
        recorded: number of the trial to record, from 0.
        full: whether to record all quantities, see `evo_cpg.simulation.recording.Recorder`.
    """
    count = experiment.runs * experiment.strategy.population * experiment.trials
    # A chunk may hold fewer trials than an individual has.
    block, lane = divmod(recorded, chunk_width(count, devices))
    recorder = Recorder(first=lane, full=full)
    evaluate = compile_evaluation(experiment, population_mesh(1), devices, recorder, ahead=True)

    def of(champion: Champion) -> Replay:
        genes = np.asarray(champion.genes, np.float32)[:, None]
        fitness, mean, frames = evaluate(genes, champion)
        frames = {name: values[..., block : block + 1] for name, values in frames.items()}
        keys = champion_keys(experiment, champion)
        key = None if keys is None else np.asarray(keys)[:, recorded]
        simulation, frames = _own(experiment.simulation, champion.genes, key, frames)
        motion = as_recording(simulation, frames, _names(experiment, simulation), trial=recorded)
        terms = {name: float(values[0]) for name, values in mean.terms.items()}
        return Replay(float(fitness[0]), terms, frames, motion)

    return of


def compile_population_replay(
    experiment: ExperimentParts,
) -> Callable[[Checkpoint, int, Sequence[int]], list[Replay]]:
    """Compile a function that replays the first trials of at most `LANES` individuals.

    All individuals of a vector cost as much as one, so a replay of a single one would waste the
    others.

    Returns:
        A function of a checkpoint, the number of a run, and the places of individuals in the run's
        population. The individuals are those of the next generation, with its noise. The fitness is
        that of the first trial, or -inf if the individual diverged or broke a rule.
    """
    simulation, lanes = experiment.simulation, np.zeros(LANES, int)
    first = None if situation_numbers(experiment) is None else lanes
    genes = np.zeros((simulation.genome.count, LANES), np.float32)
    keys = jax.device_get(trial_keys(experiment, 0, lanes, lanes, lanes))
    observers = JUDGE, Recorder(count=None)
    given = genes, keys, first
    run = compile_trials(simulation, population_mesh(1), LANES, None, observers, given)
    assess = jax.jit(functools.partial(score, simulation.task))

    def of(checkpoint: Checkpoint, run_number: int, places: Sequence[int]) -> list[Replay]:
        # Copies of the last individual fill the vector.
        filled = np.pad(np.asarray(places), (0, LANES - len(places)), mode="edge")
        own = trial_keys(experiment, checkpoint.generation, lanes + run_number, filled, lanes)
        own = jax.device_get(own)
        genes = checkpoint.genes[:, run_number * experiment.strategy.population + filled]
        outcome, frames = run(np.asarray(genes, np.float32), own, first)
        scales = {name: jnp.float32(each[run_number]) for name, each in checkpoint.scales.items()}
        fitness = jax.device_get(assess(outcome, scales))
        replays = []
        for i in range(len(places)):
            terms = {name: float(values[i]) for name, values in outcome.terms.items()}
            alone = {name: values[..., i : i + 1] for name, values in frames.items()}
            key = None if own is None else own[:, i]
            shown, alone = _own(simulation, genes[:, i], key, alone)
            motion = as_recording(shown, alone, _names(experiment, shown))
            replays.append(Replay(float(fitness[i]), terms, alone, motion))
        return replays

    return of


def of_course(simulation: Simulation, keys: UInt32[np.ndarray, " w"]) -> Simulation:
    """Return the simulation of one course, given the raw random keys of its trial."""
    if simulation.draws is None:
        return simulation
    values = simulation.draws.values(np.asarray(simulation.course_keys(keys))[:, None])
    common = dataclasses.replace(simulation, draws=None)
    inputs, kept = inputs_of(simulation.draws, common)
    return BatchedSimulation(common, inputs, [values[i] for i in kept])[0]


def _own(
    simulation: Simulation,
    genes: Float[np.ndarray, " g"],
    keys: UInt32[np.ndarray, " w"] | None,
    frames: dict[str, Any],
) -> tuple[Simulation, dict[str, Any]]:
    """Return the simulation that recorded arrays show: of a course, or of a plan's creature."""
    if simulation.plans is None:
        return simulation if keys is None else of_course(simulation, keys), frames
    own = simulation.plans.own(genes)
    return own, simulation.plans.frames_of(own, frames)


def _names(experiment: ExperimentParts, shown: Simulation) -> list[str]:
    """Return the names of the bodies in the order of the creature, which may be a plan's own."""
    known = set(shown.world.tree.names)
    return [body.name for body in experiment.creature.bodies if body.name in known]
