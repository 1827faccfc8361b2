"""Select the instructions of each operation, as templates that all equal operations share.

`evo_cpg.native.backend.allocate` decides which values are in registers. So loads and stores are
*volatile*: LLVM does not drop or move them, and spends no time on trying.
"""

import functools
from collections.abc import Callable

import numpy as np

from evo_cpg.native.backend.code import Template
from evo_cpg.native.backend.operations import TYPES, FunctionText, Writer, suffix, write
from evo_cpg.native.ir import Node

SCRATCH, FRAME = "%scratch", "%frame"
"""Pointers to a vector's own memory and to the memory that vectors share."""

_BYTE, _INDEX = np.dtype(np.int8), np.dtype(np.int32)

# Operations whose code is shorter with some constants.
_DEPENDS_ON_CONSTANTS = {
    "div", "max", "min", "rem", "shift_left", "shift_right_arithmetic", "shift_right_logical",
}  # fmt: skip


def _made_once(arity: int, method: Callable) -> Callable[..., Template]:
    """Return a method that makes one template for each kind of arguments of another method.

    The last ``arity`` arguments of the other method are operands. The others are the kind.
    """

    @functools.wraps(method)
    def get(self: "Selector", *kind) -> Template:
        return self.template((method, *kind), arity, functools.partial(method, self, *kind))

    return get


