"""Select the instructions of each operation, as templates that all equal operations share.

`evo_cpg.native.backend.allocate` decides which values are in registers. So loads and stores are
*volatile*: LLVM does not drop or move them, and spends no time on trying.
"""

import functools
from collections.abc import Callable

import numpy as np

from evo_cpg.native.backend.code import Template, Variant
from evo_cpg.native.backend.operations import write
from evo_cpg.native.backend.solve_routine import routine
from evo_cpg.native.backend.writer import TYPES, Writer
from evo_cpg.native.ir.graph import Node

SCRATCH, FRAME = "%scratch", "%frame"
"""Pointers to a vector's own memory and to the memory that vectors share."""

_BOOL, _BYTE, _INDEX = np.dtype(bool), np.dtype(np.int8), np.dtype(np.int32)

# Operations whose code is shorter with some constants.
_DEPENDS_ON_CONSTANTS = {
    "div", "max", "min", "rem", "shift_left", "shift_right_arithmetic", "shift_right_logical",
}  # fmt: skip


def _made_once(arity: int) -> Callable[[Callable], Callable[..., Template]]:
    """Return a decorator that makes one template for each kind of arguments of a method.

    The last ``arity`` arguments of the method are operands. The others are the kind.
    """

    def decorate(method: Callable) -> Callable[..., Template]:
        @functools.wraps(method)
        def get(self: "Selector", *kind) -> Template:
            key = method, *kind
            found = self._known.get(key)
            if found is None:
                found = self._w.template(arity, functools.partial(method, self, *kind))
                self._known[key] = found
            return found

        return get

    return decorate


