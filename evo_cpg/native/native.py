"""The primitive ``fused``: machine code evaluates it, JAX differentiates and maps it.

A derivative of a fused program is a fused program itself. JAX differentiates the program for one
individual, in forward or reverse mode. The derivative is a program for one individual too, and is
compiled like any other program. For a gradient only the arguments of each program are stored. The
backward pass computes the program again from them, in registers.
"""

import functools
import time
import weakref
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.native import engine, machine_constants
from evo_cpg.native import jax_internals as internals
from evo_cpg.native.backend.code import Variant
from evo_cpg.native.backend.machine import load
from evo_cpg.native.compile import to_llvm
from evo_cpg.native.frontend.primitives import Arrays, Program, fused_p, linear_map, plain
from evo_cpg.native.fuse import fuse
from evo_cpg.native.stopwatch import Made, counted


class Native(NamedTuple):
    """Machine code of a program.

    Attributes:
        name: name of the handler in XLA.
        scratch: bytes of working memory.
        width: number of individuals in a vector, the least number of individuals in a call.
    """

    name: str
    scratch: int
    width: int


_codes: "weakref.WeakKeyDictionary[Program, dict]" = weakref.WeakKeyDictionary()


def evaluate(*arrays: jax.Array, program: Program, batch: tuple[int, ...]) -> list[jax.Array]:
    """Return the results of a program for all individuals.

    The arrays are the shared arguments, then the other arguments with trailing batch axes.
    """
    count = int(np.prod(batch, dtype=int))
    outputs = program.outputs
    if not count or not any(aval.size for aval in outputs):
        return [jnp.zeros((*aval.shape, *batch), aval.dtype) for aval in outputs]
    try:
        # The code is compiled at the first call.
        target = engine.target()
        codes = _codes.setdefault(program, {})
        kinds = [np.dtype(x.dtype) for x in (*program.inputs, *program.outputs)]
        widest = max([kind.itemsize for kind in kinds if kind.kind == "f"], default=4)
        width = 1 if count == 1 else target.bytes // widest
        variant = Variant(target, width)
        if variant not in codes:
            with counted() as spent:
                start = time.perf_counter()
                module = to_llvm(program, variant)
                if module.operations > machine_constants.MANY_OPERATIONS:
                    # LLVM takes a minute or more.
                    most = f"{machine_constants.MANY_OPERATIONS:,}"
                    engine.warn_once(
                        f"A program has more than {most} operations, so it takes long to compile. "
                        "Fewer bodies, contacts or points of drag make it smaller"
                    )
                middle = time.perf_counter()
                name, address = load(module.text, target)
                taken = middle - start, time.perf_counter() - middle
                if spent is not None:
                    made = Made(program.name, module.operations, *taken, module.scratch)
                    spent.programs.append(made)
                codes[variant] = Native(engine.register(name, address), module.scratch, width)
        native = codes[variant]
    except Exception as error:
        engine.warn_of_fallback(program.name, error)
        return plain(program, batch)(*arrays)
    # A vector must be full: copies of the last individual fill the remaining lanes.
    lanes = max(count, native.width)
    given = [
        x.reshape(-1) if i < program.shared else x.reshape(-1, count)
        for i, x in enumerate(arrays)
        if x.size
    ]
    if lanes > count:
        filling = (0, 0), (0, lanes - count)
        given = [jnp.pad(x, filling, mode="edge") if x.ndim > 1 else x for x in given]
    rows = [int(np.prod(aval.shape, dtype=int)) for aval in outputs]
    shapes = [
        jax.ShapeDtypeStruct((size, lanes), aval.dtype)
        for size, aval in zip(rows, outputs, strict=True)
        if size
    ]
    room = jax.ShapeDtypeStruct((max(native.scratch, 1),), np.uint8)
    *found, _ = jax.ffi.ffi_call(native.name, (*shapes, room))(*given)
    results = iter(x[:, :count] if lanes > count else x for x in found)
    return [
        (next(results) if size else jnp.zeros(0, aval.dtype)).reshape(*aval.shape, *batch)
        for size, aval in zip(rows, outputs, strict=True)
    ]


