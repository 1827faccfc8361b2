"""Sine and cosine as polynomials, so that they stay inside a kernel.

XLA:CPU computes them in kernels of their own, for any argument to the last digit. In the step of a
ten-body swimmer, stacking 27 angles, these kernels and parting their results took a third of the
time.

With k the integer nearest to x / pi and r = x - k pi in [-pi/2, pi/2] (pi in three parts, the first
two so short that k times each is exact),

    sin x = (-1)^k (r + r^3 P(r^2)),   cos x = (-1)^k (1 + r^2 Q(r^2)),

where P and Q are the polynomials with the least greatest error (Remez). In float32 the results are
within 1.5e-7 for ``abs(x)`` up to 1e4, and lose digits beyond that.
"""

import functools

import jax
import numpy as np

from evo_cpg.fusion.graph import Graph, Node

_P = (-1.66666571e-01, 8.33301729e-03, -1.98066152e-04, 2.60005477e-06)
_Q = (-4.99999995e-01, 4.16666407e-02, -1.38884035e-03, 2.47618862e-05, -2.60771053e-07)
_PI_PARTS = (3.140625, 9.67502593994140625e-04, 1.509957990978376432e-07)


def has_polynomial(dtype: np.dtype) -> bool:
    """Whether the polynomials are exact enough for numbers of this type."""
    return dtype == np.float32


def sine(graph: Graph, x: Node) -> Node:
    """``sin x``."""
    r, square, sign = _reduce(graph, x)
    cubic = graph.multiply(graph.multiply(_polynomial(graph, _P, square), square), r)
    return graph.multiply(sign, graph.add(cubic, r))


def cosine(graph: Graph, x: Node) -> Node:
    """``cos x``."""
    _, square, sign = _reduce(graph, x)
    even = graph.multiply(_polynomial(graph, _Q, square), square)
    return graph.multiply(sign, graph.add(even, graph.constant(1, x.dtype)))


def _reduce(graph: Graph, x: Node) -> tuple[Node, Node, Node]:
    """The remainder r, its square, and the sign ``(-1)^k``."""
    number = functools.partial(graph.constant, dtype=x.dtype)
    nearest = {"rounding_method": jax.lax.RoundingMethod.TO_NEAREST_EVEN}
    turns = graph.multiply(x, number(1 / np.pi))
    k = graph.apply(jax.lax.round_p, nearest, (turns,))
    r = x
    for part in _PI_PARTS:
        r = graph.subtract(r, graph.multiply(k, number(part)))
    half = graph.multiply(k, number(0.5))
    fraction = graph.subtract(half, graph.apply(jax.lax.floor_p, {}, (half,)))
    sign = graph.subtract(number(1), graph.multiply(number(4), fraction))
    return r, graph.multiply(r, r), sign


def _polynomial(graph: Graph, coefficients: tuple[float, ...], x: Node) -> Node:
    """By Horner's rule, the constant term first."""
    value = graph.constant(coefficients[-1], x.dtype)
    for coefficient in coefficients[-2::-1]:
        value = graph.add(graph.multiply(value, x), graph.constant(coefficient, x.dtype))
    return value
