"""What follows from the physics steps of a trial, in float64: time is the batch axis."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

# Steps that are looked at together: the arrays of surface points are large.
_BLOCK = 1024


def along_time(function: Callable, *steps: Any) -> Any:
    """``function(*steps)``, block by block, so that one program serves trials of any length.

    Args:
        function: treats every step alike; time is the last axis of what it takes and gives.
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
