"""Write each operation on scalars as LLVM instructions.

The instructions keep JAX's semantics: maxima propagate NaN, integers may be divided by zero, and
conversions to integers saturate.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from evo_cpg.native.backend.writer import TYPES, Writer
from evo_cpg.native.ir.graph import Node

# LLVM's names of operations on floats, signed integers and unsigned integers.
_ARITHMETIC = {
    "add": ("fadd", "add", "add"),
    "sub": ("fsub", "sub", "sub"),
    "mul": ("fmul", "mul", "mul"),
    "and": (None, "and", "and"),
    "or": (None, "or", "or"),
    "xor": (None, "xor", "xor"),
    "eq": ("fcmp oeq", "icmp eq", "icmp eq"),
    "ne": ("fcmp une", "icmp ne", "icmp ne"),
    "lt": ("fcmp olt", "icmp slt", "icmp ult"),
    "le": ("fcmp ole", "icmp sle", "icmp ule"),
    "gt": ("fcmp ogt", "icmp sgt", "icmp ugt"),
    "ge": ("fcmp oge", "icmp sge", "icmp uge"),
}
_INTRINSICS = {
    "abs": "fabs",
    "ceil": "ceil",
    "floor": "floor",
    "round": "roundeven",
    "sqrt": "sqrt",
}
_SHIFTS = {"shift_left": "shl", "shift_right_arithmetic": "ashr", "shift_right_logical": "lshr"}


class Operation:
    """An operation to write, with the data of its instructions.

    Attributes:
        op: name of the operation.
        dtype: type of its result.
        source: type of its first operand.
        kind: kind of ``source``, a column of tables: 0 float, 1 signed integer, 2 unsigned or bool.
        t: LLVM's type of the result.
        s: LLVM's type of the first operand.
        constants: values of constant operands, or None for other operands.
    """

    def __init__(self, writer: Writer, node: Node):
        self._writer, self._uniform = writer, node.uniform
        self.op, self.dtype, self.source = node.op, node.dtype, node.operands[0].dtype
        self.kind = "fiu".index("u" if self.source.kind in "ub" else self.source.kind)
        self.t, self.s = self.type_of(self.dtype), self.type_of(self.source)
        self.constants = [operand.value for operand in node.operands]
        self.let, self.fma = writer.let, writer.fma

    def type_of(self, dtype: np.dtype) -> str:
        """Return LLVM's type of a value: a scalar if the operation is uniform, else a vector."""
        return self._writer.type_of(dtype, self._uniform)

    def literal(self, value: Any, dtype: np.dtype | None = None) -> str:
        """Return a constant, by default of the result's type."""
        return self._writer.literal(value, dtype or self.dtype, self._uniform)

    def choose(self, flag: str, yes: str, no: str) -> str:
        """Write a selection between two values of the result's type."""
        flags = self.type_of(np.dtype(bool))
        return self.let(f"select {flags} {flag}, {self.t} {yes}, {self.t} {no}")

    def intrinsic(self, name: str, t: str, a: Sequence[str], source: str = "") -> str:
        """Write a call of an LLVM intrinsic and return the name of its result."""
        return self._writer.intrinsic(name, t, a, source)

    def library_call(self, name: str, a: Sequence[str]) -> str:
        """Write calls of a function of the C library, one per individual."""
        w, t = self._writer, TYPES[self.dtype.char]
        w.functions[name] = f"declare {t} @{name}({', '.join([t] * len(a))})"
        if self._uniform or w.width == 1:
            return self.let(f"call {t} @{name}({', '.join(f'{t} {x}' for x in a)})")
        result = "poison"
        for i in range(w.width):
            parts = [self.let(f"extractelement {self.t} {x}, i32 {i}") for x in a]
            one = self.let(f"call {t} @{name}({', '.join(f'{t} {x}' for x in parts)})")
            result = self.let(f"insertelement {self.t} {result}, {t} {one}, i32 {i}")
        return result


