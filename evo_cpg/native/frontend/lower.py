"""Lower a JAX program on small arrays to a graph of scalars.

An array becomes a NumPy array of nodes. NumPy performs operations that only move numbers (slices,
stacks, transposes) while tracing, so they cost nothing. Sums and small matrix products become
additions and multiplications. Elementwise operations become one node per element.
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from evo_cpg.native import jax_internals as internals
from evo_cpg.native import machine_constants
from evo_cpg.native.frontend.builder import Builder, all_nodes, elementwise, node_array
from evo_cpg.native.frontend.elementary import FLOAT32
from evo_cpg.native.frontend.loops import LOOPS, WRITES, Sums, as_nodes
from evo_cpg.native.frontend.moves import MOVES
from evo_cpg.native.frontend.primitives import (
    Program,
    apply_map,
    eliminate_p,
    fused_p,
    linear_map_p,
    solve_written_out,
    traced,
    unset_p,
)
from evo_cpg.native.ir import ARITHMETIC, LIBRARY, Graph, Node, Unsupported

Arrays = list[np.ndarray]
Rule = Callable[[Builder, Arrays, dict], Arrays]


def lower(program: Program, builder: Builder) -> Graph:
    """Return the graph of a program for one individual.

    Raises:
        Unsupported: if the program holds something that cannot be written as scalars.
    """
    inputs = [
        builder.argument(x.shape, x.dtype, shared=i < program.shared)
        for i, x in enumerate(program.inputs)
    ]
    return builder.graph(trace_program(builder, program, inputs))


def trace_program(builder: Builder, program: Program, inputs: Sequence[np.ndarray]) -> Arrays:
    """Return the results of a program for one individual, arrays of nodes.

    The results do not depend on the code around the program, not even in the last digit. Nodes
    outside the program are not simplified together with nodes inside (its inputs are opaque), and
    its sums are ordered separately. So a control step has the same results alone and as a part of a
    trial. The shared arguments come first.
    """
    builder.begin_part()
    around, builder.part = builder.part, program.name
    inside = [elementwise(functools.partial(builder.alias, "opaque"), x) for x in inputs]
    given = iter(inside[: program.shared])
    consts = [next(given) if own is None else constants(builder, own) for own in program.constants]
    results = trace(builder, program.jaxpr, [*consts, *inside[program.shared :]])
    results = [as_nodes(builder, x) for x in results]
    part = builder.end_part(all_nodes(inputs), all_nodes(results))
    builder.part = around
    hide = functools.partial(builder.alias, "opaque", part=part)
    return [elementwise(hide, x) for x in results]


def trace(
    builder: Builder,
    program: Jaxpr | ClosedJaxpr,
    inputs: Sequence[np.ndarray],
    consts: Sequence[np.ndarray] = (),
) -> Arrays:
    """Return the outputs of a program as arrays of nodes, from its arguments and its constants.

    A `ClosedJaxpr` holds its constants.

    Raises:
        Unsupported: if the program holds something that cannot be written as scalars.
    """
    if isinstance(program, ClosedJaxpr):
        consts = [constants(builder, np.asarray(value)) for value in program.consts]
        program = program.jaxpr
    known: dict = dict(zip(program.constvars, consts, strict=True))
    known.update(zip(program.invars, inputs, strict=True))

    def read(atom) -> np.ndarray:
        if isinstance(atom, Literal):
            return constants(builder, np.asarray(atom.val, atom.aval.dtype))  # pyright: ignore
        return known[atom]

    def trace_inner(*args: Any) -> Arrays:
        """Trace a program within a loop or a branch, whose results must be nodes."""
        return [as_nodes(builder, x) for x in trace(*args)]

    around = builder.part
    for equation in program.eqns:
        scope = internals.scope(equation)
        builder.part = f"{around}/{scope}" if scope else around
        operands = [read(atom) for atom in equation.invars]
        name, params = equation.primitive.name, equation.params
        if name != "scan" and name not in CALLS:
            operands = [as_nodes(builder, x) for x in operands]
        if name in _PROGRAMS:
            results = _PROGRAMS[name](builder, equation, operands)
        elif name in WRITES and _is_written(*operands[:2]):
            results = WRITES[name](builder, operands, params)
        elif operands and all(operand.size == 0 for operand in operands):
            results = _evaluate(builder, equation, operands)
        elif name in LOOPS:
            results = LOOPS[name](builder, operands, params, trace_inner)
        elif name in _RULES:
            results = _RULES[name](builder, operands, params)
        elif name in _ELEMENTWISE:
            rule = functools.partial(_ELEMENTWISE[name], builder)
            results = [elementwise(rule, *operands)]
        elif name in ARITHMETIC:
            results = [builder.apply_each(name, *operands)]
        elif name in FLOAT32 or name in LIBRARY:
            results = [_function(builder, name, operands)]
        elif name in internals.RANDOM:
            results = trace(builder, internals.random_program(equation), operands)
        elif all(node.value is not None for operand in operands for node in operand.flat):
            results = _evaluate(builder, equation, operands)
        else:
            raise Unsupported(f"no rule for {name}")
        known.update(zip(equation.outvars, results, strict=True))
    builder.part = around
    return [read(atom) for atom in program.outvars]


def _is_written(array: Any, indices: np.ndarray) -> bool:
    """Return whether a scatter writes to memory: to an array in it, or to computed places."""
    return isinstance(array, Sums) or any(node.value is None for node in indices.flat)


def constants(builder: Builder, values: np.ndarray) -> np.ndarray:
    """Return an array of constant nodes. Tangents of integers (float0) are False, as in JAX."""
    if values.dtype == jax.dtypes.float0:
        values = np.zeros(values.shape, bool)
    return node_array(
        [builder.constant(value, values.dtype) for value in values.flat], values.shape
    )


def is_supported(name: str) -> bool:
    """Return whether there is a rule for a primitive, for any operands."""
    known = (_PROGRAMS, LOOPS, _RULES, _ELEMENTWISE, ARITHMETIC, FLOAT32, LIBRARY)
    return name in internals.RANDOM or any(name in names for names in known)


# Rules of primitives that hold programs.


def inner_program(equation: Any) -> Any:
    """Return the program that a call (`CALLS`) evaluates."""
    return equation.params.get("jaxpr") or equation.params["call_jaxpr"]


def _call(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    return trace(builder, inner_program(equation), operands)


def _fused(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    """Trace a fused program once for each element of its batch axes."""
    program, batch = equation.params["program"], equation.params["batch"]
    if not batch:
        return trace_program(builder, program, operands)
    shared, own = operands[: program.shared], operands[program.shared :]
    results = [np.empty((*aval.shape, *batch), object) for aval in program.outputs]
    for place in np.ndindex(batch):
        one = [np.asarray(x[(..., *place)], object) for x in own]
        found = trace_program(builder, program, [*shared, *one])
        for result, part in zip(results, found, strict=True):
            result[(..., *place)] = part
    return results


def _linear_map(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    run = functools.partial(apply_map, **equation.params)
    inner, _ = traced(run, *[atom.aval for atom in equation.invars])
    return trace(builder, inner, operands)


def _elimination(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    """Write out a short elimination, or call the function that loops.

    In written-out code, zero elements cost nothing (`evo_cpg.native.ldl`). An animal whose limbs
    may all touch has no zeros, so the elimination takes v^3/6 operations for v unknowns. The
    function eliminates in the same order. It skips elements that are zero for all individuals of a
    vector, such as the coupling of limbs that do not touch.
    """
    H, b = operands
    if H.ndim == 2:
        filled = np.vectorize(lambda node: node.value is None or node.value != 0, otypes=[bool])(H)
        products = 0
        for k in reversed(range(len(H))):
            (used,) = np.nonzero(filled[k, :k])
            products += len(used) * (len(used) + 1) // 2
            filled[np.ix_(used, used)] = True
        if products > machine_constants.LONGEST_ELIMINATION:
            triangle = H[np.tril_indices(len(H))]
            answers = builder.make("solve", (*triangle, *b), b[0].dtype, len(b))
            return [builder.rows(answers, b.shape)]
    inner = jax.make_jaxpr(solve_written_out)(*[atom.aval for atom in equation.invars])
    return trace(builder, inner, operands)


def _linear_solve(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    """Trace the solver of a linear system. Its other programs are for derivatives."""
    counts, jaxprs = equation.params["const_lengths"], equation.params["jaxprs"]
    before = counts.matvec + counts.vecmat
    given = operands[sum(counts) :]
    return trace(builder, jaxprs.solve, [*operands[before : before + counts.solve], *given])


CALLS = (
    "checkpoint", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "jit", "pjit",
    "remat2",
)  # fmt: skip
"""Primitives that evaluate one program. Their other parameters do not matter."""

_PROGRAMS: dict[str, Callable[[Builder, Any, Arrays], Arrays]] = {
    **dict.fromkeys(CALLS, _call),
    fused_p.name: _fused,
    linear_map_p.name: _linear_map,
    eliminate_p.name: _elimination,
    "custom_linear_solve": _linear_solve,
}
"""Rules of primitives that hold programs. A rule maps an equation and operands to results."""


def _evaluate(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    """Compute any other primitive on constants by JAX while tracing."""
    values = [
        np.array([node.value for node in operand.flat], atom.aval.dtype).reshape(operand.shape)
        for operand, atom in zip(operands, equation.invars, strict=True)
    ]
    with jax.ensure_compile_time_eval():
        results = equation.primitive.bind(*values, **equation.params)
    results = results if equation.primitive.multiple_results else [results]
    return [constants(builder, np.asarray(result)) for result in results]


# Operations on scalars and on arrays.


@functools.cache
def _in_float32(name: str, count: int) -> ClosedJaxpr:
    scalar = jax.ShapeDtypeStruct((), np.float32)
    return jax.make_jaxpr(FLOAT32[name])(*[scalar] * count)


def _function(builder: Builder, name: str, operands: Arrays) -> np.ndarray:
    """Write out a frequent function for float32. Call the C library, in float64, for others."""
    dtype = next((node.dtype for node in operands[0].flat), np.dtype(np.float32))
    if dtype == np.float32 and name in FLOAT32:
        # The functions are written for scalars, but elementwise operations take arrays as well.
        builder.begin_part()
        hide = functools.partial(builder.alias, "opaque")
        inside = [elementwise(hide, x) for x in np.broadcast_arrays(*operands)]
        (result,) = trace(builder, _in_float32(name, len(operands)), inside)
        # The sums in these functions are written so that rounding errors cancel. Keep their order.
        part = builder.end_part(all_nodes(operands), result.flat, reorder=False)
        return elementwise(functools.partial(hide, part=part), result)

    if dtype == np.float32 and name in LIBRARY:
        wide = [builder.apply_each("convert", x, dtype=np.dtype(np.float64)) for x in operands]
        return builder.apply_each("convert", _function(builder, name, wide), dtype=dtype)
    if dtype == np.float64 and name == "logistic":
        return _defined(lambda x: 1.0 / (1.0 + jnp.exp(-x)), builder, operands, {})[0]
    if dtype != np.float64 or name not in LIBRARY:
        raise Unsupported(f"no rule for {name} of {dtype}")
    return elementwise(lambda *x: builder.make(name, x, dtype), *operands)


def _reduction(op: str, builder: Builder, operands: Arrays, params: dict) -> Arrays:
    (x,), axes = operands, params["axes"]
    kept = [i for i in range(x.ndim) if i not in axes]
    rows = x.transpose(*axes, *kept).reshape(-1, *(x.shape[i] for i in kept))
    total = functools.reduce(functools.partial(builder.apply_each, op), rows)
    return [np.asarray(total, object)]


def _cumulative(op: str, builder: Builder, operands: Arrays, params: dict) -> Arrays:
    axis, step = params["axis"], -1 if params["reverse"] else 1
    rows = np.moveaxis(operands[0], axis, 0)[::step]
    sums = itertools.accumulate(rows, functools.partial(builder.apply_each, op))
    return [np.moveaxis(np.stack([np.asarray(x, object) for x in sums])[::step], 0, axis)]


def _dot_general(builder: Builder, operands: Arrays, params: dict) -> Arrays:
    """Return matrix products. Terms with equal constant factors, up to the sign, share one.

    Coordinates of points on a regular grid differ by their signs only. The common terms of their
    rows are then computed once. The order of summation, and so the rounding, differs from the
    original product.
    """
    (a, b), apply = operands, builder.apply
    if (dtype := params["preferred_element_type"]) is not None:
        a, b = (builder.apply_each("convert", x, dtype=dtype) for x in operands)
    (contract_a, contract_b), (batch_a, batch_b) = params["dimension_numbers"]
    free_a = [i for i in range(a.ndim) if i not in (*contract_a, *batch_a)]
    free_b = [i for i in range(b.ndim) if i not in (*contract_b, *batch_b)]
    batch = [a.shape[i] for i in batch_a]
    outer_a, outer_b = [a.shape[i] for i in free_a], [b.shape[i] for i in free_b]
    a = a.transpose(*batch_a, *free_a, *contract_a).reshape(
        int(np.prod(batch, dtype=int)), int(np.prod(outer_a, dtype=int)), -1
    )
    b = b.transpose(*batch_b, *free_b, *contract_b).reshape(a.shape[0], -1, a.shape[2])
    result = np.empty((a.shape[0], a.shape[1], b.shape[1]), object)
    for n, i, j in np.ndindex(result.shape):
        groups: dict[Node, list[tuple[bool, Node]]] = {}
        for x, y in zip(a[n, i], b[n, j], strict=True):
            factor, other = (x, y) if x.value is not None else (y, x)
            if factor.value is None:
                factor, other, negative = builder.constant(1, x.dtype), apply("mul", x, y), False
            else:
                negative = bool(factor.value < 0)
                factor = apply("neg", factor) if negative else factor
            if factor.value != 0:
                groups.setdefault(factor, []).append((negative, other))
        total = builder.constant(0, a[n, i, 0].dtype)
        for factor, terms in groups.items():
            # The first term sets the product's sign, so that a - b and b - a are one node.
            flip, inner = terms[0]
            for negative, term in terms[1:]:
                inner = apply("add" if negative == flip else "sub", inner, term)
            total = apply("sub" if flip else "add", total, apply("mul", factor, inner))
        result[n, i, j] = total
    return [result.reshape((*batch, *outer_a, *outer_b))]


def _select_n(builder: Builder, operands: Arrays, params: dict) -> Arrays:
    which, *cases = operands
    result, select = cases[-1], functools.partial(builder.apply_each, "select")
    for k, case in reversed([*enumerate(cases[:-1])]):
        if all(node.dtype.kind == "b" for node in which.flat):
            return [select(which, result, case)]
        here = elementwise(
            lambda w, k=k: builder.apply("le", w, builder.constant(k, w.dtype)), which
        )
        result = select(here, case, result)
    return [result]


def _defined(function: Callable, builder: Builder, operands: Arrays, params: dict) -> Arrays:
    """Trace a definition in JAX of a primitive, for operands with elements."""
    shapes = [jax.ShapeDtypeStruct(x.shape, x.flat[0].dtype) for x in operands]
    inner, _ = traced(functools.partial(function, **params), *shapes)
    return trace(builder, inner, operands)


def _extreme_place(best: Callable, x: jax.Array, axes: Sequence[int], index_dtype: Any) -> Any:
    """Return the index of the first NaN if there is one, else of the first largest or smallest."""
    (axis,), x = axes, x.astype(np.int8) if x.dtype == bool else x
    found = (x == best(x, axis, keepdims=True)) | (x != x)
    places = jax.lax.broadcasted_iota(index_dtype, x.shape, axis)
    return jnp.where(found, places, x.shape[axis] - 1).min(axis)


def _away_from_zero(x: jax.Array, rounding_method: Any) -> jax.Array:
    size = abs(x)
    below = jnp.floor(size)
    return jnp.sign(x) * (below + (size - below >= 0.5).astype(x.dtype))


def _rounded(builder: Builder, operands: Arrays, params: dict) -> Arrays:
    if params["rounding_method"] == jax.lax.RoundingMethod.TO_NEAREST_EVEN:
        return [builder.apply_each("round", *operands)]
    return _defined(_away_from_zero, builder, operands, params)


def _unset(builder: Builder, operands: Arrays, params: dict) -> Arrays:
    """Return elements that count as zeros, and are not written to memory (`loops.Sums`)."""
    dtype = operands[0].flat[0].dtype
    node = builder.new("constant", (), dtype, builder.top, True, value=dtype.type(0), detail=True)
    return [np.full(params["shape"], node, object)]


_ELEMENTWISE: dict[str, Callable[..., Node]] = {
    "add_any": lambda b, x, y: b.apply("add", x, y),
    "clamp": lambda b, low, x, high: b.apply("min", b.apply("max", low, x), high),
    "rsqrt": lambda b, x: b.apply("div", b.constant(1, x.dtype), b.apply("sqrt", x)),
    "square": lambda b, x: b.power(x, 2),
}
"""Rules of primitives on scalars. A rule maps a builder and nodes to a node."""

# Operations by the names of JAX's reductions and cumulative reductions.
_REDUCTIONS = {"and": "and", "max": "max", "min": "min", "or": "or", "prod": "mul", "sum": "add"}

_RULES: dict[str, Rule] = {
    **MOVES,
    **{f"reduce_{x}": functools.partial(_reduction, op) for x, op in _REDUCTIONS.items()},
    **{f"cum{x}": functools.partial(_cumulative, op) for x, op in _REDUCTIONS.items()},
    "argmax": functools.partial(_defined, functools.partial(_extreme_place, jnp.max)),
    "argmin": functools.partial(_defined, functools.partial(_extreme_place, jnp.min)),
    "bitcast_convert_type": lambda b, xs, params: [
        b.apply_each("bitcast", *xs, dtype=params["new_dtype"])
    ],
    "convert_element_type": lambda b, xs, params: [
        b.apply_each("convert", *xs, dtype=params["new_dtype"])
    ],
    "dot_general": _dot_general,
    unset_p.name: _unset,
    "integer_pow": lambda b, operands, params: [
        elementwise(lambda x: b.power(x, params["y"]), *operands)
    ],
    # The product keeps all digits near one. JAX 0.12 added this primitive for `tanh`.
    "one_minus_square": functools.partial(_defined, lambda x: (1.0 - x) * (1.0 + x)),
    "round": _rounded,
    "select_n": _select_n,
}
"""Rules of primitives on arrays. A rule maps operands and parameters to results."""
