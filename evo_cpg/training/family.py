"""Descent of the individuals of a run."""

import numpy as np
from jaxtyping import Int

from evo_cpg.training.run_folder import RunFolder


def founders(folder: RunFolder, generation: int) -> Int[np.ndarray, " n"] | None:
    """Return the ancestors in generation 0 of the individuals of run 0, through first parents.

    Return None if the run keeps no family tree.
    """
    del folder, generation
    return None
