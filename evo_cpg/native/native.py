"""The primitive ``fused``: machine code evaluates it, JAX differentiates and maps it.

A derivative of a fused program is a fused program itself. JAX differentiates the program for one
individual, in forward or reverse mode. The derivative is a program for one individual too, and is
compiled like any other program. For a gradient only the arguments of each program are stored. The
backward pass computes the program again from them, in registers.
"""

import ctypes
import functools
import math
import time
import weakref
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.monitoring import record_event_duration_secs

from evo_cpg.native import engine, machine_constants
from evo_cpg.native import jax_internals as internals
from evo_cpg.native.backend.code import Variant
from evo_cpg.native.backend.llvm import call_frame
from evo_cpg.native.backend.machine import Known, host, keep_note, load, recalled
from evo_cpg.native.compile import Module, to_llvm
from evo_cpg.native.frontend.identity import note_of
from evo_cpg.native.frontend.primitives import (
    Arrays,
    Program,
    fused_p,
    is_tracing,
    linear_map,
    mapped_axis,
)
from evo_cpg.native.fuse import fuse
from evo_cpg.native.ir import Unsupported

# Events that `jax.monitoring` reports for every program: the time from the JAX program to LLVM IR,
# with the program's name, its operations and its bytes of working memory, and the time from there
# to machine code in memory.
WRITING, COMPILING = "/evo_cpg/native/writing", "/evo_cpg/native/compiling"


class Native(NamedTuple):
    """Machine code of a program.

    Attributes:
        name: name of the handler in XLA.
        address: address of the handler.
        scratch: bytes of working memory.
        width: number of individuals in a vector, the least number of individuals in a call.
    """

    name: str
    address: int
    scratch: int
    width: int


_codes: "weakref.WeakKeyDictionary[Program, dict]" = weakref.WeakKeyDictionary()


def compiled(program: Program, single: bool) -> Native:
    """Return the machine code of a program, which is compiled at the first call.

    Args:
        program: the program.
        single: whether the code computes a single individual, and needs no vectors.
    """
    target = engine.target()
    if single and target.name == "avx512":
        # Instructions of AVX2 are shorter.
        target = host("avx2")
    codes = _codes.setdefault(program, {})
    kinds = [np.dtype(x.dtype) for x in (*program.inputs, *program.outputs)]
    widest = max([kind.itemsize for kind in kinds if kind.kind == "f"], default=4)
    width = 1 if single else target.bytes // widest
    variant = Variant(target, width)
    if variant not in codes:
        start = time.perf_counter()
        note = note_of(program, variant)
        known = recalled(note)
        if known is None:
            module = _lowered(program, variant)
        middle = time.perf_counter()
        if known is None:
            known = Known(*load(module.text, target), module.scratch, module.operations)
            keep_note(note, known)
        made = {"operations": known.operations, "scratch": known.scratch}
        record_event_duration_secs(WRITING, middle - start, name=program.name, **made)
        record_event_duration_secs(COMPILING, time.perf_counter() - middle, name=program.name)
        name = engine.register(known.name, known.address)
        codes[variant] = Native(name, known.address, known.scratch, width)
    return codes[variant]


def _lowered(program: Program, variant: Variant) -> Module:
    """Return LLVM IR of a program, and warn if it is large."""
    module = to_llvm(program, variant)
    if module.operations > machine_constants.MANY_OPERATIONS:
        most = f"{machine_constants.MANY_OPERATIONS:,}"
        engine.warn_once(
            f"A program has more than {most} operations, so it takes long to compile. "
            "Fewer bodies, contacts or points of drag make it smaller"
        )
    return module


