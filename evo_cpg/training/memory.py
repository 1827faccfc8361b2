"""How much memory a run needs, and whether the machine has it: known before it starts.

Trials run in blocks that are small whatever the population; what grows with it are its genomes, of
which breeding holds several copies. 20,000 to 500,000 individuals took four times their genomes. A
map of behaviour has a genome in every cell.
"""

import contextlib
import os
from pathlib import Path

from evo_cpg.evolution.map_elites import MapStrategy
from evo_cpg.training.experiment import Experiment

# Bytes of everything else, and copies of all genomes at the worst moment, with room to spare.
_REST, _COPIES = 2**29, 6
_GENE = 4  # bytes

_CONTROL_GROUPS = (
    "/sys/fs/cgroup/memory.max",
    "/sys/fs/cgroup/memory/memory.limit_in_bytes",
)


class TooLargeError(Exception):
    """A population for which the machine has no memory; the message is for the user."""


def needed(experiment: Experiment) -> int:
    """Bytes that training will need at most."""
    genes = experiment.simulation.controller.gene_count
    genomes = experiment.strategy.population + _cells(experiment)
    return _REST + _COPIES * _GENE * genes * experiment.runs * genomes


def available() -> int | None:
    """Bytes that the machine has, or its container; None where that cannot be known."""
    found = []
    for file in _CONTROL_GROUPS:
        try:
            found.append(int(Path(file).read_text()))
        except (OSError, ValueError):
            # No such group, or one without a limit.
            continue
    with contextlib.suppress(AttributeError, OSError, ValueError):
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min(found, default=None)


def require_memory(experiment: Experiment) -> None:
    """Check that a run fits.

    Raises:
        TooLargeError: it does not.
    """
    asked, there = needed(experiment), available()
    if there is None or asked <= there:
        return
    genes = experiment.simulation.controller.gene_count
    individuals = experiment.runs * experiment.strategy.population
    cells = _cells(experiment)
    most = (there - _REST) // (_COPIES * _GENE * genes) // experiment.runs - cells
    beside = f" and {cells} cells of a map" if cells else ""
    raise TooLargeError(
        f"evolution.population: {individuals} individuals in all{beside}, of {genes} genes, need "
        f"up to {asked / 2**30:.1f} GiB, and there are {there / 2**30:.1f}; allowed here: "
        f"{max(0, most)}"
    )


def _cells(experiment: Experiment) -> int:
    """Of a map of behaviour, in one run."""
    strategy = experiment.strategy
    return strategy.cells if isinstance(strategy, MapStrategy) else 0
