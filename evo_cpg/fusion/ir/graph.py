"""The intermediate representation: a graph of scalar operations, for one individual.

| type | what it is |
|---|---|
| `Node` | one operation, with the types of its operands and of its result (`ir.types`) |
| `Block` | the place of a node: the whole program, or the test or the body of a loop |
| `Loop` | a counted loop, a loop with a condition, or a branch |
| `Graph` | a program: its arguments, its nodes, its results |

Every node has the type of one scalar and belongs to one block. A node is *uniform* if it is the
same for all individuals. Passes read a graph and return a new one. They never change a node.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


class Buffer(NamedTuple):
    """An array that goes into or out of a program.

    Attributes:
        rows: numbers for each individual.
        dtype: of the numbers.
        shared: whether there is one set of them for all individuals.
    """

    rows: int
    dtype: np.dtype
    shared: bool = False


class Block:
    """Where nodes are computed.

    Attributes:
        parent: the block around it; None for the whole program.
        depth: number of blocks around it.
    """

    def __init__(self, parent: "Block | None" = None):
        self.parent = parent
        self.depth: int = parent.depth + 1 if parent else 0


@dataclasses.dataclass(slots=True, eq=False, repr=False)
class Node:
    """One scalar, or something in memory that other nodes read.

    Attributes:
        op: name of the operation, a key of `evo_cpg.fusion.ir.types.OPERATIONS`.
        operands: nodes.
        dtype: type of the result.
        block: where it is computed.
        uniform: whether it is the same for all individuals.
        number: order of creation; operands come before their users.
        value: value of a constant, else None.
        detail: what else the operation needs (a `Loop`, the place of an input, an index).
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
    """A loop over a block, the detail of a node whose operands are the carried values at first.

    Attributes:
        count: number of rounds; None while the condition holds for any individual. Individuals for
            which it does not hold stay as they are.
        test: block of the condition, in which the carried values are known.
        body: block that is repeated, within ``test``.
        counter: number of the round, from 0, of a counted loop.
        carried: placeholders of the values that are carried into a round.
        following: the values that are carried out of it.
        condition: None for a counted loop.
        index: where a round's values go in the lists, of a counted loop.
        written: what each round adds to lists.
        once: a branch: the condition is asked once, and the block runs once at most.
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
    """A program within the program, whose sums are put in order by themselves.

    Attributes:
        arguments: the nodes that it starts from.
        results: its last nodes.
        reorder: whether its sums may be added in another order than they are written.
    """

    arguments: tuple[Node, ...]
    results: tuple[Node, ...]
    reorder: bool


class Run(NamedTuple):
    """Operations without loops, and the loop behind them.

    Attributes:
        nodes: in the order in which they are computed.
        loop: None behind the last loop of a block.
    """

    nodes: Sequence[Node]
    loop: Node | None


@dataclasses.dataclass(frozen=True)
class Graph:
    """A program for one individual.

    Attributes:
        arguments: buffers; the detail of an input is (number of the buffer, row).
        results: buffers, and the node of each row.
        top: block of the whole program.
        nodes: all nodes in the order of their numbers.
        loops: the loop whose test or body a block is.
        parts: programs within the program, until dead code is eliminated. The detail of an
            ``opaque`` node is the number of the part whose result it is; None for an argument.
        kept: for each loop the numbers of the carried values that are needed.
        runs: for each block its runs, once they are scheduled.
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
        """Number of the operations that are scheduled."""
        runs = [run for each in self.runs.values() for run in each]
        return sum(len(run.nodes) + (run.loop is not None) for run in runs)

    def around(self, node: Node) -> list[Node]:
        """Return the loops around a node that adds to sums, up to where these begin."""
        found, block, memory = [], node.block, node.operands[-1]
        while block is not memory.block:
            assert block.parent is not None
            found.append(self.loops[block])
            block = block.parent
        return found


class Change(NamedTuple):
    """What a node becomes; its type and its block stay.

    Attributes:
        op: new operation.
        operands: nodes of the old graph.
        number: new place in the order.
    """

    op: str
    operands: tuple[Node, ...]
    number: float


def rewrite(graph: Graph, changes: Mapping[Node, Change]) -> Graph:
    """Return a graph in which some nodes are others, and all their users use these."""
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
"""Nodes that are known without computing anything, and other names of nodes."""


def resolve(node: Node) -> Node:
    """Return the node behind others that only stand for it."""
    while node.op in ("opaque", "inside"):
        node = node.operands[0]
    return node


def home(node: Node) -> Node:
    """Return the node whose place in memory holds a value: a carried value for its result."""
    return node.operands[0].detail.carried[node.detail] if node.op == "result" else node


def table_values(table: Node) -> np.ndarray:
    """Return the numbers of a table of constants."""
    return np.frombuffer(table.detail, table.dtype)


def row_count(table: Node) -> int:
    """Return how many numbers a table in memory has."""
    if table.op == "list":
        return table.operands[0].detail.count or 1
    if table.op == "totals":
        return len(table.operands[0].operands)
    return table.detail if table.op == "solve" else len(table.operands)


def runs_of(
    graph: Graph, order: Callable[[list[Node]], Sequence[Node]] = list
) -> dict[Block, list[Run]]:
    """Return the operations of each block up to each of its loops, and behind the last.

    Args:
        graph: the program.
        order: puts the operations of a run in order; else they stay in the order of their numbers.
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
