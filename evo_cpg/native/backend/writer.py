"""Write the text of LLVM instructions: names, types, constants.

A value is either a scalar, equal for all individuals of a vector, or a vector.
"""

import struct
from collections.abc import Callable, Sequence

import numpy as np

from evo_cpg.native.backend.code import Template

# LLVM's types by the characters of NumPy's types.
TYPES = {
    "?": "i1", "b": "i8", "B": "i8", "h": "i16", "H": "i16", "i": "i32", "I": "i32", "l": "i64",
    "L": "i64", "q": "i64", "Q": "i64", "f": "float", "d": "double",
}  # fmt: skip


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

    def template(self, arity: int, write: Callable[..., str | None]) -> Template:
        """Return the instructions that a function writes.

        Args:
            arity: number of operands.
            write: function from gaps for operands to the name of the result, or None.
        """
        self.lines, self._arity, self._names = [], arity, 0
        operands = [f"{{{k}}}" for k in range(arity)]
        found = write(*operands)
        names = [f"%v{{{arity + k}}}" for k in range(self._names)]
        result = 0 if found is None or found in operands else names.index(found) + 1
        return Template("\n".join(self.lines), len(self.lines), self._names, result)

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

        Args:
            name: name of the intrinsic, without ``llvm.`` and types.
            t: type of its result.
            a: names of its operands.
            source: type of its operands, or "" if equal to ``t``.
        """
        source = source or t
        suffix = self.suffix(t) + (f".{self.suffix(source)}" if source != t else "")
        return self.let(
            f"call {t} @llvm.{name}.{suffix}({', '.join([f'{source} {x}' for x in a])})"
        )

    @staticmethod
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
