"""Lower loops and branches of a JAX program to loops of the graph.

Both sides of a short branch are computed and one result is selected, as under `jax.vmap`. A vector
skips a long branch if none of its individuals takes it.

Arrays stay in memory if a loop carries them and only writes to their elements (`Sums`), or if a
loop stacks them over its rounds (`Stacked`). A backward pass reads what the forward pass has
stacked.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr

from evo_cpg.native import jax_internals as internals
from evo_cpg.native import machine_constants
from evo_cpg.native.frontend.builder import Builder, all_nodes, elementwise, node_array
from evo_cpg.native.frontend.moves import SCATTER_ADD, clamped
from evo_cpg.native.frontend.primitives import equations, programs_in
from evo_cpg.native.ir import GraphBlock, GraphLoop, Node, Unsupported, resolve

Trace = Callable[..., list[Any]]


@dataclasses.dataclass(eq=False)
class Sums:
    """An array in memory that a loop carries and only writes to.

    Attributes:
        shape: shape of the array.
        memory: node of its memory.
        written: nodes that write to the array.
    """

    shape: tuple[int, ...]
    memory: Node
    written: list[Node] = dataclasses.field(default_factory=list)

    def read(self, builder: Builder) -> np.ndarray:
        """Return the elements after all writes."""
        given = self.memory, *self.written
        totals = builder.new("totals", given, self.memory.dtype, builder.block, False)
        return builder.rows(totals, self.shape)


def _in_memory(builder: Builder, x: np.ndarray) -> Sums:
    """Put an array of nodes in memory."""
    return Sums(x.shape, builder.new("sums", tuple(x.flat), x.flat[0].dtype, builder.block, False))


@dataclasses.dataclass(eq=False)
class Stacked:
    """Results of all rounds of a loop, which stay in memory until an operation needs them as nodes.

    Attributes:
        shape: shape of the array, the rounds first.
        columns: for each element of a round's result, its list, or the node of a constant result.
    """

    shape: tuple[int, ...]
    columns: list[Node]

    @property
    def size(self) -> int:
        """Number of numbers."""
        return self.shape[0] * len(self.columns)

    def row(self, builder: Builder, index: Node) -> np.ndarray:
        """Return the results of one round."""
        row = [builder.lookup(x, index) if x.op == "list" else x for x in self.columns]
        return node_array(row, self.shape[1:])

    def nodes(self, builder: Builder) -> np.ndarray:
        """Return all results as nodes.

        Raises:
            Unsupported: if there are too many.
        """
        most = machine_constants.MOST_OPERATIONS
        if self.size > most:
            raise Unsupported(f"a loop stacks more than {most} numbers that are not read in a loop")
        rounds = [builder.constant(k, np.int32) for k in range(self.shape[0])]
        return np.stack([self.row(builder, k) for k in rounds])


def as_nodes(builder: Builder, x: Any) -> Any:
    """Return an array of nodes for a `Stacked` array, and any other array unchanged."""
    return x.nodes(builder) if isinstance(x, Stacked) else x


def _write(builder: Builder, operands: list, params: dict, adds: bool) -> list:
    """Add to rows of an array, or set them, at places that may differ by individual.

    A place outside the array is clamped, or nothing is written if JAX drops it. An array of nodes
    is put in memory and read again.

    Raises:
        Unsupported: if the elements at a place are no whole row.
    """
    sums, indices, updates = operands
    if not isinstance(sums, Sums):
        if not _writes_rows(params, [x.shape for x in operands]):
            raise Unsupported("no rule for a scatter to parts of rows at computed places")
        memory = _in_memory(builder, sums)
        _write(builder, [memory, indices, updates], params, adds)
        return [memory.read(builder)]
    dtype, count, size = sums.memory.dtype, sums.shape[0], int(np.prod(sums.shape[1:], dtype=int))
    for place, values in zip(indices.reshape(-1), updates.reshape(-1, size), strict=True):
        index = clamped(builder, place, count - 1)
        valid = builder.constant(True, bool)
        if builder.active is not None and not builder.active.uniform:
            valid = builder.active
        if "DROP" in str(params["mode"]):
            same = builder.apply("convert", index, dtype=place.dtype)
            valid = builder.apply("and", valid, builder.apply("eq", same, place))
        index = builder.apply("mul", index, builder.constant(size, np.int32))
        # Later values replace earlier ones, so a write follows the other writes of its block.
        earlier = [node for node in sums.written if node.block is builder.block]
        given = index, valid, *values, *earlier[-1:], sums.memory
        detail = size, adds
        sums.written.append(builder.new("write", given, dtype, builder.block, False, detail=detail))
    return [sums]


SCATTER = ("scatter",)

WRITES: dict[str, Callable[[Builder, list, dict], list]] = {
    **dict.fromkeys(SCATTER_ADD, functools.partial(_write, adds=True)),
    **dict.fromkeys(SCATTER, functools.partial(_write, adds=False)),
}
"""Rules by the name of JAX's primitive, for an array in memory."""


