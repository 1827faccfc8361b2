"""Write each operation on scalars as LLVM instructions.

A value is either a scalar, equal for all individuals of a vector, or a vector. The instructions
keep JAX's semantics: maxima propagate NaN, integers may be divided by zero, and conversions to
integers saturate.
"""

import contextlib
import functools
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from evo_cpg.native.backend.code import Template
from evo_cpg.native.ir import Node

# LLVM's types by the characters of NumPy's types.
TYPES = {
    "?": "i1", "b": "i8", "B": "i8", "h": "i16", "H": "i16", "i": "i32", "I": "i32", "l": "i64",
    "L": "i64", "q": "i64", "Q": "i64", "f": "float", "d": "double",
}  # fmt: skip


class FunctionText:
    """Writer of an LLVM function with loops and branches.

    Args:
        head: linkage, result, name, parameters and attributes of the function.
    """

    def __init__(self, head: str):
        self._head, self.total = head, ""
        # Allocations come first, because LLVM repeats an allocation within a loop.
        self._variables: list[str] = []
        self._lines: list[str] = []
        self._here, self._count = "begin", 0

    def text(self, result: str = "void") -> str:
        """Return the function, which ends with a result (its type and name)."""
        body = "\n".join([*self._variables, "br label %begin", "begin:", *self._lines])
        return f"define {self._head} #0 {{\n{body}\nret {result}\n}}"

    def do(self, *lines: str) -> None:
        """Write instructions without a result."""
        self._lines += lines

    def let(self, text: str) -> str:
        """Write an instruction and return the name of its result."""
        self._count += 1
        self._lines.append(f"%x{self._count} = {text}")
        return f"%x{self._count}"

    def room(self, t: str) -> str:
        """Return a pointer to new memory for a value that changes."""
        self._count += 1
        self._variables.append(f"%x{self._count} = alloca {t}")
        return f"%x{self._count}"

    def at(self, base: str, index: str | int, size: int = 1) -> str:
        """Return a pointer ``index`` times ``size`` bytes after another one."""
        if size != 1:
            index = self.let(f"mul i64 {index}, {size}")
        return self.let(f"getelementptr i8, ptr {base}, i64 {index}")

    def load(self, t: str, pointer: str, align: int = 0) -> str:
        """Read a value, whose place is a multiple of ``align`` bytes (0 for the type's own)."""
        return self.let(f"load {t}, ptr {pointer}" + f", align {align}" * (align > 0))

    def store(self, t: str, value: str | int, pointer: str, align: int = 0) -> None:
        """Write a value to memory."""
        self.do(f"store {t} {value}, ptr {pointer}" + f", align {align}" * (align > 0))

    def _label(self, name: str) -> None:
        self.do(f"{name}:")
        self._here = name

    @contextlib.contextmanager
    def where(self, flag: str) -> Iterator[None]:
        """Run the code of a ``with`` statement if a flag is true."""
        self._count += 1
        inside, after = f"inside{self._count}", f"behind{self._count}"
        self.do(f"br i1 {flag}, label %{inside}, label %{after}")
        self._label(inside)
        yield
        self.do(f"br label %{after}")
        self._label(after)

    @contextlib.contextmanager
    def repeat(self) -> Iterator[Callable[[str], None]]:
        """Repeat the code of a ``with`` statement until the yielded function gets a true flag."""
        self._count += 1
        head, after = f"round{self._count}", f"after{self._count}"

        def leave(flag: str) -> None:
            self._count += 1
            more = f"more{self._count}"
            self.do(f"br i1 {flag}, label %{after}, label %{more}")
            self._label(more)

        self.do(f"br label %{head}")
        self._label(head)
        yield leave
        self.do(f"br label %{head}")
        self._label(after)

    @contextlib.contextmanager
    def each(self, count: str | int, t: str = "", start: str = "") -> Iterator[str]:
        """Repeat the code of a ``with`` statement for the numbers from 0 that are below a count.

        If there is a type ``t``, `total` has ``start`` as its first value in the loop, and each
        round sets it to the next one.
        """
        before = self._here
        with self.repeat() as leave:
            place, number = len(self._lines), self.let("")
            if t:
                total = self.total = self.let("")
            leave(self.let(f"icmp uge i64 {number}, {count}"))
            yield number
            following = self.let(f"add i64 {number}, 1")
            ends = f"[ 0, %{before} ], [ {following}, %{self._here} ]"
            self._lines[place] = f"{number} = phi i64 {ends}"
            if t:
                ends = f"[ {start}, %{before} ], [ {self.total}, %{self._here} ]"
                self._lines[place + 1] = f"{total} = phi {t} {ends}"
                self.total = total

    @contextlib.contextmanager
    def each_bit(self, bits: str) -> Iterator[str]:
        """Repeat the code of a ``with`` statement for the places of the ones among 32 bits."""
        rest = self.room("i32")
        self.store("i32", bits, rest)
        with self.repeat() as leave:
            left = self.load("i32", rest)
            leave(self.let(f"icmp eq i32 {left}, 0"))
            less = self.let(f"sub i32 {left}, 1")
            self.store("i32", self.let(f"and i32 {left}, {less}"), rest)
            place = self.let(f"call i32 @llvm.cttz.i32(i32 {left}, i1 true)")
            yield self.let(f"zext i32 {place} to i64")


