"""Memory that a run needs, compared with the machine's memory before the run starts.

Trials run in blocks, so their memory does not depend on the population. The memory of genomes
does: breeding holds several copies of all genomes (four for 20,000 to 500,000 individuals). The
state of a search is added, such as a genome in every cell of a map of behaviour, or a covariance
matrix.
"""

import contextlib
import math
import os
from pathlib import Path

import jax

from evo_cpg.errors import UserError
from evo_cpg.system import described_by
from evo_cpg.training.experiment import ExperimentParts, begin

# Bytes of everything except genomes and search state, and the largest number of copies of genomes
# and search state. Both have a margin.
_REST, _COPIES = 2**29, 6
_GENE = 4  # bytes
# Smallest size of a search's state, bytes, that the error mentions.
_MENTIONED = 2**20

_CONTROL_GROUPS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


class TooLargeError(UserError):
    """Error for a run that needs more memory than the machine has, shown to the user."""


def needed(experiment: ExperimentParts) -> tuple[int, int]:
    """Return an estimate of the bytes that training needs at most, and of the search state's bytes.

    The search state of all runs is without their populations. Checkpoints hold it.
    """
    # Only shapes are evaluated here.
    leaves = jax.tree.leaves(jax.eval_shape(lambda: begin(experiment))[1])
    state = sum(math.prod(x.shape) * x.dtype.itemsize for x in leaves)
    genes = experiment.simulation.genome.count
    genomes = _GENE * genes * experiment.runs * experiment.strategy.population
    return _REST + _COPIES * (genomes + state), state


def available() -> int | None:
    """Return the memory of the machine or its container, bytes, or None if unknown."""
    found = []
    for file in _CONTROL_GROUPS:
        # The control group may be missing, or have no limit.
        with contextlib.suppress(ValueError):
            found.append(int(described_by(Path(file))))
    with contextlib.suppress(AttributeError, OSError, ValueError):
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min(found, default=None)


def require_memory(experiment: ExperimentParts) -> None:
    """Check that a run fits into the memory.

    Raises:
        TooLargeError: the run does not fit.
    """
    (need, state), there = needed(experiment), available()
    if there is None or need <= there:
        return
    genes = experiment.simulation.genome.count
    individuals = experiment.runs * experiment.strategy.population
    most = (there - _REST - _COPIES * state) // (_COPIES * _GENE * genes) // experiment.runs
    searched = f" and {state / 2**30:.2g} GiB of search state" if state > _MENTIONED else ""
    smaller = (
        f"Allowed here: {most}"
        if most > 1
        else "No population fits into the memory. Try a smaller controller, or a search with less "
        "state"
    )
    raise TooLargeError(
        f"evolution.population: {individuals} individuals in all, of {genes} genes,{searched} need "
        f"up to {need / 2**30:.1f} GiB, but this machine has {there / 2**30:.1f} GiB. {smaller}"
    )