def _scan(builder: Builder, operands: list[Any], params: dict, trace: Trace) -> list[Any]:
    """Lower a counted loop. Its inputs per round are in tables, its stacked outputs in lists.

    Raises:
        Unsupported: if the loop stacks more numbers than native code keeps.
    """
    constant_count, carry_count = internals.scan_counts(params)
    length, closed = params["length"], params["jaxpr"]
    consts = operands[:constant_count]
    start = [as_nodes(builder, x) for x in operands[constant_count : constant_count + carry_count]]
    read = operands[constant_count + carry_count :]
    stacked = closed.out_avals[carry_count:]
    if length == 0:
        return [*start, *(np.empty((0, *aval.shape), object) for aval in stacked)]

    def one_round(index: Node, carried: list[Any]) -> list[Any]:
        rows = []
        for x in read:
            if isinstance(x, Stacked):
                rows.append(x.row(builder, index))
                continue
            columns = [builder.table(list(column)) for column in x.reshape(len(x), -1).T]
            row = [builder.lookup(column, index) for column in columns]
            rows.append(node_array(row, x.shape[1:]))
        return trace(builder, closed, [*consts, *carried, *rows])

    written = [
        not isinstance(x, Sums) and _only_writes(closed.jaxpr, constant_count + k, k, _writers(x))
        for k, x in enumerate(start)
    ]
    if length == 1 and not any(written):
        results = one_round(builder.constant(0, np.int32), start)
        return [*results[:carry_count], *(x[None] for x in results[carry_count:])]
    test = GraphBlock(builder.block)
    body = GraphBlock(test)
    counter = builder.new("counter", (), np.dtype(np.int32), body, uniform=True)
    begin = [_in_memory(builder, x) if here else x for x, here in zip(start, written, strict=True)]
    carried = [_placeholders(builder, x, body) for x in begin]
    with builder.within(body):
        index = counter
        if params["reverse"]:
            index = builder.apply("sub", builder.constant(length - 1, np.int32), counter)
        results = one_round(index, carried)
    # A value that does not change within the loop needs no list, and equal values share one.
    listed = {resolve(x): x for x in all_nodes(results[carry_count:]) if body.encloses(x.block)}
    if length * len(listed) > machine_constants.LONGEST_LISTS:
        most = machine_constants.LONGEST_LISTS
        raise Unsupported(f"a loop of {length} rounds stacks more than {most} numbers")
    loop = GraphLoop(
        length, test, body, counter, _carried(carried), _carried(results[:carry_count]), None,
        index, tuple(listed.values()),
    )  # fmt: skip
    ends, lists = builder.loop(_carried(begin), loop)
    # The sums of a loop around this loop are not complete yet, so they are not read.
    ends = [
        x.read(builder) if here else x for x, here in zip(_like(ends, begin), written, strict=True)
    ]
    column = dict(zip(listed, lists, strict=True))
    stacks = [
        Stacked(
            (length, *x.shape),
            [column[key] if (key := resolve(node)) in column else node for node in x.flat],
        )
        for x in results[carry_count:]
    ]
    return [*ends, *stacks]


