"""Lower a JAX program on small arrays to a graph of scalars.

An array becomes a NumPy array of nodes. NumPy performs operations that only move numbers (slices,
stacks, transposes) while tracing, so they cost nothing. Sums and small matrix products become
additions and multiplications. Elementwise operations become one node per element.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from evo_cpg.native import jax_internals as internals
from evo_cpg.native.frontend.builder import Builder, Sums, all_nodes, elementwise, node_array
from evo_cpg.native.frontend.elementary import FLOAT32
from evo_cpg.native.frontend.loops import LOOPS
from evo_cpg.native.frontend.moves import MOVES, SCATTER_ADD, add_to_sums
from evo_cpg.native.frontend.primitives import Program, fused_p, linear_map_p, trace_of
from evo_cpg.native.frontend.symmetric_solve import eliminate, eliminate_p, elimination_of
from evo_cpg.native.ir.graph import Graph, Node
from evo_cpg.native.ir.types import ARITHMETIC, LIBRARY
from evo_cpg.native.unsupported import Unsupported

Arrays = list[np.ndarray]
Rule = Callable[[Builder, Arrays, dict], Arrays]


def lower(program: Program, builder: Builder) -> Graph:
    """Return the graph of a program.

    Args:
        program: program for one individual.
        builder: maker of the nodes.

    Raises:
        Unsupported: the program holds something that cannot be written as scalars.
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
    trial.

    Args:
        builder: maker of the nodes.
        program: program to trace.
        inputs: shared arguments, then the other arguments.

    Raises:
        Unsupported: the program holds something that cannot be written as scalars.
    """
    inside = [elementwise(builder.opaque, x) for x in inputs]
    given = iter(inside[: program.shared])
    consts = [next(given) if own is None else constants(builder, own) for own in program.constants]
    results = trace(builder, program.jaxpr, [], [*consts, *inside[program.shared :]])
    part = builder.end_part(all_nodes(inputs), all_nodes(results))
    hide = functools.partial(builder.opaque, part=part)
    return [elementwise(hide, x) for x in results]


def trace(
    builder: Builder, jaxpr: Jaxpr, consts: Sequence[np.ndarray], inputs: Sequence[np.ndarray]
) -> Arrays:
    """Return the program's outputs as arrays of nodes.

    Args:
        builder: maker of the nodes.
        jaxpr: the program.
        consts: values of its constants, arrays of nodes.
        inputs: values of its arguments, arrays of nodes.

    Raises:
        Unsupported: the program holds something that cannot be written as scalars.
    """
    known: dict = {}

    def read(atom) -> np.ndarray:
        if isinstance(atom, Literal):
            return constants(builder, np.asarray(atom.val, _type(atom)))
        return known[atom]

    known.update(zip(jaxpr.constvars, consts, strict=True))
    known.update(zip(jaxpr.invars, inputs, strict=True))
    for equation in jaxpr.eqns:
        operands = [read(atom) for atom in equation.invars]
        results = _equation(builder, equation, operands)
        known.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def trace_closed(builder: Builder, closed: ClosedJaxpr, inputs: Sequence[np.ndarray]) -> Arrays:
    """Trace a program that holds its constants (`trace`)."""
    values = [constants(builder, np.asarray(value)) for value in closed.consts]
    return trace(builder, closed.jaxpr, values, inputs)


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
    return internals.is_random(name) or any(name in names for names in known)


def _equation(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    """Return the results of an equation by the rule of its primitive."""
    name, params = equation.primitive.name, equation.params
    if name in _PROGRAMS:
        return _PROGRAMS[name](builder, equation, operands)
    if any(isinstance(operand, Sums) for operand in operands) and name in SCATTER_ADD:
        return add_to_sums(builder, operands, params)
    if operands and all(operand.size == 0 for operand in operands):
        return _evaluate(builder, equation, operands)
    if name in LOOPS:
        return LOOPS[name](builder, operands, params, trace_closed)
    if name in _RULES:
        return _RULES[name](builder, operands, params)
    if name in _ELEMENTWISE:
        return [elementwise(functools.partial(_ELEMENTWISE[name], builder), *operands)]
    if name in ARITHMETIC:
        return [elementwise(functools.partial(builder.apply, name), *operands)]
    if name in FLOAT32 or name in LIBRARY:
        return [_function(builder, name, operands)]
    if internals.is_random(name):
        return trace_closed(builder, internals.random_program(equation), operands)
    if all(node.value is not None for operand in operands for node in operand.flat):
        return _evaluate(builder, equation, operands)
    raise Unsupported(f"no rule for {name}")


# Rules of primitives that hold programs.


def _call(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    inner = equation.params.get("jaxpr") or equation.params["call_jaxpr"]
    closed = isinstance(inner, ClosedJaxpr)
    return trace_closed(builder, inner, operands) if closed else trace(builder, inner, [], operands)


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
    inner = trace_of(equation.params, [atom.aval for atom in equation.invars])
    return trace_closed(builder, inner, operands)


def _elimination(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    """Call the routine that loops, or write out a short elimination."""
    answers = eliminate(builder, operands)
    if answers is not None:
        return [answers]
    inner = elimination_of([atom.aval for atom in equation.invars])
    return trace_closed(builder, inner, operands)


def _linear_solve(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    """Trace the solver of a linear system. Its other programs are for derivatives."""
    counts, jaxprs = equation.params["const_lengths"], equation.params["jaxprs"]
    before = counts.matvec + counts.vecmat
    given = operands[sum(counts) :]
    return trace_closed(builder, jaxprs.solve, [*operands[before : before + counts.solve], *given])


_CALLS = (
    "checkpoint", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "jit", "pjit",
    "remat2",
)  # fmt: skip

_PROGRAMS: dict[str, Callable[[Builder, Any, Arrays], Arrays]] = {
    **dict.fromkeys(_CALLS, _call),
    fused_p.name: _fused,
    linear_map_p.name: _linear_map,
    eliminate_p.name: _elimination,
    "custom_linear_solve": _linear_solve,
}
"""Rules of primitives that hold programs. A rule maps an equation and operands to results."""


def _evaluate(builder: Builder, equation: Any, operands: Arrays) -> Arrays:
    """Compute any other primitive on constants by JAX while tracing."""
    values = [
        np.array([node.value for node in operand.flat], _type(atom)).reshape(operand.shape)
        for operand, atom in zip(operands, equation.invars, strict=True)
    ]
    with jax.ensure_compile_time_eval():
        results = equation.primitive.bind(*values, **equation.params)
    results = results if equation.primitive.multiple_results else [results]
    return [constants(builder, np.asarray(result)) for result in results]


def _type(atom: Any) -> np.dtype:
    return np.dtype(atom.aval.dtype)


# Operations on scalars and on arrays.


@functools.cache
def _in_float32(name: str, count: int) -> ClosedJaxpr:
    scalar = jax.ShapeDtypeStruct((), np.float32)
    return jax.make_jaxpr(FLOAT32[name])(*[scalar] * count)


def _function(builder: Builder, name: str, operands: Arrays) -> np.ndarray:
    """Write out an elementary function for float32. Call the C library for float64."""
    dtype = next((node.dtype for node in operands[0].flat), np.dtype(np.float32))
    if dtype == np.float32 and name in FLOAT32:
        # The functions are written for scalars, but elementwise operations take arrays as well.
        inside = [elementwise(builder.opaque, x) for x in np.broadcast_arrays(*operands)]
        (result,) = trace_closed(builder, _in_float32(name, len(operands)), inside)
        # The sums in these functions are written so that rounding errors cancel. Keep their order.
        part = builder.end_part(all_nodes(operands), result.flat, reorder=False)
        return elementwise(functools.partial(builder.opaque, part=part), result)
    if dtype == np.float64 and name == "logistic":
        return elementwise(functools.partial(_logistic, builder), *operands)
    if dtype != np.float64 or name not in LIBRARY:
        raise Unsupported(f"no rule for {name} of {dtype}")
    return elementwise(lambda *x: builder.make(name, x, dtype), *operands)


def _logistic(builder: Builder, x: Node) -> Node:
    one = builder.constant(1, x.dtype)
    power = builder.make("exp", (builder.negate(x),), x.dtype)
    return builder.apply("div", one, builder.add(one, power))


def _reduction(op: str, builder: Builder, operands: Arrays, params: dict) -> Arrays:
    (x,), axes = operands, params["axes"]
    kept = [i for i in range(x.ndim) if i not in axes]
    rows = x.transpose(*kept, *axes).reshape(*(x.shape[i] for i in kept), -1)
    combine = functools.partial(builder.apply, op)
    total = rows[..., 0]
    for k in range(1, rows.shape[-1]):
        total = elementwise(combine, total, rows[..., k])
    return [np.asarray(total, object)]


def _cumulative(op: str, builder: Builder, operands: Arrays, params: dict) -> Arrays:
    result = operands[0].copy()
    rows = np.moveaxis(result, params["axis"], 0)
    rows = rows[::-1] if params["reverse"] else rows
    for k in range(1, len(rows)):
        combine = functools.partial(builder.apply, op)
        rows[k, ...] = elementwise(combine, rows[k - 1], rows[k])
    return [result]


def _extreme_place(op: str, builder: Builder, operands: Arrays, params: dict) -> Arrays:
    """Return the index of the first NaN if there is one, else of the first largest or smallest."""
    (x,), (axis,), dtype = operands, params["axes"], np.dtype(params["index_dtype"])
    x = np.moveaxis(x, axis, 0)

    def better(old: Node, new: Node) -> Node:
        beyond = builder.apply(op, new, old)
        nan = builder.apply("ne", new, new)
        good = builder.apply("eq", old, old)
        return builder.apply("or", beyond, builder.apply("and", nan, good))

    best, place = x[0], np.full(x.shape[1:], builder.constant(0, dtype))
    for k in range(1, len(x)):
        number = builder.constant(k, dtype)
        chosen = elementwise(better, best, x[k])
        place = elementwise(lambda c, old, k=number: builder.select(c, k, old), chosen, place)
        best = elementwise(builder.select, chosen, x[k], best)
    return [np.asarray(place, object)]


def _dot_general(builder: Builder, operands: Arrays, params: dict) -> Arrays:
    a, b = operands
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
        result[n, i, j] = _scalar_product(builder, a[n, i], b[n, j])
    return [result.reshape((*batch, *outer_a, *outer_b))]


def _scalar_product(builder: Builder, a: np.ndarray, b: np.ndarray) -> Node:
    """Return a sum of products. Terms with equal constant factors, up to the sign, share one.

    Coordinates of points on a regular grid differ by their signs only. The common terms of their
    rows are then computed once. The order of summation, and so the rounding, differs from the
    original product.
    """
    groups: dict[Node, list[tuple[bool, Node]]] = {}
    for x, y in zip(a, b, strict=True):
        factor, other = (x, y) if x.value is not None else (y, x)
        if factor.value is None:
            factor, other, negative = builder.constant(1, x.dtype), builder.multiply(x, y), False
        else:
            negative = bool(factor.value < 0)
            factor = builder.negate(factor) if negative else factor
        if factor.value != 0:
            groups.setdefault(factor, []).append((negative, other))
    total = builder.constant(0, a[0].dtype)
    for factor, terms in groups.items():
        # The first term sets the sign of the product, so that a - b and b - a are the same node.
        flip = terms[0][0]
        inner = terms[0][1]
        for negative, term in terms[1:]:
            combine = builder.add if negative == flip else builder.subtract
            inner = combine(inner, term)
        product = builder.multiply(factor, inner)
        total = builder.subtract(total, product) if flip else builder.add(total, product)
    return total


def _select_n(builder: Builder, operands: Arrays, params: dict) -> Arrays:
    which, *cases = operands
    if all(node.dtype.kind == "b" for node in which.flat):
        return [elementwise(lambda w, no, yes: builder.select(w, yes, no), which, *cases)]
    result = cases[-1]
    for k in range(len(cases) - 2, -1, -1):
        number = k

        def choose(w: Node, here: Node, later: Node, number: int = number) -> Node:
            is_it = builder.apply("le", w, builder.constant(number, w.dtype))
            return builder.select(is_it, here, later)

        result = elementwise(choose, which, cases[k], result)
    return [result]


def _rounded(builder: Builder, operands: Arrays, params: dict) -> Arrays:
    if params["rounding_method"] == jax.lax.RoundingMethod.TO_NEAREST_EVEN:
        return [elementwise(functools.partial(builder.apply, "round"), *operands)]

    def away_from_zero(x: Node) -> Node:
        size = builder.apply("abs", x)
        below = builder.apply("floor", size)
        half = builder.apply("ge", builder.subtract(size, below), builder.constant(0.5, x.dtype))
        up = builder.add(
            below, builder.select(half, *(builder.constant(v, x.dtype) for v in (1, 0)))
        )
        return builder.multiply(up, builder.apply("sign", x))

    return [elementwise(away_from_zero, *operands)]


def _power(builder: Builder, operands: Arrays, params: dict) -> Arrays:
    return [elementwise(lambda x: builder.power(x, params["y"]), *operands)]


def _conversion(op: str, builder: Builder, operands: Arrays, params: dict) -> Arrays:
    dtype = np.dtype(params["new_dtype"])
    return [elementwise(functools.partial(builder.apply, op, dtype=dtype), *operands)]


_ELEMENTWISE: dict[str, Callable[..., Node]] = {
    "add_any": Builder.add,
    "clamp": lambda b, low, x, high: b.apply("min", b.apply("max", low, x), high),
    # The product keeps all digits near one. JAX 0.12 added this primitive for `tanh`.
    "one_minus_square": lambda b, x: b.multiply(
        b.subtract(one := b.constant(1, x.dtype), x), b.add(one, x)
    ),
    "rsqrt": lambda b, x: b.apply("div", b.constant(1, x.dtype), b.apply("sqrt", x)),
    "square": lambda b, x: b.power(x, 2),
}
"""Rules of primitives on scalars. A rule maps a builder and nodes to a node."""

_RULES: dict[str, Rule] = {
    **MOVES,
    "argmax": functools.partial(_extreme_place, "gt"),
    "argmin": functools.partial(_extreme_place, "lt"),
    "bitcast_convert_type": functools.partial(_conversion, "bitcast"),
    "convert_element_type": functools.partial(_conversion, "convert"),
    "cummax": functools.partial(_cumulative, "max"),
    "cummin": functools.partial(_cumulative, "min"),
    "cumprod": functools.partial(_cumulative, "mul"),
    "cumsum": functools.partial(_cumulative, "add"),
    "dot_general": _dot_general,
    "integer_pow": _power,
    "reduce_and": functools.partial(_reduction, "and"),
    "reduce_max": functools.partial(_reduction, "max"),
    "reduce_min": functools.partial(_reduction, "min"),
    "reduce_or": functools.partial(_reduction, "or"),
    "reduce_prod": functools.partial(_reduction, "mul"),
    "reduce_sum": functools.partial(_reduction, "add"),
    "round": _rounded,
    "select_n": _select_n,
}
"""Rules of primitives on arrays. A rule maps operands and parameters to results."""
