"""Compute a graph in NumPy, without instructions, registers or memory, to find faults.

The interpreter follows the meaning of the operations (`evo_cpg.native.ir`) node by node, in the
order of the blocks. It is a second opinion on every pass and on the machine code.
"""

from collections.abc import Callable, Sequence
from itertools import count as from_zero

import numpy as np
from scipy import special

from evo_cpg.native.frontend.simplify import FOLDED
from evo_cpg.native.ir import LIBRARY, Graph, GraphBlock, GraphLoop, Node, home, resolve, runs_of


def interpret(graph: Graph, arguments: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the results of a graph, each ``(rows, n)``.

    Args:
        graph: graph after any pass.
        arguments: numbers of each argument, ``(rows, n)``, or ``(rows,)`` if individuals share it.
    """
    count = next((x.shape[1] for x in arguments if x.ndim > 1), 1)
    with np.errstate(all="ignore"):
        run = _Interpreter(graph, arguments, count)
        run.block(graph.top)
        return [
            np.array([np.broadcast_to(run.value(node), count) for node in nodes])
            for _, nodes in graph.results
        ]


class _Interpreter:
    """Values of nodes and tables. A value has one number per individual, or one if uniform."""

    def __init__(self, graph: Graph, arguments: Sequence[np.ndarray], count: int):
        self.graph, self.runs = graph, graph.runs or runs_of(graph)
        self.lanes = np.arange(count)
        self.values: dict[Node, np.ndarray] = {}
        self.tables: dict[Node, np.ndarray] = {}
        for node in graph.nodes:
            if node.op == "input":
                self.values[node] = arguments[node.detail[0]][node.detail[1]]
            elif node.op == "list":
                rounds = node.operands[0].detail.count or 1
                self.tables[node] = np.zeros((rounds, count), node.dtype)

    def value(self, node: Node) -> np.ndarray:
        """Return the current value of a node."""
        node = resolve(node)
        return np.asarray(node.value) if node.value is not None else self.values[home(node)]

    def block(self, block: GraphBlock) -> None:
        """Compute the operations and the loops of a block."""
        for nodes, loop in self.runs.get(block, ()):
            for node in nodes:
                self._operation(node)
            if loop is not None:
                self._loop(loop, loop.detail)

    def _operation(self, node: Node) -> None:
        if node.op in ("list", "result"):
            return
        if node.op == "constants":
            self.tables[node] = np.frombuffer(node.detail, node.dtype)
        elif node.op == "totals":
            self.tables[node] = self.tables[node.operands[0]]
        elif node.op in ("rows", "sums", "solve"):
            rows = [np.broadcast_to(self.value(x), self.lanes.shape) for x in node.operands]
            table = np.array(rows, node.dtype)
            self.tables[node] = _solution(table, node.detail) if node.op == "solve" else table
        elif node.op == "write":
            (size, adds), table = node.detail, self.tables[node.operands[-1]]
            index, valid, *values = map(self.value, node.operands[: 2 + size])
            for k, value in enumerate(values):
                old = table[index + k, self.lanes]
                table[index + k, self.lanes] = np.where(valid, old * adds + value, old)
        elif node.op == "lookup":
            table, index = self.tables[node.operands[0]], self.value(node.operands[1])
            self.values[node] = table[index] if table.ndim == 1 else table[index, self.lanes]
        else:
            given = [self.value(x) for x in node.operands]
            self.values[node] = np.asarray(_compute(node, *given)).astype(node.dtype, copy=False)

    def _loop(self, node: Node, loop: GraphLoop) -> None:
        """Run a loop or a branch. Individuals whose condition is false keep their values."""
        kept, active = self.graph.kept[node], np.asarray(True)
        lists = [table for table in self.tables if table.op == "list" and table.operands[0] is node]
        for k in kept:
            self.values[loop.carried[k]] = self.value(node.operands[k])
        last = 1 if loop.once else loop.count
        for number in range(last) if last else from_zero():
            if loop.condition is not None:
                self.block(loop.test)
                active = self.value(loop.condition)
            if not active.any():
                return
            if loop.counter is not None:
                self.values[loop.counter] = np.asarray(number, np.int32)
            self.block(loop.body)
            place = None if loop.index is None else (self.value(loop.index), self.lanes)
            for one in lists:
                self.tables[one][place] = self.value(loop.written[one.detail])
            ends = [self.value(loop.following[k]) for k in kept]
            for k, end in zip(kept, ends, strict=True):
                self.values[loop.carried[k]] = np.where(active, end, self.value(loop.carried[k]))


def _compute(node: Node, *given: np.ndarray) -> np.ndarray:
    """Return the result of an operation on numbers."""
    x, dtype = given[0], node.dtype
    if node.op == "bitcast":
        return x.view(dtype)
    if node.op != "convert":
        return _OPERATIONS[node.op](*given)
    if x.dtype.kind != "f" or dtype.kind not in "iu":
        return x.astype(dtype)
    # Floats beyond the range of an integer become its ends.
    low, high = np.iinfo(dtype).min, np.iinfo(dtype).max
    whole = np.where((x > low) & (x < high), x, 0).astype(dtype)
    return np.where(x >= high, high, np.where(x <= low, low, whole)).astype(dtype)


def _quotient(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Divide. Integers round towards zero, and a zero divisor gives -1."""
    if x.dtype.kind == "f":
        return x / y
    return np.where(y == 0, -1, (x - np.fmod(x, y)) // np.where(y == 0, 1, y))


def _solution(table: np.ndarray, count: int) -> np.ndarray:
    """Solve symmetric equations, given the rows of their lower triangle and the right-hand side."""
    H = np.zeros((table.shape[1], count, count), table.dtype)
    rows, columns = np.tril_indices(count)
    H[:, rows, columns] = H[:, columns, rows] = table[:-count].T
    return np.linalg.solve(H, table[-count:].T[..., None])[..., 0].T


_OPERATIONS: dict[str, Callable[..., np.ndarray]] = {
    **FOLDED,
    **{name: getattr(np, name, None) or getattr(special, name) for name in {*LIBRARY} - {"lgamma"}},
    "div": _quotient,
    "fma": lambda x, y, z: x * y + z,
    "fms": lambda x, y, z: x * y - z,
    "fnma": lambda x, y, z: z - x * y,
    "lgamma": special.gammaln,
    "rem": lambda x, y: np.where((y == 0) & (x.dtype.kind != "f"), x, np.fmod(x, y)),
    "select": np.where,
    "shift_right_arithmetic": lambda x, y: x.view(f"i{x.itemsize}") >> y.view(f"i{y.itemsize}"),
    "shift_right_logical": lambda x, y: x.view(f"u{x.itemsize}") >> y.view(f"u{y.itemsize}"),
}
"""NumPy's functions for operations. Integers of the right size may have another type."""
