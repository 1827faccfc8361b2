"""The intermediate representation: a graph of scalar operations, for one individual.

| type | meaning |
|---|---|
| `Node` | one operation, with the types of its operands and of its result (`ir.types`) |
| `Block` | the place of a node: the whole program, or the test or the body of a loop |
| `Loop` | a counted loop, a loop with a condition, or a branch |
| `Graph` | a program: its arguments, its nodes, its results |

Every node has the type of one scalar and belongs to one block. A node is *uniform* if its value is
equal for all individuals. Passes read a graph and return a new graph. They never change a node.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


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


class Block:
    """The place where nodes are computed.

    Attributes:
        parent: the block around it, or None for the whole program.
        depth: number of blocks around it.
    """

    def __init__(self, parent: "Block | None" = None):
        self.parent = parent
        self.depth: int = parent.depth + 1 if parent else 0


@dataclasses.dataclass(slots=True, eq=False, repr=False)
class Node:
    """One scalar, or numbers in memory that other nodes read.

    Attributes:
        op: name of the operation, a key of `evo_cpg.native.ir.types.OPERATIONS`.
        operands: operand nodes.
        dtype: type of the result.
        block: block in which the node is computed.
        uniform: whether the value is equal for all individuals.
        number: order of creation. Operands come before their users.
        value: value of a constant, else None.
        detail: other data of the operation (a `Loop`, the place of an input, an index).
    """

    op: str
    operands: "tuple[Node, ...]"
    dtype: np.dtype
    block: Block
    uniform: bool
    number: float
    value: Any = None
    detail: Any = None

    def __repr__(self) -> str:
        inside = self.value if self.value is not None else [o.number for o in self.operands]
        return f"{self.number}: {self.op} {inside}"


class Loop(NamedTuple):
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
    test: Block
    body: Block
    counter: Node | None
    carried: tuple[Node, ...]
    following: tuple[Node, ...]
    condition: Node | None
    index: Node | None
    written: tuple[Node, ...]
    once: bool = False


class Part(NamedTuple):
    """A program within the program, whose sums are ordered independently.

    Attributes:
        arguments: first nodes of the part.
        results: last nodes of the part.
        reorder: whether the order of summation may change.
    """

    arguments: tuple[Node, ...]
    results: tuple[Node, ...]
    reorder: bool


class Run(NamedTuple):
    """Operations without loops, and the loop after them.

    Attributes:
        nodes: operations in the order of their computation.
        loop: loop after the operations, or None after the last loop of a block.
    """

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
    top: Block
    nodes: Sequence[Node]
    loops: Mapping[Block, Node]
    parts: tuple[Part, ...]
    kept: Mapping[Node, tuple[int, ...]]
    runs: Mapping[Block, Sequence[Run]] = dataclasses.field(default_factory=dict)

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
        """Return the loops around a node that adds to sums, up to the block of the sums."""
        found, block, memory = [], node.block, node.operands[-1]
        while block is not memory.block:
            assert block.parent is not None
            found.append(self.loops[block])
            block = block.parent
        return found


class Change(NamedTuple):
    """The replacement of a node. The new node has the type and the block of the old one.

    Attributes:
        op: new operation.
        operands: new operands, nodes of the old graph.
        number: new place in the order.
    """

    op: str
    operands: tuple[Node, ...]
    number: float


def rewrite(graph: Graph, changes: Mapping[Node, Change]) -> Graph:
    """Return a graph in which some nodes and all uses of them are replaced."""
    if not changes:
        return graph
    new: dict[Node, Node] = {}

    def mapped(nodes: Iterable[Node]) -> tuple[Node, ...]:
        return tuple([new.get(node, node) for node in nodes])

    nodes = sorted(graph.nodes, key=lambda node: changes.get(node, node).number)
    for i, node in enumerate(nodes):
        change = changes.get(node)
        op, operands, number = (node.op, node.operands, node.number) if change is None else change
        detail, changed = node.detail, change is not None
        for operand in operands:
            if operand in new:
                operands, changed = mapped(operands), True
                break
        if op == "loop":
            lists = "carried", "following", "written"
            detail, changed = (
                detail._replace(
                    condition=new.get(detail.condition, detail.condition),
                    index=new.get(detail.index, detail.index),
                    **{name: mapped(getattr(detail, name)) for name in lists},
                ),
                True,
            )
        if changed:
            nodes[i] = new[node] = Node(
                op, operands, node.dtype, node.block, node.uniform, number, None, detail
            )
    return dataclasses.replace(
        graph,
        results=tuple((buffer, mapped(rows)) for buffer, rows in graph.results),
        nodes=nodes,
        loops=dict(zip(graph.loops, mapped(graph.loops.values()), strict=True)),
        parts=tuple(Part(mapped(a), mapped(results), r) for a, results, r in graph.parts),
        kept=dict(zip(mapped(graph.kept), graph.kept.values(), strict=True)),
    )


NO_CODE = {"input", "carried", "counter", "constant", "opaque", "inside"}
"""Operations without code of their own: known values, inputs, and other names of nodes."""


def resolve(node: Node) -> Node:
    """Return the node that ``opaque`` and ``inside`` nodes are other names of."""
    while node.op in ("opaque", "inside"):
        node = node.operands[0]
    return node


def home(node: Node) -> Node:
    """Return the node whose place in memory holds a value.

    A loop's result is in its carried value.
    """
    return node.operands[0].detail.carried[node.detail] if node.op == "result" else node


def table_values(table: Node) -> np.ndarray:
    """Return the numbers of a table of constants."""
    return np.frombuffer(table.detail, table.dtype)


def row_count(table: Node) -> int:
    """Return the count of numbers of a table in memory."""
    if table.op == "list":
        return table.operands[0].detail.count or 1
    if table.op == "totals":
        return len(table.operands[0].operands)
    return table.detail if table.op == "solve" else len(table.operands)


def runs_of(
    graph: Graph, order: Callable[[list[Node]], Sequence[Node]] = list
) -> dict[Block, list[Run]]:
    """Return the runs of each block: operations before each loop, and after the last loop.

    Args:
        graph: the program.
        order: function that orders the operations of a run, by default the order of their numbers.
    """
    blocks: dict[Block, list[Node]] = {}
    for node in graph.nodes:
        if node.op not in NO_CODE:
            blocks.setdefault(node.block, []).append(node)
    runs = {}
    for block, nodes in blocks.items():
        runs[block], start = [], 0
        for stop, node in enumerate(nodes):
            if node.op == "loop":
                runs[block].append(Run(order(nodes[start:stop]), node))
                start = stop + 1
        runs[block].append(Run(order(nodes[start:]), None))
    return runs
