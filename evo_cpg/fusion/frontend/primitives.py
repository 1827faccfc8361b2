"""What programs for one individual are to JAX.

| primitive | what it stands for |
|---|---|
| ``fused`` | a program that runs as native code for all individuals |
| ``linear_map`` | a function that is linear in some arguments, and its transpose |

See `evo_cpg.fusion.fuse` for the function that binds them.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from evo_cpg.fusion import jax_internals as internals

Arrays = Sequence[jax.Array]

# Rules that are given with a function, so that its loops need none.
_OWN_RULES = {"custom_jvp_call", "custom_vjp_call"}
_LOOPS = {"scan", "while"}

fused_p = internals.primitive("fused")  # `evo_cpg.fusion.native` implements it.
linear_map_p = internals.primitive("linear_map")


@dataclasses.dataclass(frozen=True, eq=False)
class Program:
    """What a fused function does for one individual.

    Attributes:
        name: of the function, for messages.
        jaxpr: of the function; its constants are its first arguments.
        constants: their values; None for those that are arguments, because they are traced.
        shared: how many arguments come first that all individuals share, in place of these.
    """

    name: str
    jaxpr: Jaxpr
    constants: tuple[np.ndarray | None, ...]
    shared: int

    @property
    def inputs(self) -> list[Any]:
        """Shapes and types of the arguments, what is shared first."""
        count = len(self.constants)
        constants = zip(self.jaxpr.invars[:count], self.constants, strict=True)
        shared = [variable.aval for variable, own in constants if own is None]
        return [*shared, *(variable.aval for variable in self.jaxpr.invars[count:])]

    @property
    def outputs(self) -> list[Any]:
        """Shapes and types of the results for one individual."""
        return [atom.aval for atom in self.jaxpr.outvars]

    def __call__(self, *arrays: jax.Array) -> list[Any]:
        """The results for one individual; of NumPy where they are constants."""
        given = iter(arrays[: self.shared])
        consts = [next(given) if own is None else own for own in self.constants]
        return internals.run(ClosedJaxpr(self.jaxpr, []), [*consts, *arrays[self.shared :]])

    @functools.cached_property
    def primitives(self) -> frozenset[str]:
        """Names of the primitives that do something in it and in programs within it."""
        names: set[str] = set()
        for equation in equations(self.jaxpr, ()):
            if equation.primitive is fused_p:
                names |= equation.params["program"].primitives
            elif not all(isinstance(atom, Literal) for atom in equation.invars):
                names.add(equation.primitive.name)
        return frozenset(names)

    @functools.cached_property
    def loops(self) -> bool:
        """Whether there are loops in it that bring no derivative of their own."""
        return any(
            equation.params["program"].loops
            if equation.primitive is fused_p
            else equation.primitive.name in _LOOPS
            for equation in equations(self.jaxpr, _OWN_RULES)
        )


def equations(jaxpr: Jaxpr, closed: Iterable[str] = ()) -> Iterator[Any]:
    """Walk through the equations of a program and of the programs within it.

    Args:
        jaxpr: the program.
        closed: primitives whose programs are left out.
    """
    for equation in jaxpr.eqns:
        yield equation
        if equation.primitive.name not in closed:
            for inner in programs_in(equation):
                yield from equations(inner, closed)


def programs_in(equation: Any) -> Iterator[Jaxpr]:
    """Walk through the programs among the parameters of an equation."""
    for value in equation.params.values():
        for inner in value if isinstance(value, (tuple, list)) else (value,):
            inner = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
            if isinstance(inner, Jaxpr):
                yield inner


def plain(program: Program, batch: tuple[int, ...]) -> Callable[..., list[jax.Array]]:
    """The program for all individuals, as JAX itself computes it.

    Args:
        program: for one.
        batch: lengths of the trailing batch axes of its own arguments and of its results.
    """

    def one(*arrays: jax.Array) -> tuple[jax.Array, ...]:
        return tuple(map(jnp.asarray, program(*arrays)))

    def run(*arrays: jax.Array) -> list[jax.Array]:
        if not batch:
            return list(one(*arrays))
        shared, count = program.shared, int(np.prod(batch, dtype=int))
        axes = [None] * shared + [-1] * (len(arrays) - shared)
        own = [x.reshape(*x.shape[: x.ndim - len(batch)], count) for x in arrays[shared:]]
        every = jax.vmap(one, in_axes=axes, out_axes=-1, axis_size=count)
        results = every(*arrays[:shared], *own)
        return [x.reshape(*x.shape[:-1], *batch) for x in results]

    return run


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


def _apply_map(*values, forward, backward, shapes, count):
    del backward, shapes
    return list(forward(values[:count], values[count:]))


def _differentiate_map(primals, tangents, **params):
    results = linear_map_p.bind(*primals, **params)
    count = params["count"]
    if all(isinstance(tangent, internals.Zero) for tangent in tangents[:count]):
        x = [internals.instantiate_zeros(tangent) for tangent in tangents[count:]]
        return results, linear_map_p.bind(*primals[:count], *x, **params)
    # What the map depends on changes as well: a second derivative.
    tangents = [internals.instantiate_zeros(tangent) for tangent in tangents]
    return jax.jvp(lambda *values: _apply_map(*values, **params), list(primals), tangents)


def _transpose_map(cotangents, *values, forward, backward, shapes, count):
    del shapes
    cotangents = [internals.instantiate_zeros(cotangent) for cotangent in cotangents]
    like = [value.aval for value in values[count:]]
    found = linear_map(backward, forward, values[:count], cotangents, like)
    return [None] * count + found


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


internals.implement(
    linear_map_p,
    lambda *_, forward, backward, shapes, count: [
        jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in shapes
    ],
    _apply_map,
    _differentiate_map,
    _batch_map,
    _transpose_map,
)


def trace_of(params: dict[str, Any], inputs: Sequence[Any]) -> ClosedJaxpr:
    """The program of a ``linear_map`` with the given parameters."""
    return jax.make_jaxpr(lambda *values: _apply_map(*values, **params))(*inputs)
