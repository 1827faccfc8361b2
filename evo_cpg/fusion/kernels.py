"""Evaluate an array program for all individuals in few large kernels.

XLA:CPU gives every small matrix product of an articulated body a kernel of its own: reading and
writing memory and starting hundreds of kernels then costs several times the arithmetic. Here the
program is traced for one individual down to scalars (`evo_cpg.fusion.trace`), cut into pieces of
some hundred operations, and each piece becomes *one* loop over the individuals, in which every
intermediate value lives in a vector register.

The loop is a variadic `jax.lax.reduce_window` with windows of one element, whose combiner ignores
what it has accumulated and maps the new operands to the results: XLA compiles a combiner as one
scalar function with many results, inlines it and vectorises the loop around it. It counts no
arithmetic in it, so it does not cut the loop up among threads either.

A fused program is one primitive to JAX until it is compiled; its derivatives are fused as well (see
`evo_cpg.fusion.derivatives`).
"""

import contextlib
import contextvars
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import core
from jax.interpreters import mlir

from evo_cpg.fusion.graph import Call, Graph, Node, lane_p, lane_sum_p, pack_p
from evo_cpg.fusion.primitives import Program, array_call_p, fused_p, gathered_p, side_by_side_p
from evo_cpg.fusion.schedule import KERNEL_ARRAYS, cut, read_by
from evo_cpg.fusion.sums import chain_sums
from evo_cpg.fusion.trace import constants, trace
from evo_cpg.spatial.linear import compute_once

# Up to so many sines, as many kernels are faster than one and what it takes to stack and part rows:
# 36 instead of 74 us for the 8 joints of 64 quadrupeds.
_FEW = 16

# Bytes, of a line of the cache and of a number of float32.
_CACHE_LINE, _SINGLE = 64, 4

_tracing = contextvars.ContextVar("tracing", default=False)


def fuse(function: Callable, *args: Any, batch_ndim: int) -> Any:
    """``function(*args)``, computed in few large kernels.

    Args:
        function: of pytrees of arrays, with any number of trailing batch axes, none included;
            individual by individual, without loops, branches or random numbers.
        args: arrays whose last ``batch_ndim`` axes are the same for all.
        batch_ndim: number of batch axes.

    Raises:
        NotImplementedError: when compiled, if the function is not scalar arithmetic.
    """
    if _tracing.get() or jax.default_backend() != "cpu":
        return function(*args)
    leaves, structure = jax.tree.flatten(args)
    batch = leaves[0].shape[leaves[0].ndim - batch_ndim :]
    singles = [
        jax.ShapeDtypeStruct(leaf.shape[: leaf.ndim - batch_ndim], leaf.dtype) for leaf in leaves
    ]

    with _inlining():
        closed, result = jax.make_jaxpr(function, return_shape=True)(*structure.unflatten(singles))
    traced = [isinstance(value, core.Tracer) for value in closed.consts]
    own = tuple(
        None if is_traced else np.asarray(value)
        for value, is_traced in zip(closed.consts, traced, strict=True)
    )
    shared = [value for value, is_traced in zip(closed.consts, traced, strict=True) if is_traced]
    program = Program(closed.jaxpr, own, len(shared))
    found = fused_p.bind(*shared, *leaves, program=program, batch=tuple(batch))
    return jax.tree.structure(result).unflatten(found)


