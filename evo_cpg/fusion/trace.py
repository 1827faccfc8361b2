"""From a JAX program on small arrays to a graph of scalars.

An array becomes a NumPy array of nodes. Whatever only moves numbers about (slices, stacks,
transposes) is then done by NumPy while tracing and leaves nothing behind; sums and small matrix
products become additions and multiplications; elementwise operations one node per element.
"""

import collections
import functools
from collections.abc import Callable

import jax
import numpy as np
from jax.extend.core import Jaxpr, Literal, Primitive

from evo_cpg.fusion.graph import Graph, Node
from evo_cpg.fusion.moves import MOVES
from evo_cpg.fusion.primitives import array_call_p, linear_map_p, trace_of
from evo_cpg.fusion.sine import cosine, has_polynomial, sine

# Programs within the program, by primitive, and the parameter that holds them.
_CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
}

# What `jax.checkpoint` makes of a function; see `evo_cpg.fusion.kernels.recomputed`.
_RECOMPUTED = {"checkpoint", "remat", "remat2"}

_ELEMENTWISE = {
    "abs",
    "acos",
    "add",
    "and",
    "asin",
    "atan",
    "atan2",
    "ceil",
    "convert_element_type",
    "cos",
    "div",
    "eq",
    "erf",
    "exp",
    "expm1",
    "floor",
    "ge",
    "gt",
    "integer_pow",
    "is_finite",
    "le",
    "log",
    "log1p",
    "logistic",
    "lt",
    "max",
    "min",
    "mul",
    "ne",
    "neg",
    "not",
    "or",
    "pow",
    "rem",
    "round",
    "rsqrt",
    "select_n",
    "sign",
    "sin",
    "sqrt",
    "square",
    "sub",
    "tan",
    "tanh",
    "xor",
}

_POLYNOMIALS = {"cos": cosine, "sin": sine}


