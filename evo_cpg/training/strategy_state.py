"""What a strategy remembers, as named arrays and back."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

from evo_cpg.errors import UserError


class StrategyError(UserError):
    """A strategy that does not do what it must; the message is for the user."""


def state_arrays(state: PyTree) -> dict[str, np.ndarray]:
    """The leaves of a state by their paths, such as ``archive.genes``; on the host."""
    leaves, _ = jax.tree.flatten_with_path(jax.device_get(state))
    return {_name(path): np.asarray(leaf) for path, leaf in leaves}


def state_from(arrays: Mapping[str, np.ndarray], like: PyTree) -> PyTree:
    """The inverse of `state_arrays`.

    Args:
        arrays: by path.
        like: a state of the same structure, of which only shapes and types are looked at.

    Raises:
        StrategyError: they are those of another strategy, or of other settings of it.
    """
    leaves, structure = jax.tree.flatten_with_path(like)
    wanted = {_name(path): leaf for path, leaf in leaves}

    def kinds(given: Mapping[str, Any]) -> dict[str, tuple]:
        return {name: (leaf.shape, np.dtype(leaf.dtype)) for name, leaf in given.items()}

    if kinds(arrays) != kinds(wanted):
        found, asked = (_described(given) for given in (arrays, wanted))
        raise StrategyError(
            f"the checkpoint holds what another strategy remembers ({found}), and this one "
            f"{asked}: was the section `evolution` changed?"
        )
    return jax.tree.unflatten(structure, [arrays[name] for name in wanted])


def _name(path: tuple) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".") or "value"


def _described(arrays: Mapping[str, Any]) -> str:
    if not arrays:
        return "nothing"
    return ", ".join(f"{name} {leaf.shape}" for name, leaf in arrays.items())
