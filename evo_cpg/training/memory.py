"""How much memory a run needs, and whether the machine has it: known before it starts.

Trials run in blocks that are small whatever the population; what grows with it are its genomes, of
which breeding holds several copies: 20,000 to 500,000 individuals took four times their genomes.
Beside them is what a search remembers from one generation to the next, such as a genome in every
cell of a map of behaviour, or a covariance matrix.
"""

import contextlib
import math
import os
from pathlib import Path

import jax

from evo_cpg.errors import UserError
from evo_cpg.system import described_by
from evo_cpg.training.experiment import Experiment, begin

# Bytes of everything else, and copies of all genomes, and of what a search remembers, at the worst
# moment, with room to spare.
_REST, _COPIES = 2**29, 6
_GENE = 4  # bytes
# What a search remembers is told from so many bytes on.
_MENTIONED = 2**20

_CONTROL_GROUPS = (
    "/sys/fs/cgroup/memory.max",
    "/sys/fs/cgroup/memory/memory.limit_in_bytes",
)


class TooLargeError(UserError):
    """A run for which the machine has no memory; the message is for the user."""


def needed(experiment: Experiment) -> int:
    """Bytes that training will need at most."""
    genes = experiment.simulation.genome.count
    genomes = _GENE * genes * experiment.runs * experiment.strategy.population
    return _REST + _COPIES * (genomes + remembered(experiment))


def remembered(experiment: Experiment) -> int:
    """Bytes of what the searches of all runs remember beside their populations.

    That is what checkpoints hold of them. Nothing is computed for it.
    """
    state = jax.eval_shape(lambda: begin(experiment))[1]
    return sum(math.prod(x.shape) * x.dtype.itemsize for x in jax.tree.leaves(state))


def available() -> int | None:
    """Bytes that the machine has, or its container; None where that cannot be known."""
    found = []
    for file in _CONTROL_GROUPS:
        # No such group, or one without a limit.
        with contextlib.suppress(ValueError):
            found.append(int(described_by(Path(file))))
    with contextlib.suppress(AttributeError, OSError, ValueError):
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min(found, default=None)


def require_memory(experiment: Experiment) -> None:
    """Check that a run fits.

    Raises:
        TooLargeError: it does not.
    """
    need, there = needed(experiment), available()
    if there is None or need <= there:
        return
    genes = experiment.simulation.genome.count
    individuals = experiment.runs * experiment.strategy.population
    state = remembered(experiment)
    most = (there - _REST - _COPIES * state) // (_COPIES * _GENE * genes) // experiment.runs
    beside = (
        f" and the {state / 2**30:.2g} GiB that their search remembers"
        if state > _MENTIONED
        else ""
    )
    smaller = (
        f"allowed here: {most}"
        if most > 1
        else "no population is small enough, but a smaller controller may be, or a search that "
        "remembers less"
    )
    raise TooLargeError(
        f"evolution.population: {individuals} individuals in all, of {genes} genes,{beside} need "
        f"up to {need / 2**30:.1f} GiB, and there are {there / 2**30:.1f}; {smaller}"
    )
