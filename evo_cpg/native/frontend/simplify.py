"""Rewrite rules that the builder applies to every operation as it makes it.

`RULES` is the table of all rules. Each rule returns an equal node that costs less, or None. The
rules are exact, with two exceptions: the sign of a zero, and 0 x = 0 even if x is not finite.

Simplification is not a pass from graph to graph. NumPy folds operations on constants (`FOLDED`),
and lowering needs the result: the places of slices and the lengths of loops must be known numbers.
"""

import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from evo_cpg.native.ir import Node

if TYPE_CHECKING:
    from evo_cpg.native.frontend.builder import Builder


class RewriteRule(NamedTuple):
    """A rewrite rule.

    Attributes:
        name: the rewrite as text, with c for a constant.
        apply: function from a builder and the operands to an equal node, or None.
    """

    name: str
    apply: "Callable[..., Node | None]"


def _is(node: Node, value: float) -> bool:
    return node.value is not None and node.value == value


def _add_negative(b: "Builder", x: Node, y: Node) -> Node | None:
    if x.dtype.kind != "f":
        return None
    if x.op == "neg":
        return b.apply("sub", y, x.operands[0])
    return b.apply("sub", x, y.operands[0]) if y.op == "neg" else None


def _multiply_negative(b: "Builder", x: Node, y: Node) -> Node | None:
    """Move minus signs outward, where sums absorb them and equal products meet."""
    factor, other = (x, y) if x.value is not None else (y, x)
    if factor.value is None or factor.dtype.kind != "f" or not factor.value < 0:
        return None
    return b.apply("neg", b.apply("mul", b.constant(-factor.value, factor.dtype), other))


def _divide_by_power(b: "Builder", x: Node, y: Node) -> Node | None:
    """Multiply by the reciprocal of a power of two, which is exact if it is not subnormal."""
    if y.value is None or y.dtype.kind != "f":
        return None
    mantissa, exponent = math.frexp(float(y.value))
    if abs(mantissa) != 0.5 or abs(exponent) >= 100:
        return None
    return b.apply("mul", x, b.constant(1.0 / float(y.value), y.dtype))


def _settle(decisive: bool, b: "Builder", x: Node, y: Node) -> Node | None:
    """Simplify "and" or "or": an operand with the decisive truth value is the result.

    An operand with the other truth value has no effect.
    """
    if x.dtype.kind != "b":
        return None
    for one, other in ((x, y), (y, x)):
        if one.value is not None:
            return one if one.value == decisive else other
    return x if x is y else None


def _select_truth(b: "Builder", condition: Node, yes: Node, no: Node) -> Node | None:
    if yes.dtype.kind != "b" or yes.value is None or no.value is None:
        return None
    return condition if yes.value else b.apply("not", condition)


RULES: dict[str, tuple[RewriteRule, ...]] = {
    "add": (
        RewriteRule("x + 0 -> x", lambda b, x, y: y if _is(x, 0) else x if _is(y, 0) else None),
        RewriteRule("x + (-y) -> x - y", _add_negative),
    ),
    "sub": (
        RewriteRule("x - 0 -> x", lambda b, x, y: x if _is(y, 0) else None),
        RewriteRule(
            "0 - x -> -x",
            lambda b, x, y: b.apply("neg", y) if _is(x, 0) and x.dtype.kind == "f" else None,
        ),
        RewriteRule(
            "x - (-y) -> x + y",
            lambda b, x, y: (
                b.apply("add", x, y.operands[0]) if y.op == "neg" and x.dtype.kind == "f" else None
            ),
        ),
    ),
    "mul": (
        RewriteRule("0 x -> 0", lambda b, x, y: x if _is(x, 0) else y if _is(y, 0) else None),
        RewriteRule("1 x -> x", lambda b, x, y: y if _is(x, 1) else x if _is(y, 1) else None),
        RewriteRule("(-c) x -> -(c x)", _multiply_negative),
    ),
    "div": (RewriteRule("x / 2^k -> x 2^-k", _divide_by_power),),
    "neg": (RewriteRule("-(-x) -> x", lambda b, x: x.operands[0] if x.op == "neg" else None),),
    "not": (RewriteRule("not not x -> x", lambda b, x: x.operands[0] if x.op == "not" else None),),
    "and": (
        RewriteRule(
            "x and true -> x; x and false -> false; x and x -> x", functools.partial(_settle, False)
        ),
    ),
    "or": (
        RewriteRule(
            "x or false -> x; x or true -> true; x or x -> x", functools.partial(_settle, True)
        ),
    ),
    "select": (
        RewriteRule(
            "select c, x, y -> x or y",
            lambda b, c, x, y: None if c.value is None else x if c.value else y,
        ),
        RewriteRule("select a, x, x -> x", lambda b, a, x, y: x if x is y else None),
        RewriteRule("select a, true, false -> a; select a, false, true -> not a", _select_truth),
    ),
}
"""Rewrite rules by operation, tried in order."""


def _whole_quotient(a: np.integer, b: np.integer) -> Any:
    """Divide and round towards zero. A zero divisor gives -1 (all bits), as in XLA."""
    size = abs(int(a)) // abs(int(b)) if b else -1
    bits = (-size if b and (a < 0) != (b < 0) else size) % (1 << 8 * a.dtype.itemsize)
    return np.asarray(bits, f"u{a.dtype.itemsize}").view(a.dtype)[()]


FOLDED: dict[str, Callable] = {
    "abs": np.abs,
    "add": np.add,
    "and": np.bitwise_and,
    "ceil": np.ceil,
    "div": lambda a, b: np.divide(a, b) if a.dtype.kind == "f" else _whole_quotient(a, b),
    "eq": np.equal,
    "floor": np.floor,
    "ge": np.greater_equal,
    "gt": np.greater,
    "is_finite": np.isfinite,
    "le": np.less_equal,
    "lt": np.less,
    "max": np.maximum,
    "min": np.minimum,
    "mul": np.multiply,
    "ne": np.not_equal,
    "neg": np.negative,
    "not": np.invert,
    "or": np.bitwise_or,
    "round": np.rint,
    "shift_left": np.left_shift,
    "sign": np.sign,
    "sqrt": np.sqrt,
    "sub": np.subtract,
    "xor": np.bitwise_xor,
}
"""NumPy's functions for operations on constants."""
