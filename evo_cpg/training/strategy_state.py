"""Conversion of a strategy's state to named arrays and back.

Files hold NumPy's own number types directly. They hold the bits of other types, such as bfloat16,
and the raw data of random keys. The type is then part of the name, as in ``best.bfloat16``.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from evo_cpg.errors import UserError


class StrategyError(UserError):
    """Error of a strategy that breaks its contract. The message is for the user."""


def state_arrays(state: PyTree) -> dict[str, np.ndarray]:
    """Return the arrays of a state as NumPy arrays. Names are paths, such as ``archive.genes``.

    If two arrays have the same path, the later name ends with an apostrophe.
    """
    leaves, _ = jax.tree.flatten_with_path(jax.device_get(state))
    return {name: _stored(leaf) for name, leaf in _named(leaves).items()}


def state_from(arrays: Mapping[str, np.ndarray], like: PyTree) -> PyTree:
    """Return the state that `state_arrays` converted to arrays.

    Args:
        arrays: arrays by name.
        like: state of equal structure. Only its shapes and types are used.

    Raises:
        StrategyError: the arrays come from another strategy or from other settings.
    """
    leaves, structure = jax.tree.flatten_with_path(like)
    named = _named(leaves)
    expected = {name: _stored_like(leaf) for name, leaf in named.items()}

    def kinds(given: Mapping[str, Any]) -> dict[str, tuple]:
        return {name: (leaf.shape, np.dtype(leaf.dtype)) for name, leaf in given.items()}

    if kinds(arrays) != kinds(expected):
        found, described = (_described(given) for given in (arrays, expected))
        raise StrategyError(
            f"the checkpoint holds the state of another strategy ({found}). This strategy needs "
            f"{described}. Was the section `evolution` changed?"
        )
    return jax.tree.unflatten(
        structure, [_restored(arrays[name], leaf) for name, leaf in named.items()]
    )


def _named(leaves: Iterable[tuple[tuple, Any]]) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for path, leaf in leaves:
        name = jax.tree_util.keystr(path, simple=True, separator=".") or "value"
        if _is_key(leaf) or _is_foreign(leaf):
            name = f"{name}.{leaf.dtype}"
        while name in named:
            name += "'"
        named[name] = leaf
    return named


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(getattr(leaf, "dtype", bool), jax.dtypes.prng_key)


def _is_foreign(leaf: Any) -> bool:
    """Return whether a leaf's type is not NumPy's own, so that files would lose the type."""
    return np.dtype(getattr(leaf, "dtype", bool)).isbuiltin == 2


def _bits(leaf: Any) -> np.dtype:
    return np.dtype(f"u{np.dtype(leaf.dtype).itemsize}")


def _stored(leaf: Any) -> np.ndarray:
    """Return a leaf as files hold it."""
    if _is_key(leaf):
        return np.asarray(jax.random.key_data(leaf))
    array = np.asarray(leaf)
    return array.view(_bits(array)) if _is_foreign(array) else array


def _stored_like(leaf: Any) -> Any:
    """Return an object with the shape and type of the result of `_stored`."""
    if _is_key(leaf):
        return jax.eval_shape(jax.random.key_data, leaf)
    return jax.ShapeDtypeStruct(leaf.shape, _bits(leaf)) if _is_foreign(leaf) else leaf


def _restored(array: np.ndarray, like: Any) -> Any:
    """Invert `_stored`."""
    if _is_key(like):
        made = []
        jax.eval_shape(lambda key: made.append(jax.random.key_impl(key)), like)
        return jax.random.wrap_key_data(jnp.asarray(array), impl=made[0])
    return array.view(like.dtype) if _is_foreign(like) else array


def _described(arrays: Mapping[str, Any]) -> str:
    if not arrays:
        return "nothing"
    return ", ".join(f"{name} {leaf.shape}" for name, leaf in arrays.items())
