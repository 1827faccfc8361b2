"""The intermediate representation: a graph of scalar operations, for one individual.

| type | meaning |
|---|---|
| `Node` | one operation, with the types of its operands and of its result (`OPERATIONS`) |
| `GraphBlock` | the place of a node: the whole program, or the test or the body of a loop |
| `GraphLoop` | a counted loop, a loop with a condition, or a branch |
| `GraphPart` | a program within the program |
| `Graph` | a program: its arguments, its nodes, its results |

Every node has the type of one scalar and belongs to one block. A node is *uniform* if its value is
equal for all individuals. Passes read a graph and return a new graph. They never change a node.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from types import UnionType
from typing import Any, NamedTuple

import numpy as np


class Unsupported(Exception):
    """Raised if a part of a program cannot become native code, or this machine has none."""


class Buffer(NamedTuple):
    """An array that is an argument or a result of a program.

    Attributes:
        rows: count of numbers for each individual.
        dtype: type of the numbers.
        shared: whether all individuals share one set of numbers.
    """

    rows: int
    dtype: np.dtype
    shared: bool = False


class GraphBlock:
    """The place where nodes are computed.

    Attributes:
        parent: the block around it, or None for the whole program.
        depth: number of blocks around it.
    """

    def __init__(self, parent: "GraphBlock | None" = None):
        self.parent = parent
        self.depth: int = parent.depth + 1 if parent else 0

    def encloses(self, inner: "GraphBlock | None") -> bool:
        """Return whether the other block is this block or lies within it."""
        while inner is not None and inner is not self:
            inner = inner.parent
        return inner is self


@dataclasses.dataclass(slots=True, eq=False, repr=False)
class Node:
    """One scalar, or numbers in memory that other nodes read.

    Attributes:
        op: name of the operation, a key of `OPERATIONS`.
        block: block in which the node is computed.
        uniform: whether the value is equal for all individuals.
        number: order of creation. Operands come before their users.
        value: value of a constant, else None.
        detail: other data of the operation (a `GraphLoop`, the place of an input, an index).
        part: name of the program within the program that the node comes from, and after a slash
            the `jax.named_scope` in it.
    """

    op: str
    operands: "tuple[Node, ...]"
    dtype: np.dtype
    block: GraphBlock
    uniform: bool
    number: float
    value: Any = None
    detail: Any = None
    part: str = ""

    def __repr__(self) -> str:
        inside = self.value if self.value is not None else [o.number for o in self.operands]
        return f"{self.number}: {self.op} {inside}"


class GraphLoop(NamedTuple):
    """A loop over a block: ``detail`` of a node whose operands are the initial carried values.

    Attributes:
        count: number of rounds, or None for a loop that runs while the condition holds for any
            individual. The other individuals keep their values.
        test: block in which the condition is computed from the carried values.
        body: block that is repeated, within ``test``.
        counter: number of the round, from 0, of a counted loop.
        carried: placeholders for the carried values at the start of a round.
        following: the carried values at the end of a round.
        condition: truth value of an uncounted loop, or None for a counted loop.
        index: place of a round's values in the lists of a counted loop.
        written: values of each round that the lists store.
        once: whether the loop is a branch: one test, and the body runs once at most.
    """

    count: int | None
    test: GraphBlock
    body: GraphBlock
    counter: Node | None
    carried: tuple[Node, ...]
    following: tuple[Node, ...]
    condition: Node | None
    index: Node | None
    written: tuple[Node, ...]
    once: bool = False


class GraphPart(NamedTuple):
    """A program within the program, whose sums are ordered independently.

    Attributes:
        arguments: first nodes of the part.
        results: last nodes of the part.
        reorder: whether the order of summation may change.
        name: name of the part.
    """

    arguments: tuple[Node, ...]
    results: tuple[Node, ...]
    reorder: bool
    name: str


class GraphRun(NamedTuple):
    """Operations in the order of their computation, and the loop after them (None at the end)."""

    nodes: Sequence[Node]
    loop: Node | None


@dataclasses.dataclass(frozen=True)
class Graph:
    """A program for one individual.

    Attributes:
        arguments: buffers. The detail of an input is (number of the buffer, row).
        results: buffers, and the node of each row.
        top: block of the whole program.
        nodes: all nodes in the order of their numbers.
        loops: loop of each test block and body block.
        parts: programs within the program, until dead code is eliminated. The detail of an
            ``opaque`` node is the number of the part whose result it is, or None for an argument.
        kept: indices of each loop's carried values that results need.
        runs: runs of each block (empty before scheduling).
    """

    arguments: tuple[Buffer, ...]
    results: tuple[tuple[Buffer, tuple[Node, ...]], ...]
    top: GraphBlock
    nodes: Sequence[Node]
    loops: Mapping[GraphBlock, Node]
    parts: tuple[GraphPart, ...]
    kept: Mapping[Node, tuple[int, ...]]
    runs: Mapping[GraphBlock, Sequence[GraphRun]] = dataclasses.field(default_factory=dict)

    @property
    def result_nodes(self) -> list[Node]:
        """The nodes of all results, row by row."""
        return [node for _, nodes in self.results for node in nodes]

    @property
    def operations(self) -> int:
        """Number of scheduled operations."""
        runs = [run for each in self.runs.values() for run in each]
        return sum(len(run.nodes) + (run.loop is not None) for run in runs)

    def around(self, node: Node) -> list[Node]:
        """Return the loops around a node that writes to sums, up to the block of the sums."""
        found, block, memory = [], node.block, node.operands[-1]
        while block is not memory.block:
            assert block.parent is not None
            found.append(self.loops[block])
            block = block.parent
        return found


NO_CODE = {"input", "carried", "counter", "constant", "opaque", "inside"}
"""Operations without code of their own: known values, inputs, and other names of nodes."""


def resolve(node: Node) -> Node:
    """Return the node that ``opaque`` and ``inside`` nodes are other names of."""
    while node.op in ("opaque", "inside"):
        node = node.operands[0]
    return node


def home(node: Node) -> Node:
    """Return the node whose place in memory holds a value. A loop's result is in its carry."""
    return node.operands[0].detail.carried[node.detail] if node.op == "result" else node


