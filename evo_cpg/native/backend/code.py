"""Allocated programs: LLVM instructions, places in memory and loops, before they become text.

| type | meaning |
|---|---|
| `Template` | the instructions for one operation, with gaps for its operands |
| `Step` | a template with operands |
| `Stretch` | code without branches, which becomes a function |
| `Copy` | rows of an argument that are copied to adjacent places |
| `LoopCode` | a loop or a branch over stretches |
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evo_cpg.native.ir.graph import Buffer, Loop


class Target(NamedTuple):
    """The machine that code is made for.

    Attributes:
        name: name of the instruction set.
        bytes: size of a vector, bytes.
        registers: number of vector registers.
        fma: whether the processor multiplies and adds in one instruction.
        processor: LLVM's name of the processor.
        features: LLVM's list of processor features.
    """

    name: str
    bytes: int
    registers: int
    fma: bool
    processor: str
    features: str


class Variant(NamedTuple):
    """The kind of machine code.

    Attributes:
        target: the machine.
        width: number of individuals in a vector.
    """

    target: Target
    width: int


class Template(NamedTuple):
    """Instructions with gaps: ``{0}``, ``{1}``... for operands, then one for each new name.

    Attributes:
        text: lines of LLVM IR.
        lines: number of lines.
        names: number of values that the lines name.
        result: number of the result among the new names, from 1, or 0 for the first operand.
    """

    text: str
    lines: int
    names: int
    result: int


class Step(NamedTuple):
    """A template with operands.

    Attributes:
        template: the instructions.
        operands: names of values, constants or places.
        first: number of the first new name.
    """

    template: Template
    operands: tuple[str | int, ...]
    first: int


class Piece(NamedTuple):
    """A part of a stretch that is short enough for a function.

    Attributes:
        steps: steps in order.
        buffers: pointers to arguments, results and shared memory that the piece uses.
    """

    steps: Sequence[Step]
    buffers: tuple[str, ...]


class Stretch(NamedTuple):
    """Code without branches.

    Attributes:
        pieces: one piece, or several pieces that run in turn.
        result: name of its result, or "" if there is none.
        kind: LLVM's type of the result.
    """

    pieces: Sequence[Piece]
    result: str = ""
    kind: str = "void"


class Copy(NamedTuple):
    """Consecutive rows that are copied from an argument to scratch memory.

    Attributes:
        step: instructions that copy one row.
        rows: number of rows.
        buffer: pointer to the argument.
    """

    step: Step
    rows: int
    buffer: str


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


@dataclasses.dataclass(frozen=True)
class LoopCode:
    """A loop or a branch.

    Attributes:
        loop: loop of the graph.
        number: unique number for labels.
        counter: place of the number of the round in scratch memory, or None if no code reads it.
        test: code of the loop's test. The result of its last stretch is true if another round
            follows.
        body: code of a round.
        per_vector: whether the loop is a branch that each vector of a group takes separately.
        packed: slots that the loop reads and slots that it carries, or None if it is not packed.
    """

    loop: Loop
    number: int
    counter: int | None
    test: "Sequence[Item]"
    body: "Sequence[Item]"
    per_vector: bool = False
    packed: tuple[Sequence[Slot], Sequence[Slot]] | None = None


Item = Stretch | Copy | LoopCode


class Table(NamedTuple):
    """A table of constants.

    Attributes:
        name: name of the LLVM global.
        values: constants of the table.
        dtype: type of the constants.
    """

    name: str
    values: np.ndarray
    dtype: np.dtype


@dataclasses.dataclass(frozen=True)
class Code:
    """A program in which every value has a place.

    Attributes:
        arguments: arrays that the program reads.
        results: arrays that the program writes.
        variant: kind of machine code.
        items: code in order.
        tables: constants in memory.
        functions: functions that the code calls, by name.
        size: bytes of scratch memory of each vector.
        frame: bytes of memory that vectors share.
        grouped: whether several vectors run together, as a group
            (`evo_cpg.native.backend.packing`).
    """

    arguments: tuple[Buffer, ...]
    results: tuple[Buffer, ...]
    variant: Variant
    items: Sequence[Item]
    tables: Sequence[Table]
    functions: dict[str, str]
    size: int
    frame: int
    grouped: bool
