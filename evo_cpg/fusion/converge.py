"""Searches in a loop that ends when every individual has found its answer, and their derivatives.

JAX has no reverse mode through such a loop, and how an answer was found is nothing to its
derivative. By the implicit function theorem that is the derivative of one more step of Newton's
method from there, which goes nowhere; JAX differentiates that.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from evo_cpg.fusion import jax_internals as internals

Value = TypeVar("Value")
Given = TypeVar("Given")
Answer = TypeVar("Answer")
Notes = TypeVar("Notes")


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
    search: Callable[[Given, Value], tuple[Answer, Notes]],
    replay: Callable[[Given, Notes], Answer],
    given: Given,
    x: Value,
) -> Answer:
    """The answer of ``search(given, x)``, with the derivatives of what ``replay`` gives.

    Args:
        search: gives an answer, and notes on how it came about.
        replay: of the notes; the same answer by steps that JAX can differentiate. It is neither
            traced nor computed where no derivative is asked for.
        given: a pytree that holds all by which there are derivatives.
        x: where the search starts, by which there is none.
    """
    traced, fixed = eqx.partition(given, _is_traced_number)
    return _implicit(
        lambda traced, x: search(eqx.combine(traced, fixed), x),
        lambda traced, notes: replay(eqx.combine(traced, fixed), notes),
        traced,
        x,
    )


def _is_traced_number(leaf: Any) -> bool:
    return isinstance(leaf, internals.Tracer) and jnp.issubdtype(leaf.dtype, jnp.inexact)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _implicit(search: Callable, replay: Callable, traced: Any, x: Any) -> Any:
    del replay
    return search(traced, x)[0]


@_implicit.defjvp
def _implicit_jvp(search: Callable, replay: Callable, primals: tuple, tangents: tuple) -> Any:
    traced, x = primals
    found, notes = search(traced, x)
    return found, jax.jvp(lambda traced: replay(traced, notes), primals[:1], tangents[:1])[1]
