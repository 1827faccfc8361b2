"""Make the nodes of a graph in which equal nodes are shared.

The builder folds constants, applies the rewrite rules (`evo_cpg.native.frontend.simplify`), and
returns an equal node if one exists. So a creature's zeros (a centre of mass on the joint, a
principal axis) cost nothing in the end.

A node belongs to the innermost of the blocks of its operands. So values that do not change in a
loop are computed before the loop.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from evo_cpg.native.frontend.simplify import FOLDED, RULES, Rule, saturates
from evo_cpg.native.ir.graph import Block, Buffer, Graph, Loop, Node, Part, row_count, table_values
from evo_cpg.native.ir.types import COMMUTATIVE, PREDICATES


class Sums:
    """An array in memory that a loop carries and only adds to.

    Attributes:
        shape: shape of the array.
        memory: node of its memory.
        added: nodes that add to the array.
    """

    def __init__(self, shape: tuple[int, ...], memory: Node):
        self.shape, self.memory = shape, memory
        self.added: list[Node] = []


class Builder:
    """Maker of nodes. If an equal node exists, the builder returns that node.

    Args:
        rules: rewrite rules by operation, tried in order.

    Attributes:
        top: block of the whole program.
        block: block in which loops are currently made.
        active: node that is true for individuals that run the block, or None if all individuals do.
    """

    def __init__(self, rules: Mapping[str, Sequence[Rule]] = RULES):
        self.top = self.block = Block()
        self.active: Node | None = None
        self._rules = {op: [rule.apply for rule in each] for op, each in rules.items()}
        self._arguments: list[Buffer] = []
        self._made: list[Node] = []
        self._loops: dict[Block, Node] = {}
        self._parts: list[Part] = []
        self._nodes: dict[Any, Node] = {}
        self._constants: dict[Any, Node] = {}

    def argument(self, shape: Sequence[int], dtype: Any, shared: bool = False) -> np.ndarray:
        """Add an argument and return its nodes. An array without elements is not added."""
        dtype, size = np.dtype(dtype), int(np.prod(shape, dtype=int))
        places = [(len(self._arguments), row) for row in range(size)]
        if size:
            self._arguments.append(Buffer(size, dtype, shared))
        return node_array(
            [self._new("input", (), dtype, self.top, shared, detail=place) for place in places],
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

    def end_part(
        self, arguments: Iterable[Node], results: Iterable[Node], reorder: bool = True
    ) -> int:
        """End a program within the program. Equal nodes before and after its end are not shared.

        Args:
            arguments: first nodes of the part.
            results: last nodes of the part.
            reorder: whether the order of summation may change.

        Returns:
            Number of the part.
        """
        self._parts.append(Part(tuple(arguments), tuple(results), reorder))
        self._nodes.clear()
        return len(self._parts) - 1

    def constant(self, value: Any, dtype: Any) -> Node:
        """Return a constant of the given type."""
        value = np.asarray(value, dtype)[()]
        key = (value.dtype.char, value.tobytes())
        node = self._constants.get(key)
        if node is None:
            node = self._new("constant", (), value.dtype, self.top, True, value=value)
            self._constants[key] = node
        return node

    def placeholder(self, op: str, dtype: Any, block: Block, uniform: bool = False) -> Node:
        """Return a node for a carried value or the counter of a loop."""
        return self._new(op, (), np.dtype(dtype), block, uniform)

    def opaque(self, node: Node, block: Block | None = None, part: int | None = None) -> Node:
        """Return an opaque node for the same number. Only the type of the number is known.

        A constant is returned unchanged.

        Args:
            node: the original node.
            block: block of the new node, or None for the block of ``node``.
            part: number of the part whose result the node is, or None for an argument.
        """
        if node.value is not None:
            return node
        block = block or node.block
        return self._new("opaque", (node,), node.dtype, block, node.uniform, detail=part)

    def inside(self, node: Node, block: Block) -> Node:
        """Return a node for the same number. Values computed from the new node are in the block."""
        if node.value is not None:
            return node
        return self._new("inside", (node,), node.dtype, block, node.uniform)

    def make(self, op: str, operands: Sequence[Node], dtype: Any, detail: Any = None) -> Node:
        """Return an existing equal node, or a new node without simplification.

        Args:
            op: name of the operation.
            operands: operand nodes.
            dtype: type of the value.
            detail: other data of the operation, hashable.
        """
        return self._found(op, tuple(operands), np.dtype(dtype), detail)

    def _found(self, op: str, operands: tuple[Node, ...], dtype: np.dtype, detail: Any) -> Node:
        key = (op, dtype.char, detail, operands)
        node = self._nodes.get(key)
        if node is None:
            block, uniform = self.top, True
            for operand in operands:
                if operand.block.depth > block.depth:
                    block = operand.block
                uniform = uniform and operand.uniform
            node = self._new(op, operands, dtype, block, uniform, detail=detail)
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
        if index.value is not None and table.op == "constants":
            return self.constant(table_values(table)[int(index.value)], table.dtype)
        return self.make("lookup", (table, index), table.dtype)

    def solve(self, triangle: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the solution of symmetric equations, by a function that loops.

        Args:
            triangle: lower triangle of the matrix, row by row.
            b: right-hand side.
        """
        return self.rows(self.make("solve", (*triangle, *b), b[0].dtype, len(b)), b.shape)

    def rows(self, table: Node, shape: Sequence[int]) -> np.ndarray:
        """Return all numbers of a table or list."""
        places = [self.constant(place, np.int32) for place in range(row_count(table))]
        return node_array([self.lookup(table, place) for place in places], shape)

    def sums(self, start: np.ndarray) -> Sums:
        """Return sums in memory with the given initial nodes, all of one type."""
        nodes = tuple(start.flat)
        memory = self._new("sums", nodes, nodes[0].dtype, self.block, False)
        return Sums(start.shape, memory)

    def accumulate(self, sums: Sums, index: Node, value: Node) -> None:
        """Add a number to the sum at an index (int32, equal for all individuals)."""
        if self.active is not None and not self.active.uniform:
            value = self.select(self.active, value, self.constant(0, value.dtype))
        operands = index, value, sums.memory
        sums.added.append(self._new("accumulate", operands, value.dtype, self.block, False))

    def totals(self, sums: Sums) -> np.ndarray:
        """Return the final sums after the loop that was made last."""
        operands = (sums.memory, *sums.added)
        table = self._new("totals", operands, sums.memory.dtype, self.block, False)
        return self.rows(table, sums.shape)

    def loop(self, start: Sequence[Node], loop: Loop) -> tuple[list[Node], list[Node]]:
        """Add a loop to the current block.

        Args:
            start: initial carried values.
            loop: the loop.

        Returns:
            Final carried values, and the lists of the loop.
        """
        block, flag = self.block, np.dtype(bool)
        node = self._new("loop", tuple(start), flag, block, False, detail=loop)
        self._loops |= {loop.test: node, loop.body: node}
        results = [
            self._new("result", (node,), one.dtype, block, False, detail=k)
            for k, one in enumerate(loop.carried)
        ]
        lists = [
            self._new("list", (node,), one.dtype, block, False, detail=k)
            for k, one in enumerate(loop.written)
        ]
        return results, lists

    @contextlib.contextmanager
    def within(self, block: Block, active: Node | None = None) -> Iterator[None]:
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
        """Return the result of an operation on scalars, simplified.

        Args:
            op: name of JAX's primitive.
            operands: operand nodes.
            dtype: type of the result of a conversion.
        """
        if op in ("convert", "bitcast"):
            return self._convert(op, operands[0], np.dtype(dtype))
        kind = operands[-1].dtype
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
        if op in COMMUTATIVE and _comes_later(*operands):
            operands = operands[::-1]
        return self._found(op, operands, kind, None)

    def add(self, a: Node, b: Node) -> Node:
        """Return the sum a + b."""
        return self.apply("add", a, b)

    def subtract(self, a: Node, b: Node) -> Node:
        """Return the difference a - b."""
        return self.apply("sub", a, b)

    def multiply(self, a: Node, b: Node) -> Node:
        """Return the product a b."""
        return self.apply("mul", a, b)

    def negate(self, a: Node) -> Node:
        """Return -a."""
        return self.apply("neg", a)

    def select(self, condition: Node, yes: Node, no: Node) -> Node:
        """Return ``yes`` if the condition holds, else ``no``."""
        return self.apply("select", condition, yes, no)

    def convert(self, a: Node, dtype: Any) -> Node:
        """Return the number converted to another type."""
        return self.apply("convert", a, dtype=dtype)

    def power(self, base: Node, exponent: int) -> Node:
        """Return an integer power, by repeated squaring."""
        if exponent < 0:
            return self.apply("div", self.constant(1, base.dtype), self.power(base, -exponent))
        if exponent == 0:
            return self.constant(1, base.dtype)
        half = self.power(base, exponent // 2)
        square = self.multiply(half, half) if exponent > 1 else half
        return self.multiply(square, base) if exponent % 2 else square

    def _convert(self, op: str, operand: Node, dtype: np.dtype) -> Node:
        if dtype == operand.dtype:
            return operand
        if operand.value is not None and op == "bitcast":
            return self.constant(operand.value.view(dtype), dtype)
        if operand.value is not None and not saturates(operand, dtype):
            with np.errstate(all="ignore"):
                return self.constant(operand.value.astype(dtype), dtype)
        return self.make(op, (operand,), dtype)

    def _new(
        self,
        op: str,
        operands: tuple[Node, ...],
        dtype: np.dtype,
        block: Block,
        uniform: bool,
        value: Any = None,
        detail: Any = None,
    ) -> Node:
        node = Node(op, operands, dtype, block, uniform, len(self._made) + 1, value, detail)
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
    return np.asarray(np.frompyfunc(make, len(arrays), 1)(*arrays), object)


def _comes_later(a: Node, b: Node) -> bool:
    """Return whether b must go before a: constants go last, other nodes in order of creation."""
    if a.value is not None or b.value is not None:
        return a.value is not None
    return a.number > b.number
