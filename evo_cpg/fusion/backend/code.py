"""Allocated programs: LLVM instructions by name, places in memory, loops; everything but the text.

| type | what it is |
|---|---|
| `Template` | the instructions for one operation, with gaps for its operands |
| `Step` | a template with operands |
| `Stretch` | code without branches, which becomes a function |
| `Copy` | rows of an argument that are brought close together |
| `LoopCode` | a loop or a branch over stretches |
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evo_cpg.fusion.ir.graph import Buffer, Loop


class Target(NamedTuple):
    """The machine that code is made for.

    Attributes:
        name: of its set of instructions.
        bytes: of a vector.
        registers: for vectors.
        fma: whether it multiplies and adds in one instruction.
        compresses: whether one closes up the chosen numbers of a vector.
        processor: LLVM's name of it.
        features: LLVM's list of what it has.
    """

    name: str
    bytes: int
    registers: int
    fma: bool
    compresses: bool
    processor: str
    features: str


class Variant(NamedTuple):
    """The kind of machine code.

    Attributes:
        target: the machine that it is for.
        width: individuals in a vector.
    """

    target: Target
    width: int


class Template(NamedTuple):
    """Instructions with gaps: ``{0}`` and on for operands, then one for each new name.

    Attributes:
        text: lines of LLVM IR.
        lines: how many.
        names: how many values the lines name.
        result: number of the result among the new names, from 1; 0 for the first operand.
    """

    text: str
    lines: int
    names: int
    result: int


class Step(NamedTuple):
    """A template with operands.

    Attributes:
        template: the instructions.
        operands: names of values, constants, places.
        first: number of the first new name.
    """

    template: Template
    operands: tuple[str | int, ...]
    first: int


class Piece(NamedTuple):
    """A part of a stretch that is short enough for a function.

    Attributes:
        steps: in order.
        buffers: pointers that it needs besides scratch memory.
    """

    steps: Sequence[Step]
    buffers: tuple[str, ...]


class Stretch(NamedTuple):
    """Code without branches.

    Attributes:
        pieces: one, or several that take turns.
        result: name of its result, if it has one.
        kind: LLVM's type of that.
    """

    pieces: Sequence[Piece]
    result: str = ""
    kind: str = "void"


class Copy(NamedTuple):
    """Rows that lie one behind the other, brought from an argument to scratch memory.

    Attributes:
        step: what is done for each row.
        rows: how many.
        buffer: pointer to the argument.
    """

    step: Step
    rows: int
    buffer: str


class Slot(NamedTuple):
    """A place in scratch memory.

    Attributes:
        start: bytes.
        size: bytes of one individual's number.
        shared: one number for all individuals.
    """

    start: int
    size: int
    shared: bool = False


@dataclasses.dataclass(frozen=True)
class LoopCode:
    """A loop or a branch.

    Attributes:
        loop: what it is.
        number: a number of its own, for labels.
        counter: place of the number of the round; None if it is not read.
        test: code that ends with a stretch whose result says whether there is another round.
        body: code of a round.
        per_vector: a branch that each vector of a group takes by itself.
        packed: places that the loop reads and that it carries, if its individuals are packed.
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
        name: of the global.
        values: what it holds.
        dtype: their type.
    """

    name: str
    values: np.ndarray
    dtype: np.dtype


@dataclasses.dataclass(frozen=True)
class Code:
    """A program whose values have their places.

    Attributes:
        arguments: what it reads.
        results: what it writes.
        variant: what it is made for.
        items: in order.
        tables: constants in memory.
        functions: those that are called, by name.
        size: bytes of scratch memory for a vector.
        frame: bytes of memory that vectors share.
        grouped: whether several vectors run together.
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