class Selector(Writer):
    """Templates for a variant of code."""

    def operation(self, node: Node) -> Template:
        """Return the instructions of an arithmetic operation."""
        operands, constants = node.operands, None
        if node.op in _DEPENDS_ON_CONSTANTS:
            constants = tuple([None if x.value is None else x.value.item() for x in operands])
        key = node.op, node.dtype, node.uniform, operands[0].dtype, constants
        return self.template(key, len(operands), lambda *names: write(self, node, [*names]))

    def line(self, text: str) -> Template:
        """Return one instruction with a result, with gaps ``{0}``, ``{1}``... for its operands."""
        return self.template(text, text.count("{"), lambda *_: self.let(text))

    @functools.partial(_made_once, 2)
    def store(self, dtype: np.dtype, uniform: bool, base: str, value: str, place: str) -> None:
        """Write a value to ``base`` plus ``place`` bytes."""
        pointer = self.let(f"getelementptr i8, ptr {base}, i64 {place}")
        self._store(value, dtype, pointer, uniform)

    @functools.partial(_made_once, 1)
    def load(self, dtype: np.dtype, uniform: bool, base: str, place: str) -> str:
        """Read a value at ``base`` plus ``place`` bytes."""
        pointer = self.let(f"getelementptr i8, ptr {base}, i64 {place}")
        return self._load(dtype, pointer, uniform)

    @functools.partial(_made_once, 2)
    def load_row(self, dtype: np.dtype, shared: bool, base: str, row: str) -> str:
        """Read a row of an argument: one number per individual, or one shared number."""
        return self._load(dtype, self._row(base, row, dtype, shared), shared)

    @functools.partial(_made_once, 4)
    def copy_rows(self, dtype: np.dtype, base: str, row: str, count: str, place: str) -> None:
        """Copy rows of an argument to adjacent places in memory, by a loop in a separate function.

        The first row is ``row``. It goes to ``place`` bytes after the start of scratch memory.
        """
        t, size = self.type_of(_kept_as(dtype), False), dtype.itemsize
        name = f"copy.{suffix(t)}"
        f = FunctionText(f"internal void @{name}(ptr %from, ptr %to, i64 %n, i64 %count) noinline")
        with f.each("%count") as k:
            value = f.load(t, f.at("%from", f.let(f"mul i64 {k}, %n"), size), size)
            f.store(t, value, f.at("%to", k, size * self.width), size)
        self.functions[name] = f.text()
        first = self._row(base, row, dtype, False)
        to = self.let(f"getelementptr i8, ptr {SCRATCH}, i64 {place}")
        self.lines.append(f"call void @{name}(ptr {first}, ptr {to}, i64 %n, i64 {count})")

    @functools.partial(_made_once, 3)
    def store_row(self, dtype: np.dtype, value: str, base: str, row: str) -> None:
        """Write a row of a result."""
        self._store(value, dtype, self._row(base, row, dtype, False), False)

    @functools.partial(_made_once, 2)
    def places(self, dtype: np.dtype, shared: bool, same_index: bool, base: str, index: str) -> str:
        """Return a pointer to a number of a table, or a vector of each individual's pointers.

        All individuals may share the table, or the index, or both.
        """
        t = TYPES[_kept_as(dtype).char]
        if self.width == 1 or same_index:
            row = t if shared else f"[{self.width} x {t}]"
            return self.let(f"getelementptr {row}, ptr {base}, i32 {index}")
        kind = self.type_of(_INDEX, False)
        if not shared:
            lanes = ", ".join(f"i32 {i}" for i in range(self.width))
            index = self.let(f"mul {kind} {index}, splat (i32 {self.width})")
            index = self.let(f"add {kind} {index}, <{lanes}>")
        return self.let(f"getelementptr {t}, ptr {base}, {kind} {index}")

    @functools.partial(_made_once, 1)
    def read(self, dtype: np.dtype, shared: bool, same_index: bool, places: str) -> str:
        """Read the number at `places`."""
        one = self.width == 1 or same_index
        return self._load(dtype, places, shared and same_index, not one)

    @functools.partial(_made_once, 3)
    def write(
        self, dtype: np.dtype, how: tuple[bool, bool, bool], value: str, places: str, flags: str
    ) -> None:
        """Write a number at `places`, for individuals with a flag.

        ``how`` says whether there is only one pointer, whether the number is added, and whether
        the flag is true for everyone.
        """
        one, adds, everyone = how
        t, bits, before = self.type_of(dtype, False), self.type_of(np.dtype(bool), False), ""
        if adds or (one and not everyone):
            before = self._load(dtype, places, False, not one)
        if adds:
            value = self.let(f"{'fadd' if dtype.kind == 'f' else 'add'} {t} {before}, {value}")
        if one and not everyone:
            value = self.let(f"select {bits} {flags}, {t} {value}, {t} {before}")
        if one:
            self._store(value, dtype, places, False)
            return
        self.lines.append(
            f"call void @llvm.masked.scatter.{suffix(t)}.v{self.width}p0({t} {value}, "
            f"<{self.width} x ptr> {places}, i32 {dtype.itemsize}, {bits} {flags})"
        )

    @functools.partial(_made_once, 1)
    def spread(self, dtype: np.dtype, name: str) -> str:
        """Return a vector with one value in all lanes."""
        t, scalar = self.type_of(dtype, False), TYPES[dtype.char]
        one = self.let(f"insertelement {t} poison, {scalar} {name}, i32 0")
        zeros = f"<{self.width} x i32> zeroinitializer"
        return self.let(f"shufflevector {t} {one}, {t} poison, {zeros}")

    @functools.partial(_made_once, 3)
    def fill(self, dtype: np.dtype, to: str, value: str, count: str) -> None:
        """Write one value to all rows of a table, by a loop in a separate function."""
        t = self.type_of(dtype, False)
        size = dtype.itemsize * self.width
        name = f"fill.{suffix(t)}"
        f = FunctionText(f"internal void @{name}(ptr %to, {t} %value, i64 %count) noinline")
        with f.each("%count") as row:
            f.store(t, "%value", f.at("%to", row, size), dtype.itemsize)
        self.functions[name] = f.text()
        self.lines.append(f"call void @{name}(ptr {to}, {t} {value}, i64 {count})")

    @functools.partial(_made_once, 3)
    def solve(self, dtype: np.dtype, uniform: bool, H: str, b: str, count: str) -> None:
        """Call the function that solves symmetric equations in memory."""
        t = self.type_of(dtype, uniform)
        name, size = f"solve.{suffix(t)}", dtype.itemsize * (1 if uniform else self.width)
        self.functions[name] = _solver(name, t, size, dtype.itemsize, self.fma)
        self.lines.append(f"call void @{name}(ptr {H}, ptr {b}, i64 {count})")

    def _store(self, value: str, dtype: np.dtype, pointer: str, uniform: bool) -> None:
        t, kept = self.type_of(dtype, uniform), self.type_of(_kept_as(dtype), uniform)
        if t != kept:
            value = self.let(f"zext {t} {value} to {kept}")
        text = f"store volatile {kept} {value}, ptr {pointer}, align {dtype.itemsize}"
        self.lines.append(text)

    def _load(self, dtype: np.dtype, pointer: str, uniform: bool, gathers: bool = False) -> str:
        """Read a value from a pointer, or from a pointer for each individual."""
        t, width = self.type_of(_kept_as(dtype), uniform), self.width
        if gathers:
            value = self.let(
                f"call {t} @llvm.masked.gather.{suffix(t)}.v{width}p0(<{width} x ptr> {pointer}, "
                f"i32 {dtype.itemsize}, <{width} x i1> splat (i1 true), {t} poison)"
            )
        else:
            value = self.let(f"load volatile {t}, ptr {pointer}, align {dtype.itemsize}")
        if dtype.kind != "b":
            return value
        return self.let(f"icmp ne {t} {value}, {self.literal(0, _BYTE, uniform)}")

    def _row(self, base: str, row: str, dtype: np.dtype, shared: bool) -> str:
        item = TYPES[_kept_as(dtype).char]
        if shared:
            return self.let(f"getelementptr {item}, ptr {base}, i64 {row}")
        start = self.let(f"mul i64 %n, {row}")
        place = self.let(f"add i64 {start}, %first")
        return self.let(f"getelementptr {item}, ptr {base}, i64 {place}")