def _writers(start: np.ndarray) -> tuple[str, ...]:
    """Return the primitives that may write to an array in memory, by its initial elements.

    Elements are set only in an array from `unset`, whose other elements are never read.
    """
    is_unset = start.size and start.flat[0].op == "constant" and start.flat[0].detail
    return SCATTER if is_unset else SCATTER_ADD


def _writes_rows(params: dict, shapes: Sequence[tuple[int, ...]]) -> bool:
    """Return whether a scatter writes whole rows, at indices of the first axis."""
    numbers, (whole, (*batch, depth), new) = params["dimension_numbers"], shapes
    rows = depth == 1 and numbers.inserted_window_dims == (0,) and not numbers.operand_batching_dims
    window = tuple(range(len(batch), len(new)))
    return rows and numbers.update_window_dims == window and new[len(batch) :] == whole[1:]


def _only_writes(jaxpr: Jaxpr, into: int, out: int, writers: tuple[str, ...]) -> bool:
    """Return whether a program only writes to argument ``into``, and returns it as ``out``.

    ``writers`` are the names of the primitives that may write.
    """
    array: Any = jaxpr.invars[into]
    for equation in jaxpr.eqns:
        places = [k for k, atom in enumerate(equation.invars) if atom is array]
        if not places:
            continue
        if len(places) > 1:
            return False
        (place,), name, params = places, equation.primitive.name, equation.params
        if name in writers:
            shapes = [atom.aval.shape for atom in equation.invars]  # pyright: ignore
            if place or not _writes_rows(params, shapes):
                return False
            array = equation.outvars[0]
        elif name in ("jit", "pjit") or (name == "cond" and place):
            inner, place = (
                (params["branches"], place - 1) if name == "cond" else ([params["jaxpr"]], place)
            )
            outs = [
                k
                for k in range(len(inner[0].jaxpr.outvars))
                if all(_only_writes(each.jaxpr, place, k, writers) for each in inner)
            ]
            if not outs:
                return False
            array = equation.outvars[outs[0]]
        elif name == "scan":
            constants, carries = internals.scan_counts(params)
            inner, program = place - constants, params["jaxpr"].jaxpr
            if not 0 <= inner < carries or not _only_writes(program, place, inner, writers):
                return False
            array = equation.outvars[inner]
        else:
            return False
    ends = [k for k, atom in enumerate(jaxpr.outvars) if atom is array]
    return ends == [out]


def _while(
    builder: Builder, operands: list[np.ndarray], params: dict, trace: Trace
) -> list[np.ndarray]:
    """Lower a loop that ends when the condition holds for no individual.

    Individuals that are done keep their values.
    """
    of_test, of_body = params["cond_nconsts"], params["body_nconsts"]
    test_consts, body_consts = operands[:of_test], operands[of_test : of_test + of_body]
    start = operands[of_test + of_body :]
    test = GraphBlock(builder.block)
    body = GraphBlock(test)
    carried = [_placeholders(builder, x, test) for x in start]
    with builder.within(test):
        (condition,) = trace(builder, params["cond_jaxpr"], [*test_consts, *carried])
        condition = condition.item()
        if builder.active is not None and not condition.uniform:
            # The inner loop may end although its condition holds for individuals that are done in
            # the outer loop.
            condition = builder.apply("and", condition, builder.active)
    # The body must not share nodes with the test, which runs before the condition is known.
    hide = functools.partial(builder.alias, "opaque", block=body)
    again = [elementwise(hide, x) for x in carried]
    with builder.within(body, None if condition.uniform else condition):
        results = trace(builder, params["body_jaxpr"], [*body_consts, *again])
    loop = GraphLoop(
        None, test, body, None, all_nodes(carried), all_nodes(results), condition, None, ()
    )
    ends, _ = builder.loop(all_nodes(start), loop)
    return _like(ends, start)