def _evaluate(*arrays: jax.Array, program: Program, batch: tuple[int, ...]) -> list[jax.Array]:
    """Outputs of the program for all individuals.

    Args:
        arrays: what it shares, and its arguments with the batch axes behind.
        program: for one individual.
        batch: lengths of the batch axes.
    """
    shared, leaves = arrays[: program.shared], arrays[program.shared :]
    graph = Graph()
    individuals = int(np.prod(batch, dtype=int))
    floats = [x.dtype.itemsize for x in arrays if jnp.issubdtype(x.dtype, jnp.floating)]
    pad = functools.partial(_padded, max(floats, default=_SINGLE))
    values: dict[Node, jax.Array] = {}
    homes: dict[Node, tuple[jax.Array, int]] = {}  # Array of an input, and its row in it.

    def as_nodes(array: jax.Array, shape: tuple[int, ...]) -> np.ndarray:
        """Nodes for the elements of an array, given for one individual or for each."""
        nodes = np.empty(shape, object)
        if not nodes.size:
            return nodes
        rows = jnp.broadcast_to(array.reshape(nodes.size, -1), (nodes.size, individuals))
        for row, index in enumerate(np.ndindex(shape)):
            node = nodes[index] = graph.input(len(homes), np.dtype(array.dtype))
            homes[node] = rows, row
        return nodes

    inputs = [as_nodes(leaf, leaf.shape[: leaf.ndim - len(batch)]) for leaf in leaves]
    given = iter(shared)
    consts = [
        as_nodes(array := next(given), array.shape) if own is None else constants(graph, own)
        for own in program.constants
    ]
    outputs = trace(graph, program.jaxpr, consts, inputs)
    for node, each in graph.lane_constants.items():
        values[node] = jnp.asarray(pad(np.repeat(each, individuals)))

    def value(node: Node) -> jax.Array:
        if node.value is not None:
            return jnp.full(individuals, node.value, node.dtype)
        if node not in values and node.source is not None:
            whole, lane = node.source
            return _lanes(values[whole], whole.lanes, individuals)[lane]
        return values[node]

    wanted = [
        node.source[0] if node.source is not None else node
        for array in outputs
        for node in array.flat
    ]
    chain_sums(wanted)
    pieces = cut(wanted)
    for piece, _ in pieces:
        for node in piece:
            if node.primitive is pack_p and (rows := _run_of_rows(node, homes)) is not None:
                values[node] = pad(rows.reshape(-1))
    read = dict.fromkeys(wanted)
    read.update(
        (o, None) for piece, _ in pieces for n in piece if n not in values for o in n.operands
    )
    by_array: dict[int, list[Node]] = {}
    for node in read:
        if node in homes:
            by_array.setdefault(id(homes[node][0]), []).append(node)
    for nodes in by_array.values():
        values.update(_rows(homes[nodes[0]][0], {node: homes[node][1] for node in nodes}))
    for piece, kept in pieces:
        if isinstance(piece[0].primitive, Call):
            values.update(_evaluate_call(piece[0].primitive, value, batch))
        elif piece[0].primitive is pack_p:
            values.update({node: pad(_pack(node, value)) for node in piece if node not in values})
        elif piece[0].primitive is lane_p:
            values.update({node: value(node) for node in piece})
        elif piece[0].primitive is lane_sum_p:
            values.update(_add_lanes(piece, value, individuals))
        elif piece[0].costly:
            values.update(_evaluate_costly(piece, value))
        else:
            operands = read_by(piece)
            results = _run(piece, operands, kept, [values[node] for node in operands])
            values.update(zip(kept, results, strict=True))
    results = []
    for array, variable in zip(outputs, program.jaxpr.outvars, strict=True):
        rows = [value(node) for node in array.flat]
        whole = jnp.stack(rows) if rows else jnp.zeros((0,), variable.aval.dtype)  # pyright: ignore
        results.append(whole.reshape(*array.shape, *batch))
    return results


fused_p.def_impl(_evaluate)
mlir.register_lowering(fused_p, mlir.lower_fun(_evaluate, multiple_results=True))


def together(tree: Any) -> Any:
    """The same values, marked as wanted at the same time within a fused function.

    The program is ordered backwards from its results, one after the other. Where many results
    share much of their work (an articulated inertia and its wrench), computing them together
    spares storing what they share.
    """
    return jax.lax.optimization_barrier(tree) if _tracing.get() else tree


def recomputed(function: Callable) -> Callable:
    """The same function; within a fused one, its derivative computes it again.

    Nothing that it computes on the way is then passed on to the backward pass, only its arguments.
    That costs its operations once more, which is little beside storing what they give.
    """
    return jax.checkpoint(function) if _tracing.get() else function