class Stepper:
    """Repeated calls of ``state = function(state, given)`` for individuals, without XLA.

    A call through JAX costs more than a step of a small animal. The results of a call are the
    arguments of the next one, so that nothing is copied.

    Args:
        function: function of one individual.
        state: first state, with the individuals on the last axes if there are several.
        given: argument of the first call, in the same way.
        name: name of the function for messages.
        count: number of individuals, or None for one without an axis.

    Attributes:
        leaves: arrays of the present state. The next two calls overwrite them. They have further
            individuals, copies of the last one, if there are fewer than a vector has.
        structure: the state's structure of arrays.

    Raises:
        Unsupported: if the function does not become native code.
    """

    def __init__(
        self, function: Callable, state: Any, given: jax.Array, name: str, count: int | None = None
    ):
        run = functools.partial(fuse, function, batch_ndim=0 if count is None else 1, name=name)
        equations = jax.make_jaxpr(run)(state, given).jaxpr.eqns
        if [x.primitive for x in equations] != [fused_p]:
            raise Unsupported(f"{name} is not native code")
        native = compiled(equations[0].params["program"], single=count is None)
        found, self.structure = jax.tree.flatten(state)
        more = 0 if count is None else max(native.width - count, 0)

        def filled(x: jax.Array) -> np.ndarray:
            return np.concatenate([x, *[x[..., -1:]] * more], -1) if more else np.array(x)

        self.leaves, self._given = [filled(x) for x in found], filled(given)
        self._scratch = np.zeros(max(native.scratch, 1), np.uint8)
        self._lanes = 1 if count is None else count + more
        self._run = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(native.address)
        self.separate()

    def separate(self) -> None:
        """Copy all arrays, so that a shallow copy of a stepper has a state of its own.

        A shallow copy has the same machine code, so that nothing is traced or compiled again.
        """
        self.leaves, self._other = ([x.copy() for x in self.leaves] for _ in range(2))
        self._given, self._scratch = self._given.copy(), self._scratch.copy()
        self._frames = [
            call_frame([*one, self._given], [*two, self._scratch], self._lanes)
            for one, two in ((self.leaves, self._other), (self._other, self.leaves))
        ]
        self._addresses = [frame.ctypes.data for frame in self._frames]

    def __call__(self, given: np.ndarray) -> None:
        """Compute the next state."""
        self._given[..., : np.shape(given)[-1]] = given
        self._run(self._addresses[0])
        self.leaves, self._other = self._other, self.leaves
        self._addresses.reverse()


def evaluate(*arrays: jax.Array, program: Program, batch: tuple[int, ...]) -> list[jax.Array]:
    """Return the results of a program for all individuals.

    The arrays are the shared arguments, then the other arguments with trailing batch axes.
    """
    count = int(np.prod(batch, dtype=int))
    outputs = program.outputs
    if not count or not any(aval.size for aval in outputs):
        return [jnp.zeros((*aval.shape, *batch), aval.dtype) for aval in outputs]
    try:
        native = compiled(program, single=count == 1)
    except Exception as error:
        engine.warn_of_fallback(program.name, error)
        return program(*arrays)
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
    found = call_handler(native.name, given, outputs, lanes, native.scratch)
    results = iter(x[:, :count] if lanes > count else x for x in found)
    return [
        (next(results) if x.size else jnp.zeros(0, x.dtype)).reshape(*x.shape, *batch)
        for x in outputs
    ]


def call_handler(
    name: str, given: Arrays, outputs: Sequence[Any], lanes: int, scratch: int
) -> list[jax.Array]:
    """Return the results of a handler, ``(rows, lanes)``, without those that have no rows.

    Args:
        name: name of the handler in XLA.
        given: arguments that have rows, ``(rows, lanes)``, or ``(rows,)`` if individuals share one.
        outputs: shapes and types of the results for one individual.
        lanes: number of individuals.
        scratch: bytes of working memory.
    """
    shapes = [jax.ShapeDtypeStruct((x.size, lanes), x.dtype) for x in outputs if x.size]
    room = jax.ShapeDtypeStruct((max(scratch, 1),), np.uint8)
    *found, _ = jax.ffi.ffi_call(name, (*shapes, room))(*given)
    return found


