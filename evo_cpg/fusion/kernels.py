"""Evaluate an array program for all individuals in few large kernels.

XLA:CPU gives every small matrix product of an articulated body a kernel of its own: reading and
writing memory and starting hundreds of kernels then costs several times the arithmetic. Here the
program is traced for one individual down to scalars (`evo_cpg.fusion.trace`), cut into pieces of
some hundred operations, and each piece becomes *one* loop over the individuals, in which every
intermediate value lives in a vector register.

The loop is a variadic `jax.lax.reduce` over a broadcast axis of two whose combiner ignores what
it has accumulated and maps the new operands to the results: XLA compiles a combiner as one scalar
function with many results, inlines it and vectorises the loop around it. The broadcast and the
slices that pick the operands out of packed arrays fuse into the loop. (An axis of one would be
simplified away.)

Derivatives are those of the original program, which JAX differentiates as usual.
"""

import collections
import contextlib
import contextvars
import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr

from evo_cpg.fusion.graph import Call, Graph, Node
from evo_cpg.fusion.trace import array_call_p, constants, trace
from evo_cpg.spatial.linear import compute_once

# Most operations in one kernel, and most arrays that it reads and writes: LLVM's alias analysis
# gives up beyond 250 of them, and the loop is then not vectorised.
KERNEL_SIZE = 1200
KERNEL_ARRAYS = 240

# Cuts are considered every so many operations; starting a kernel costs as much as so many arrays.
_CUT_STRIDE = 20
_KERNEL_COST = 10

_tracing = contextvars.ContextVar("tracing", default=False)


def fuse(function: Callable, *args: Any, batch_ndim: int) -> Any:
    """``function(*args)``, computed in few large kernels.

    Args:
        function: of pytrees of arrays, with any number of trailing batch axes, none included;
            individual by individual, without loops, branches or random numbers.
        args: arrays whose last ``batch_ndim`` axes are the same for all.
        batch_ndim: number of batch axes.

    Raises:
        NotImplementedError: the function does something else than scalar arithmetic.
    """
    if _tracing.get() or jax.default_backend() != "cpu":
        return function(*args)
    leaves, structure = jax.tree.flatten(args)
    batch = leaves[0].shape[leaves[0].ndim - batch_ndim :]
    singles = [
        jax.ShapeDtypeStruct(leaf.shape[: leaf.ndim - batch_ndim], leaf.dtype) for leaf in leaves
    ]

    def plain(*leaves):
        return tuple(jax.tree.leaves(function(*structure.unflatten(leaves))))

    with _inlining():
        program, result = jax.make_jaxpr(function, return_shape=True)(*structure.unflatten(singles))
    closed_over = [value for value in program.consts if isinstance(value, jax.core.Tracer)]
    if closed_over:
        plain = functools.partial(_for_each, program, len(closed_over), batch_ndim)

    @jax.custom_jvp
    def fused(*values):
        return _evaluate(program, values[: len(closed_over)], values[len(closed_over) :], batch)

    @fused.defjvp
    def _(primals, tangents):
        return jax.jvp(plain, primals, tangents)

    return jax.tree.structure(result).unflatten(fused(*closed_over, *leaves))


def _for_each(
    program: ClosedJaxpr, shared_count: int, batch_ndim: int, *values: jax.Array
) -> tuple:
    """The program for all individuals without fusing it; the first values are common to all."""
    shared, own = iter(values[:shared_count]), values[shared_count:]
    consts = [next(shared) if isinstance(c, jax.core.Tracer) else c for c in program.consts]

    def one(*leaves):
        return tuple(jax.core.eval_jaxpr(program.jaxpr, consts, *leaves))

    for _ in range(batch_ndim):
        one = jax.vmap(one, in_axes=-1, out_axes=-1)
    return one(*own)


