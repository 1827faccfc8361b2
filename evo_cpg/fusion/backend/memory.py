"""Loads and stores: scratch memory, the rows of arguments and results, tables.

What is in registers is decided elsewhere (`registers`), so every load and store is
*volatile*: LLVM neither drops nor moves one, nor spends time on trying to.
"""

import numpy as np

from evo_cpg.fusion import machine_constants
from evo_cpg.fusion.backend.writer import TYPES, Writer

FRAME = "%frame"
"""Name of the pointer into the memory that is lent."""

FRAME_ORIGIN = 8192
"""Where it points to in it, bytes: AVX-512 tells offsets of up to 128 vectors in one byte."""

_BOOL, _BYTE, _INDEX = np.dtype(bool), np.dtype(np.int8), np.dtype(np.int32)


class Memory:
    """Writes what touches memory.

    Args:
        w: where it is written.
        masked: whether fewer individuals than a vector holds exist.

    Attributes:
        size: bytes of scratch memory that are needed.
        frame_size: of memory that is lent. Vectors that take turns share it, so that it stays in
            the cache; what they keep is in scratch memory of their own.
        buffers: names of the arguments and results that were touched since it was last emptied.
    """

    def __init__(self, w: Writer, masked: bool):
        self._w, self._masked = w, masked
        self._free: dict[int, list[int]] = {}
        self.size = self.frame_size = 0
        self.buffers: dict[str, None] = {}

    def room(self, size: int) -> int:
        """So many bytes of scratch memory for good; where they begin."""
        place = self.size
        self.size += _lines(size)
        return place

    def borrow(self, size: int) -> int:
        """So many bytes until they are given back, such as are likely still in the cache."""
        free = self._free.get(size)
        if free:
            return free.pop()
        place = self.frame_size
        self.frame_size += _lines(size)
        return place

    def give_back(self, size: int, place: int) -> None:
        """Borrowed memory may be used for something else."""
        self._free.setdefault(size, []).append(place)

    def at(self, place: int | str) -> str:
        """A pointer to a place in scratch memory."""
        return self._w.let(f"getelementptr i8, ptr %scratch, i64 {place}")

    def borrowed(self, place: int) -> str:
        """A pointer to a place that was borrowed."""
        self.buffers[FRAME] = None
        return self._w.let(f"getelementptr i8, ptr {FRAME}, i64 {place - FRAME_ORIGIN}")

    def store(self, value: str, dtype: np.dtype, place: int | str, uniform: bool = False) -> None:
        """Write a value to a place in scratch memory or behind a pointer."""
        pointer = place if isinstance(place, str) else self.at(place)
        value, t = self._kept(value, dtype, uniform)
        self._w.lines.append(f"store volatile {t} {value}, ptr {pointer}, align {dtype.itemsize}")

    def load(self, dtype: np.dtype, place: int | str, uniform: bool = False) -> str:
        """Read a value; its name."""
        pointer = place if isinstance(place, str) else self.at(place)
        t = self._w.type_of(_kept_as(dtype), uniform)
        value = self._w.let(f"load volatile {t}, ptr {pointer}, align {dtype.itemsize}")
        return self._read(value, dtype, uniform)

    def load_row(self, base: str, row: int | str, dtype: np.dtype, shared: bool) -> str:
        """A row of an argument: a number for each individual, or one for all."""
        pointer = self._row(base, row, dtype, shared)
        if shared or not self._masked:
            return self.load(dtype, pointer, shared)
        t, mask = self._w.type_of(_kept_as(dtype), False), self._w.type_of(_BOOL, False)
        name = f"llvm.masked.load.{self._w.suffix(t)}.p0"
        self._w.declared[name] = f"declare {t} @{name}(ptr, i32, {mask}, {t})"
        # Individuals that do not exist are zero.
        value = self._w.let(
            f"call {t} @{name}(ptr {pointer}, i32 {dtype.itemsize}, {mask} %valid, "
            f"{t} zeroinitializer)"
        )
        return self._read(value, dtype, False)

    def store_row(self, value: str, base: str, row: int, dtype: np.dtype) -> None:
        """Write a row of a result."""
        pointer = self._row(base, row, dtype, False)
        if not self._masked:
            self.store(value, dtype, pointer)
            return
        value, t = self._kept(value, dtype, False)
        mask = self._w.type_of(_BOOL, False)
        name = f"llvm.masked.store.{self._w.suffix(t)}.p0"
        self._w.declared[name] = f"declare void @{name}({t}, ptr, i32, {mask})"
        self._w.lines.append(
            f"call void @{name}({t} {value}, ptr {pointer}, i32 {dtype.itemsize}, {mask} %valid)"
        )

    def look_up(
        self, base: str, index: str, dtype: np.dtype, shared: bool, same_index: bool
    ) -> str:
        """A number of a table.

        Args:
            base: pointer to the table.
            index: which, of one number for all or of a number for each individual.
            dtype: of the table.
            shared: whether the table is the same for all individuals.
            same_index: whether the index is.
        """
        w, t = self._w, _item(dtype)
        if same_index or w.width == 1:
            steps = index if shared or w.width == 1 else w.let(f"mul i32 {index}, {w.width}")
            pointer = w.let(f"getelementptr {t}, ptr {base}, i32 {steps}")
            return self.load(dtype, pointer, same_index and shared)
        whole, result, indices = w.type_of(dtype, False), "poison", w.type_of(_INDEX, False)
        for i in range(w.width):
            own = w.let(f"extractelement {indices} {index}, i32 {i}")
            if not shared:
                own = w.let(f"mul i32 {own}, {w.width}")
                own = w.let(f"add i32 {own}, {i}")
            pointer = w.let(f"getelementptr {t}, ptr {base}, i32 {own}")
            value = self.load(dtype, pointer, True)
            result = w.let(f"insertelement {whole} {result}, {TYPES[dtype.char]} {value}, i32 {i}")
        return result

    def _row(self, base: str, row: int | str, dtype: np.dtype, shared: bool) -> str:
        self.buffers[base] = None
        if shared:
            return self._w.let(f"getelementptr {_item(dtype)}, ptr {base}, i64 {row}")
        start = self._w.let(f"mul i64 %n, {row}")
        place = self._w.let(f"add i64 {start}, %first")
        return self._w.let(f"getelementptr {_item(dtype)}, ptr {base}, i64 {place}")

    def _kept(self, value: str, dtype: np.dtype, uniform: bool) -> tuple[str, str]:
        """A value and its type as they are in memory: truth values are bytes."""
        t, kept = self._w.type_of(dtype, uniform), self._w.type_of(_kept_as(dtype), uniform)
        return (value if t == kept else self._w.let(f"zext {t} {value} to {kept}")), kept

    def _read(self, value: str, dtype: np.dtype, uniform: bool) -> str:
        if dtype.kind != "b":
            return value
        zero = self._w.literal(0, _BYTE, uniform)
        return self._w.let(f"icmp ne {self._w.type_of(_BYTE, uniform)} {value}, {zero}")


def _kept_as(dtype: np.dtype) -> np.dtype:
    return _BYTE if dtype.kind == "b" else dtype


def _item(dtype: np.dtype) -> str:
    return TYPES[_kept_as(dtype).char]


def _lines(size: int) -> int:
    """So many bytes, rounded up to whole lines of the cache."""
    line = machine_constants.CACHE_LINE
    return -(-size // line) * line
