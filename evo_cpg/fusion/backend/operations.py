"""Each operation on scalars as LLVM's instructions.

They have JAX's meaning: NaN goes through maxima, whole numbers may be divided by zero, conversions
to whole numbers stop at the ends of their range.
"""

import numpy as np

from evo_cpg.fusion.backend.writer import TYPES, Writer
from evo_cpg.fusion.ir.graph import Node

# Of floats, signed and unsigned whole numbers: what LLVM calls an operation.
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


def write(w: Writer, node: Node, a: list[str]) -> str:
    """Write an operation.

    Args:
        w: where it is written.
        node: the operation.
        a: names of its operands, vectors unless all is the same for all individuals.

    Returns:
        The name of its result.
    """
    op, dtype, uniform, source = node.op, node.dtype, node.uniform, node.operands[0].dtype
    t, s = w.type_of(dtype, uniform), w.type_of(source, uniform)
    kind = "fiu".index("u" if source.kind in "ub" else source.kind)
    if op in _ARITHMETIC and _ARITHMETIC[op][kind]:
        return w.let(f"{_ARITHMETIC[op][kind]} {s} {a[0]}, {a[1]}")
    if op in ("fma", "fms", "fnma"):
        return _fused(w, op, t, a, uniform)
    if op == "select":
        c = w.type_of(source, uniform)
        return w.let(f"select {c} {a[0]}, {t} {a[1]}, {t} {a[2]}")
    if op == "neg":
        return w.let(f"fneg {t} {a[0]}" if kind == 0 else f"sub {t} zeroinitializer, {a[0]}")
    if op == "not":
        return w.let(f"xor {t} {a[0]}, {w.literal(-1, dtype, uniform)}")
    if op == "div":
        return _quotient(w, node, t, a, kind)
    if op in ("max", "min"):
        return _extreme(w, node, s, a, kind)
    if op in _INTRINSICS and kind == 0:
        return w.intrinsic(_INTRINSICS[op], t, a)
    if op == "abs":
        zero = w.literal(0, dtype, uniform)
        negative = w.let(f"icmp slt {t} {a[0]}, {zero}")
        opposite = w.let(f"sub {t} {zero}, {a[0]}")
        flag = w.type_of(np.dtype(bool), uniform)
        return w.let(f"select {flag} {negative}, {t} {opposite}, {t} {a[0]}")
    if op == "sign":
        return _sign(w, t, a[0], dtype, uniform)
    if op == "is_finite":
        size = w.intrinsic("fabs", s, a)
        return w.let(f"fcmp one {s} {size}, {w.literal(np.inf, source, uniform)}")
    if op == "rem":
        return _remainder(w, node, t, a, kind)
    if op in _SHIFTS:
        return _shift(w, node, t, a)
    if op == "convert":
        return _conversion(w, source, dtype, s, t, a[0], uniform)
    if op == "bitcast":
        return w.let(f"bitcast {s} {a[0]} to {t}")
    return _library_call(w, node, a)


def _fused(w: Writer, op: str, t: str, a: list[str], uniform: bool) -> str:
    x, y, z = a
    if not w.fma:
        product = w.let(f"fmul {t} {x}, {y}")
        first, second = (z, product) if op != "fms" else (product, z)
        return w.let(f"{'fadd' if op == 'fma' else 'fsub'} {t} {first}, {second}")
    if op == "fms":
        z = w.let(f"fneg {t} {z}")
    elif op == "fnma":
        x = w.let(f"fneg {t} {x}")
    return w.intrinsic("fma", t, [x, y, z])


def _extreme(w: Writer, node: Node, t: str, a: list[str], kind: int) -> str:
    """The larger or smaller of two; NaN if either is."""
    word = {"max": ("ogt", "sgt", "ugt"), "min": ("olt", "slt", "ult")}[node.op][kind]
    flag = w.type_of(np.dtype(bool), node.uniform)
    x, y = a
    first, second = node.operands
    if second.value is not None:
        # What a comparison with NaN chooses is the second one: then a constant is the first.
        x, y, first, second = y, x, second, first
    better = w.let(f"{'icmp' if kind else 'fcmp'} {word} {t} {x}, {y}")
    chosen = w.let(f"select {flag} {better}, {t} {x}, {t} {y}")
    if kind or (first.value is not None and first.value == first.value):
        return chosen
    lost = w.let(f"fcmp uno {t} {x}, {x}")
    return w.let(f"select {flag} {lost}, {t} {x}, {t} {chosen}")


def _sign(w: Writer, t: str, x: str, dtype: np.dtype, uniform: bool) -> str:
    flag = w.type_of(np.dtype(bool), uniform)
    zero, one = (w.literal(value, dtype, uniform) for value in (0, 1))
    if dtype.kind == "f":
        size = w.intrinsic("copysign", t, [one, x])
        away = w.let(f"fcmp one {t} {x}, {zero}")
        # Zero and NaN are their own signs.
        return w.let(f"select {flag} {away}, {t} {size}, {t} {x}")
    above = w.let(f"icmp ne {t} {x}, {zero}")
    up = w.let(f"select {flag} {above}, {t} {one}, {t} {zero}")
    if dtype.kind != "i":
        return up
    below = w.let(f"icmp slt {t} {x}, {zero}")
    return w.let(f"select {flag} {below}, {t} {w.literal(-1, dtype, uniform)}, {t} {up}")