def _evaluate(
    program: ClosedJaxpr,
    shared: tuple[jax.Array, ...],
    leaves: tuple[jax.Array, ...],
    batch: tuple[int, ...],
) -> tuple:
    """Outputs of the program for all individuals.

    Args:
        program: for one individual.
        shared: in place of its constants that are being traced.
        leaves: its arguments, with the batch axes behind.
        batch: lengths of the batch axes.
    """
    graph = Graph()
    place: dict[Node, tuple[int, int]] = {}
    arrays = [*shared, *leaves]

    def as_nodes(i: int, shape: tuple[int, ...]) -> np.ndarray:
        nodes = np.empty(shape, object)
        for row, index in enumerate(np.ndindex(shape)):
            node = nodes[index] = graph.input((i, row), np.dtype(arrays[i].dtype))
            place[node] = (i, row)
        return nodes

    inputs = [
        as_nodes(i, leaf.shape[: leaf.ndim - len(batch)])
        for i, leaf in enumerate(leaves, len(shared))
    ]
    shared_nodes = iter([as_nodes(i, array.shape) for i, array in enumerate(shared)])
    consts = [
        next(shared_nodes)
        if isinstance(value, jax.core.Tracer)
        else constants(graph, np.asarray(value))
        for value in program.consts
    ]
    outputs = trace(graph, program.jaxpr, consts, inputs)

    individuals = int(np.prod(batch, dtype=int))
    packed = [
        jnp.broadcast_to(array.reshape(-1, 1), (array.size, individuals)) for array in shared
    ] + [leaf.reshape(-1, individuals) for leaf in leaves]
    values: dict[Node, jax.Array] = {}

    def value(node: Node) -> jax.Array:
        if node.value is not None:
            return jnp.full(individuals, node.value, node.dtype)
        if node in place:
            i, row = place[node]
            return jax.lax.slice_in_dim(packed[i], row, row + 1).reshape(individuals)
        return values[node]

    wanted = [node for array in outputs for node in array.flat]
    for piece, kept in cut(wanted):
        if isinstance(piece[0].primitive, Call):
            values.update(_evaluate_call(piece[0].primitive, value, batch))
        elif piece[0].costly:
            values.update(_evaluate_costly(piece, value))
        else:
            operands = _operands(piece)
            results = _run(piece, operands, kept, [value(node) for node in operands])
            values.update(zip(kept, results, strict=True))
    results = []
    for array in outputs:
        rows = [value(node)[None] for node in array.flat]
        whole = jnp.concatenate(rows) if rows else jnp.zeros((0, individuals))
        results.append(whole.reshape(*array.shape, *batch))
    return tuple(results)


def together(tree: Any) -> Any:
    """The same values, marked as wanted at the same time within a fused function.

    The program is ordered backwards from its results, one after the other. Where many results
    share much of their work (an articulated inertia and its wrench), computing them together
    spares storing what they share.
    """
    return jax.lax.optimization_barrier(tree) if _tracing.get() else tree


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


def cut(wanted: list[Node]) -> list[tuple[list[Node], list[Node]]]:
    """Order the operations behind the wanted nodes and cut them into pieces.

    Returns:
        For each piece its operations, and those of them that are needed outside. The costly
        functions of one kind whose operands are ready together make a piece of their own.
    """
    order = _depth_first(wanted)
    uses = collections.Counter(wanted)
    for node in order:
        uses.update(set(node.operands))
    stage = _stages(order)
    pieces: list[list[Node]] = []
    for level in range(max(stage.values(), default=-1) + 1):
        kinds: dict[Any, list[Node]] = {}
        for node in order:
            if stage[node] == level:
                kinds.setdefault(_kind(node), []).append(node)
        for nodes in sorted(
            kinds.values(), key=lambda nodes: (nodes[0].costly, nodes[0].precision is not None)
        ):
            pieces.extend([nodes] if nodes[0].costly else _chunks(nodes, uses))
    owner = {node: i for i, piece in enumerate(pieces) for node in piece}
    needed = set(wanted)
    for i, piece in enumerate(pieces):
        needed.update(o for node in piece for o in node.operands if owner.get(o) != i)
    return [(piece, [node for node in piece if node in needed]) for piece in pieces]


def _kind(node: Node) -> Any:
    """Nodes of a kind can share a kernel."""
    if isinstance(node.primitive, Call):
        return node.primitive
    if node.costly:
        operand_types = tuple(operand.dtype for operand in node.operands)
        return node.primitive, repr(sorted(node.params.items())), operand_types
    return node.precision


def _stages(order: list[Node]) -> dict[Node, int]:
    """For each node, before which costly functions it has to be computed: as late as possible."""
    last = max((node.level for node in order), default=0)
    stage = dict.fromkeys(order, last)
    for node in reversed(order):
        if node.costly:
            stage[node] = node.level
        for operand in node.operands:
            if operand in stage:
                stage[operand] = min(stage[operand], stage[node])
    return stage