def trace(
    graph: Graph, jaxpr: Jaxpr, consts: list[np.ndarray], inputs: list[np.ndarray]
) -> list[np.ndarray]:
    """The program's outputs as arrays of nodes.

    Args:
        graph: where the nodes are made.
        jaxpr: the program.
        consts: values of its constants, arrays of nodes.
        inputs: values of its arguments, arrays of nodes.

    Raises:
        NotImplementedError: the program holds something that is not scalar arithmetic (a loop, a
            branch, a random number).
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
        name = equation.primitive.name
        if name in _CALLS:
            inner = equation.params[_CALLS[name]]
            values = [constants(graph, np.asarray(value)) for value in inner.consts]
            results = trace(graph, inner.jaxpr, values, operands)
        elif name in _RECOMPUTED:
            if equation.params["differentiated"]:
                operands = [_map(graph, graph.again, operand) for operand in operands]
            results = trace(graph, equation.params["jaxpr"], [], operands)
        elif equation.primitive is array_call_p:
            shapes = [(out.aval.shape, _type(out)) for out in equation.outvars]  # pyright: ignore
            results = graph.call(equation.params["function"], operands, shapes)
        elif equation.primitive is linear_map_p:
            inner = trace_of(equation.params, [atom.aval for atom in equation.invars])
            values = [constants(graph, np.asarray(value)) for value in inner.consts]
            results = trace(graph, inner.jaxpr, values, operands)
        elif all(operand.size == 0 for operand in operands):
            results = _evaluate(graph, equation, operands)
        elif name in _ELEMENTWISE:
            results = [_elementwise(graph, equation, operands)]
        elif name == "add_any":
            results = [_map(graph, graph.add, *operands)]
        elif name in _ARRAY_RULES:
            results = _ARRAY_RULES[name](graph, operands, equation.params)
        elif all(node.value is not None for operand in operands for node in operand.flat):
            results = _evaluate(graph, equation, operands)
        else:
            raise NotImplementedError(f"{name} is not scalar arithmetic and cannot be fused")
        known.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _type(atom) -> np.dtype:
    return np.dtype(atom.aval.dtype)


def constants(graph: Graph, values: np.ndarray) -> np.ndarray:
    """An array of constant nodes."""
    nodes = [graph.constant(value, values.dtype) for value in values.flat]
    result = np.empty(len(nodes), object)
    result[:] = nodes
    return result.reshape(values.shape)


def _map(graph: Graph, make: Callable[..., Node], *arrays: np.ndarray) -> np.ndarray:
    """Apply a function of nodes element by element, with broadcasting.

    Where the elements of some operand are all lanes of one node, that is done once for them all.
    """
    arrays = tuple(np.broadcast_arrays(*arrays, subok=False))
    shape = arrays[0].shape
    rows = list(zip(*(array.flat for array in arrays), strict=True))
    result = np.empty(len(rows), object)
    single = []
    sets: dict[tuple, dict[int, list[int]]] = {}
    for place, row in enumerate(rows):
        sources = tuple(node.source and node.source[0] for node in row)
        first = next((node.source for node in row if node.source is not None), None)
        if first is None:
            single.append(place)
        else:
            sets.setdefault(sources, {}).setdefault(first[1], []).append(place)
    for sources, lanes in sets.items():
        count = next(source.lanes for source in sources if source is not None)
        if len({len(lanes.get(i, ())) for i in range(count)}) > 1:
            single += [place for places in lanes.values() for place in places]
            continue
        for places in zip(*(lanes[i] for i in range(count)), strict=True):
            packs = zip(*(rows[place] for place in places), strict=True)
            whole = make(*(graph.pack(pack) for pack in packs))
            for i, place in enumerate(places):
                result[place] = graph.lane(whole, i)
    for place in single:
        result[place] = make(*rows[place])
    return result.reshape(shape)


def _evaluate(graph: Graph, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    """Any other primitive on constants, by JAX itself."""
    values = [
        np.array([node.value for node in operand.flat], _type(atom)).reshape(operand.shape)
        for operand, atom in zip(operands, equation.invars, strict=True)
    ]
    with jax.ensure_compile_time_eval():
        results = equation.primitive.bind(*values, **equation.params)
    results = results if equation.primitive.multiple_results else [results]
    return [constants(graph, np.asarray(result)) for result in results]


def _elementwise(graph: Graph, equation, operands: list[np.ndarray]) -> np.ndarray:
    primitive, params = equation.primitive, equation.params
    polynomial = _POLYNOMIALS.get(primitive.name)
    if polynomial is not None and has_polynomial(_type(equation.invars[0])):
        return _map(graph, functools.partial(polynomial, graph), *operands)
    return _map(graph, lambda *nodes: graph.apply(primitive, params, nodes), *operands)


def _reduction(primitive):
    def reduce(graph, operands, params):
        (x,), axes = operands, params["axes"]
        kept = [i for i in range(x.ndim) if i not in axes]
        rows = x.transpose(*kept, *axes).reshape(*(x.shape[i] for i in kept), -1)
        if any(_all_lanes(row) for row in rows.reshape(-1, rows.shape[-1])):
            return [np.apply_along_axis(functools.partial(_combine, graph, primitive), -1, rows)]
        total = rows[..., 0]
        for k in range(1, rows.shape[-1]):
            total = _map(graph, lambda *two: graph.apply(primitive, {}, two), total, rows[..., k])
        return [np.asarray(total, object)]

    return reduce


def _all_lanes(row: np.ndarray) -> list[Node]:
    """The nodes all of whose lanes are among some scalars."""
    found = collections.Counter(node.source[0] for node in row if node.source is not None)
    return [node for node, count in found.items() if count == node.lanes]


def _combine(graph: Graph, primitive: Primitive, row: np.ndarray) -> Node:
    """The sum (product, maximum, ...) of scalars; the lanes of a node are combined as such."""

    def both(a: Node, b: Node) -> Node:
        return graph.apply(primitive, {}, (a, b))

    whole = _all_lanes(row)
    totals: dict[int, Node] = {}
    for node in whole:
        totals[node.lanes] = both(totals[node.lanes], node) if node.lanes in totals else node
    terms = [node for node in row if node.source is None or node.source[0] not in whole]
    for node in totals.values():
        if primitive is jax.lax.add_p:
            terms.append(graph.lane_sum(node))
        else:
            terms += [graph.lane(node, i) for i in range(node.lanes)]
    return functools.reduce(both, terms)


def _dot_general(graph, operands, params):
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
    return [result.reshape(*batch, *outer_a, *outer_b)]


def _scalar_product(graph: Graph, a: np.ndarray, b: np.ndarray) -> Node:
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


def _side_by_side(graph, operands, params):
    (x,) = operands
    result = np.empty(x.shape, object)
    for index in np.ndindex(x.shape[:-1]):
        whole = graph.pack(tuple(x[index]))
        result[index] = [graph.lane(whole, i) for i in range(x.shape[-1])]
    return [result]


def _together(graph, operands, params):
    nodes = (
        node.source[0] if node.source else node for operand in operands for node in operand.flat
    )
    company = tuple(dict.fromkeys(node for node in nodes if node.is_operation))
    for node in company:
        node.company = company
    return operands


_ARRAY_RULES: dict[str, Callable[[Graph, list[np.ndarray], dict], list[np.ndarray]]] = {
    **MOVES,
    "dot_general": _dot_general,
    "optimization_barrier": _together,
    "reduce_and": _reduction(jax.lax.and_p),
    "reduce_max": _reduction(jax.lax.max_p),
    "reduce_min": _reduction(jax.lax.min_p),
    "reduce_or": _reduction(jax.lax.or_p),
    "reduce_sum": _reduction(jax.lax.add_p),
    "side_by_side": _side_by_side,
}
