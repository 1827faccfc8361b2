"""Iterate until every individual has converged, and differentiate the solution.

JAX has no reverse mode through ``while_loop``. By the implicit function theorem the derivative of
the solution does not depend on the iterations. It equals the derivative of one more Newton step at
the solution. JAX differentiates that step, which leaves the solution unchanged.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

Value = TypeVar("Value")


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
        return jax.tree.map(
            lambda new, old: jnp.where(
                jnp.expand_dims(going, tuple(range(new.ndim - going.ndim))), new, old
            ),
            new,
            x,
        )

    return jax.lax.while_loop(lambda x: jnp.any(goes_on(x)), step, x)


def implicit(
    search: Callable[[Value], tuple[Any, Any]], replay: Callable[[Any], Any], x: Value, like: Any
) -> Any:
    """Return the first result of ``search(x)``, with the derivatives of ``replay``.

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
