"""What fused programs are to JAX, and what they may hold besides its own operations.

| primitive | what it stands for |
|---|---|
| ``fused`` | a program that is computed in few large kernels |
| ``array_call`` | a function of whole arrays that the trace leaves as it is |
| ``side_by_side`` | an array whose last axis is to become lanes |
| ``linear_map`` | a function that is linear in some arguments, and its transpose |

See `evo_cpg.fusion.kernels` for the functions that bind them.
"""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import core
from jax.extend.core import Jaxpr, Primitive
from jax.interpreters import ad, batching, mlir


@dataclasses.dataclass(frozen=True, eq=False)
class Program:
    """What a fused function does for one individual.

    Attributes:
        jaxpr: of the function.
        constants: of the jaxpr; None for those that are arguments, because they are traced.
        shared: how many arguments come first that all individuals share, in place of these.
    """

    jaxpr: Jaxpr
    constants: tuple[np.ndarray | None, ...]
    shared: int

    def __call__(self, *arrays: jax.Array) -> list[Any]:
        """The results for one individual; of NumPy where they are constants."""
        given = iter(arrays[: self.shared])
        consts = [next(given) if own is None else own for own in self.constants]
        return core.eval_jaxpr(self.jaxpr, consts, *arrays[self.shared :])


fused_p = Primitive("fused")
fused_p.multiple_results = True


@fused_p.def_abstract_eval
def _(*_, program, batch):
    outputs = [atom.aval for atom in program.jaxpr.outvars]
    return [core.ShapedArray((*aval.shape, *batch), aval.dtype) for aval in outputs]


array_call_p = Primitive("array_call")
array_call_p.multiple_results = True


@array_call_p.def_abstract_eval
def _(*inputs, function):
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in inputs]
    return [core.ShapedArray(x.shape, x.dtype) for x in jax.eval_shape(function, *shapes)]


def _differentiate_call(primals, tangents, *, function):
    """Forwards and backwards it is again a function of whole arrays."""
    moving = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, ad.Zero)]

    def of_moving(values):
        def call(*some):
            every = list(values)
            for i, value in zip(moving, some, strict=True):
                every[i] = value
            return function(*every)

        return call, [values[i] for i in moving]

    def forward(*values):
        call, some = of_moving(values[: len(primals)])
        return tuple(jax.jvp(call, some, list(values[len(primals) :]))[1])

    def backward(*values):
        call, some = of_moving(values[: len(primals)])
        return tuple(jax.vjp(call, *some)[1](tuple(values[len(primals) :])))

    results = array_call_p.bind(*primals, function=function)
    changes = linear_map(
        lambda fixed, x: array_call_p.bind(*fixed, *x, function=forward),
        lambda fixed, x: array_call_p.bind(*fixed, *x, function=backward),
        primals,
        [tangents[i] for i in moving],
        results,
    )
    return results, changes


ad.primitive_jvps[array_call_p] = _differentiate_call

side_by_side_p = Primitive("side_by_side")
side_by_side_p.def_impl(lambda x: x)
side_by_side_p.def_abstract_eval(lambda x: core.ShapedArray(x.shape, x.dtype))
ad.deflinear2(side_by_side_p, lambda cotangent, _: [side_by_side_p.bind(cotangent)])
batching.primitive_batchers[side_by_side_p] = lambda xs, axes: (xs[0], axes[0])
mlir.register_lowering(side_by_side_p, lambda _, x: [x])

# Arrays whose slopes are to be computed together; see `evo_cpg.fusion.kernels.gathered`.
gathered_p = Primitive("gathered")
gathered_p.multiple_results = True
gathered_p.def_impl(lambda *x: list(x))
gathered_p.def_abstract_eval(lambda *x: [core.ShapedArray(each.shape, each.dtype) for each in x])


def _differentiate_gathered(primals, tangents):
    changes = [ad.instantiate_zeros(tangent) for tangent in tangents]
    return gathered_p.bind(*primals), gathered_p.bind(*changes)


ad.primitive_jvps[gathered_p] = _differentiate_gathered
ad.primitive_transposes[gathered_p] = lambda cotangents, *_: jax.lax.optimization_barrier(
    [ad.instantiate_zeros(cotangent) for cotangent in cotangents]
)

linear_map_p = Primitive("linear_map")
linear_map_p.multiple_results = True

Arrays = Sequence[jax.Array]


def linear_map(
    forward: Callable[[Arrays, Arrays], Arrays],
    backward: Callable[[Arrays, Arrays], Arrays],
    fixed: Arrays,
    x: Arrays,
    like: Sequence[Any],
) -> list[jax.Array]:
    """``forward(fixed, x)``, whose transpose is known.

    JAX transposes a linear program operation by operation, which a fused one does not allow, and
    only what is asked for is traced: a gradient never looks at ``forward``.

    Args:
        forward: linear in its second argument.
        backward: its transpose, from changes of the results to those of ``x``.
        fixed: what the map depends on.
        x: what it is applied to.
        like: of the shapes and types of the results.
    """
    shapes = tuple((array.shape, array.dtype) for array in like)
    return linear_map_p.bind(
        *fixed, *x, forward=forward, backward=backward, shapes=shapes, count=len(fixed)
    )


@linear_map_p.def_abstract_eval
def _(*_, forward, backward, shapes, count):
    return [core.ShapedArray(shape, dtype) for shape, dtype in shapes]


@linear_map_p.def_impl
def _apply(*values, forward, backward, shapes, count):
    return list(forward(values[:count], values[count:]))


def _differentiate_map(primals, tangents, **params):
    results = linear_map_p.bind(*primals, **params)
    count = params["count"]
    if all(isinstance(tangent, ad.Zero) for tangent in tangents[:count]):
        x = [ad.instantiate_zeros(tangent) for tangent in tangents[count:]]
        return results, linear_map_p.bind(*primals[:count], *x, **params)
    # What the map depends on changes as well: a second derivative.
    tangents = [ad.instantiate_zeros(tangent) for tangent in tangents]
    return jax.jvp(lambda *values: _apply(*values, **params), list(primals), tangents)


ad.primitive_jvps[linear_map_p] = _differentiate_map


def _transpose_map(cotangents, *values, forward, backward, shapes, count):
    del shapes
    cotangents = [ad.instantiate_zeros(cotangent) for cotangent in cotangents]
    like = [value.aval for value in values[count:]]
    found = linear_map(backward, forward, values[:count], cotangents, like)
    return [None] * count + found


ad.primitive_transposes[linear_map_p] = _transpose_map


def _batch_map(values, axes, *, forward, backward, shapes, count):
    size = next(
        value.shape[axis] for value, axis in zip(values, axes, strict=True) if axis is not None
    )
    stacked = [
        jnp.broadcast_to(value, (size, *value.shape))
        if axis is None
        else jnp.moveaxis(value, axis, 0)
        for value, axis in zip(values, axes, strict=True)
    ]
    results = linear_map_p.bind(
        *stacked,
        forward=jax.vmap(forward),
        backward=jax.vmap(backward),
        shapes=tuple(((size, *shape), dtype) for shape, dtype in shapes),
        count=count,
    )
    return results, itertools.repeat(0, len(results))


batching.primitive_batchers[linear_map_p] = _batch_map
mlir.register_lowering(linear_map_p, mlir.lower_fun(_apply, multiple_results=True))


def trace_of(params: dict[str, Any], inputs: Sequence[core.AbstractValue]) -> Any:
    """The program of a ``linear_map`` with the given parameters."""
    return jax.make_jaxpr(lambda *values: _apply(*values, **params))(*inputs)