class Writer:
    """Writer of the instructions of templates.

    Attributes:
        width: number of individuals in a vector.
        fma: whether the processor multiplies and adds in one instruction.
        lines: instructions of the current template.
        functions: declarations or definitions of the called functions, by name. LLVM intrinsics
            need none.
    """

    def __init__(self, width: int, fma: bool):
        self.width, self.fma = width, fma
        self.lines: list[str] = []
        self.functions: dict[str, str] = {}
        self._arity = self._names = 0
        self._known: dict[Any, Template] = {}

    def template(self, key: Any, arity: int, write: Callable[..., str | None]) -> Template:
        """Return the instructions that a function writes, written once for each key.

        Args:
            key: what the instructions depend on, hashable.
            arity: number of operands.
            write: function from gaps for operands to the name of the result, or None.
        """
        if key not in self._known:
            self.lines, self._arity, self._names = [], arity, 0
            operands = [f"{{{k}}}" for k in range(arity)]
            found = write(*operands)
            names = [f"%v{{{arity + k}}}" for k in range(self._names)]
            result = 0 if found is None or found in operands else names.index(found) + 1
            text = "\n".join(self.lines)
            self._known[key] = Template(text, len(self.lines), self._names, result)
        return self._known[key]

    def let(self, text: str) -> str:
        """Write an instruction and return the name of its result."""
        name = f"%v{{{self._arity + self._names}}}"
        self._names += 1
        self.lines.append(f"{name} = {text}")
        return name

    def type_of(self, dtype: np.dtype, uniform: bool) -> str:
        """Return LLVM's type of a value: a scalar if uniform, else a vector."""
        t = TYPES[dtype.char]
        return t if uniform or self.width == 1 else f"<{self.width} x {t}>"

    def literal(self, value, dtype: np.dtype, uniform: bool) -> str:
        """Return a constant as LLVM text: a scalar if uniform, else a vector."""
        text = number(value, dtype)
        if uniform or self.width == 1:
            return text
        return f"splat ({TYPES[dtype.char]} {text})"

    def intrinsic(self, name: str, t: str, a: Sequence[str], source: str = "") -> str:
        """Call an LLVM intrinsic and return the name of its result.

        The intrinsic maps operands ``a`` of type ``source`` ("" for ``t``) to type ``t``.
        """
        source = source or t
        types = suffix(t) + (f".{suffix(source)}" if source != t else "")
        given = ", ".join([f"{source} {x}" for x in a])
        return self.let(f"call {t} @llvm.{name}.{types}({given})")


def suffix(t: str) -> str:
    """Return the suffix of intrinsic names for a type."""
    short = t.replace("float", "f32").replace("double", "f64")
    if short.startswith("<"):
        width, _, item = short[1:-1].partition(" x ")
        return f"v{width}{item}"
    return short


def number(value, dtype: np.dtype) -> str:
    """Return a constant as LLVM reads it."""
    if dtype.kind == "b":
        return "true" if value else "false"
    if dtype.kind in "iu":
        return str(int(np.asarray(value).astype(dtype)))
    # LLVM writes constants of both float types with the digits of a double.
    bits = struct.unpack("<Q", struct.pack("<d", float(np.asarray(value, dtype))))[0]
    return f"0x{bits:016X}"


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


class _Operation:
    """An operation to write, with the data of its instructions.

    ``kind`` is the kind of the first operand, a column of tables: 0 float, 1 signed integer,
    2 unsigned or bool. ``t`` and ``s`` are LLVM's types of the result and of the first operand.
    """

    def __init__(self, writer: Writer, node: Node):
        self._writer, self._uniform = writer, node.uniform
        self.op, self.dtype, self.source = node.op, node.dtype, node.operands[0].dtype
        self.kind = "fiu".index("u" if self.source.kind in "ub" else self.source.kind)
        self.type_of = functools.partial(writer.type_of, uniform=node.uniform)
        self.t, self.s = self.type_of(self.dtype), self.type_of(self.source)
        self.constants = [operand.value for operand in node.operands]
        self.let, self.fma, self.intrinsic = writer.let, writer.fma, writer.intrinsic
        # A constant is of the result's type by default.
        self.literal = functools.partial(writer.literal, dtype=node.dtype, uniform=node.uniform)

    def choose(self, flag: str, yes: str, no: str) -> str:
        """Write a selection between two values of the result's type."""
        flags = self.type_of(np.dtype(bool))
        return self.let(f"select {flags} {flag}, {self.t} {yes}, {self.t} {no}")

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
    """Write an operation and return the name of its result.

    ``a`` are the names of its operands, scalars if the operation is uniform, else vectors.
    """
    o = _Operation(writer, node)
    word = _ARITHMETIC.get(o.op, (None,) * 3)[o.kind]
    if word is not None:
        return o.let(f"{word} {o.s} {a[0]}, {a[1]}")
    if o.op in _INTRINSICS and o.kind == 0:
        return o.intrinsic(_INTRINSICS[o.op], o.t, a)
    if o.op in _WRITERS:
        return _WRITERS[o.op](o, *a)
    return o.library_call(o.op, a)


