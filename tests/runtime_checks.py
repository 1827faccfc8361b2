"""Type checker that `conftest` applies to every function and class of the package.

It checks shapes and kinds of numbers. Like the package, it takes an array of NumPy or one with some
traced elements in place of one of JAX, and a number of NumPy in place of one of Python.
"""

import collections.abc
import functools
import operator
import types
import typing

import beartype
import jax
import jaxtyping
import numpy as np
from typing_extensions import is_protocol

from evo_cpg.creature.algebra.numerics import MixedArray

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
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        return functools.reduce(operator.or_, map(_relaxed, typing.get_args(hint)))
    if is_protocol(hint):
        return typing.runtime_checkable(hint)
    if isinstance(hint, type) and issubclass(hint, jaxtyping.AbstractArray):
        return hint.dtype[jax.Array | MixedArray | np.ndarray | np.generic, hint.dim_str]
    if typing.get_origin(hint) is collections.abc.Sequence:
        return hint | np.ndarray
    # The package refuses other words itself.
    return str if typing.get_origin(hint) is typing.Literal else hint
