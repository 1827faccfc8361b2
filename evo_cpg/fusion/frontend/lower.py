"""From a JAX program on small arrays to a graph of scalars.

An array becomes a NumPy array of nodes. Whatever only moves numbers about (slices, stacks,
transposes) is then done by NumPy while tracing and leaves nothing behind; sums and small matrix
products become additions and multiplications; elementwise operations one node per element.
"""

import functools
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from evo_cpg.fusion import jax_internals as internals
from evo_cpg.fusion.frontend.builder import Builder, Sums
from evo_cpg.fusion.frontend.elementary import FLOAT32
from evo_cpg.fusion.frontend.loops import LOOPS
from evo_cpg.fusion.frontend.moves import MOVES, SCATTER_ADD, add_to_sums
from evo_cpg.fusion.frontend.primitives import Program, fused_p, linear_map_p, trace_of
from evo_cpg.fusion.frontend.symmetric_solve import eliminate, eliminate_p, elimination_of
from evo_cpg.fusion.ir.graph import Graph, Node
from evo_cpg.fusion.unsupported import Unsupported

# Programs within the program, by primitive, and the parameter that holds them.
_CALLS = {
    "checkpoint": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "remat2": "jaxpr",
}

# Operations on scalars that the graph knows by the name of JAX's primitive.
_SCALAR = {
    "abs", "add", "and", "ceil", "div", "eq", "floor", "ge", "gt", "is_finite", "le", "lt", "max",
    "min", "mul", "ne", "neg", "not", "or", "rem", "shift_left", "shift_right_arithmetic",
    "shift_right_logical", "sign", "sqrt", "sub", "xor",
}  # fmt: skip

# Functions that the C library has for float64, by the name of JAX's primitive.
LIBRARY = {
    "acos": "acos", "acosh": "acosh", "asin": "asin", "asinh": "asinh", "atan": "atan",
    "atan2": "atan2", "atanh": "atanh", "cbrt": "cbrt", "cos": "cos", "cosh": "cosh", "erf": "erf",
    "erfc": "erfc", "exp": "exp", "exp2": "exp2", "expm1": "expm1", "lgamma": "lgamma",
    "log": "log", "log1p": "log1p", "pow": "pow", "sin": "sin", "sinh": "sinh", "tan": "tan",
    "tanh": "tanh",
}  # fmt: skip

_LINEAR_SOLVE = "custom_linear_solve"
_OWN = {linear_map_p.name, eliminate_p.name, _LINEAR_SOLVE}

Rule = Callable[[Builder, list[np.ndarray], dict], list[np.ndarray]]


def lower(program: Program, builder: Builder) -> Graph:
    """Return the graph of a program.

    Args:
        program: for one individual.
        builder: makes its nodes.

    Raises:
        Unsupported: the program holds something that cannot be written as scalars.
    """
    inputs = [
        builder.argument(x.shape, x.dtype, shared=i < program.shared)
        for i, x in enumerate(program.inputs)
    ]
    return builder.graph(trace_program(builder, program, inputs))