def _cond(builder: Builder, operands: list, params: dict, trace: Trace) -> list:
    """Lower a branch.

    Raises:
        Unsupported: if the first branch, which is always computed, adds to an array.
    """
    which, *given = operands
    number, branches = which.item(), params["branches"]
    if number.value is not None:
        place = int(np.clip(int(number.value), 0, len(branches) - 1))
        return trace(builder, branches[place], given)
    sums = [x for x in given if isinstance(x, Sums)]
    before = [len(x.written) for x in sums]
    results = trace(builder, branches[0], given)
    if before != [len(x.written) for x in sums]:
        raise Unsupported("a branch adds to an array even if its condition is false")
    for k, branch in enumerate(branches[1:], 1):
        more = "eq" if k + 1 < len(branches) else "ge"
        narrow = builder.apply("convert", number, dtype=np.int32)
        here = builder.apply(more, narrow, builder.constant(k, np.int32))
        results = _branch(builder, branch, given, here, results, trace)
    return results


def _branch(
    builder: Builder, branch: ClosedJaxpr, given: list, here: Node, otherwise: list, trace: Trace
) -> list:
    """Return the branch's results for individuals that take it, else the other results."""
    adds = any(isinstance(x, Sums) for x in otherwise)
    # The approximate number of scalars that the branch computes, each loop's body once.
    leaves = [each for each in equations(branch.jaxpr) if not any(programs_in(each))]
    length = sum(atom.aval.size for each in leaves for atom in each.outvars)
    if not adds and length < machine_constants.SHORTEST_BRANCH:
        results = trace(builder, branch, given)
        both = zip(results, otherwise, strict=True)
        return [builder.apply_each("select", here, yes, no) for yes, no in both]
    test = GraphBlock(builder.block)
    body = GraphBlock(test)
    with builder.within(test):
        condition = builder.alias("inside", here, test)
        if builder.active is not None:
            condition = builder.apply("and", condition, builder.active)
    carried = [_placeholders(builder, x, body) for x in otherwise]

    def hide(node: Node) -> Node:
        """Return a node as seen from the branch, so that code only for the branch is inside it.

        A number of a list stays unchanged, so that the list is not copied.
        """
        listed = node.op == "lookup" and node.operands[0].op in ("list", "totals")
        here = node.block is builder.block and not listed
        return builder.alias("inside", node, body) if here else node

    inside = [x if isinstance(x, Sums) else elementwise(hide, x) for x in given]
    with builder.within(body, condition):
        results = trace(builder, branch, inside)
    values = _carried(carried), _carried(results)
    loop = GraphLoop(None, test, body, None, *values, condition, None, (), once=True)
    ends, _ = builder.loop(_carried(otherwise), loop)
    return _like(ends, otherwise)


LOOPS: dict[str, Callable[[Builder, list[np.ndarray], dict, Trace], list[np.ndarray]]] = {
    "cond": _cond,
    "scan": _scan,
    "while": _while,
}


def _carried(arrays: Sequence[Any]) -> tuple[Node, ...]:
    """Return the nodes of the arrays that a loop carries. An array in memory stays in its place."""
    return all_nodes(x for x in arrays if not isinstance(x, Sums))


def _placeholders(builder: Builder, like: Any, block: GraphBlock) -> Any:
    if isinstance(like, Sums):
        return like
    return elementwise(lambda x: builder.new("carried", (), x.dtype, block, False), like)


def _like(nodes: list[Node], arrays: Sequence[Any]) -> list[Any]:
    """Return consecutive nodes in arrays of the same shapes as other arrays."""
    given = iter(nodes)
    return [
        x if isinstance(x, Sums) else node_array([*itertools.islice(given, x.size)], x.shape)
        for x in arrays
    ]