def _kept_as(dtype: np.dtype) -> np.dtype:
    """Return the type of a value in memory: truth values are bytes."""
    return _BYTE if dtype.kind == "b" else dtype


def _solver(name: str, t: str, row: int, size: int, fma: bool) -> str:
    """Return LLVM IR of a function that solves the equations ``H x = b`` in memory.

    The lower triangle of H is stored row by row, and overwritten. The solution replaces b. The
    function has loops over rows and columns instead of straight-line code, and eliminates in the
    order of `evo_cpg.native.ldl`. It skips elements that are zero for all individuals of a vector.

    Args:
        name: name of the function.
        t: LLVM's type of a number.
        row: bytes from one number to the next.
        size: bytes of one individual's number.
        fma: whether the processor multiplies and adds in one instruction.
    """
    lanes, _, item = t[1:-1].partition(" x ") if t.startswith("<") else ("", "", t)
    zero, one = (f"splat ({item} {x})" if lanes else x for x in ("0.0", "1.0"))
    flag = f"<{lanes} x i1>" if lanes else "i1"

    f = FunctionText(f"internal void @{name}(ptr %H, ptr %b, i64 %count) noinline")
    load = functools.partial(f.load, t, align=size)
    store = functools.partial(f.store, t, align=size)

    def less(a: str, x: str, y: str) -> str:
        """Subtract a product."""
        if not fma:
            return f.let(f"fsub {t} {a}, {f.let(f'fmul {t} {x}, {y}')}")
        minus = f.let(f"fneg {t} {x}")
        return f.let(f"call {t} @llvm.fma.{suffix(t)}({t} {minus}, {t} {y}, {t} {a})")

    def row_of(k: str) -> str:
        """Return a pointer to a row of the triangle."""
        twice = f.let(f"mul i64 {k}, {f.let(f'add i64 {k}, 1')}")
        return f.at("%H", f.let(f"lshr i64 {twice}, 1"), row)

    last = f.let("sub i64 %count, 1")
    with f.each("%count") as done:
        k = f.let(f"sub i64 {last}, {done}")
        row_k = row_of(k)
        diagonal = f.at(row_k, k, row)
        inverse = f.let(f"fdiv {t} {one}, {load(diagonal)}")
        store(inverse, diagonal)
        z = load(f.at("%b", k, row))
        with f.each(k) as passed:
            left = f.let(f"sub i64 {k}, {passed}")
            i = f.let(f"sub i64 {left}, 1")
            place = f.at(row_k, i, row)
            r = load(place)
            some = f.let(f"fcmp une {t} {r}, {zero}")
            if lanes:
                some = f.let(f"call i1 @llvm.vector.reduce.or.v{lanes}i1({flag} {some})")
            with f.where(some):
                scaled, row_i = f.let(f"fmul {t} {r}, {inverse}"), row_of(i)
                with f.each(left) as j:
                    element = f.at(row_i, j, row)
                    store(less(load(element), scaled, load(f.at(row_k, j, row))), element)
                store(scaled, place)
                b_i = f.at("%b", i, row)
                store(less(load(b_i), scaled, z), b_i)
    with f.each("%count") as m:
        row_m, b_m = row_of(m), f.at("%b", m, row)
        begin = f.let(f"fmul {t} {load(b_m)}, {load(f.at(row_m, m, row))}")
        with f.each(m, t, begin) as q:
            f.total = less(f.total, load(f.at(row_m, q, row)), load(f.at("%b", q, row)))
        store(f.total, b_m)
    return f.text()
