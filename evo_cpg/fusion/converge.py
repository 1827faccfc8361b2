"""Searches in a loop that ends when every individual has found its answer, and their derivatives.

JAX has no reverse mode through such a loop, and how an answer was found is nothing to its
derivative. By the implicit function theorem that is the derivative of one more step of Newton's
method from there, which goes nowhere; JAX differentiates that.
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
    """``jax.lax.while_loop`` for every individual by itself.

    Args:
        goes_on: whether each individual does, ``(*n)``.
        advance: of a pytree of arrays with the individuals on their last axes, to one like it.
        x: where it starts.
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
    """The first of ``search(x)``, with the derivatives of what ``replay`` gives.

    Args:
        search: gives an answer, and notes on how it came about.
        replay: of the notes; the same answer by steps that JAX can differentiate. It is not
            computed where no derivative is asked for.
        x: where the search starts, by which there is no derivative.
        like: notes of the same shape.
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