def trace_program(
    graph: Builder, program: Program, inputs: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """The results of a program for one individual, arrays of nodes.

    What a program computes depends on nothing around it, not even in its last digit: nothing is
    known of its inputs, and its sums are put in order before anything else uses its results. So a
    control step has the same results alone and as a part of a trial.

    Args:
        graph: where the nodes are made.
        program: what to trace.
        inputs: what it shares, and its arguments.

    Raises:
        Unsupported: the program holds something that cannot be written as scalars.
    """
    inside = [_map(graph.opaque, x) for x in inputs]
    given = iter(inside[: program.shared])
    consts = [next(given) if own is None else constants(graph, own) for own in program.constants]
    results = trace(graph, program.jaxpr, [], [*consts, *inside[program.shared :]])
    graph.end_part([node for array in results for node in array.flat])
    hide = functools.partial(graph.opaque, given=graph.given(inputs))
    return [_map(hide, x) for x in results]


def trace(
    graph: Builder, jaxpr: Jaxpr, consts: Sequence[np.ndarray], inputs: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """The program's outputs as arrays of nodes.

    Args:
        graph: where the nodes are made.
        jaxpr: the program.
        consts: values of its constants, arrays of nodes.
        inputs: values of its arguments, arrays of nodes.

    Raises:
        Unsupported: the program holds something that cannot be written as scalars.
    """
    known: dict = {}

    def read(atom) -> np.ndarray:
        if isinstance(atom, Literal):
            return constants(graph, np.asarray(atom.val, _type(atom)))
        return known[atom]

    known.update(zip(jaxpr.constvars, consts, strict=True))
    known.update(zip(jaxpr.invars, inputs, strict=True))
    for equation in jaxpr.eqns:
        operands = [read(atom) for atom in equation.invars]
        results = _equation(graph, equation, operands)
        known.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def trace_closed(
    graph: Builder, closed: ClosedJaxpr, inputs: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """`trace` of a program that brings its constants along."""
    values = [constants(graph, np.asarray(value)) for value in closed.consts]
    return trace(graph, closed.jaxpr, values, inputs)


def constants(graph: Builder, values: np.ndarray) -> np.ndarray:
    """Return an array of constant nodes; tangents of integers (float0) are False, as in JAX."""
    if values.dtype == jax.dtypes.float0:
        values = np.zeros(values.shape, bool)
    result = np.empty(values.size, object)
    result[:] = [graph.constant(value, values.dtype) for value in values.flat]
    return result.reshape(values.shape)


def is_supported(name: str) -> bool:
    """Whether there is a rule for a primitive, whatever it is applied to."""
    known = (_CALLS, _SCALAR, LOOPS, _RULES, FLOAT32, LIBRARY, _OWN)
    return internals.is_random(name) or any(name in names for names in known)


def _for_each(
    graph: Builder, program: Program, batch: tuple[int, ...], inputs: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """`trace_program`, of which each individual may hold several."""
    if not batch:
        return trace_program(graph, program, inputs)
    shared, own = inputs[: program.shared], inputs[program.shared :]
    results = [
        np.empty((*atom.aval.shape, *batch), object)  # pyright: ignore
        for atom in program.jaxpr.outvars
    ]
    for place in np.ndindex(batch):
        one = [np.asarray(x[(..., *place)], object) for x in own]
        for result, found in zip(
            results, trace_program(graph, program, [*shared, *one]), strict=True
        ):
            result[(..., *place)] = found
    return results


def _equation(graph: Builder, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    name, params = equation.primitive.name, equation.params
    if name in _CALLS:
        inner = params[_CALLS[name]]
        closed = isinstance(inner, ClosedJaxpr)
        return trace_closed(graph, inner, operands) if closed else trace(graph, inner, [], operands)
    if equation.primitive is fused_p:
        return _for_each(graph, params["program"], params["batch"], operands)
    if equation.primitive is linear_map_p:
        inner = trace_of(params, [atom.aval for atom in equation.invars])
        return trace_closed(graph, inner, operands)
    if any(isinstance(operand, Sums) for operand in operands) and name in SCATTER_ADD:
        return add_to_sums(graph, operands, params)
    if operands and all(operand.size == 0 for operand in operands):
        return _evaluate(graph, equation, operands)
    if name in _SCALAR:
        return [_map(functools.partial(graph.apply, name), *operands)]
    if name in LOOPS:
        return LOOPS[name](graph, operands, params, trace_closed)
    if equation.primitive is eliminate_p:
        answers = eliminate(graph, operands)
        if answers is not None:
            return [answers]
        inner = elimination_of([atom.aval for atom in equation.invars])
        return trace_closed(graph, inner, operands)
    if name == _LINEAR_SOLVE:
        return _solve_linear(graph, operands, params)
    if name in _RULES:
        return _RULES[name](graph, operands, params)
    if name in FLOAT32 or name in LIBRARY:
        return [_elementary(graph, name, operands, params)]
    if internals.is_random(name):
        return trace_closed(graph, internals.random_program(equation), operands)
    if all(node.value is not None for operand in operands for node in operand.flat):
        return _evaluate(graph, equation, operands)
    raise Unsupported(f"it has no rule for {name}")


def _solve_linear(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
    """What a linear system's own solver does; its other programs are for derivatives."""
    counts, jaxprs = params["const_lengths"], params["jaxprs"]
    before = counts.matvec + counts.vecmat
    given = operands[sum(counts) :]
    return trace_closed(graph, jaxprs.solve, [*operands[before : before + counts.solve], *given])


def _type(atom) -> np.dtype:
    return np.dtype(atom.aval.dtype)


def _map(make: Callable[..., Node], *arrays: np.ndarray) -> np.ndarray:
    """Apply a function of nodes element by element, with broadcasting."""
    return np.asarray(np.frompyfunc(make, len(arrays), 1)(*arrays), object)


def _evaluate(graph: Builder, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    """Any other primitive on constants, by JAX itself."""
    values = [
        np.array([node.value for node in operand.flat], _type(atom)).reshape(operand.shape)
        for operand, atom in zip(operands, equation.invars, strict=True)
    ]
    with jax.ensure_compile_time_eval():
        results = equation.primitive.bind(*values, **equation.params)
    results = results if equation.primitive.multiple_results else [results]
    return [constants(graph, np.asarray(result)) for result in results]


@functools.cache
def _in_float32(name: str, count: int) -> ClosedJaxpr:
    scalar = jax.ShapeDtypeStruct((), np.float32)
    return jax.make_jaxpr(FLOAT32[name])(*[scalar] * count)


def _elementary(graph: Builder, name: str, operands: list[np.ndarray], params: dict) -> np.ndarray:
    """A function of the C library: written out for float32, called for float64."""
    del params
    dtype = next((node.dtype for node in operands[0].flat), np.dtype(np.float32))
    if dtype == np.float32 and name in FLOAT32:
        # Written for scalars; what is elementwise takes arrays as well.
        inside = [_map(graph.opaque, x) for x in np.broadcast_arrays(*operands)]
        (result,) = trace_closed(graph, _in_float32(name, len(operands)), inside)
        # Their sums are ordered so that errors cancel.
        graph.end_part(list(result.flat), reorder=False)
        return _map(functools.partial(graph.opaque, given=graph.given(operands)), result)
    if dtype == np.float64 and name == "logistic":
        one = constants(graph, np.ones((), dtype))
        power = _elementary(graph, "exp", [_map(graph.negate, operands[0])], {})
        return _map(lambda one, e: graph.apply("div", one, graph.add(one, e)), one, power)
    if dtype != np.float64 or name not in LIBRARY:
        raise Unsupported(f"it has no {name} of {dtype}")
    return _map(lambda *x: graph.make(LIBRARY[name], x, dtype), *operands)


def _reduction(op: str) -> Rule:
    def reduce(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
        (x,), axes = operands, params["axes"]
        kept = [i for i in range(x.ndim) if i not in axes]
        rows = x.transpose(*kept, *axes).reshape(*(x.shape[i] for i in kept), -1)
        combine = functools.partial(graph.apply, op)
        total = rows[..., 0]
        for k in range(1, rows.shape[-1]):
            total = _map(combine, total, rows[..., k])
        return [np.asarray(total, object)]

    return reduce


def _cumulative(op: str) -> Rule:
    def accumulate(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
        x = np.moveaxis(operands[0], params["axis"], 0)
        x = x[::-1] if params["reverse"] else x
        rows = list(x[:1])
        for row in x[1:]:
            rows.append(_map(functools.partial(graph.apply, op), rows[-1], row))
        result = np.array(rows, object).reshape(x.shape)
        result = result[::-1] if params["reverse"] else result
        return [np.moveaxis(result, 0, params["axis"])]

    return accumulate


def _extreme_place(op: str) -> Rule:
    """Index of the first largest or smallest; of the first NaN, if there is one."""

    def find(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
        (x,), (axis,), dtype = operands, params["axes"], np.dtype(params["index_dtype"])
        x = np.moveaxis(x, axis, 0)

        def better(old: Node, new: Node) -> Node:
            beyond = graph.apply(op, new, old)
            nan = graph.apply("ne", new, new)
            good = graph.apply("eq", old, old)
            return graph.apply("or", beyond, graph.apply("and", nan, good))

        best, place = x[0], np.full(x.shape[1:], graph.constant(0, dtype))
        for k in range(1, len(x)):
            number = graph.constant(k, dtype)
            chosen = _map(better, best, x[k])
            place = _map(lambda c, old, k=number: graph.select(c, k, old), chosen, place)
            best = _map(graph.select, chosen, x[k], best)
        return [np.asarray(place, object)]

    return find


def _dot_general(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
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
        result[n, i, j] = _scalar_product(graph, a[n, i], b[n, j])
    return [result.reshape((*batch, *outer_a, *outer_b))]


def _scalar_product(graph: Builder, a: np.ndarray, b: np.ndarray) -> Node:
    """Sum of products; those with the same constant factor, up to its sign, share it.

    Points on a regular grid have coordinates that differ by their signs only: what their rows
    have in common is then computed once for all rows. The order of summation, and with it the
    rounding, is not that of the original product.
    """
    groups: dict[Node, list[tuple[bool, Node]]] = {}
    for x, y in zip(a, b, strict=True):
        factor, other = (x, y) if x.value is not None else (y, x)
        if factor.value is None:
            factor, other, negative = graph.constant(1, x.dtype), graph.multiply(x, y), False
        else:
            negative = bool(factor.value < 0)
            factor = graph.negate(factor) if negative else factor
        if factor.value != 0:
            groups.setdefault(factor, []).append((negative, other))
    total = graph.constant(0, a[0].dtype)
    for factor, terms in groups.items():
        # The first term gives the sign, so that opposite sums are the same node.
        flip = terms[0][0]
        inner = terms[0][1]
        for negative, term in terms[1:]:
            combine = graph.add if negative == flip else graph.subtract
            inner = combine(inner, term)
        product = graph.multiply(factor, inner)
        total = graph.subtract(total, product) if flip else graph.add(total, product)
    return total


def _select_n(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
    which, *cases = operands
    if all(node.dtype.kind == "b" for node in which.flat):
        return [_map(lambda w, no, yes: graph.select(w, yes, no), which, *cases)]
    result = cases[-1]
    for k in range(len(cases) - 2, -1, -1):
        number = k

        def choose(w: Node, here: Node, later: Node, number: int = number) -> Node:
            is_it = graph.apply("le", w, graph.constant(number, w.dtype))
            return graph.select(is_it, here, later)

        result = _map(choose, which, cases[k], result)
    return [result]


def _rounded(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
    if params["rounding_method"] == jax.lax.RoundingMethod.TO_NEAREST_EVEN:
        return [_map(functools.partial(graph.apply, "round"), *operands)]

    def away_from_zero(x: Node) -> Node:
        size = graph.apply("abs", x)
        whole = graph.apply("floor", size)
        half = graph.apply("ge", graph.subtract(size, whole), graph.constant(0.5, x.dtype))
        up = graph.add(whole, graph.select(half, *(graph.constant(v, x.dtype) for v in (1, 0))))
        return graph.multiply(up, graph.apply("sign", x))

    return [_map(away_from_zero, *operands)]


def _power(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
    return [_map(lambda x: graph.power(x, params.get("y", 2)), *operands)]


def _one_minus_square(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
    """As a product, which keeps all digits near one; JAX has it since 0.12, for ``tanh``."""

    def product(x: Node) -> Node:
        one = graph.constant(1, x.dtype)
        return graph.multiply(graph.subtract(one, x), graph.add(one, x))

    return [_map(product, *operands)]


def _inverse_root(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
    def inverse(x: Node) -> Node:
        return graph.apply("div", graph.constant(1, x.dtype), graph.apply("sqrt", x))

    return [_map(inverse, *operands)]


def _clamp(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
    def clamp(low: Node, x: Node, high: Node) -> Node:
        return graph.apply("min", graph.apply("max", low, x), high)

    return [_map(clamp, *operands)]


def _conversion(op: str) -> Rule:
    def convert(graph: Builder, operands: list[np.ndarray], params: dict) -> list[np.ndarray]:
        dtype = np.dtype(params["new_dtype"])
        return [_map(functools.partial(graph.apply, op, dtype=dtype), *operands)]

    return convert


_RULES: dict[str, Rule] = {
    **MOVES,
    "add_any": lambda graph, operands, params: [_map(graph.add, *operands)],
    "argmax": _extreme_place("gt"),
    "argmin": _extreme_place("lt"),
    "bitcast_convert_type": _conversion("bitcast"),
    "clamp": _clamp,
    "convert_element_type": _conversion("convert"),
    "cummax": _cumulative("max"),
    "cummin": _cumulative("min"),
    "cumprod": _cumulative("mul"),
    "cumsum": _cumulative("add"),
    "dot_general": _dot_general,
    "integer_pow": _power,
    "one_minus_square": _one_minus_square,
    "reduce_and": _reduction("and"),
    "reduce_max": _reduction("max"),
    "reduce_min": _reduction("min"),
    "reduce_or": _reduction("or"),
    "reduce_prod": _reduction("mul"),
    "reduce_sum": _reduction("add"),
    "round": _rounded,
    "rsqrt": _inverse_root,
    "select_n": _select_n,
    "square": _power,
}
