"""Learning in the course of evolution: some individuals take gradient steps before their trials.

Offspring inherit what their parents have learned (Lamarckian learning, as in memetic algorithms),
or only the genes with which these began (Baldwinian learning, Hinton and Nowlan 1987, "How learning
can guide evolution").
"""

from collections.abc import Callable

import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Float

from evo_cpg.training.ascent import compile_ascent, draw_settings
from evo_cpg.training.experiment import ExperimentParts, trial_keys
from evo_cpg.training.plan_ascent import compile_plan_ascent

# Tag that keeps the draws of the ascents apart from other draws of the same seed.
_CLIMB = 3


def compile_learning(
    experiment: ExperimentParts, mesh: Mesh
) -> Callable[..., Float[np.ndarray, "g all"]]:
    """Return a function that runs the gradient ascent of those who learn, on the mesh's devices.

    Returns:
        A function of the population, the number of its generation, and the task's scales in each
        run, compiled at its first call. Every run's part of the population begins with its elites,
        then come children. The result is the population after the ascent of the first of each run.
        Each run draws from its own seed.
    """
    learning = experiment.learning
    assert learning is not None
    learners, runs = learning.learners, experiment.runs
    compile_climb = compile_plan_ascent if experiment.simulation.plans else compile_ascent
    climb = compile_climb(experiment, mesh, learning.steps)
    of_trials = np.indices((runs, learners, experiment.trials)).reshape(3, -1)

    def learn(
        genes: Float[np.ndarray, "g all"], generation: int, scales: dict[str, tuple[float, ...]]
    ) -> Float[np.ndarray, "g all"]:
        population = genes.shape[1] // runs
        places = (population * np.arange(runs)[:, None] + np.arange(learners)).ravel()
        draws = []
        for run in range(runs):
            draw = np.random.default_rng((experiment.seed + run, generation, _CLIMB))
            draws.append(draw_settings(draw, experiment.simulation, learners))
        settings = jax.tree.map(lambda *x: np.concatenate(x), *draws)
        own_scales = {
            name: np.repeat(np.array(values, np.float32), learners)
            for name, values in scales.items()
        }
        keys = jax.device_get(trial_keys(experiment, generation, *of_trials))
        if keys is not None:
            # Words of a key, trials, and learners.
            keys = np.moveaxis(keys.reshape(len(keys), -1, experiment.trials), 1, 2)
        climbed = climb(genes[:, places], settings, own_scales, keys)
        genes = genes.copy()
        genes[:, places] = climbed.genes
        return genes

    return learn
