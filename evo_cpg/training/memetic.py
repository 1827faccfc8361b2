"""Learning in addition to evolution: every few generations the elites take gradient steps.

The improved genomes replace the elites in the population (Lamarckian learning, as in memetic
algorithms).
"""

from collections.abc import Callable

import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Float

from evo_cpg.training.ascent import compile_ascent, draw_settings
from evo_cpg.training.experiment import ExperimentParts, trial_keys

# Tag that keeps the draws of the ascents apart from other draws of the same seed.
_CLIMB = 3


def compile_learning(
    experiment: ExperimentParts, mesh: Mesh
) -> Callable[..., Float[np.ndarray, "g all"]]:
    """Return a function that runs the elites' gradient ascent on the devices of the mesh.

    Returns:
        A function of the population, the number of its generation, and the task's scales in each
        run, compiled at its first call. Every run's part of the population begins with its elites.
        The result is the population with improved elites. Each run draws from its own seed.
    """
    learning = experiment.learning
    assert learning is not None
    elites, runs = learning.elites, experiment.runs
    climb = compile_ascent(experiment, mesh, learning.steps)

    def learn(
        genes: Float[np.ndarray, "g all"], generation: int, scales: dict[str, tuple[float, ...]]
    ) -> Float[np.ndarray, "g all"]:
        population = genes.shape[1] // runs
        places = (population * np.arange(runs)[:, None] + np.arange(elites)).ravel()
        draws = [
            draw_settings(
                np.random.default_rng((experiment.seed + run, generation, _CLIMB)),
                experiment.simulation,
                elites,
            )
            for run in range(runs)
        ]
        settings = jax.tree.map(lambda *x: np.concatenate(x), *draws)
        own_scales = {
            name: np.repeat(np.array(values, np.float32), elites) for name, values in scales.items()
        }
        climbed = climb(genes[:, places], settings, own_scales, _keys(experiment, generation))
        genes = genes.copy()
        genes[:, places] = climbed.genes
        return genes

    return learn


def _keys(experiment: ExperimentParts, generation: int) -> np.ndarray | None:
    """Return random keys of all elites' trials, ``(w, trials, n)``, or None without noise."""
    assert experiment.learning is not None
    shape = experiment.runs, experiment.learning.elites, experiment.trials
    run, individual, trial = np.indices(shape).reshape(3, -1)
    keys = jax.device_get(trial_keys(experiment, generation, run, individual, trial))
    if keys is None:
        return None
    return np.moveaxis(keys.reshape(len(keys), -1, experiment.trials), 1, 2)
