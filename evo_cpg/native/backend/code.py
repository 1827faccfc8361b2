"""Allocated programs: LLVM instructions, places in memory and loops, before they become text.

| type | meaning |
|---|---|
| `Template` | the instructions for one operation, with gaps for its operands |
| `Step` | a template with operands |
| `StretchCode` | code without branches, which becomes one or more functions (`FunctionCode`) |
| `LoopCode` | a loop or a branch over stretches |
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from evo_cpg.native.ir import Buffer, GraphLoop


class Target(NamedTuple):
    """The machine that code is made for.

    Attributes:
        name: name of the instruction set.
        bytes: size of a vector, bytes.
        registers: number of vector registers.
        fma: whether the processor multiplies and adds in one instruction.
        compresses: whether one instruction moves chosen numbers of a vector into its first lanes.
        processor: LLVM's name of the processor.
        features: LLVM's list of processor features.
    """

    name: str
    bytes: int
    registers: int
    fma: bool
    compresses: bool
    processor: str
    features: str


class Variant(NamedTuple):
    """The kind of machine code: the machine, and the number of individuals in a vector."""

    target: Target
    width: int


class Template(NamedTuple):
    """Lines of LLVM IR with gaps: ``{0}``, ``{1}``... for operands, then one for each new name.

    Attributes:
        lines: number of lines.
        names: number of new names.
        result: number of the result among the new names, from 1, or 0 for the first operand.
    """

    text: str
    lines: int
    names: int
    result: int


class Step(NamedTuple):
    """A template with operands: names of values, constants or places.

    ``first`` is the number of the first new name.
    """

    template: Template
    operands: tuple[str | int, ...]
    first: int


class FunctionCode(NamedTuple):
    """Code without branches that is short enough for a function.

    Attributes:
        steps: steps in order.
        buffers: pointers to arguments, results and shared memory that the steps use.
        parts: number of lines of each part of the program, by name.
    """

    steps: Sequence[Step]
    buffers: tuple[str, ...]
    parts: Mapping[str, int]


class StretchCode(NamedTuple):
    """Code without branches: functions that run in turn.

    Attributes:
        functions: one function, or several if the stretch is long.
        result: name of its result, or "" if there is none.
        kind: LLVM's type of the result.
    """

    functions: Sequence[FunctionCode]
    result: str = ""
    kind: str = "void"


class Slot(NamedTuple):
    """A place in scratch memory.

    Attributes:
        start: offset, bytes.
        size: bytes of one individual's number.
        shared: whether all individuals share one number.
    """

    start: int
    size: int
    shared: bool = False


class GrowingTable(NamedTuple):
    """A table in scratch memory of which only the first rows are in use.

    Attributes:
        start: offset of the first row, bytes.
        size: bytes of one individual's number.
        step: bytes from one row to the next.
        extent: offset of each individual's number of rows in use, bytes.
    """

    start: int
    size: int
    step: int
    extent: int


# Slots that a packed loop reads, slots that it carries, and growing tables that it reads.
Packed = tuple[Sequence[Slot], Sequence[Slot], Sequence[GrowingTable]]


@dataclasses.dataclass(frozen=True)
class LoopCode:
    """A loop or a branch.

    Attributes:
        loop: loop of the graph.
        counter: place of the number of the round in scratch memory, or None if no code reads it.
        test: code of the loop's test. The result of its last stretch is true if another round
            follows.
        body: code of a round.
        packed: what is moved if the individuals are packed together, else None.
    """

    loop: GraphLoop
    counter: int | None
    test: "Sequence[Item]"
    body: "Sequence[Item]"
    packed: Packed | None


Item = StretchCode | LoopCode


@dataclasses.dataclass(frozen=True)
class Code:
    """A program in which every value has a place.

    Attributes:
        arguments: arrays that the program reads.
        results: arrays that the program writes.
        variant: kind of machine code.
        items: code in order.
        tables: tables of constants, by the name of an LLVM global.
        functions: functions that the code calls, by name.
        size: bytes of scratch memory of each vector.
        frame: bytes of memory that vectors share.
        grouped: whether several vectors run together, as a group
            (`evo_cpg.native.backend.packing`).
        spills: number of stores and loads of values that left their registers within a stretch, by
            the part of the program that they are for.
        places: bytes of scratch memory of each part.
    """

    arguments: tuple[Buffer, ...]
    results: tuple[Buffer, ...]
    variant: Variant
    items: Sequence[Item]
    tables: Mapping[str, np.ndarray]
    functions: dict[str, str]
    size: int
    frame: int
    grouped: bool
    spills: Mapping[str, int]
    places: Mapping[str, int]
