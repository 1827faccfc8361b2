"""Evaluate an array program for all individuals as one piece of native code.

XLA:CPU gives every small matrix product of an articulated body a kernel of its own: reading and
writing memory and starting hundreds of kernels then costs several times the arithmetic. Here the
program is traced for one individual down to scalars (`frontend.lower`), and every scalar
becomes one instruction on a vector of individuals (`backend.allocate`).

Functions that are fused may call others that are: a trial is one program, of which a control step
is a part that is a program as well. What cannot become native code is then the smallest part that
holds what is in the way.
"""

import contextlib
import contextvars
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.fusion import engine
from evo_cpg.fusion import jax_internals as internals
from evo_cpg.fusion.frontend.lower import is_supported
from evo_cpg.fusion.frontend.primitives import Program, fused_p
from evo_cpg.fusion.stopwatch import counted
from evo_cpg.fusion.unsupported import Unsupported

_tracing = contextvars.ContextVar("tracing", default=False)


def fuse(function: Callable, *args: Any, batch_ndim: int, name: str = "") -> Any:
    """``function(*args)``, computed individual by individual in native code.

    Args:
        function: of pytrees of arrays, with any number of trailing batch axes, none included, that
            treats every individual alike.
        args: arrays whose last ``batch_ndim`` axes are the same for all.
        batch_ndim: number of batch axes.
        name: of the function, for messages.
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
        # Whatever it is: if JAX cannot compute the whole either, it says so.
        with engine.smallest_fallback(name, error):
            return function(*args)


def _bind(function: Callable, args: tuple, batch_ndim: int, name: str) -> Any:
    """The results of the primitive.

    Raises:
        Unsupported: outside of other programs, it holds what native code has no rule for.
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
        raise Unsupported(f"it has no rule for {', '.join(unknown)}")
    found = fused_p.bind(*shared, *leaves, program=program, batch=tuple(batch))
    return jax.tree.structure(result).unflatten(found)


def symmetric(m: jax.Array) -> jax.Array:
    """The same matrix ``(k, k, ...)``, known to be symmetric: fused, its lower half costs nothing.

    Outside a fused function the matrix is returned as it is.
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