class Selector:
    """Templates for a variant of code.

    Attributes:
        functions: functions that templates call, by name.
    """

    def __init__(self, variant: Variant):
        self._w = Writer(variant.width, variant.target.fma)
        self.functions = self._w.functions
        self.literal = self._w.literal
        self._known: dict[tuple, Template] = {}

    def operation(self, node: Node) -> Template:
        """Return the instructions of an arithmetic operation."""
        operands, constants = node.operands, None
        if node.op in _DEPENDS_ON_CONSTANTS:
            constants = tuple([None if x.value is None else x.value.item() for x in operands])
        key = node.op, node.dtype, node.uniform, operands[0].dtype, constants
        found = self._known.get(key)
        if found is None:
            found = self._w.template(len(operands), lambda *names: write(self._w, node, [*names]))
            self._known[key] = found
        return found

    @_made_once(1)
    def address(self, base: str, place: str) -> str:
        """Return a pointer to a place in memory."""
        return self._w.let(f"getelementptr i8, ptr {base}, i64 {place}")

    @_made_once(2)
    def element(self, pointer: str, steps: str) -> str:
        """Return the address ``steps`` bytes after another one."""
        return self._w.let(f"getelementptr i8, ptr {pointer}, i32 {steps}")

    @_made_once(2)
    def times(self, x: str, y: str) -> str:
        """Return a product of int32."""
        return self._w.let(f"mul i32 {x}, {y}")

    @_made_once(2)
    def add(self, dtype: np.dtype, x: str, y: str) -> str:
        """Return a sum of two vectors."""
        word = "fadd" if dtype.kind == "f" else "add"
        return self._w.let(f"{word} {self._w.type_of(dtype, False)} {x}, {y}")

    @_made_once(3)
    def choose(self, dtype: np.dtype, flag: str, yes: str, no: str) -> str:
        """Return ``yes`` in lanes where the flag is true, else ``no``."""
        t, flags = self._w.type_of(dtype, False), self._w.type_of(_BOOL, False)
        return self._w.let(f"select {flags} {flag}, {t} {yes}, {t} {no}")

    @_made_once(2)
    def store(self, dtype: np.dtype, uniform: bool, base: str, value: str, place: str) -> None:
        """Write a value to ``base`` plus ``place`` bytes.

        If ``base`` is "", ``place`` is a pointer.
        """
        pointer = self._w.let(f"getelementptr i8, ptr {base}, i64 {place}") if base else place
        self._store(value, dtype, pointer, uniform)

    @_made_once(1)
    def load(self, dtype: np.dtype, uniform: bool, base: str, place: str) -> str:
        """Read a value at ``base`` plus ``place`` bytes.

        If ``base`` is "", ``place`` is a pointer.
        """
        pointer = self._w.let(f"getelementptr i8, ptr {base}, i64 {place}") if base else place
        return self._load(dtype, pointer, uniform)

    @_made_once(2)
    def load_row(self, dtype: np.dtype, shared: bool, base: str, row: str) -> str:
        """Read a row of an argument: one number per individual, or one shared number."""
        return self._load(dtype, self._row(base, row, dtype, shared), shared)

    @_made_once(4)
    def copy_row(self, dtype: np.dtype, base: str, row: str, size: str, start: str) -> None:
        """Copy row ``row + %i`` of an argument to scratch memory, at ``start + %i * size``."""
        w = self._w
        source = w.let(f"add i64 %i, {row}")
        value = self._load(dtype, self._row(base, source, dtype, False), False)
        place = w.let(f"mul i64 %i, {size}")
        place = w.let(f"add i64 {place}, {start}")
        self._store(value, dtype, w.let(f"getelementptr i8, ptr {SCRATCH}, i64 {place}"), False)

    @_made_once(3)
    def store_row(self, dtype: np.dtype, value: str, base: str, row: str) -> None:
        """Write a row of a result."""
        self._store(value, dtype, self._row(base, row, dtype, False), False)

    @_made_once(2)
    def look_up(
        self, dtype: np.dtype, shared: bool, same_index: bool, base: str, index: str
    ) -> str:
        """Read a number of a table.

        Args:
            dtype: type of the table's numbers.
            shared: whether all individuals share the table.
            same_index: whether all individuals share the index.
            base: pointer to the table.
            index: index of the number: one for all individuals, or one per individual.
        """
        w, t = self._w, TYPES[_kept_as(dtype).char]
        if same_index or w.width == 1:
            steps = index if shared or w.width == 1 else w.let(f"mul i32 {index}, {w.width}")
            pointer = w.let(f"getelementptr {t}, ptr {base}, i32 {steps}")
            return self._load(dtype, pointer, same_index and shared)
        whole, result, indices = w.type_of(dtype, False), "poison", w.type_of(_INDEX, False)
        for i in range(w.width):
            own = w.let(f"extractelement {indices} {index}, i32 {i}")
            if not shared:
                own = w.let(f"mul i32 {own}, {w.width}")
                own = w.let(f"add i32 {own}, {i}")
            pointer = w.let(f"getelementptr {t}, ptr {base}, i32 {own}")
            value = self._load(dtype, pointer, True)
            result = w.let(f"insertelement {whole} {result}, {TYPES[dtype.char]} {value}, i32 {i}")
        return result

    @_made_once(1)
    def spread(self, dtype: np.dtype, name: str) -> str:
        """Return a vector with one value in all lanes."""
        t, scalar = self._w.type_of(dtype, False), TYPES[dtype.char]
        one = self._w.let(f"insertelement {t} poison, {scalar} {name}, i32 0")
        zeros = f"<{self._w.width} x i32> zeroinitializer"
        return self._w.let(f"shufflevector {t} {one}, {t} poison, {zeros}")

    @_made_once(3)
    def fill(self, dtype: np.dtype, to: str, value: str, count: str) -> None:
        """Write one value to all rows of a table, by a loop in a separate function."""
        w, t = self._w, self._w.type_of(dtype, False)
        size = dtype.itemsize * w.width
        name = f"fill.{w.suffix(t)}"
        w.functions[name] = (
            f"define internal void @{name}(ptr %to, {t} %value, i64 %count) noinline #0 {{\n"
            "entry:\nbr label %row\nrow:\n"
            "%i = phi i64 [ 0, %entry ], [ %j, %row ]\n"
            f"%steps = mul i64 %i, {size}\n"
            "%place = getelementptr i8, ptr %to, i64 %steps\n"
            f"store {t} %value, ptr %place, align {dtype.itemsize}\n"
            "%j = add i64 %i, 1\n%more = icmp ult i64 %j, %count\n"
            "br i1 %more, label %row, label %done\ndone:\nret void\n}"
        )
        w.lines.append(f"call void @{name}(ptr {to}, {t} {value}, i64 {count})")

    @_made_once(3)
    def solve(self, dtype: np.dtype, uniform: bool, H: str, b: str, count: str) -> None:
        """Call the function that solves symmetric equations in memory."""
        w, t = self._w, self._w.type_of(dtype, uniform)
        name, size = f"solve.{w.suffix(t)}", dtype.itemsize * (1 if uniform else w.width)
        w.functions[name] = routine(name, t, size, dtype.itemsize, w.fma)
        w.lines.append(f"call void @{name}(ptr {H}, ptr {b}, i64 {count})")

    @_made_once(1)
    def any_of(self, flags: str) -> str:
        """Return whether a truth value holds for any individual."""
        t, name = self._w.type_of(_BOOL, False), f"llvm.vector.reduce.or.v{self._w.width}i1"
        return self._w.let(f"call i1 @{name}({t} {flags})")

    @_made_once(1)
    def mask(self, flags: str) -> str:
        """Return an int32 with one bit per individual."""
        bits = f"i{self._w.width}"
        own = self._w.let(f"bitcast {self._w.type_of(_BOOL, False)} {flags} to {bits}")
        return self._w.let(f"zext {bits} {own} to i32")

    def _store(self, value: str, dtype: np.dtype, pointer: str, uniform: bool) -> None:
        value, t = self._kept(value, dtype, uniform)
        self._w.lines.append(f"store volatile {t} {value}, ptr {pointer}, align {dtype.itemsize}")

    def _load(self, dtype: np.dtype, pointer: str, uniform: bool) -> str:
        t = self._w.type_of(_kept_as(dtype), uniform)
        value = self._w.let(f"load volatile {t}, ptr {pointer}, align {dtype.itemsize}")
        return self._read(value, dtype, uniform)

    def _row(self, base: str, row: str, dtype: np.dtype, shared: bool) -> str:
        item = TYPES[_kept_as(dtype).char]
        if shared:
            return self._w.let(f"getelementptr {item}, ptr {base}, i64 {row}")
        start = self._w.let(f"mul i64 %n, {row}")
        place = self._w.let(f"add i64 {start}, %first")
        return self._w.let(f"getelementptr {item}, ptr {base}, i64 {place}")

    def _kept(self, value: str, dtype: np.dtype, uniform: bool) -> tuple[str, str]:
        """Return a value and its type as stored in memory: truth values are bytes."""
        t, kept = self._w.type_of(dtype, uniform), self._w.type_of(_kept_as(dtype), uniform)
        return (value if t == kept else self._w.let(f"zext {t} {value} to {kept}")), kept

    def _read(self, value: str, dtype: np.dtype, uniform: bool) -> str:
        if dtype.kind != "b":
            return value
        zero = self._w.literal(0, _BYTE, uniform)
        return self._w.let(f"icmp ne {self._w.type_of(_BYTE, uniform)} {value}, {zero}")


def _kept_as(dtype: np.dtype) -> np.dtype:
    return _BYTE if dtype.kind == "b" else dtype
