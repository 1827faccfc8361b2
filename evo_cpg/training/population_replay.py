"""Replays of several individuals of a population, side by side.

They have the whole first trial, with fitness and joints, as a replay of a champion has. Films of
whole populations need only places of bodies, see `evo_cpg.training.crowd_motion`.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from evo_cpg.native.machine_constants import LANES
from evo_cpg.simulation.judge import JUDGE, score
from evo_cpg.simulation.recording import Recorder, Recording, as_recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.training.checkpoint import Checkpoint
from evo_cpg.training.experiment import ExperimentParts, placeholder_scales, trial_keys


class PopulationReplay(NamedTuple):
    """First trials of some individuals.

    Attributes:
        fitness: fitness of each in its first trial, or -inf if it diverged or broke a rule.
        recordings: motion of each in this trial.
    """

    fitness: Float[np.ndarray, " n"]
    recordings: list[Recording]


def compile_population_replay(
    experiment: ExperimentParts,
) -> Callable[[Checkpoint, int, Sequence[int]], PopulationReplay]:
    """Compile a function that runs the first trials of at most `LANES` individuals.

    All individuals of a vector cost as much as one, so a replay of a single one would waste the
    others.

    Args:
        experiment: experiment in which the individuals evolve.

    Returns:
        A function of a checkpoint, the number of a run, and the places of individuals in the run's
        population. The individuals are those of the next generation, with its noise.
    """
    simulation = experiment.simulation
    names = [body.name for body in experiment.creature.bodies]

    def trial(
        genes: Float[Array, "g lanes"],
        keys: UInt32[Array, "w lanes"] | None,
        scales: dict[str, Float[Array, ""]],
    ) -> tuple[Float[Array, " lanes"], dict[str, Array]]:
        several = len(simulation.situations) > 1
        first = jnp.zeros(LANES, int) if several else None
        observers = JUDGE, Recorder(count=None)
        outcome, frames = rollout(simulation, genes, keys, first, observers)
        return score(simulation.task, outcome, scales), frames

    lanes = np.zeros(LANES, int)
    program = (
        jax.jit(trial)
        .lower(
            jax.ShapeDtypeStruct((simulation.genome.count, LANES), jnp.float32),
            jax.eval_shape(lambda: trial_keys(experiment, 0, lanes, lanes, lanes)),
            dict.fromkeys(placeholder_scales(experiment), jnp.float32(1.0)),
        )
        .compile()
    )

    def of(checkpoint: Checkpoint, run: int, places: Sequence[int]) -> PopulationReplay:
        # Copies of the last individual fill the vector.
        filled = np.pad(np.asarray(places), (0, LANES - len(places)), mode="edge")
        keys = trial_keys(experiment, checkpoint.generation, lanes + run, filled, lanes)
        genes = checkpoint.genes[:, run * experiment.strategy.population + filled]
        scales = {name: jnp.float32(each[run]) for name, each in checkpoint.scales.items()}
        fitness, frames = jax.device_get(program(np.asarray(genes, np.float32), keys, scales))
        motions = [as_recording(simulation, frames, names, i) for i in range(len(places))]
        return PopulationReplay(fitness[: len(places)], motions)

    return of