def _quotient(w: Writer, node: Node, t: str, a: list[str], kind: int) -> str:
    if kind == 0:
        return w.let(f"fdiv {t} {a[0]}, {a[1]}")
    safe, by_zero, overflow = _divisor(w, node, t, a)
    found = w.let(f"{'sdiv' if kind == 1 else 'udiv'} {t} {a[0]}, {safe}")
    flag = w.type_of(np.dtype(bool), node.uniform)
    if by_zero:
        found = w.let(
            f"select {flag} {by_zero}, {t} {w.literal(-1, node.dtype, node.uniform)}, {t} {found}"
        )
    if overflow:
        found = w.let(f"select {flag} {overflow}, {t} {a[0]}, {t} {found}")
    return found


def _remainder(w: Writer, node: Node, t: str, a: list[str], kind: int) -> str:
    if kind == 0:
        return _library_call(w, node, a, "fmodf" if node.dtype == np.float32 else "fmod")
    safe, by_zero, overflow = _divisor(w, node, t, a)
    found = w.let(f"{'srem' if kind == 1 else 'urem'} {t} {a[0]}, {safe}")
    flag = w.type_of(np.dtype(bool), node.uniform)
    zero = w.literal(0, node.dtype, node.uniform)
    if by_zero:
        found = w.let(f"select {flag} {by_zero}, {t} {a[0]}, {t} {found}")
    if overflow:
        found = w.let(f"select {flag} {overflow}, {t} {zero}, {t} {found}")
    return found


def _divisor(w: Writer, node: Node, t: str, a: list[str]) -> tuple[str, str, str]:
    """A divisor that a processor takes, and where it is not the given one."""
    dtype, value = node.dtype, node.operands[1].value
    if value is not None and value not in (0, -1):
        return a[1], "", ""
    flag = w.type_of(np.dtype(bool), node.uniform)
    zero, one, minus = (w.literal(v, dtype, node.uniform) for v in (0, 1, -1))
    by_zero = w.let(f"icmp eq {t} {a[1]}, {zero}")
    wrong, overflow = by_zero, ""
    if dtype.kind == "i":
        least = w.literal(np.iinfo(dtype).min, dtype, node.uniform)
        first = w.let(f"icmp eq {t} {a[0]}, {least}")
        second = w.let(f"icmp eq {t} {a[1]}, {minus}")
        overflow = w.let(f"and {flag} {first}, {second}")
        wrong = w.let(f"or {flag} {by_zero}, {overflow}")
    return w.let(f"select {flag} {wrong}, {t} {one}, {t} {a[1]}"), by_zero, overflow


def _shift(w: Writer, node: Node, t: str, a: list[str]) -> str:
    bits, by = 8 * node.dtype.itemsize, node.operands[1].value
    word = _SHIFTS[node.op]
    if by is not None and 0 <= by < bits:
        return w.let(f"{word} {t} {a[0]}, {a[1]}")
    flag = w.type_of(np.dtype(bool), node.uniform)
    most = w.literal(bits - 1, node.dtype, node.uniform)
    beyond = w.let(f"icmp ugt {t} {a[1]}, {most}")
    count = w.let(f"select {flag} {beyond}, {t} {most}, {t} {a[1]}")
    shifted = w.let(f"{word} {t} {a[0]}, {count}")
    if word == "ashr":
        return shifted
    zero = w.literal(0, node.dtype, node.uniform)
    return w.let(f"select {flag} {beyond}, {t} {zero}, {t} {shifted}")


def _conversion(
    w: Writer, source: np.dtype, dtype: np.dtype, s: str, t: str, x: str, uniform: bool
) -> str:
    if dtype.kind == "b":
        zero = w.literal(0, source, uniform)
        return w.let(f"{'fcmp une' if source.kind == 'f' else 'icmp ne'} {s} {x}, {zero}")
    if source.kind == "b":
        one, zero = (w.literal(value, dtype, uniform) for value in (1, 0))
        return w.let(f"select {s} {x}, {t} {one}, {t} {zero}")
    if source.kind == "f" and dtype.kind in "iu":
        name = "fptosi" if dtype.kind == "i" else "fptoui"
        return w.intrinsic(f"{name}.sat", t, [x], source=s)
    if source.kind in "iu" and dtype.kind in "iu":
        if dtype.itemsize == source.itemsize:
            return x
        longer = "sext" if source.kind == "i" else "zext"
        word = longer if dtype.itemsize > source.itemsize else "trunc"
        return w.let(f"{word} {s} {x} to {t}")
    if source.kind in "iu":
        return w.let(f"{'sitofp' if source.kind == 'i' else 'uitofp'} {s} {x} to {t}")
    word = "fpext" if dtype.itemsize > source.itemsize else "fptrunc"
    return w.let(f"{word} {s} {x} to {t}")


def _library_call(w: Writer, node: Node, a: list[str], name: str = "") -> str:
    """A function of the C library, one individual after the other."""
    name = name or node.op
    t = TYPES[node.dtype.char]
    w.declared[name] = f"declare {t} @{name}({', '.join([t] * len(a))})"
    if node.uniform or w.width == 1:
        return w.let(f"call {t} @{name}({', '.join(f'{t} {x}' for x in a)})")
    whole = w.type_of(node.dtype, False)
    result = "poison"
    for i in range(w.width):
        parts = [w.let(f"extractelement {whole} {x}, i32 {i}") for x in a]
        one = w.let(f"call {t} @{name}({', '.join(f'{t} {x}' for x in parts)})")
        result = w.let(f"insertelement {whole} {result}, {t} {one}, i32 {i}")
    return result
