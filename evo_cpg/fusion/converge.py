"""A loop that ends when nothing changes any more, and has derivatives.

It finds x = f(p, x). JAX has no reverse mode through such a loop, but the implicit function theorem
gives it: with A and B the derivatives of f with respect to x and p,

    dx = A dx + B dp,      and backwards    l = g + A^T l,    dp* = B^T l,

which are found like x itself, by going round (Christianson 1994): nothing of the way to x is kept.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from evo_cpg.fusion.primitives import Arrays, linear_map

Value = TypeVar("Value")


def converge(function: Callable[[Value], Value], x: Value, at_most: int) -> Value:
    """``x = function(x)``, by going round until no number of any individual changes.

    Args:
        function: of a pytree of arrays, to one like it.
        x: where it starts.
        at_most: rounds, where it does not settle.
    """
    pure, closed = jax.closure_convert(function, x)
    return _converge(pure, at_most, x, closed)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _converge(pure: Callable, at_most: int, x: Value, closed: list) -> Value:
    def advance(carry: tuple) -> tuple:
        x, _, count = carry
        new = pure(x, *closed)
        pairs = zip(jax.tree.leaves(x), jax.tree.leaves(new), strict=True)
        changed = [jnp.any(a != b) for a, b in pairs]
        return new, functools.reduce(jnp.logical_or, changed), count + 1

    def goes_on(carry: tuple) -> jax.Array:
        _, changed, count = carry
        return changed & (count < at_most)

    return jax.lax.while_loop(goes_on, advance, (x, jnp.asarray(True), jnp.int32(0)))[0]


@_converge.defjvp
def _converge_jvp(pure: Callable, at_most: int, primals: tuple, tangents: tuple) -> tuple[Any, Any]:
    """By the implicit function theorem; where it started makes no difference."""
    _, change = tangents
    found = _converge(pure, at_most, *primals)
    leaves, structure = jax.tree.flatten(found)
    given, count = list(primals[1]), len(leaves)

    def once(x: list, p: list) -> list:
        return jax.tree.leaves(pure(structure.unflatten(x), *p))

    def forward(fixed: Arrays, change: Arrays) -> list:
        x, p = list(fixed[:count]), list(fixed[count:])
        start = jax.jvp(lambda p: once(x, p), (p,), (list(change),))[1]

        def advance(d: list, _: None) -> tuple[list, None]:
            step = jax.jvp(lambda x: once(x, p), (x,), (d,))[1]
            return [a + b for a, b in zip(start, step, strict=True)], None

        return jax.lax.scan(advance, start, None, length=at_most)[0]

    def backward(fixed: Arrays, slope: Arrays) -> list:
        x, p = list(fixed[:count]), list(fixed[count:])
        pull = jax.vjp(lambda x: once(x, p), x)[1]

        def advance(d: list, _: None) -> tuple[list, None]:
            (step,) = pull(d)
            return [a + b for a, b in zip(slope, step, strict=True)], None

        total, _ = jax.lax.scan(advance, list(slope), None, length=at_most)
        (result,) = jax.vjp(lambda p: once(x, p), p)[1](total)
        return result

    changes = linear_map(forward, backward, [*leaves, *given], list(change), leaves)
    return found, structure.unflatten(changes)
