"""Derivatives of fused programs, which are fused programs themselves.

JAX differentiates the program for one individual, in forward or reverse mode. The derivative is a
program for one individual too, and is compiled like any other program. For a gradient only the
arguments of each program are stored. The backward pass computes the program again from them, in
registers.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from evo_cpg.native import jax_internals as internals
from evo_cpg.native.frontend.primitives import Program, fused_p, linear_map, plain
from evo_cpg.native.fuse import fuse


def differentiate(
    primals: Sequence[jax.Array],
    tangents: Sequence[Any],
    *,
    program: Program,
    batch: tuple[int, ...],
) -> tuple[list[jax.Array], list[Any]]:
    """Return the results of a program and their tangents, symbolic zeros for integer results."""
    if program.loops:
        # JAX differentiates the loop as plain JAX. Programs within the loop stay fused.
        changes = [internals.instantiate_zeros(tangent) for tangent in tangents]
        results, changes = jax.jvp(plain(program, batch), list(primals), changes)
        return results, changes
    results = fused_p.bind(*primals, program=program, batch=batch)
    moving = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, internals.Zero)]
    smooth = [i for i, x in enumerate(results) if jnp.issubdtype(x.dtype, jnp.floating)]
    ndim, name = len(batch), f"the derivative of {program.name}"

    def one(values: Sequence[jax.Array]) -> tuple:
        """Return a function for one individual, and its arguments.

        The function computes the float results of the program from the differentiated inputs. Its
        arguments are the values of these inputs.

        Args:
            values: values of all inputs.
        """

        def run(*some: jax.Array) -> tuple:
            every = list(values)
            for i, value in zip(moving, some, strict=True):
                every[i] = value
            outputs = program(*every)
            return tuple(outputs[i] for i in smooth)

        return run, [values[i] for i in moving]

    def each(function: Callable) -> Callable:
        """Map a function over any number of trailing batch axes."""

        def run(values: list[jax.Array], x: list[jax.Array]) -> tuple:
            mapped = function
            for _ in range(values[0].ndim - len(program.inputs[0].shape)):
                mapped = jax.vmap(mapped, in_axes=-1, out_axes=-1)
            return mapped(values, x)

        return run

    @each
    def push(values: list[jax.Array], x: list[jax.Array]) -> tuple:
        run, some = one(values)
        return jax.jvp(run, some, x)[1]

    @each
    def pull(values: list[jax.Array], x: list[jax.Array]) -> tuple:
        run, some = one(values)
        return jax.vjp(run, *some)[1](tuple(x))

    def forward(fixed: Sequence[jax.Array], x: Sequence[jax.Array]) -> tuple:
        every = _for_all(fixed, range(len(fixed)), program, batch)
        changes = _for_all(x, moving, program, batch)
        return fuse(push, every, changes, batch_ndim=ndim, name=name)

    def backward(fixed: Sequence[jax.Array], x: Sequence[jax.Array]) -> list[jax.Array]:
        every = _for_all(fixed, range(len(fixed)), program, batch)
        found = fuse(pull, every, list(x), batch_ndim=ndim, name=name)
        own = tuple(range(-ndim, 0))
        return [x.sum(own) if i < program.shared else x for i, x in zip(moving, found, strict=True)]

    changes = iter(
        linear_map(
            forward,
            backward,
            primals,
            [tangents[i] for i in moving],
            [results[i] for i in smooth],
        )
    )
    return results, [
        next(changes) if i in smooth else internals.no_tangent(x) for i, x in enumerate(results)
    ]


def _for_all(
    values: Sequence[jax.Array], numbers: Iterable[int], program: Program, batch: tuple[int, ...]
) -> list[jax.Array]:
    """Return the values, with shared values broadcast to the batch axes.

    Args:
        values: arrays.
        numbers: index of the program's argument that each array belongs to.
        program: program for one individual.
        batch: lengths of the batch axes.
    """
    return [
        jnp.broadcast_to(x.reshape(*x.shape, *(1,) * len(batch)), (*x.shape, *batch))
        if i < program.shared
        else x
        for i, x in zip(numbers, values, strict=True)
    ]


def batch_again(
    values: Sequence[jax.Array],
    axes: Sequence[int | None],
    *,
    program: Program,
    batch: tuple[int, ...],
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
