"""Replay and recording of a champion's trials with their original noise."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from evo_cpg.simulation.judge import JUDGE, Outcome
from evo_cpg.simulation.recording import Recorder, Recording, as_recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.devices import chunk_width
from evo_cpg.training.experiment import (
    ExperimentParts,
    champion_keys,
    judge,
    placeholder_scales,
    situation_numbers,
)

Replayed = tuple[float, dict[str, float], Recording]
"""Mean fitness and mean terms of all trials, and the motion in one trial."""

Frames = tuple[float, dict[str, float], dict[str, Array]]
"""Mean fitness and mean terms of all trials, and the arrays of one trial from a `Recorder`."""


def replay_champion(
    experiment: ExperimentParts, champion: Champion, devices: int, recorded: int = 0
) -> Replayed:
    """Repeat the champion's trials with their original noise.

    Args:
        experiment: experiment in which the champion evolved.
        champion: individual to replay.
        devices: number of devices that shared the population in training.
        recorded: number of the trial to record, from 0.

    Returns:
        Mean fitness and mean terms of all trials, and the motion in one trial.
    """
    return compile_replay(experiment, devices, recorded)(champion)


def compile_replay(
    experiment: ExperimentParts, devices: int, recorded: int = 0
) -> Callable[[Champion], Replayed]:
    """Compile `replay_champion` before there is a champion.

    The program of the training trials cannot record. It computes a whole trial as one piece of
    native code that returns only final results. The frames of all its individuals would take
    hundreds of megabytes. A recording runs a trial step by step.
    """
    program = compile_frames(experiment, devices, recorded)
    names = [body.name for body in experiment.creature.bodies]

    def of(champion: Champion) -> Replayed:
        fitness, terms, frames = program(champion)
        motion = as_recording(experiment.simulation, frames, names, trial=recorded)
        return fitness, terms, motion

    return of


def compile_frames(
    experiment: ExperimentParts, devices: int, recorded: int = 0, full: bool = False
) -> Callable[[Champion], Frames]:
    """Compile `replay_champion` with recorded arrays of each control step instead of a motion.

    If ``full``, record all quantities (see `evo_cpg.simulation.recording.Recorder`).
    """
    simulation, genes = experiment.simulation, experiment.simulation.genome.count
    numbers = situation_numbers(experiment)
    placeholder = Champion(np.zeros(genes, np.float32), 0.0, 0, {}, {}, 0, 0)
    keys = jax.eval_shape(lambda: champion_keys(experiment, placeholder))
    program = jax.jit(functools.partial(replay, experiment, devices, recorded=recorded, full=full))
    lowered = program.lower(jax.ShapeDtypeStruct((genes,), jnp.float32), keys, numbers)
    # Compile `judge` too, as in training: compiled code may fuse a multiplication and an addition,
    # with one rounding instead of two.
    scales = {name: jnp.float32(1.0) for name in placeholder_scales(experiment)}
    assess = jax.jit(functools.partial(judge, simulation.task))
    assessed = assess.lower(lowered.out_info[0], scales).compile()
    run = lowered.compile()

    def of(champion: Champion) -> Frames:
        given = np.asarray(champion.genes, np.float32), champion_keys(experiment, champion)
        outcome, frames = run(*given, numbers)
        fitness, mean = assessed(
            outcome, {name: jnp.float32(value) for name, value in champion.scales.items()}
        )
        terms = {name: float(value) for name, value in mean.terms.items()}
        return float(fitness), terms, frames

    return of


def replay(
    experiment: ExperimentParts,
    devices: int,
    genes: Float[Array, " g"],
    keys: UInt32[Array, "w trials"] | None = None,
    numbers: Int[Array, " trials"] | None = None,
    recorded: int = 0,
    full: bool = False,
) -> tuple[Outcome, dict[str, Array]]:
    """Run an individual's trials on one device, in chunks as wide as in training.

    Compiled code may round differently for other array lengths, or if an array is a constant. Array
    lengths and arguments are as in training, so the numbers are equal, too.

    Args:
        experiment: experiment in which the individual evolved.
        devices: number of devices that shared the population in training.
        genes: genome of the individual.
        keys: random keys of the trials, or None without noise.
        numbers: situation numbers of the trials, see `situation_numbers`.
        recorded: number of the trial to record, from 0.
        full: whether to record all quantities, see `evo_cpg.simulation.recording.Recorder`.

    Returns:
        The outcome of each trial, and the recorded arrays of one trial.
    """
    simulation, trials = experiment.simulation, experiment.trials
    count = experiment.runs * experiment.strategy.population * trials
    lanes = chunk_width(count, devices)
    replicas = jnp.broadcast_to(genes[:, None], (genes.shape[0], lanes))

    def beginning_with(first: int) -> tuple[Array | None, Array | None]:
        """Return keys and numbers of the trials in all lanes. Lane 0 holds the trial ``first``."""
        order = (np.arange(lanes) + first) % trials
        return jax.tree.map(lambda x: x[..., order], (keys, numbers))

    # A chunk may hold fewer trials than an individual has.
    parts, frames = [], {}
    for start in range(0, trials, lanes):
        if start <= recorded < start + lanes:
            observers = JUDGE, Recorder(first=recorded - start, full=full)
            outcome, frames = rollout(simulation, replicas, *beginning_with(start), observers)
        else:
            outcome = rollout(simulation, replicas, *beginning_with(start))
        parts.append(outcome)
    return jax.tree.map(lambda *x: jnp.concatenate(x)[:trials], *parts), frames
