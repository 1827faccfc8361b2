"""Evaluate an array program for all individuals as one piece of native code.

XLA:CPU makes a kernel of every small matrix product of an articulated body. Memory traffic and the
start of hundreds of kernels then cost several times the arithmetic. This module traces the program
for one individual down to scalars (`frontend.lower`). Every scalar becomes one instruction on a
vector of individuals (`backend.allocate`).

Fused functions may call other fused functions: a trial is one program, and a control step is a
program within it. If an operation is unsupported, only the smallest part around it runs on JAX.
"""

import contextlib
import contextvars
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.native import engine
from evo_cpg.native import jax_internals as internals
from evo_cpg.native.frontend.lower import is_supported
from evo_cpg.native.frontend.primitives import Program, fused_p
from evo_cpg.native.stopwatch import counted
from evo_cpg.native.unsupported import Unsupported

_tracing = contextvars.ContextVar("tracing", default=False)


def fuse(function: Callable, *args: Any, batch_ndim: int, name: str = "") -> Any:
    """Return ``function(*args)``, computed individual by individual in native code.

    Args:
        function: function of pytrees of arrays with any number of trailing batch axes, or none.
            It must treat every individual alike.
        args: pytrees of arrays. The last ``batch_ndim`` axes have the same lengths in all arrays.
        batch_ndim: number of batch axes.
        name: name of the function, for messages.
    """
    if not _tracing.get() and not engine.is_native():
        return function(*args)
    name = name or getattr(function, "__qualname__", "") or type(function).__name__
    if _tracing.get():
        return _bind(function, args, batch_ndim, name)
    try:
        with counted():
            return _bind(function, args, batch_ndim, name)
    except Exception as error:
        # Fall back to plain JAX after any error. If JAX fails, too, it raises its own error.
        with engine.smallest_fallback(name, error):
            return function(*args)


def _bind(function: Callable, args: tuple, batch_ndim: int, name: str) -> Any:
    """Return the results of the primitive.

    Raises:
        Unsupported: the outermost program holds a primitive that native code has no rule for.
    """
    leaves, structure = jax.tree.flatten(args)
    batch = leaves[0].shape[leaves[0].ndim - batch_ndim :]
    singles = [
        jax.ShapeDtypeStruct(leaf.shape[: leaf.ndim - batch_ndim], leaf.dtype) for leaf in leaves
    ]
    with _within_a_program():
        closed, result = jax.make_jaxpr(function, return_shape=True)(*structure.unflatten(singles))
    traced = [isinstance(value, internals.Tracer) for value in closed.consts]
    own = tuple(
        None if is_traced else np.asarray(value)
        for value, is_traced in zip(closed.consts, traced, strict=True)
    )
    shared = [value for value, is_traced in zip(closed.consts, traced, strict=True) if is_traced]
    program = Program(name, internals.opened(closed), own, len(shared))
    unknown = sorted(each for each in program.primitives if not is_supported(each))
    if unknown and not _tracing.get():
        raise Unsupported(f"no rule for {', '.join(unknown)}")
    found = fused_p.bind(*shared, *leaves, program=program, batch=tuple(batch))
    return jax.tree.structure(result).unflatten(found)


def symmetric(m: jax.Array) -> jax.Array:
    """Return the symmetric matrix ``(k, k, ...)``, its lower triangle copied from the upper one.

    In a fused function the lower triangle then costs nothing. Elsewhere the matrix is unchanged.
    """
    if not _tracing.get():
        return m
    size = m.shape[0]
    flat = jnp.unstack(m.reshape(-1, *m.shape[2:]))
    upper = [flat[min(i, j) * size + max(i, j)] for i in range(size) for j in range(size)]
    return jnp.stack(upper).reshape(m.shape)


@contextlib.contextmanager
def _within_a_program() -> Iterator[None]:
    token = _tracing.set(True)
    try:
        yield
    finally:
        _tracing.reset(token)
