"""Measure the time that a thread spends on making native code, and note what it makes."""

import contextlib
import contextvars
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple


class Made(NamedTuple):
    """Record of a program that became machine code.

    Attributes:
        name: of the program.
        operations: number of nodes of its graph that became code.
        writing: time from the JAX program to LLVM IR, s.
        compiling: time from LLVM IR to machine code in memory, s.
        scratch: bytes of memory that it works in.
    """

    name: str
    operations: int
    writing: float
    compiling: float
    scratch: int


@dataclass
class Spent:
    """Time spent on native code.

    Attributes:
        seconds: all of it, s: tracing programs, writing their code, and compiling it.
        compiler: the part of it that LLVM took, s; 0 where all code was kept from before.
        programs: that became machine code, in order.
    """

    seconds: float = 0.0
    compiler: float = 0.0
    programs: list[Made] = field(default_factory=list)


_spent: contextvars.ContextVar[Spent | None] = contextvars.ContextVar("spent", default=None)


@contextlib.contextmanager
def measuring() -> Iterator[Spent]:
    """Measure what this thread spends within the block."""
    spent = Spent()
    token = _spent.set(spent)
    try:
        yield spent
    finally:
        _spent.reset(token)


def record(made: Made) -> None:
    """Note a program that became machine code, if this thread measures."""
    spent = _spent.get()
    if spent is not None:
        spent.programs.append(made)


@contextlib.contextmanager
def counted(compiler: bool = False) -> Iterator[None]:
    """Add the time of the block to what is measured.

    Args:
        compiler: whether the block is LLVM's part, which lies within a block that counts already.
    """
    spent, start = _spent.get(), time.perf_counter()
    try:
        yield
    finally:
        if spent is not None:
            took = time.perf_counter() - start
            if compiler:
                spent.compiler += took
            else:
                spent.seconds += took