def _depth_first(wanted: list[Node]) -> list[Node]:
    """Operations in an order in which a value is computed shortly before it is used."""
    done: set[Node] = set()
    order: list[Node] = []
    for root in wanted:
        stack = [(root, False)]
        while stack:
            node, expanded = stack.pop()
            if node in done or not node.is_operation:
                continue
            if expanded:
                done.add(node)
                order.append(node)
            else:
                if node.company:
                    company, node.company = node.company, ()
                    stack.append((node, False))
                    stack.extend((other, False) for other in reversed(company))
                    continue
                stack.append((node, True))
                latest_last = sorted(node.operands, key=lambda operand: operand.number)
                stack.extend((operand, False) for operand in latest_last)
    return order


def _chunks(order: list[Node], uses: dict[Node, int]) -> list[list[Node]]:
    """Cut a sequence of operations where the fewest values have to be stored and read again.

    Dynamic programming over the places of possible cuts, one every `_CUT_STRIDE` operations.
    """
    cuts = [*range(0, len(order), _CUT_STRIDE), len(order)]
    cost = dict.fromkeys(cuts, np.inf)
    previous: dict[int, int] = {}
    cost[0] = 0
    for start in cuts[:-1]:
        for stop, arrays in _extensions(order, start, uses):
            if cost[start] + arrays + _KERNEL_COST < cost[stop]:
                cost[stop] = cost[start] + arrays + _KERNEL_COST
                previous[stop] = start
    chunks, stop = [], len(order)
    while stop:
        chunks.append(order[previous[stop] : stop])
        stop = previous[stop]
    return chunks[::-1]


def _extensions(order: list[Node], start: int, uses: dict[Node, int]) -> Iterator[tuple[int, int]]:
    """Places up to which one kernel can go from a start, and how many arrays it then touches."""
    pending: dict[Node, int] = {}
    inputs: set[Node] = set()
    results = 0
    for stop in range(start + 1, min(start + KERNEL_SIZE, len(order)) + 1):
        node = order[stop - 1]
        for operand in set(node.operands):
            if operand in pending:
                pending[operand] -= 1
                results -= not pending[operand]
            elif operand.value is None:
                inputs.add(operand)
        pending[node] = uses[node]
        results += 1
        arrays = len(inputs) + max(len(inputs), results)
        first = stop - start <= _CUT_STRIDE
        if 2 * len(inputs) > KERNEL_ARRAYS and not first:
            return
        if (stop % _CUT_STRIDE == 0 or stop == len(order)) and (arrays <= KERNEL_ARRAYS or first):
            yield stop, arrays


def _operands(piece: list[Node]) -> list[Node]:
    """What a piece reads, constants apart, in a fixed order."""
    inside = set(piece)
    outside = {
        operand: None
        for node in piece
        for operand in node.operands
        if operand not in inside and operand.value is None
    }
    return list(outside)


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
        jnp.broadcast_to(jnp.zeros((), dtype) if i is None else values[i][None], (2, individuals))
        for i, dtype in zip(slots, slot_types, strict=True)
    )

    def combine(_, new):
        known = {operands[i]: x for i, x in zip(slots, new, strict=True) if i is not None}
        for node in piece:
            known[node] = node.primitive.bind(
                *(known[o] if o.value is None else o.value for o in node.operands), **node.params
            )
        return (*(known[node] for node in kept), *(new[len(kept) :]))

    start = tuple(np.zeros((), dtype)[()] for dtype in slot_types)
    results = jax.lax.reduce(padded, start, combine, (0,))
    if rest:
        # Or a rule of StableHLO tries for ten seconds to get rid of results that nobody uses.
        results = jax.lax.optimization_barrier(results)
    return list(results)[: len(kept)]


def _evaluate_costly(
    piece: list[Node], value: Callable[[Node], jax.Array]
) -> dict[Node, jax.Array]:
    """Evaluate one function for all nodes of a piece, over one array."""
    first = piece[0]
    count = len(first.operands)
    stacked = [jnp.stack([value(node.operands[k]) for node in piece]) for k in range(count)]
    results = first.primitive.bind(*stacked, **first.params)
    if jnp.issubdtype(results.dtype, jnp.floating):
        results = compute_once(results)
    return {node: results[i] for i, node in enumerate(piece)}


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