def row_count(table: Node) -> int:
    """Return the count of numbers of a table in memory."""
    if table.op == "list":
        return table.operands[0].detail.count or 1
    if table.op == "totals":
        return len(table.operands[0].operands)
    return table.detail if table.op == "solve" else len(table.operands)


def runs_of(
    graph: Graph, order: Callable[[list[Node]], Sequence[Node]] = list
) -> dict[GraphBlock, list[GraphRun]]:
    """Return the runs of each block: operations before each loop, and after the last loop.

    ``order`` orders the operations of a run, by default in the order of their numbers.
    """
    blocks: dict[GraphBlock, list[Node]] = {}
    for node in graph.nodes:
        if node.op not in NO_CODE:
            blocks.setdefault(node.block, []).append(node)
    runs = {}
    for block, nodes in blocks.items():
        runs[block], start = [], 0
        for stop, node in enumerate(nodes):
            if node.op == "loop":
                runs[block].append(GraphRun(order(nodes[start:stop]), node))
                start = stop + 1
        runs[block].append(GraphRun(order(nodes[start:]), None))
    return runs


class Operation(NamedTuple):
    """A kind of node.

    Attributes:
        signature: types of the operands and, after the arrow, of the result. Equal letters are
            equal types.
        detail: type of the node's other data, or None if there is none.

    | letter | type |
    |---|---|
    | f, i, n | a float, an integer, a float or an integer |
    | b | a truth value |
    | k | an int32, an index into memory |
    | a | any type |
    | * | any type, independent of other letters |
    | ... | any number of operands of the type before it |
    """

    signature: str
    detail: "type | UnionType | None" = None


ARITHMETIC: dict[str, Operation] = {
    name: Operation(signature)
    for names, signature in (
        ("add sub mul div rem max min", "n n -> n"),
        ("eq ne lt le gt ge", "a a -> b"),
        ("and or xor", "a a -> a"),
        ("shift_left shift_right_arithmetic shift_right_logical", "i i -> i"),
        ("abs neg sign", "n -> n"),
        ("ceil floor round sqrt", "f -> f"),
        ("is_finite", "f -> b"),
        ("not", "a -> a"),
        ("select", "b a a -> a"),
        ("convert bitcast", "a -> *"),
    )
    for name in names.split()
}
"""Operations that compute one scalar from others. Most have the names of JAX's primitives."""

_OF_ONE = (
    "acos acosh asin asinh atan atanh cbrt cos cosh erf erfc exp exp2 expm1 lgamma log log1p"
    " sin sinh tan tanh"
)
LIBRARY: dict[str, Operation] = {
    **dict.fromkeys(_OF_ONE.split(), Operation("f -> f")),
    **dict.fromkeys(("atan2", "pow"), Operation("f f -> f")),
}
"""Functions of the C library, by the names of JAX's primitives."""

OPERATIONS: dict[str, Operation] = {
    **ARITHMETIC,
    **LIBRARY,
    # Multiply-adds: x y + z, x y - z, z - x y.
    **dict.fromkeys(("fma", "fms", "fnma"), Operation("f f f -> f")),
    # Inputs of a block.
    # The detail is true for an element of an `unset` array.
    "constant": Operation("-> *", bool | None),
    "input": Operation("-> *", tuple),
    "carried": Operation("-> *"),
    "counter": Operation("-> k"),
    # Other names of a number, for use in another part or block.
    "opaque": Operation("a -> a", int | None),
    "inside": Operation("a -> a"),
    # Tables in memory, and the numbers in them.
    "constants": Operation("-> *", bytes),
    "rows": Operation("a... -> a"),
    "solve": Operation("f... -> f", int),
    "sums": Operation("n... -> n"),
    "totals": Operation("n... -> n"),
    # Some numbers for places from an index on, for individuals with the flag. The detail is their
    # count, and whether they are added.
    "write": Operation("k b n... -> n", tuple),
    "lookup": Operation("a k -> a"),
    # Loops. A list holds the values that each round has written.
    "loop": Operation("*... -> b", GraphLoop),
    "result": Operation("b -> *", int),
    "list": Operation("b -> *", int),
}

COMMUTATIVE = {"add", "mul", "max", "min", "and", "or", "xor", "eq", "ne"}
PREDICATES = {op for op, each in ARITHMETIC.items() if each.signature.endswith("-> b")}
"""Operations whose result is a truth value."""
