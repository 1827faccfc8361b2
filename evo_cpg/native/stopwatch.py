"""Measure the time that a thread spends on native code, and record the programs it compiles."""

import contextlib
import contextvars
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple


class Made(NamedTuple):
    """Record of a program that became machine code.

    Attributes:
        name: name of the program.
        operations: number of nodes of its graph that became code.
        writing: time from the JAX program to LLVM IR, s.
        compiling: time from LLVM IR to machine code in memory, s.
        scratch: bytes of working memory.
    """

    name: str
    operations: int
    writing: float
    compiling: float
    scratch: int


@dataclass
class NativeTime:
    """Time spent on native code.

    Attributes:
        seconds: total time, s: tracing programs, writing their code, and compiling it.
        compiler: time in LLVM, part of ``seconds``, s (0 if all code came from the cache).
        programs: programs that became machine code, in order.
    """

    seconds: float = 0.0
    compiler: float = 0.0
    programs: list[Made] = field(default_factory=list)


_spent: contextvars.ContextVar[NativeTime | None] = contextvars.ContextVar("spent", default=None)


@contextlib.contextmanager
def measuring() -> Iterator[NativeTime]:
    """Measure the time that this thread spends on native code within the block."""
    spent = NativeTime()
    token = _spent.set(spent)
    try:
        yield spent
    finally:
        _spent.reset(token)


@contextlib.contextmanager
def counted(compiler: bool = False) -> Iterator[NativeTime | None]:
    """Add the time of the block to the measurement of this thread, if there is one.

    Args:
        compiler: True for the time in LLVM, which lies within a block that is counted already.
    """
    spent, start = _spent.get(), time.perf_counter()
    try:
        yield spent
    finally:
        if spent is not None:
            took = time.perf_counter() - start
            if compiler:
                spent.compiler += took
            else:
                spent.seconds += took