def write(writer: Writer, node: Node, a: list[str]) -> str:
    """Write an operation.

    Args:
        writer: writer of the instructions.
        node: the operation.
        a: names of its operands, scalars if the operation is uniform, else vectors.

    Returns:
        Name of its result.
    """
    o = Operation(writer, node)
    word = _ARITHMETIC.get(o.op, (None,) * 3)[o.kind]
    if word is not None:
        return o.let(f"{word} {o.s} {a[0]}, {a[1]}")
    if o.op in _INTRINSICS and o.kind == 0:
        return o.intrinsic(_INTRINSICS[o.op], o.t, a)
    if o.op in _WRITERS:
        return _WRITERS[o.op](o, *a)
    return o.library_call(o.op, a)


def _multiply_add(o: Operation, x: str, y: str, z: str) -> str:
    if not o.fma:
        product = o.let(f"fmul {o.t} {x}, {y}")
        first, second = (z, product) if o.op != "fms" else (product, z)
        return o.let(f"{'fadd' if o.op == 'fma' else 'fsub'} {o.t} {first}, {second}")
    if o.op == "fms":
        z = o.let(f"fneg {o.t} {z}")
    elif o.op == "fnma":
        x = o.let(f"fneg {o.t} {x}")
    return o.intrinsic("fma", o.t, [x, y, z])


def _select(o: Operation, condition: str, yes: str, no: str) -> str:
    return o.let(f"select {o.s} {condition}, {o.t} {yes}, {o.t} {no}")


def _negative(o: Operation, x: str) -> str:
    return o.let(f"fneg {o.t} {x}" if o.kind == 0 else f"sub {o.t} zeroinitializer, {x}")


def _not(o: Operation, x: str) -> str:
    return o.let(f"xor {o.t} {x}, {o.literal(-1)}")


def _extreme(o: Operation, x: str, y: str) -> str:
    """Write the maximum or minimum of two numbers, which is NaN if either is NaN."""
    word = {"max": ("ogt", "sgt", "ugt"), "min": ("olt", "slt", "ult")}[o.op][o.kind]
    known = o.constants[0]
    if o.constants[1] is not None:
        # A comparison with NaN selects the second operand. So a constant goes first.
        x, y, known = y, x, o.constants[1]
    better = o.let(f"{'icmp' if o.kind else 'fcmp'} {word} {o.t} {x}, {y}")
    chosen = o.choose(better, x, y)
    if o.kind or (known is not None and known == known):
        return chosen
    return o.choose(o.let(f"fcmp uno {o.t} {x}, {x}"), x, chosen)


def _size(o: Operation, x: str) -> str:
    """Write the absolute value of an integer."""
    zero = o.literal(0)
    negative = o.let(f"icmp slt {o.t} {x}, {zero}")
    return o.choose(negative, o.let(f"sub {o.t} {zero}, {x}"), x)


def _sign(o: Operation, x: str) -> str:
    zero, one = o.literal(0), o.literal(1)
    if o.kind == 0:
        size = o.intrinsic("copysign", o.t, [one, x])
        # The sign of zero is zero, and the sign of NaN is NaN.
        return o.choose(o.let(f"fcmp one {o.t} {x}, {zero}"), size, x)
    up = o.choose(o.let(f"icmp ne {o.t} {x}, {zero}"), one, zero)
    if o.kind == 2:
        return up
    return o.choose(o.let(f"icmp slt {o.t} {x}, {zero}"), o.literal(-1), up)


def _is_finite(o: Operation, x: str) -> str:
    size = o.intrinsic("fabs", o.s, [x])
    return o.let(f"fcmp one {o.s} {size}, {o.literal(np.inf, o.source)}")


def _quotient(o: Operation, x: str, y: str) -> str:
    if o.kind == 0:
        return o.let(f"fdiv {o.t} {x}, {y}")
    return _divided(o, ("sdiv", "udiv")[o.kind - 1], x, y, by_zero=o.literal(-1), overflow=x)


