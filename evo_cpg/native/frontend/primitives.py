"""JAX primitives for programs for one individual.

| primitive | meaning | bound by |
|---|---|---|
| ``fused`` | a program that runs as native code for all individuals | `evo_cpg.native.fuse.fuse` |
| ``linear_map`` | a function that is linear in some arguments, and its transpose | `linear_map` |
| ``eliminate`` | the solution of symmetric equations | `evo_cpg.native.fuse.solve_symmetric` |
| ``unset`` | an array whose elements are set before they are read | `evo_cpg.native.fuse.unset` |
"""

import contextvars
import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from evo_cpg.native import jax_internals as internals
from evo_cpg.native.ldl import factorize, solve_factorized

Arrays = Sequence[jax.Array]

# Primitives of functions with derivative rules of their own. Loops within them need no derivative.
_OWN_RULES = {"custom_jvp_call", "custom_vjp_call"}

fused_p = internals.primitive("fused")  # `evo_cpg.native.native` implements it.
linear_map_p = internals.primitive("linear_map")
eliminate_p = internals.primitive("eliminate")
unset_p = internals.primitive("unset")

_tracing = contextvars.ContextVar("tracing", default=False)


def is_tracing() -> bool:
    """Return whether a program for one individual is being traced."""
    return _tracing.get()


def traced(function: Callable, *args: Any) -> tuple[ClosedJaxpr, Any]:
    """Return a function as a program for one individual, and the shapes of its result.

    Only the shapes of the arguments matter. Fused functions within it become its parts.
    """
    token = _tracing.set(True)
    try:
        return jax.make_jaxpr(function, return_shape=True)(*args)
    finally:
        _tracing.reset(token)


@dataclasses.dataclass(frozen=True, eq=False)
class Program:
    """A fused function as a program for one individual.

    Attributes:
        name: name of the function, for messages.
        jaxpr: JAX program of the function. Its constants are its first arguments.
        constants: values of the constants, or None for a traced constant, which is an argument.
        shared: number of traced constants, the first arguments, which all individuals share.
        tangents: numbers of tangents among the arguments and among the results, which come last.
            The other results do not depend on the tangents.
        forward: whether the program is differentiated in forward mode only.
    """

    name: str
    jaxpr: Jaxpr
    constants: tuple[np.ndarray | None, ...]
    shared: int
    tangents: tuple[int, int] = (0, 0)
    forward: bool = False

    @property
    def inputs(self) -> list[Any]:
        """Shapes and types of the arguments, shared arguments first."""
        count = len(self.constants)
        constants = zip(self.jaxpr.invars[:count], self.constants, strict=True)
        shared = [variable.aval for variable, own in constants if own is None]
        return [*shared, *(variable.aval for variable in self.jaxpr.invars[count:])]

    @property
    def outputs(self) -> list[Any]:
        """Shapes and types of the results for one individual."""
        return [atom.aval for atom in self.jaxpr.outvars]

    def __call__(self, *arrays: jax.Array) -> list[Any]:
        """Return the results for one individual, or for each along further last axes."""
        inputs = zip(arrays, self.inputs, strict=True)
        axes = [-1 if x.ndim > len(aval.shape) else None for x, aval in inputs]
        if any(axis is not None for axis in axes):
            return jax.vmap(self, axes, -1)(*arrays)
        given = iter(arrays[: self.shared])
        consts = [next(given) if own is None else own for own in self.constants]
        run = jaxpr_as_fun(ClosedJaxpr(self.jaxpr, []))
        return list(map(jnp.asarray, run(*consts, *arrays[self.shared :])))

    @functools.cached_property
    def in_forward_mode(self) -> "Program":
        """The same program, whose parts compute their results and tangents together.

        JAX cannot transpose such a program.
        """
        jaxpr = _in_forward_mode(self.jaxpr)
        return dataclasses.replace(self, jaxpr=jaxpr, forward=True)

    @functools.cached_property
    def primitives(self) -> frozenset[str]:
        """Names of the primitives with non-literal operands, those of inner programs included."""
        names: set[str] = set()
        for equation in equations(self.jaxpr, ()):
            if equation.primitive is fused_p:
                names |= equation.params["program"].primitives
            elif not all(isinstance(atom, Literal) for atom in equation.invars):
                names.add(equation.primitive.name)
        return frozenset(names)

    @functools.cached_property
    def searches(self) -> bool:
        """Return whether JAX differentiates the program forwards only.

        It has a loop with a condition, and no derivative rule of its own for it.
        """
        return any(
            equation.params["program"].searches
            if equation.primitive is fused_p
            else equation.primitive.name == "while"
            for equation in equations(self.jaxpr, _OWN_RULES)
        )

    @functools.cached_property
    def loops(self) -> bool:
        """Return whether the program has loops over parts, without their own derivative rule."""
        return any(
            equation.params["program"].loops
            if equation.primitive is fused_p
            else any(
                each.primitive is fused_p
                for inner in programs_in(equation)
                for each in equations(inner, _OWN_RULES)
            )
            for equation in equations(self.jaxpr, _OWN_RULES)
            if equation.primitive is fused_p or equation.primitive.name in ("scan", "while")
        )


def _in_forward_mode(x: Any) -> Any:
    """Replace the programs within a JAX program, or within a parameter of an equation."""
    if isinstance(x, Program):
        return x.in_forward_mode
    if isinstance(x, ClosedJaxpr):
        return ClosedJaxpr(_in_forward_mode(x.jaxpr), x.consts)
    if isinstance(x, Jaxpr):
        new = [
            each.replace(params={key: _in_forward_mode(p) for key, p in each.params.items()})
            for each in x.eqns
        ]
        return x.replace(eqns=new)
    return tuple(map(_in_forward_mode, x)) if type(x) is tuple else x