def gathered(tree: Any) -> Any:
    """The same values; within a fused function their slopes are computed `together`."""
    if not _tracing.get():
        return tree
    leaves, structure = jax.tree.flatten(tree)
    return structure.unflatten(gathered_p.bind(*leaves))


def side_by_side(x: jax.Array) -> jax.Array:
    """The same array ``(..., k)``; within a fused function its last axis becomes lanes.

    What is the same for each of several legs is then computed in one go, by operations on arrays
    that are ``k`` times as long: kernels of fewer operations on more numbers. The lanes go on
    through everything that is computed from them in the same way for all ``k``.
    """
    return side_by_side_p.bind(x) if _tracing.get() and x.shape[-1] > 1 else x


def unfused(function: Callable, *args: Any) -> Any:
    """``function(*args)`` on whole arrays, within a fused function or not.

    For what XLA does better than scalar code: products with large constant matrices.

    Args:
        function: of pytrees of arrays, with any number of trailing batch axes.
        args: pytrees of arrays.
    """
    if not _tracing.get():
        return function(*args)
    leaves, structure = jax.tree.flatten(args)

    def flat(*leaves):
        return tuple(jax.tree.leaves(function(*structure.unflatten(leaves))))

    result = jax.eval_shape(function, *args)
    return jax.tree.structure(result).unflatten(array_call_p.bind(*leaves, function=flat))


def symmetric(m: jax.Array) -> jax.Array:
    """The same matrix ``(k, k, ...)``, known to be symmetric: fused, its lower half costs nothing.

    Outside a fused function the matrix is returned as it is.
    """
    if not _tracing.get():
        return m
    size = range(m.shape[0])
    return jnp.stack([jnp.stack([m[min(i, j), max(i, j)] for j in size]) for i in size])


def _run(
    piece: list[Node], operands: list[Node], kept: list[Node], values: list[jax.Array]
) -> list[jax.Array]:
    """Evaluate a piece in one kernel."""
    individuals = values[0].shape[0]
    # A reduction has as many results as operands, of the same types.
    types = [node.dtype for node in kept]
    order: list[int | None] = [None] * len(types)
    rest = []
    for i, node in enumerate(operands):
        slot = next((s for s, t in enumerate(types) if order[s] is None and t == node.dtype), None)
        if slot is None:
            rest.append(i)
        else:
            order[slot] = i
    slots = order + rest
    slot_types = types + [operands[i].dtype for i in rest]
    padded = tuple(
        jnp.zeros(individuals, dtype) if i is None else values[i]
        for i, dtype in zip(slots, slot_types, strict=True)
    )

    def combine(_, new):
        known = {operands[i]: x for i, x in zip(slots, new, strict=True) if i is not None}
        for node in piece:
            known[node] = node.evaluate(
                *(known[o] if o.value is None else o.value for o in node.operands)
            )
        return (*(known[node] for node in kept), *(new[len(kept) :]))

    start = tuple(np.zeros((), dtype)[()] for dtype in slot_types)
    results = jax.lax.reduce_window(padded, start, combine, (1,), (1,), ((0, 0),))
    return list(results)[: len(kept)]


def _run_of_rows(node: Node, homes: dict[Node, tuple[jax.Array, int]]) -> jax.Array | None:
    """The part of an array that holds all lanes of a node, where they stand in a row."""
    if not all(operand in homes for operand in node.operands):
        return None
    array, first = homes[node.operands[0]]
    for i, operand in enumerate(node.operands):
        home, row = homes[operand]
        if home is not array or row != first + i:
            return None
    return array[first : first + node.lanes]


