"""Fused programs as native code: from a program to a call of machine code, or to plain JAX."""

import time
import weakref
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.fusion import engine
from evo_cpg.fusion.backend.emit import Buffer, Code, Variant, emit
from evo_cpg.fusion.backend.handler import handler
from evo_cpg.fusion.backend.machine import Target, load
from evo_cpg.fusion.frontend.lower import trace_program
from evo_cpg.fusion.frontend.primitives import RULES, Program, plain
from evo_cpg.fusion.ir.graph import Graph
from evo_cpg.fusion.stopwatch import counted


class Native(NamedTuple):
    """Machine code of a program.

    Attributes:
        name: under which XLA finds it.
        scratch: bytes of memory that it works in.
    """

    name: str
    scratch: int


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


# Bytes of a float32.
_SINGLE = 4

# Whether JAX computes what code cannot be made for; not in the self-test.
FALLS_BACK = True

# All programs that became machine code in this process, in order.
made: list[Made] = []

_codes: "weakref.WeakKeyDictionary[Program, dict]" = weakref.WeakKeyDictionary()


def evaluate(*arrays: jax.Array, program: Program, batch: tuple[int, ...]) -> list[jax.Array]:
    """The results of a program for all individuals.

    Args:
        arrays: what it shares, and its arguments with the batch axes behind.
        program: for one individual.
        batch: lengths of the batch axes.
    """
    count = int(np.prod(batch, dtype=int))
    outputs = program.outputs
    if not count or not any(aval.size for aval in outputs):
        return [jnp.zeros((*aval.shape, *batch), aval.dtype) for aval in outputs]
    try:
        native = _native(program, count)
    except Exception as error:
        if not FALLS_BACK:
            raise
        engine.warn_of_fallback(program.name, error)
        return plain(program, batch)(*arrays)
    rows = [int(np.prod(aval.shape, dtype=int)) for aval in outputs]
    shapes = [
        jax.ShapeDtypeStruct((size, count), aval.dtype)
        for size, aval in zip(rows, outputs, strict=True)
        if size
    ]
    room = jax.ShapeDtypeStruct((max(native.scratch, 1),), np.uint8)
    given = [
        x.reshape(-1) if i < program.shared else x.reshape(-1, count)
        for i, x in enumerate(arrays)
        if x.size
    ]
    *found, _ = jax.ffi.ffi_call(native.name, (*shapes, room))(*given)
    results = iter(found)
    return [
        (next(results) if size else jnp.zeros(0, aval.dtype)).reshape(*aval.shape, *batch)
        for size, aval in zip(rows, outputs, strict=True)
    ]


def _native(program: Program, count: int) -> Native:
    """Machine code for so many individuals, made at the first call."""
    target = engine.target()
    codes = _codes.setdefault(program, {})
    kinds = [np.dtype(x.dtype) for x in (*program.inputs, *program.outputs)]
    widest = max([kind.itemsize for kind in kinds if kind.kind == "f"], default=_SINGLE)
    width = 1 if count == 1 else target.bytes // widest
    key = target, width, count < width
    if key not in codes:
        variant = Variant(width, count < width, target.fma, target.registers, target.compresses)
        with counted():
            codes[key] = _make(program, target, variant)
    return codes[key]


def _make(program: Program, target: Target, variant: Variant) -> Native:
    start = time.perf_counter()
    code = written(program, target, variant)
    middle = time.perf_counter()
    name, address = load(code.text, target)
    taken = middle - start, time.perf_counter() - middle
    made.append(Made(program.name, code.operations, *taken, code.scratch))
    return Native(engine.register(name, address), code.scratch)


def written(program: Program, target: Target, variant: Variant) -> Code:
    """LLVM IR of a program's code and of the entry into it.

    Args:
        program: for one individual.
        target: the machine.
        variant: the kind of code.

    Raises:
        Unsupported: there is no rule for a part of it, or it is too large.
    """
    graph, inputs, arguments = Graph(), [], []
    for i, x in enumerate(program.inputs):
        shared, dtype = i < program.shared, np.dtype(x.dtype)
        nodes = np.empty(x.size, object)
        nodes[:] = [graph.input((len(arguments), row), dtype, shared) for row in range(x.size)]
        inputs.append(nodes.reshape(x.shape))
        if x.size:
            arguments.append(Buffer(x.size, dtype, shared))
    found = trace_program(graph, program, inputs)
    results = [
        (Buffer(nodes.size, np.dtype(x.dtype)), list(nodes.flat))
        for x, nodes in zip(program.outputs, found, strict=True)
        if nodes.size
    ]
    code = emit(arguments, results, graph.top, variant)
    entry = handler("handler", arguments, [buffer for buffer, _ in results], code.scratch, variant)
    vector = (
        f'"prefer-vector-width"="{8 * target.bytes}" "min-legal-vector-width"="{8 * target.bytes}"'
    )
    text = f"{code.text}\n{entry}\nattributes #0 = {{ nounwind {vector} }}\n"
    return code._replace(text=text)


RULES["evaluate"] = evaluate
