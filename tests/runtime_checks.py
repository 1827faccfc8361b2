"""Type checker that `conftest` applies to every function and class of the package.

It checks shapes and kinds of numbers. Like the package, it takes an array of NumPy or a number of
NumPy in place of one of JAX or Python.
"""

import collections.abc
import typing

import beartype
import jax
import jaxtyping
import numpy as np
from typing_extensions import is_protocol

# Dimensions that the package states too narrowly.
_DIMENSIONS = {"3 b *#n": "3 #b *#n"}

_check = beartype.beartype(
    conf=beartype.BeartypeConf(
        # An int is allowed for a float, as in PEP 484.
        is_pep484_tower=True,
        hint_overrides=beartype.FrozenDict({bool: bool | np.bool_, int: int | np.integer}),
    )
)


def typechecker(checked):
    """Return a function that checks its arguments, or a class whose methods do."""
    hints = getattr(checked, "__annotations__", {})
    for name, hint in hints.items():
        hints[name] = _relaxed(hint)
    return _check(checked)


def _relaxed(hint):
    """Return what the package takes where it says so."""
    if is_protocol(hint):
        return typing.runtime_checkable(hint)
    if isinstance(hint, type) and issubclass(hint, jaxtyping.AbstractArray):
        dims = _DIMENSIONS.get(hint.dim_str, hint.dim_str)
        return hint.dtype[jax.Array | np.ndarray | np.generic, dims]
    if typing.get_origin(hint) is collections.abc.Sequence:
        return hint | np.ndarray
    # The package refuses other words itself.
    return str if typing.get_origin(hint) is typing.Literal else hint