def _rows(x: jax.Array, rows: dict[Node, int]) -> dict[Node, jax.Array]:
    """Rows of an array ``(k, n)``, each in memory of its own.

    By one kernel that passes them on: slices would be as many kernels. It also makes sure that
    the array is computed once, and not by every kernel that reads from it.
    """
    values: dict[Node, jax.Array] = {}
    nodes = list(rows)
    for start in range(0, len(nodes), KERNEL_ARRAYS // 2):
        some = nodes[start : start + KERNEL_ARRAYS // 2]
        twice = tuple(
            jnp.broadcast_to(x[rows[node]][None], (2, x.shape[1])) for node in [*some, some[0]]
        )
        neutral = (np.zeros((), x.dtype)[()],) * len(twice)
        results = jax.lax.reduce(twice, neutral, lambda _, new: new, (0,))
        # Or a rule of StableHLO removes what nobody uses, in a time that grows with the square.
        values.update(zip(some, jax.lax.optimization_barrier(results)[:-1], strict=True))
    return values


def _evaluate_costly(
    piece: list[Node], value: Callable[[Node], jax.Array]
) -> dict[Node, jax.Array]:
    """Evaluate one function for all nodes of a piece: few one by one, many over one array."""
    first = piece[0]
    count = len(first.operands)
    if len(piece) <= _FEW:
        return {node: node.evaluate(*map(value, node.operands)) for node in piece}
    stacked = [jnp.stack([value(node.operands[k]) for node in piece]) for k in range(count)]
    results = first.evaluate(*stacked)
    if jnp.issubdtype(results.dtype, jnp.floating):
        results = compute_once(results)
    return {node: results[i] for i, node in enumerate(piece)}


def _pack(node: Node, value: Callable[[Node], jax.Array]) -> jax.Array:
    """The lanes of a node one behind the other."""
    first = value(node.operands[0])
    if node.uniform:
        return jnp.broadcast_to(first, (node.lanes, *first.shape)).reshape(-1)
    return jnp.concatenate([value(operand) for operand in node.operands])


def _padded(itemsize: int, x: Any) -> Any:
    """An array ``(k,)``, longer by one line of the cache where it has an even number of them.

    Arrays that lie one behind the other would else compete for the same few places in the cache.

    Args:
        itemsize: of the program's floating-point numbers, bytes. Truth values become as long as
            these: a kernel reads arrays of one length.
        x: of NumPy or JAX.
    """
    line = _CACHE_LINE // itemsize
    if not len(x) or len(x) % (2 * line):
        return x
    join = np.concatenate if isinstance(x, np.ndarray) else jnp.concatenate
    return join([x, x[:line]])


def _lanes(x: jax.Array, count: int, individuals: int) -> jax.Array:
    """The lanes ``(count, individuals)`` in an array that may be longer."""
    return x[: count * individuals].reshape(count, individuals)


def _add_lanes(
    piece: list[Node], value: Callable[[Node], jax.Array], individuals: int
) -> dict[Node, jax.Array]:
    """Sums over lanes, many in one kernel."""
    sums = {}
    for start in range(0, len(piece), KERNEL_ARRAYS // 2):
        some = piece[start : start + KERNEL_ARRAYS // 2]
        packs = [node.operands[0] for node in some]
        lanes = tuple(_lanes(value(pack), pack.lanes, individuals) for pack in packs)
        neutral = tuple(np.zeros((), node.dtype)[()] for node in some)
        results = jax.lax.reduce(
            lanes, neutral, lambda total, new: tuple(map(jnp.add, total, new)), (0,)
        )
        sums.update(zip(some, results, strict=True))
    return sums


def _evaluate_call(
    call: Call, value: Callable[[Node], jax.Array], batch: tuple[int, ...]
) -> dict[Node, jax.Array]:
    """Evaluate a function of whole arrays."""
    arrays = [
        jnp.stack([value(node) for node in nodes.flat]).reshape(*nodes.shape, *batch)
        for nodes in call.inputs
    ]
    results = {}
    for nodes, array in zip(call.outputs, call.function(*arrays), strict=True):
        rows = array.reshape(nodes.size, -1)
        results.update({node: rows[i] for i, node in enumerate(nodes.flat)})
    return results


@contextlib.contextmanager
def _inlining():
    """Fused functions within the traced one are traced as they stand."""
    token = _tracing.set(True)
    try:
        yield
    finally:
        _tracing.reset(token)
