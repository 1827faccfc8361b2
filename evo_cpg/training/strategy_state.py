"""What a strategy remembers, as named arrays and back.

Files hold numbers of NumPy's own types. Of other ones, such as bfloat16, they hold the bits, and of
random keys their data; the type is then a part of the name, as in ``best.bfloat16``.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from evo_cpg.errors import UserError


class StrategyError(UserError):
    """A strategy that does not do what it must; the message is for the user."""


def state_arrays(state: PyTree) -> dict[str, np.ndarray]:
    """The leaves of a state by their paths, such as ``archive.genes``; on the host.

    Where two have the same path, the later one's has a prime.
    """
    leaves, _ = jax.tree.flatten_with_path(jax.device_get(state))
    return {name: _stored(leaf) for name, leaf in _named(leaves).items()}


def state_from(arrays: Mapping[str, np.ndarray], like: PyTree) -> PyTree:
    """The inverse of `state_arrays`.

    Args:
        arrays: by path.
        like: a state of the same structure, of which only shapes and types are looked at.

    Raises:
        StrategyError: they are those of another strategy, or of other settings of it.
    """
    leaves, structure = jax.tree.flatten_with_path(like)
    named = _named(leaves)
    expected = {name: _stored_like(leaf) for name, leaf in named.items()}

    def kinds(given: Mapping[str, Any]) -> dict[str, tuple]:
        return {name: (leaf.shape, np.dtype(leaf.dtype)) for name, leaf in given.items()}

    if kinds(arrays) != kinds(expected):
        found, described = (_described(given) for given in (arrays, expected))
        raise StrategyError(
            f"the checkpoint holds what another strategy remembers ({found}), and this one "
            f"{described}: was the section `evolution` changed?"
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
    """Whether its type comes from another package than NumPy, whose files lose it."""
    return np.dtype(getattr(leaf, "dtype", bool)).isbuiltin == 2


def _bits(leaf: Any) -> np.dtype:
    return np.dtype(f"u{np.dtype(leaf.dtype).itemsize}")


def _stored(leaf: Any) -> np.ndarray:
    """A leaf as files hold it."""
    if _is_key(leaf):
        return np.asarray(jax.random.key_data(leaf))
    array = np.asarray(leaf)
    return array.view(_bits(array)) if _is_foreign(array) else array


def _stored_like(leaf: Any) -> Any:
    """Something of the shape and type that `_stored` gives."""
    if _is_key(leaf):
        return jax.eval_shape(jax.random.key_data, leaf)
    return jax.ShapeDtypeStruct(leaf.shape, _bits(leaf)) if _is_foreign(leaf) else leaf


def _restored(array: np.ndarray, like: Any) -> Any:
    """The inverse of `_stored`."""
    if _is_key(like):
        made = []
        jax.eval_shape(lambda key: made.append(jax.random.key_impl(key)), like)
        return jax.random.wrap_key_data(jnp.asarray(array), impl=made[0])
    return array.view(like.dtype) if _is_foreign(like) else array


def _described(arrays: Mapping[str, Any]) -> str:
    if not arrays:
        return "nothing"
    return ", ".join(f"{name} {leaf.shape}" for name, leaf in arrays.items())
