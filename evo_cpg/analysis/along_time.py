"""Evaluation of functions of a trial's physics steps in float64, with time as batch axis."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

# Number of steps in a block. Arrays of surface points at all steps would need too much memory.
_BLOCK = 1024


def along_time(function: Callable, *steps: Any) -> Any:
    """Return ``function(*steps)``, block by block: one program serves trials of any length.

    Args:
        function: function of each step alone. Time is the last axis of arguments and results.
        steps: pytrees of arrays.
    """
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda x: np.asarray(x, np.float64), steps)
        count = jax.tree.leaves(exact)[0].shape[-1]
        program = jax.jit(function)
        parts = []
        for start in range(0, count, _BLOCK):
            # The last block repeats the last step.
            block = np.minimum(np.arange(start, start + _BLOCK), count - 1)
            own = jax.tree.map(functools.partial(_part, block), exact)
            parts.append(jax.device_get(program(*own)))
    return jax.tree.map(lambda *x: np.concatenate(x, -1)[..., :count], *parts)


def _part(block: np.ndarray, values: np.ndarray) -> np.ndarray:
    return values[..., block]