def differentiate(
    primals: Arrays, tangents: Sequence[Any], *, program: Program, batch: tuple[int, ...]
) -> tuple[list[jax.Array], list[Any]]:
    """Return the results of a program and their tangents, symbolic zeros for integer results."""
    if program.loops and is_tracing():
        # Within a larger program JAX differentiates a loop over parts round by round, and keeps the
        # inputs of the parts. As a whole, the loop would be computed once more to find them.
        changes = [internals.instantiate_zeros(tangent) for tangent in tangents]
        return jax.jvp(program, list(primals), changes)
    moving = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, internals.Zero)]
    smooth = [i for i, x in enumerate(program.outputs) if jnp.issubdtype(x.dtype, jnp.floating)]
    changes = [tangents[i] for i in moving]
    rule = _Derivative(program, batch, moving, smooth)
    numbers = sum(program.outputs[i].size for i in smooth)
    if program.forward:
        results, found = rule.with_tangents(primals, changes)
    elif numbers == 1 and not program.searches and not is_tracing():
        results, found = rule.with_gradient(primals, changes)
    else:
        results, found = rule.by_map(primals, changes)
    known = dict(zip(smooth, found, strict=True))
    return results, [
        known[i] if i in known else internals.no_tangent(x) for i, x in enumerate(results)
    ]


class _Derivative(NamedTuple):
    """The derivative of a program, which is itself a program for one individual.

    Attributes:
        program: the program.
        batch: lengths of the batch axes.
        moving: numbers of the arguments that have tangents.
        smooth: numbers of the results that are floats.
    """

    program: Program
    batch: tuple[int, ...]
    moving: Sequence[int]
    smooth: Sequence[int]

    def with_gradient(
        self, primals: Arrays, changes: Arrays
    ) -> tuple[list[jax.Array], list[jax.Array]]:
        """Return the results, and the tangent of the only number among them.

        Its gradient is computed together with it. So a backward pass need not compute the program
        again, which saves a fifth of the time for a trial.
        """

        def graded(run: Callable[..., Any], some: Arrays, _: Arrays) -> tuple[Any, Any]:
            def number(*some: jax.Array) -> tuple[jax.Array, Any]:
                (value,), results = run(*some)
                return value.sum(), results

            every = tuple(range(len(some)))
            return jax.grad(number, every, has_aux=True)(*some)

        slopes, results = self._fused(graded, primals, ())
        changes = self._for_all(changes, self.moving)
        ndim, kept = len(self.batch), self.program.outputs[self.smooth[0]].shape
        pairs = zip(slopes, changes, strict=True)
        each = [(x * y).sum(tuple(range(x.ndim - ndim))) for x, y in pairs]
        return list(results), [jnp.stack(each).sum(0).reshape(*kept, *self.batch)]

    def with_tangents(
        self, primals: Arrays, changes: Arrays
    ) -> tuple[list[jax.Array], list[jax.Array]]:
        """Return the results and their tangents, computed together."""

        def both(run: Callable[..., Any], some: Arrays, x: Arrays) -> tuple[Any, Any]:
            _, changes, results = jax.jvp(run, some, x, has_aux=True)
            return results, changes

        return self._fused(both, primals, self._for_all(changes, self.moving), tangents=True)

    def by_map(self, primals: Arrays, changes: Arrays) -> tuple[list[jax.Array], list[jax.Array]]:
        """Return the results and their tangents, by a linear map that JAX can transpose."""
        results = fused_p.bind(*primals, program=self.program, batch=self.batch)

        def push(run: Callable[..., Any], some: Arrays, x: Arrays) -> Any:
            return jax.jvp(run, some, x, has_aux=True)[1]

        quick = self._replace(program=self.program.in_forward_mode)

        def pull(run: Callable[..., Any], some: Arrays, x: Arrays) -> Any:
            return jax.vjp(run, *some, has_aux=True)[1](tuple(x))

        def forward(fixed: Arrays, x: Arrays) -> tuple:
            return quick._fused(push, fixed, self._for_all(x, self.moving), tangents=True)

        def backward(fixed: Arrays, x: Arrays) -> list[jax.Array]:
            found, own = self._fused(pull, fixed, list(x)), tuple(range(-len(self.batch), 0))
            pairs = zip(self.moving, found, strict=True)
            return [x.sum(own) if i < self.program.shared else x for i, x in pairs]

        like = [results[i] for i in self.smooth]
        return results, linear_map(forward, backward, primals, changes, like)

    def _fused(
        self, derivative: Callable[..., Any], values: Arrays, x: Arrays, tangents: bool = False
    ) -> Any:
        """Return a derivative for all individuals.

        The derivative gets a function from the moving arguments to the float results and all
        results, the values of these arguments, and their tangents or the results' cotangents.
        """

        def of_one(values: Arrays, x: Arrays) -> Any:
            def run(*some: jax.Array) -> tuple[tuple, list]:
                given = dict(zip(self.moving, some, strict=True))
                results = self.program(*[given.get(i, value) for i, value in enumerate(values)])
                return tuple(results[i] for i in self.smooth), results

            return derivative(run, [values[i] for i in self.moving], x)

        every = self._for_all(values, range(len(values)))
        name, count = f"the derivative of {self.program.name}", (0, 0)
        if tangents:
            count = len(self.moving), len(self.smooth)
        return fuse(of_one, every, x, batch_ndim=len(self.batch), name=name, tangents=count)

    def _for_all(self, values: Arrays, numbers: Iterable[int]) -> list[jax.Array]:
        """Return arguments of the program, given by their numbers, with the batch axes on all."""
        pairs = zip(numbers, values, strict=True)
        return [_repeated(x, self.batch) if i < self.program.shared else x for i, x in pairs]


