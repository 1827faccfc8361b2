"""What physics, controllers and sensors call: array programs for all individuals in native code.

| function | use |
|---|---|
| `fuse` | evaluate a function for all individuals as one piece of native code |
| `while_each` | iterate until every individual has converged |
| `implicit` | differentiate the result of a search by the implicit function theorem |
| `solve_symmetric` | solve linear equations with a symmetric positive definite matrix |
| `self_adjoint` | evaluate a linear function that is its own transpose |
| `unset` | begin a list that a loop fills |
| `symmetric` | say that a matrix is symmetric, so that half of it costs nothing |

XLA:CPU makes a kernel of every small matrix product of an articulated body. Memory traffic and the
start of hundreds of kernels then cost several times the arithmetic. `fuse` traces the program for
one individual down to scalars (`frontend.lower`). Every scalar becomes one instruction on a vector
of individuals (`backend.allocate`).

Fused functions may call other fused functions: a trial is one program, and a control step is a
program within it. If an operation is unsupported, only the smallest part around it runs on JAX.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.native import engine
from evo_cpg.native import jax_internals as internals
from evo_cpg.native.frontend.lower import is_supported
from evo_cpg.native.frontend.primitives import (
    Program,
    eliminate_p,
    fused_p,
    is_tracing,
    linear_map,
    traced,
    unset_p,
)
from evo_cpg.native.ir import Unsupported

Value = TypeVar("Value")


def fuse(
    function: Callable,
    *args: Any,
    batch_ndim: int,
    name: str = "",
    tangents: tuple[int, int] = (0, 0),
) -> Any:
    """Return ``function(*args)``, computed individual by individual in native code.

    Args:
        function: function of pytrees of arrays with any number of trailing batch axes, or none.
            It must treat every individual alike.
        args: pytrees of arrays. The last ``batch_ndim`` axes have the same lengths in all arrays.
        batch_ndim: number of batch axes.
        name: name of the function, for messages.
        tangents: see `Program.tangents`.
    """
    if not is_tracing() and not engine.is_native():
        return function(*args)
    name = name or getattr(function, "__qualname__", "") or type(function).__name__
    if is_tracing():
        return _bind(function, args, batch_ndim, name, tangents)
    try:
        return _bind(function, args, batch_ndim, name, tangents)
    except Exception as error:
        # Fall back to plain JAX after any error. If JAX fails, too, it raises its own error.
        with engine.smallest_fallback(name, error):
            return function(*args)


def _bind(
    function: Callable, args: tuple, batch_ndim: int, name: str, tangents: tuple[int, int]
) -> Any:
    """Return the results of the primitive.

    Raises:
        Unsupported: if the outermost program holds a primitive that native code has no rule for.
    """
    leaves, structure = jax.tree.flatten(args)
    batch = leaves[0].shape[leaves[0].ndim - batch_ndim :]
    singles = [
        jax.ShapeDtypeStruct(leaf.shape[: leaf.ndim - batch_ndim], leaf.dtype) for leaf in leaves
    ]
    closed, result = traced(function, *structure.unflatten(singles))
    shared = [value for value in closed.consts if isinstance(value, internals.Tracer)]
    own = tuple(
        None if isinstance(value, internals.Tracer) else np.asarray(value)
        for value in closed.consts
    )
    program = Program(name, internals.opened(closed), own, len(shared), tangents)
    unknown = sorted(each for each in program.primitives if not is_supported(each))
    if unknown and not is_tracing():
        raise Unsupported(f"no rule for {', '.join(unknown)}")
    found = fused_p.bind(*shared, *leaves, program=program, batch=tuple(batch))
    return jax.tree.structure(result).unflatten(found)


def symmetric(m: jax.Array) -> jax.Array:
    """Return the symmetric matrix ``(k, k, ...)``, its lower triangle copied from the upper one.

    In a fused function the lower triangle then costs nothing. Elsewhere the matrix is unchanged.
    """
    if not is_tracing():
        return m
    size = m.shape[0]
    flat = jnp.unstack(m.reshape(-1, *m.shape[2:]))
    upper = [flat[min(i, j) * size + max(i, j)] for i in range(size) for j in range(size)]
    return jnp.stack(upper).reshape(m.shape)


def solve_symmetric(H: Float[Array, "v v *n"], b: Float[Array, "v *n"]) -> Float[Array, "v *n"]:
    """Return ``H^-1 b``. Its derivative solves equations with the same matrix."""
    return jax.lax.custom_linear_solve(
        lambda x: (H * x[None]).sum(1), b, lambda _, b: eliminate_p.bind(H, b)[0], symmetric=True
    )


def self_adjoint(run: Callable[[Value, jax.Array], jax.Array], fixed: Value, x: jax.Array) -> Any:
    """Return ``run(fixed, x)`` for a function that is linear in x, with a symmetric matrix.

    Its transpose is the function itself, so a gradient does not differentiate its operations.
    """
    leaves, structure = jax.tree.flatten(fixed)

    def flat(leaves: Sequence[jax.Array], x: Sequence[jax.Array]) -> list[jax.Array]:
        return [run(structure.unflatten(leaves), *x)]

    return linear_map(flat, flat, leaves, [x], [x])[0]


def unset(shape: tuple[int, ...], like: jax.Array) -> jax.Array:
    """Return an array of zeros with the type of ``like``, for a loop that sets elements in turn.

    Native code does not clear its memory, so elements must not be read before they are set. In a
    derivative they are zeros, because it may multiply such an element by 0.

    Args:
        shape: shape of the array.
        like: an array that has a tangent if anything has.
    """
    return unset_p.bind(like, shape=shape)[0]


def while_each(
    goes_on: Callable[[Value], jax.Array], advance: Callable[[Value], Value], x: Value
) -> Value:
    """Run ``jax.lax.while_loop`` with a separate condition for every individual.

    Args:
        goes_on: function that returns whether each individual continues, ``(*n)``.
        advance: function from a pytree of arrays, individuals on their last axes, to the next one.
        x: initial value.
    """

    def step(x: Value) -> Value:
        going, new = goes_on(x), advance(x)
        if not going.ndim:
            return new
        return jax.tree.map(lambda new, old: jnp.where(going, new, old), new, x)

    return jax.lax.while_loop(lambda x: jnp.any(goes_on(x)), step, x)


def implicit(
    search: Callable[[Value], tuple[Any, Any]], replay: Callable[[Any], Any], x: Value, like: Any
) -> Any:
    """Return the first result of ``search(x)``, with the derivatives of ``replay``.

    JAX has no reverse mode through ``while_loop``. By the implicit function theorem, the derivative
    of a solution does not depend on the iterations. It equals the derivative of one more Newton
    step at the solution, which JAX can differentiate.

    Args:
        search: function that returns an answer, and the arrays from which ``replay`` repeats it
            (notes).
        replay: function from the notes to the same answer, by operations that JAX can
            differentiate. It runs only if a derivative is requested.
        x: initial value of the search. The derivative by ``x`` is zero.
        like: example of the notes, with their shapes and types.
    """
    found, found_closed = jax.closure_convert(search, x)
    again, again_closed = jax.closure_convert(replay, like)
    return _implicit(found, again, x, found_closed, again_closed)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _implicit(search: Callable, replay: Callable, x: Any, closed: list, replayed: list) -> Any:
    del replay, replayed
    return search(x, *closed)[0]


@_implicit.defjvp
def _implicit_jvp(search: Callable, replay: Callable, primals: tuple, tangents: tuple) -> Any:
    x, closed, replayed = primals
    found, notes = search(x, *closed)
    *_, changes = tangents
    return found, jax.jvp(lambda p: replay(notes, *p), (replayed,), (changes,))[1]