def differentiate(
    primals: Arrays, tangents: Sequence[Any], *, program: Program, batch: tuple[int, ...]
) -> tuple[list[jax.Array], list[Any]]:
    """Return the results of a program and their tangents, symbolic zeros for integer results."""
    if program.loops:
        # JAX differentiates the whole program as plain JAX, because it has a loop. Programs within
        # the program stay fused.
        changes = [internals.instantiate_zeros(tangent) for tangent in tangents]
        results, changes = jax.jvp(plain(program, batch), list(primals), changes)
        return results, changes
    results = fused_p.bind(*primals, program=program, batch=batch)
    moving = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, internals.Zero)]
    smooth = [i for i, x in enumerate(results) if jnp.issubdtype(x.dtype, jnp.floating)]
    ndim, name = len(batch), f"the derivative of {program.name}"

    def derived(derivative: Callable[..., tuple], values: Arrays, x: Arrays) -> tuple:
        """Return a derivative of the program, mapped over any number of trailing batch axes.

        The derivative gets the program as a function from the differentiated inputs to the float
        results, the values of these inputs, and their tangents or the results' cotangents.
        """
        if values[0].ndim > len(program.inputs[0].shape):
            each = functools.partial(derived, derivative)
            return jax.vmap(each, in_axes=-1, out_axes=-1)(values, x)

        def run(*some: jax.Array) -> tuple:
            every = list(values)
            for i, value in zip(moving, some, strict=True):
                every[i] = value
            outputs = program(*every)
            return tuple(outputs[i] for i in smooth)

        return derivative(run, [values[i] for i in moving], x)

    push = functools.partial(derived, lambda run, some, x: jax.jvp(run, some, x)[1])
    pull = functools.partial(derived, lambda run, some, x: jax.vjp(run, *some)[1](tuple(x)))

    def forward(fixed: Arrays, x: Arrays) -> tuple:
        every = _for_all(fixed, range(len(fixed)), program, batch)
        changes = _for_all(x, moving, program, batch)
        return fuse(push, every, changes, batch_ndim=ndim, name=name)

    def backward(fixed: Arrays, x: Arrays) -> list[jax.Array]:
        every = _for_all(fixed, range(len(fixed)), program, batch)
        found = fuse(pull, every, list(x), batch_ndim=ndim, name=name)
        own = tuple(range(-ndim, 0))
        return [x.sum(own) if i < program.shared else x for i, x in zip(moving, found, strict=True)]

    like = [results[i] for i in smooth]
    changes = linear_map(forward, backward, primals, [tangents[i] for i in moving], like)
    known = dict(zip(smooth, changes, strict=True))
    return results, [
        known[i] if i in known else internals.no_tangent(x) for i, x in enumerate(results)
    ]


def _for_all(
    values: Arrays, numbers: Iterable[int], program: Program, batch: tuple[int, ...]
) -> list[jax.Array]:
    """Return arguments of a program, given by their numbers, with the batch axes on all."""
    return [
        jnp.broadcast_to(x.reshape(*x.shape, *(1,) * len(batch)), (*x.shape, *batch))
        if i < program.shared
        else x
        for i, x in zip(numbers, values, strict=True)
    ]


def batch_again(
    values: Arrays, axes: Sequence[int | None], *, program: Program, batch: tuple[int, ...]
) -> tuple[list[jax.Array], list[int]]:
    """Map a program over one more batch axis, which becomes the last."""
    size = next(x.shape[axis] for x, axis in zip(values, axes, strict=True) if axis is not None)
    every = []
    for i, (x, axis) in enumerate(zip(values, axes, strict=True)):
        x = x[..., None] if axis is None else jnp.moveaxis(x, axis, -1)
        own = x.shape[:-1]
        if i < program.shared:
            x = x.reshape(*own, *(1,) * len(batch), x.shape[-1])
            own = *own, *batch
        every.append(jnp.broadcast_to(x, (*own, size)))
    results = fuse(
        lambda *x: tuple(program(*x)), *every, batch_ndim=len(batch) + 1, name=program.name
    )
    return list(results), [x.ndim - 1 for x in results]


internals.implement(
    fused_p,
    lambda *_, program, batch: [
        jax.ShapeDtypeStruct((*x.shape, *batch), x.dtype) for x in program.outputs
    ],
    evaluate,
    differentiate,
    batch_again,
)
