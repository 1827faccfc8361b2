"""Make the nodes of a graph in which equal nodes are shared.

The builder folds constants, applies the rewrite rules (`evo_cpg.native.frontend.simplify`), and
returns an equal node if one exists. So a creature's zeros (a centre of mass on the joint, a
principal axis) cost nothing in the end.

A node belongs to the innermost block among those of its operands. So values that do not change in
a loop are computed before the loop.
"""

import contextlib
import functools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from evo_cpg.native.frontend.simplify import FOLDED, RULES, RewriteRule
from evo_cpg.native.ir import (
    COMMUTATIVE,
    PREDICATES,
    Buffer,
    Graph,
    GraphBlock,
    GraphLoop,
    GraphPart,
    Node,
    row_count,
)


class Builder:
    """Maker of nodes. If an equal node exists, the builder returns that node.

    Args:
        rules: rewrite rules by operation, tried in order.

    Attributes:
        top: block of the whole program.
        block: block in which loops are currently made.
        active: node that is true for individuals that run the block, or None if all individuals do.
        part: name of the part whose nodes are currently made.
    """

    def __init__(self, rules: Mapping[str, Sequence[RewriteRule]] = RULES):
        self.top = self.block = GraphBlock()
        self.active: Node | None = None
        self.part = ""
        self._rules = {op: [rule.apply for rule in each] for op, each in rules.items()}
        self._arguments: list[Buffer] = []
        self._made: list[Node] = []
        self._loops: dict[GraphBlock, Node] = {}
        self._parts: list[GraphPart] = []
        # Equal nodes of the current part, and those of the parts around it.
        self._nodes: dict[Any, Node] = {}
        self._outside: list[dict[Any, Node]] = []
        self._constants: dict[Any, Node] = {}

    def argument(self, shape: Sequence[int], dtype: Any, shared: bool = False) -> np.ndarray:
        """Add an argument and return its nodes. An array without elements is not added."""
        dtype, size = np.dtype(dtype), int(np.prod(shape, dtype=int))
        places = [(len(self._arguments), row) for row in range(size)]
        if size:
            self._arguments.append(Buffer(size, dtype, shared))
        return node_array(
            [self.new("input", (), dtype, self.top, shared, detail=place) for place in places],
            shape,
        )

    def graph(self, results: Sequence[np.ndarray]) -> Graph:
        """Return the program with the given arrays of nodes as its results."""
        rows = [tuple(nodes.flat) for nodes in results if nodes.size]
        return Graph(
            arguments=tuple(self._arguments),
            results=tuple((Buffer(len(nodes), nodes[0].dtype), nodes) for nodes in rows),
            top=self.top,
            nodes=self._made,
            loops=self._loops,
            parts=tuple(self._parts),
            kept={
                node: tuple(range(len(node.operands))) for node in self._made if node.op == "loop"
            },
        )

    def begin_part(self) -> None:
        """Begin a program within the program. It shares no nodes with the code around it."""
        self._outside.append(self._nodes)
        self._nodes = {}

    def end_part(
        self, arguments: Iterable[Node], results: Iterable[Node], reorder: bool = True
    ) -> int:
        """End a program within the program (`GraphPart`) and return its number."""
        self._parts.append(GraphPart(tuple(arguments), tuple(results), reorder, self.part))
        self._nodes = self._outside.pop()
        return len(self._parts) - 1

    def constant(self, value: Any, dtype: Any) -> Node:
        """Return a constant of the given type."""
        value = np.asarray(value, dtype)[()]
        key = (value.dtype.char, value.tobytes())
        node = self._constants.get(key)
        if node is None:
            node = self.new("constant", (), value.dtype, self.top, True, value=value)
            self._constants[key] = node
        return node

    def alias(
        self, op: str, node: Node, block: GraphBlock | None = None, part: int | None = None
    ) -> Node:
        """Return another node for the same number. A constant is returned unchanged.

        Args:
            op: "opaque" to hide everything but the type of the number, or "inside" to have all
                values that are computed from the new node in its block.
            node: the original node.
            block: block of the new node, or None for the block of ``node``.
            part: number of the part whose result an opaque node is, or None for an argument.
        """
        if node.value is not None:
            return node
        return self.new(op, (node,), node.dtype, block or node.block, node.uniform, detail=part)

    def make(self, op: str, operands: Sequence[Node], dtype: Any, detail: Any = None) -> Node:
        """Return an existing equal node, or a new node without simplification.

        The detail, other data of the operation, must be hashable.
        """
        operands, dtype = tuple(operands), np.dtype(dtype)
        key = (op, dtype.char, detail, operands)
        node = self._nodes.get(key)
        if node is None:
            block, uniform = self.top, True
            for operand in operands:
                if operand.block.depth > block.depth:
                    block = operand.block
                uniform = uniform and operand.uniform
            node = self.new(op, operands, dtype, block, uniform, detail=detail)
            self._nodes[key] = node
        return node

    def table(self, column: Sequence[Node]) -> Node:
        """Return a table of numbers for lookups at computed indices."""
        dtype, first = column[0].dtype, column[0]
        if first.op == "lookup" and first.operands[0].op in ("list", "totals"):
            # If the column is a whole list in order, the table is that list.
            whole = first.operands[0]
            of_it = all(node.op == "lookup" and node.operands[0] is whole for node in column)
            places = [node.operands[1].value for node in column] if of_it else []
            if places == list(range(row_count(whole))):
                return whole
        if all([node.value is not None for node in column]):
            values = np.array([node.value for node in column], dtype)
            return self.make("constants", (), dtype, values.tobytes())
        return self.make("rows", column, dtype)

    def lookup(self, table: Node, index: Node) -> Node:
        """Return the number at an index (int32) of a table or list."""
        if index.value is not None and table.op == "rows":
            return table.operands[int(index.value)]
        if index.value is not None and isinstance(table.detail, bytes):
            values = np.frombuffer(table.detail, table.dtype)
            return self.constant(values[int(index.value)], table.dtype)
        return self.make("lookup", (table, index), table.dtype)

    def rows(self, table: Node, shape: Sequence[int]) -> np.ndarray:
        """Return all numbers of a table or list."""
        places = [self.constant(place, np.int32) for place in range(row_count(table))]
        return node_array([self.lookup(table, place) for place in places], shape)

    def loop(self, start: Sequence[Node], loop: GraphLoop) -> tuple[list[Node], list[Node]]:
        """Add a loop to the current block, with its initial carried values.

        Return the final carried values and the lists of the loop.
        """
        block, flag = self.block, np.dtype(bool)
        node = self.new("loop", tuple(start), flag, block, False, detail=loop)
        self._loops |= {loop.test: node, loop.body: node}
        results = [
            self.new("result", (node,), one.dtype, block, False, detail=k)
            for k, one in enumerate(loop.carried)
        ]
        lists = [
            self.new("list", (node,), one.dtype, block, False, detail=k)
            for k, one in enumerate(loop.written)
        ]
        return results, lists

    @contextlib.contextmanager
    def within(self, block: GraphBlock, active: Node | None = None) -> Iterator[None]:
        """Make the loops of a ``with`` statement in the given block.

        Args:
            block: a block within the current block.
            active: node that is true for individuals that run the block, or None for no change.
        """
        outer = self.block, self.active
        self.block, self.active = block, active or self.active
        try:
            yield
        finally:
            self.block, self.active = outer

    def apply(self, op: str, *operands: Node, dtype: Any = None) -> Node:
        """Return the result of a JAX primitive on scalars, simplified.

        A conversion needs the type of its result.
        """
        first, kind = operands[0], operands[-1].dtype
        if op in ("convert", "bitcast"):
            kind, value = np.dtype(dtype), first.value
            if kind == first.dtype:
                return first
            if value is not None and op == "bitcast":
                return self.constant(value.view(kind), kind)
            ends = np.iinfo(kind) if kind.kind in "iu" and first.dtype.kind == "f" else None
            # NumPy does not saturate, so a constant out of range is left to the processor.
            if value is not None and (ends is None or ends.min <= float(value) <= ends.max):
                with np.errstate(all="ignore"):
                    return self.constant(value.astype(kind), kind)
            return self.make(op, operands, kind)
        if op in PREDICATES:
            kind = np.dtype(bool)
        for node in operands:
            if node.value is None:
                break
        else:
            if op in FOLDED:
                with np.errstate(all="ignore"):
                    return self.constant(FOLDED[op](*[node.value for node in operands]), kind)
        for simplify in self._rules.get(op, ()):
            simpler = simplify(self, *operands)
            if simpler is not None:
                return simpler
        if op in COMMUTATIVE:
            # Constants go last, other nodes in order of creation.
            a, b = operands
            if (a.value is not None, a.number) > (b.value is not None, b.number):
                operands = b, a
        return self.make(op, operands, kind)

    def apply_each(self, op: str, *arrays: Any, dtype: Any = None) -> np.ndarray:
        """Apply an operation element by element, with broadcasting."""
        return elementwise(functools.partial(self.apply, op, dtype=dtype), *arrays)

    def power(self, base: Node, exponent: int) -> Node:
        """Return an integer power, by repeated squaring."""
        if exponent < 0:
            return self.apply("div", self.constant(1, base.dtype), self.power(base, -exponent))
        if exponent == 0:
            return self.constant(1, base.dtype)
        half = self.power(base, exponent // 2)
        square = self.apply("mul", half, half) if exponent > 1 else half
        return self.apply("mul", square, base) if exponent % 2 else square

    def new(
        self,
        op: str,
        operands: tuple[Node, ...],
        dtype: np.dtype,
        block: GraphBlock,
        uniform: bool,
        value: Any = None,
        detail: Any = None,
    ) -> Node:
        """Return a new node in any case."""
        number = len(self._made) + 1
        node = Node(op, operands, dtype, block, uniform, number, value, detail, self.part)
        self._made.append(node)
        return node


def node_array(nodes: Sequence[Node], shape: Sequence[int]) -> np.ndarray:
    """Return nodes as an array of the given shape."""
    result = np.empty(len(nodes), object)
    result[:] = nodes
    return result.reshape(shape)


def all_nodes(arrays: Iterable[np.ndarray]) -> tuple[Node, ...]:
    """Return the nodes of all arrays in order."""
    return tuple([node for array in arrays for node in array.flat])


def elementwise(make: Callable[..., Node], *arrays: Any) -> np.ndarray:
    """Apply a function of nodes element by element, with broadcasting."""
    # Constants that are not finite are JAX's business, which does not warn of them, either.
    with np.errstate(all="ignore"):
        return np.asarray(np.frompyfunc(make, len(arrays), 1)(*arrays), object)