def _remainder(o: Operation, x: str, y: str) -> str:
    if o.kind == 0:
        return o.library_call("fmodf" if o.dtype == np.float32 else "fmod", [x, y])
    return _divided(o, ("srem", "urem")[o.kind - 1], x, y, by_zero=x, overflow=o.literal(0))


def _divided(o: Operation, word: str, x: str, y: str, by_zero: str, overflow: str) -> str:
    """Write a division of integers without a trap on zero divisors and overflow.

    Args:
        o: the operation.
        word: LLVM's name of the division.
        x: dividend.
        y: divisor.
        by_zero: result for a zero divisor.
        overflow: result for the smallest integer divided by -1.
    """
    known = o.constants[1]
    if known is not None and known not in (0, -1):
        return o.let(f"{word} {o.t} {x}, {y}")
    zero = wrong = o.let(f"icmp eq {o.t} {y}, {o.literal(0)}")
    least = ""
    if o.dtype.kind == "i":
        first = o.let(f"icmp eq {o.t} {x}, {o.literal(np.iinfo(o.dtype).min)}")
        second = o.let(f"icmp eq {o.t} {y}, {o.literal(-1)}")
        flags = o.type_of(np.dtype(bool))
        least = o.let(f"and {flags} {first}, {second}")
        wrong = o.let(f"or {flags} {zero}, {least}")
    safe = o.choose(wrong, o.literal(1), y)
    found = o.choose(zero, by_zero, o.let(f"{word} {o.t} {x}, {safe}"))
    return o.choose(least, overflow, found) if least else found


def _shift(o: Operation, x: str, y: str) -> str:
    bits, by = 8 * o.dtype.itemsize, o.constants[1]
    word = _SHIFTS[o.op]
    if by is not None and 0 <= by < bits:
        return o.let(f"{word} {o.t} {x}, {y}")
    most = o.literal(bits - 1)
    beyond = o.let(f"icmp ugt {o.t} {y}, {most}")
    shifted = o.let(f"{word} {o.t} {x}, {o.choose(beyond, most, y)}")
    return shifted if word == "ashr" else o.choose(beyond, o.literal(0), shifted)


def _conversion(o: Operation, x: str) -> str:
    source, dtype = o.source, o.dtype
    longer = dtype.itemsize > source.itemsize
    if dtype.kind == "b":
        word = "fcmp une" if o.kind == 0 else "icmp ne"
        return o.let(f"{word} {o.s} {x}, {o.literal(0, source)}")
    if source.kind == "b":
        return o.choose(x, o.literal(1), o.literal(0))
    if dtype.kind in "iu":
        if o.kind == 0:
            name = "fptosi" if dtype.kind == "i" else "fptoui"
            return o.intrinsic(f"{name}.sat", o.t, [x], source=o.s)
        if dtype.itemsize == source.itemsize:
            return x
        word = ("sext", "zext")[o.kind - 1] if longer else "trunc"
    else:
        word = ("fpext" if longer else "fptrunc", "sitofp", "uitofp")[o.kind]
    return o.let(f"{word} {o.s} {x} to {o.t}")


def _bitcast(o: Operation, x: str) -> str:
    return o.let(f"bitcast {o.s} {x} to {o.t}")


_WRITERS: dict[str, Callable[..., str]] = {
    **dict.fromkeys(("fma", "fms", "fnma"), _multiply_add),
    **dict.fromkeys(_SHIFTS, _shift),
    "abs": _size,
    "bitcast": _bitcast,
    "convert": _conversion,
    "div": _quotient,
    "is_finite": _is_finite,
    "max": _extreme,
    "min": _extreme,
    "neg": _negative,
    "not": _not,
    "rem": _remainder,
    "select": _select,
    "sign": _sign,
}
