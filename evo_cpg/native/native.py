"""Evaluate fused programs by a call of machine code, or by plain JAX."""

import time
import weakref
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.native import engine
from evo_cpg.native import jax_internals as internals
from evo_cpg.native.backend.code import Variant
from evo_cpg.native.backend.machine import load
from evo_cpg.native.compile import to_llvm
from evo_cpg.native.frontend.derivatives import batch_again, differentiate
from evo_cpg.native.frontend.primitives import Program, fused_p, plain
from evo_cpg.native.stopwatch import Made, counted, record


class Native(NamedTuple):
    """Machine code of a program.

    Attributes:
        name: name of the handler in XLA.
        scratch: bytes of working memory.
        width: number of individuals in a vector, and so the minimum number of individuals in a
            call.
    """

    name: str
    scratch: int
    width: int


# Bytes of a float32.
_SINGLE = 4

_codes: "weakref.WeakKeyDictionary[Program, dict]" = weakref.WeakKeyDictionary()


def evaluate(*arrays: jax.Array, program: Program, batch: tuple[int, ...]) -> list[jax.Array]:
    """Return the results of a program for all individuals.

    Args:
        arrays: shared arguments, then the other arguments with trailing batch axes.
        program: program for one individual.
        batch: lengths of the batch axes.
    """
    count = int(np.prod(batch, dtype=int))
    outputs = program.outputs
    if not count or not any(aval.size for aval in outputs):
        return [jnp.zeros((*aval.shape, *batch), aval.dtype) for aval in outputs]
    try:
        native = _native(program, count)
    except Exception as error:
        engine.warn_of_fallback(program.name, error)
        return plain(program, batch)(*arrays)
    # A vector must be full: copies of the last individual fill the remaining lanes.
    lanes = max(count, native.width)
    rows = [int(np.prod(aval.shape, dtype=int)) for aval in outputs]
    shapes = [
        jax.ShapeDtypeStruct((size, lanes), aval.dtype)
        for size, aval in zip(rows, outputs, strict=True)
        if size
    ]
    room = jax.ShapeDtypeStruct((max(native.scratch, 1),), np.uint8)
    given = [
        x.reshape(-1) if i < program.shared else _filled(x.reshape(-1, count), lanes)
        for i, x in enumerate(arrays)
        if x.size
    ]
    *found, _ = jax.ffi.ffi_call(native.name, (*shapes, room))(*given)
    results = iter(x[:, :count] if lanes > count else x for x in found)
    return [
        (next(results) if size else jnp.zeros(0, aval.dtype)).reshape(*aval.shape, *batch)
        for size, aval in zip(rows, outputs, strict=True)
    ]


def _filled(x: jax.Array, lanes: int) -> jax.Array:
    """Return rows of ``lanes`` numbers, padded with copies of their last number."""
    missing = lanes - x.shape[1]
    return jnp.pad(x, ((0, 0), (0, missing)), mode="edge") if missing else x


def _native(program: Program, count: int) -> Native:
    """Return machine code for ``count`` individuals, compiled at the first call."""
    target = engine.target()
    codes = _codes.setdefault(program, {})
    kinds = [np.dtype(x.dtype) for x in (*program.inputs, *program.outputs)]
    widest = max([kind.itemsize for kind in kinds if kind.kind == "f"], default=_SINGLE)
    width = 1 if count == 1 else target.bytes // widest
    variant = Variant(target, width)
    if variant not in codes:
        with counted():
            codes[variant] = _make(program, variant)
    return codes[variant]


def _make(program: Program, variant: Variant) -> Native:
    start = time.perf_counter()
    module = to_llvm(program, variant)
    engine.warn_of_size(module.operations)
    middle = time.perf_counter()
    name, address = load(module.text, variant.target)
    taken = middle - start, time.perf_counter() - middle
    record(Made(program.name, module.operations, *taken, module.scratch))
    return Native(engine.register(name, address), module.scratch, variant.width)


def shapes_of(*_: Any, program: Program, batch: tuple[int, ...]) -> list[jax.ShapeDtypeStruct]:
    """Return the shapes of the results of a program for all individuals."""
    return [jax.ShapeDtypeStruct((*x.shape, *batch), x.dtype) for x in program.outputs]


internals.implement(fused_p, shapes_of, evaluate, differentiate, batch_again)