def equations(jaxpr: Jaxpr, closed: Iterable[str] = ()) -> Iterator[Any]:
    """Iterate over the equations of a program and of the programs within it.

    The programs within the ``closed`` primitives, given by name, are skipped.
    """
    for equation in jaxpr.eqns:
        yield equation
        if equation.primitive.name not in closed:
            for inner in programs_in(equation):
                yield from equations(inner, closed)


def programs_in(equation: Any) -> Iterator[Jaxpr]:
    """Iterate over the programs among the parameters of an equation."""
    for value in equation.params.values():
        for inner in value if isinstance(value, (tuple, list)) else (value,):
            inner = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
            if isinstance(inner, Jaxpr):
                yield inner


def mapped_axis(values: Arrays, axes: Sequence[int | None], to: int) -> tuple[int, list]:
    """Return the length of the mapped axis, and all values with this axis moved to ``to``."""
    size = next(x.shape[axis] for x, axis in zip(values, axes, strict=True) if axis is not None)
    return size, [
        jnp.moveaxis(jnp.broadcast_to(x, (size, *x.shape)), 0, to)
        if axis is None
        else jnp.moveaxis(x, axis, to)
        for x, axis in zip(values, axes, strict=True)
    ]


def linear_map(
    forward: Callable[[Arrays, Arrays], Arrays],
    backward: Callable[[Arrays, Arrays], Arrays],
    fixed: Arrays,
    x: Arrays,
    like: Sequence[Any],
) -> list[jax.Array]:
    """Return ``forward(fixed, x)``, with ``backward`` as its transpose.

    JAX transposes a linear program operation by operation, which a fused program does not allow.
    Only the requested direction is traced: a gradient does not trace ``forward``.

    Args:
        forward: function that is linear in its second argument.
        backward: transpose, from cotangents of the results to cotangents of ``x``.
        fixed: arrays that the map depends on.
        x: arrays that the map is applied to.
        like: arrays with the shapes and types of the results.
    """
    shapes = tuple((array.shape, array.dtype) for array in like)
    return linear_map_p.bind(
        *fixed, *x, forward=forward, backward=backward, shapes=shapes, count=len(fixed)
    )


def apply_map(*values, forward, backward, shapes, count):
    """Evaluate a ``linear_map`` with the given parameters."""
    del backward, shapes
    return list(forward(values[:count], values[count:]))


def _differentiate_map(primals, tangents, **params):
    results = linear_map_p.bind(*primals, **params)
    count = params["count"]
    if all(isinstance(tangent, internals.Zero) for tangent in tangents[:count]):
        x = [internals.instantiate_zeros(tangent) for tangent in tangents[count:]]
        return results, linear_map_p.bind(*primals[:count], *x, **params)
    # The fixed arrays change as well: a second derivative.
    tangents = [internals.instantiate_zeros(tangent) for tangent in tangents]
    return jax.jvp(functools.partial(apply_map, **params), list(primals), tangents)


def _transpose_map(cotangents, *values, forward, backward, shapes, count):
    del shapes
    cotangents = [internals.instantiate_zeros(cotangent) for cotangent in cotangents]
    like = [value.aval for value in values[count:]]
    found = linear_map(backward, forward, values[:count], cotangents, like)
    return [None] * count + found


def _batch_map(values, axes, *, forward, backward, shapes, count):
    # The fixed arrays are often the same for all tangents. Work on them alone is then done once.
    first = count if all(axis is None for axis in axes[:count]) else 0
    size, stacked = mapped_axis(values[first:], axes[first:], 0)
    how = (None, 0) if first else (0, 0)
    results = linear_map_p.bind(
        *values[:first],
        *stacked,
        forward=jax.vmap(forward, how),
        backward=jax.vmap(backward, how),
        shapes=tuple(((size, *shape), dtype) for shape, dtype in shapes),
        count=count,
    )
    return results, itertools.repeat(0, len(results))


internals.implement(
    linear_map_p,
    lambda *_, forward, backward, shapes, count: [
        jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in shapes
    ],
    apply_map,
    _differentiate_map,
    _batch_map,
    _transpose_map,
)


def solve_written_out(H: jax.Array, b: jax.Array) -> list[jax.Array]:
    """Return the solution of ``H x = b`` without a loop. Zero elements of H cost nothing."""
    return [solve_factorized(factorize(H), b)]


def _batch_solution(values, axes):
    """Move the mapped axis to the end, where the individuals are."""
    _, (H, b) = mapped_axis(values, axes, -1)
    return eliminate_p.bind(H, b), [b.ndim - 1]


internals.implement(
    eliminate_p,
    lambda H, b: [jax.ShapeDtypeStruct(b.shape, b.dtype)],
    solve_written_out,
    None,
    _batch_solution,
)


def _batch_unset(values, axes, *, shape):
    (like,), (axis,) = values, axes
    return unset_p.bind(like, shape=(like.shape[axis], *shape)), [0]


internals.implement(
    unset_p,
    lambda like, shape: [jax.ShapeDtypeStruct(shape, like.dtype)],
    lambda like, shape: [jnp.zeros(shape, like.dtype)],
    lambda primals, tangents, shape: (
        [zeros := jnp.zeros(shape, primals[0].dtype)],
        [internals.no_tangent(zeros)],
    ),
    _batch_unset,
)
