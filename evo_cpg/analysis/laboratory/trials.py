"""Record the trials of many settings at once, in one program."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.laboratory.settings import LabError
from evo_cpg.simulation.batched import BatchedSimulation
from evo_cpg.simulation.noise import raw_keys
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials

# Largest size of all frames, bytes.
_LARGEST = 4e9


def record_all(
    simulation: Simulation | BatchedSimulation, genes: Float[np.ndarray, "g n"]
) -> dict[str, np.ndarray]:
    """Return full frames of all individuals, by name (see `Recorder`).

    Raises:
        LabError: the frames are too large for the memory of an ordinary computer.
    """
    inputs, values = None, None
    if isinstance(simulation, BatchedSimulation):
        common, inputs, values = simulation
    else:
        common = simulation
    recorder, count, keys = Recorder(count=None, full=True), genes.shape[1], None
    if not common.silent:
        # All settings have the same course.
        keys = jnp.tile(raw_keys(jax.random.key(0))[:, None], count)
    shapes = jax.eval_shape(lambda genes: rollout(common, genes, keys, None, recorder), genes)
    size = sum(math.prod(x.shape) * x.dtype.itemsize for x in jax.tree.leaves(shapes))
    if size > _LARGEST:
        seconds = common.steps / common.control_rate
        raise LabError(
            f"{count} settings of {seconds:g} s need {size / 1e9:.1f} GB "
            f"of memory. Allowed: up to {_LARGEST / 1e9:g} GB. Ask fewer settings or shorter trials"
        )
    live = compile_trials(common, population_mesh(), None, inputs, recorder)
    return live(genes, jax.device_get(keys), None, 1, values)