def _repeated(x: jax.Array, batch: tuple[int, ...]) -> jax.Array:
    """Return an array with batch axes added at the end."""
    return jnp.broadcast_to(x.reshape(*x.shape, *(1,) * len(batch)), (*x.shape, *batch))


def batch_again(
    values: Arrays, axes: Sequence[int | None], *, program: Program, batch: tuple[int, ...]
) -> tuple[list[jax.Array], list[int]]:
    """Map a program over one more batch axis, which becomes the last.

    An axis of tangents alone becomes an axis of each individual instead, so that the tangents share
    all other work. The tangents of few individuals rather fill the lanes of a vector.
    """
    first, few = len(values) - program.tangents[0], math.prod(batch) < machine_constants.LANES
    if all(axis is None for axis in axes[:first]) and (is_tracing() or not few):
        return _for_tangents(values, axes, program, batch)
    _, every = mapped_axis(values, axes, -1)
    for i, x in enumerate(every[: program.shared]):
        every[i] = jnp.moveaxis(_repeated(x, batch), x.ndim - 1, -1)
    results = fuse(
        lambda *x: tuple(program(*x)), *every, batch_ndim=len(batch) + 1, name=program.name
    )
    return list(results), [x.ndim - 1 for x in results]


def _for_tangents(
    values: Arrays, axes: Sequence[int | None], program: Program, batch: tuple[int, ...]
) -> tuple[list[jax.Array], list[Any]]:
    """Map a program over an axis that only its tangents have.

    The parts of a program loop over the tangents. Work on other values is done before the loop, and
    the code of one tangent serves all. Eight tangents side by side would be 4 MB of code, which
    takes longer to fetch than to run.
    """
    last, part = program.tangents[1], is_tracing()
    own = [None if axis is None else 0 for axis in axes]
    out = [None] * (len(program.outputs) - last) + [0] * last
    shared = list(values[: program.shared])

    def run(*others: jax.Array) -> list[jax.Array]:
        every = [*shared, *others]
        if not part:
            return jax.vmap(program, own, out)(*every)

        def one(tangents: Arrays) -> list[jax.Array]:
            given = iter(tangents)
            return program(
                *(x if axis is None else next(given) for x, axis in zip(every, own, strict=True))
            )

        mapped = [x for x, axis in zip(every, own, strict=True) if axis is not None]
        results = jax.lax.map(one, mapped)
        return [x[0] if axis is None else x for x, axis in zip(results, out, strict=True)]

    moved = [
        x if axis is None else jnp.moveaxis(x, axis, 0)
        for x, axis in zip(values, axes, strict=True)
    ]
    how = {"name": program.name, "tangents": program.tangents}
    results = fuse(run, *moved[program.shared :], batch_ndim=len(batch), **how)
    return results, out


internals.implement(
    fused_p,
    lambda *_, program, batch: [
        jax.ShapeDtypeStruct((*x.shape, *batch), x.dtype) for x in program.outputs
    ],
    evaluate,
    differentiate,
    batch_again,
)
