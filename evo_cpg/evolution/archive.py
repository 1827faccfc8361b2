"""Map of behaviour: axes divided into cells, and the fittest individual of each cell."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int


class Axis(NamedTuple):
    """A descriptor, and how its range is divided into cells.

    Attributes:
        name: name of the descriptor.
        low: lower edge of the first cell.
        high: upper edge of the last cell.
        cells: number of cells.
    """

    name: str
    low: float
    high: float
    cells: int

    @property
    def edges(self) -> Float[np.ndarray, " edges"]:
        """Edges of all cells."""
        return np.linspace(self.low, self.high, self.cells + 1)


class Archive(NamedTuple):
    """Elites: the fittest individual so far of each cell. Checkpoints use the names of the arrays.

    Attributes:
        genes: genome of each elite.
        fitness: fitness of each elite, or -inf if the cell is empty.
        descriptors: descriptors of each elite, in the order of the axes.
        generation: generation in which each elite was found, from 0, or -1 if the cell is empty.
        index: index of each elite in the population of that generation. Generation and index select
            the random numbers of the elite's trials.
        told: number of generations whose individuals were entered into the archive.
    """

    genes: Float[Array, "g cells"]
    fitness: Float[Array, " cells"]
    descriptors: Float[Array, "k cells"]
    generation: Int[Array, " cells"]
    index: Int[Array, " cells"]
    told: Int[Array, ""]
