"""Record the trials of many settings at once, in one program."""

import math
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis.laboratory.settings import LabError
from evo_cpg.simulation.batched import BatchedSimulation
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.devices import layout, population_mesh, run_in_blocks, sharded

# Largest size of all frames, bytes.
_LARGEST = 4e9


def record_all(
    simulation: Simulation | BatchedSimulation, genes: Float[np.ndarray, "g n"]
) -> dict[str, np.ndarray]:
    """Return full frames of all individuals, by name (see `Recorder`).

    Args:
        simulation: the trial, or one trial for each individual.
        genes: genomes of the individuals.

    Raises:
        LabError: the frames are too large for the memory of an ordinary computer.
    """
    inputs, values = None, ()
    if isinstance(simulation, BatchedSimulation):
        common, inputs, values = simulation
    else:
        common = simulation
    recorder = Recorder(count=None, full=True)

    def follow(values: tuple[Array, ...], genes: Array) -> dict[str, Array]:
        own = BatchedSimulation(common, inputs, values) if inputs else common
        return rollout(own, genes, None, None, recorder)

    own = tuple(np.asarray(value, genes.dtype) for value in values)
    count = genes.shape[1]
    spread = layout(count, population_mesh())
    given: Any = tuple(own), genes
    shapes = jax.eval_shape(follow, *given)
    size = sum(math.prod(x.shape) * x.dtype.itemsize for x in jax.tree.leaves(shapes))
    if size > _LARGEST:
        seconds = common.steps / common.control_rate
        raise LabError(
            f"{count} settings of {seconds:g} s need {size / 1e9:.1f} GB "
            f"of memory. Allowed: up to {_LARGEST / 1e9:g} GB. Ask fewer settings or shorter trials"
        )
    program = sharded(follow, spread.mesh, (2, 2), jax.tree.map(lambda x: x.ndim, shapes))
    return run_in_blocks(
        program,
        spread,
        count,
        lambda numbers: jax.tree.map(lambda x: x[:, numbers], given),
    )