def _multiply_add(o: _Operation, x: str, y: str, z: str) -> str:
    if not o.fma:
        product = o.let(f"fmul {o.t} {x}, {y}")
        first, second = (z, product) if o.op != "fms" else (product, z)
        return o.let(f"{'fadd' if o.op == 'fma' else 'fsub'} {o.t} {first}, {second}")
    if o.op == "fms":
        z = o.let(f"fneg {o.t} {z}")
    elif o.op == "fnma":
        x = o.let(f"fneg {o.t} {x}")
    return o.intrinsic("fma", o.t, [x, y, z])


def _extreme(o: _Operation, x: str, y: str) -> str:
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


def _size(o: _Operation, x: str) -> str:
    """Write the absolute value of an integer."""
    zero = o.literal(0)
    negative = o.let(f"icmp slt {o.t} {x}, {zero}")
    return o.choose(negative, o.let(f"sub {o.t} {zero}, {x}"), x)


def _sign(o: _Operation, x: str) -> str:
    zero, one = o.literal(0), o.literal(1)
    if o.kind == 0:
        size = o.intrinsic("copysign", o.t, [one, x])
        # The sign of zero is zero, and the sign of NaN is NaN.
        return o.choose(o.let(f"fcmp one {o.t} {x}, {zero}"), size, x)
    up = o.choose(o.let(f"icmp ne {o.t} {x}, {zero}"), one, zero)
    if o.kind == 2:
        return up
    return o.choose(o.let(f"icmp slt {o.t} {x}, {zero}"), o.literal(-1), up)


def _divided(o: _Operation, x: str, y: str) -> str:
    """Write a quotient or a remainder. Integers cause no trap on zero divisors and overflow.

    A quotient by zero is -1 and a remainder x. The smallest integer over -1 is itself, remainder 0.
    """
    if o.kind == 0 and o.op == "div":
        return o.let(f"fdiv {o.t} {x}, {y}")
    if o.kind == 0:
        return o.library_call("fmodf" if o.dtype == np.float32 else "fmod", [x, y])
    word = {"div": ("sdiv", "udiv"), "rem": ("srem", "urem")}[o.op][o.kind - 1]
    by_zero, overflow = (o.literal(-1), x) if o.op == "div" else (x, o.literal(0))
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


def _shift(o: _Operation, x: str, y: str) -> str:
    bits, by = 8 * o.dtype.itemsize, o.constants[1]
    word = _SHIFTS[o.op]
    if by is not None and 0 <= by < bits:
        return o.let(f"{word} {o.t} {x}, {y}")
    most = o.literal(bits - 1)
    beyond = o.let(f"icmp ugt {o.t} {y}, {most}")
    shifted = o.let(f"{word} {o.t} {x}, {o.choose(beyond, most, y)}")
    return shifted if word == "ashr" else o.choose(beyond, o.literal(0), shifted)


def _conversion(o: _Operation, x: str) -> str:
    source, dtype = o.source, o.dtype
    longer = dtype.itemsize > source.itemsize
    if dtype.kind == "b":
        word = "fcmp une" if o.kind == 0 else "icmp ne"
        return o.let(f"{word} {o.s} {x}, {o.literal(0, dtype=source)}")
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


_WRITERS: dict[str, Callable[..., str]] = {
    **dict.fromkeys(("fma", "fms", "fnma"), _multiply_add),
    **dict.fromkeys(_SHIFTS, _shift),
    **dict.fromkeys(("max", "min"), _extreme),
    **dict.fromkeys(("div", "rem"), _divided),
    "abs": _size,
    "bitcast": lambda o, x: o.let(f"bitcast {o.s} {x} to {o.t}"),
    "convert": _conversion,
    "is_finite": lambda o, x: o.let(
        f"fcmp one {o.s} {o.intrinsic('fabs', o.s, [x])}, {o.literal(np.inf, dtype=o.source)}"
    ),
    "neg": lambda o, x: o.let(
        f"fneg {o.t} {x}" if o.kind == 0 else f"sub {o.t} zeroinitializer, {x}"
    ),
    "not": lambda o, x: o.let(f"xor {o.t} {x}, {o.literal(-1)}"),
    "select": lambda o, flag, yes, no: o.let(f"select {o.s} {flag}, {o.t} {yes}, {o.t} {no}"),
    "sign": _sign,
}
