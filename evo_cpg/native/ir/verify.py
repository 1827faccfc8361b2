"""Check a graph between two passes."""

import functools
from collections.abc import Iterable

import numpy as np

from evo_cpg.native.ir.graph import NO_CODE, Block, Graph, Node, resolve
from evo_cpg.native.ir.types import OPERATIONS

# Kinds of NumPy types by the letters of signatures.
_KINDS = {"f": "f", "i": "iu", "n": "fiu", "b": "b", "k": "i", "a": "fiub", "*": "fiub"}


class InvalidGraph(AssertionError):
    """The graph breaks a rule of the intermediate representation."""


def verify(graph: Graph) -> Graph:
    """Return the graph if it is valid.

    Raises:
        InvalidGraph: a node has the wrong type, or uses a node that is not known in its place.
    """
    known: set[Node] = set()
    last = 0.0
    for node in graph.nodes:
        if node.number <= last:
            raise InvalidGraph(f"{node!r} follows a node with a greater or equal number")
        last = node.number
        _check_type(node)
        kept = graph.kept.get(node, range(len(node.operands)))
        for operand in [node.operands[k] for k in kept]:
            _check_use(node, operand, known)
        known.add(node)
        if node.op == "loop":
            _check_loop(graph, node, known)
    for buffer, nodes in graph.results:
        for node in nodes:
            if node not in known or node.block is not graph.top or node.dtype != buffer.dtype:
                raise InvalidGraph(f"{node!r} cannot be a result of type {buffer.dtype}")
    if graph.runs:
        computed: set[Node] = set()
        _check_schedule(graph, graph.top, computed)
        for node in graph.nodes:
            _check_computed(node, [node], computed)
    return graph


def _check_schedule(graph: Graph, block: Block, computed: set[Node]) -> None:
    """Check a block in the order of its computation.

    Args:
        graph: the program.
        block: the block.
        computed: nodes that were computed before. This function adds the nodes of the block.

    Raises:
        InvalidGraph: a node is scheduled before its operands, twice, or in another block.
    """
    for run, node in graph.runs.get(block, ()):
        for one in run:
            if one.block is not block or one in computed:
                raise InvalidGraph(f"{one!r} is scheduled in another block, or twice")
            _check_computed(one, one.operands, computed)
            computed.add(one)
        if node is None:
            continue
        loop, kept = node.detail, graph.kept[node]
        _check_computed(node, [node.operands[k] for k in kept], computed)
        _check_schedule(graph, loop.test, computed)
        if loop.condition is not None:
            _check_computed(node, [loop.condition], computed)
        _check_schedule(graph, loop.body, computed)
        _check_computed(node, [loop.following[k] for k in kept], computed)
        computed.add(node)


def _check_computed(node: Node, operands: Iterable[Node], computed: set[Node]) -> None:
    for operand in map(resolve, operands):
        if operand.op not in NO_CODE and operand not in computed:
            raise InvalidGraph(f"{node!r} needs {operand!r}, which is scheduled later or never")


def _check_use(node: Node, operand: Node, known: set[Node]) -> None:
    if operand not in known:
        raise InvalidGraph(f"{node!r} uses {operand!r} before it is made")
    # Totals are read after the loop that adds to them.
    if node.op != "totals" and not _encloses(operand.block, node.block):
        raise InvalidGraph(f"{node!r} uses {operand!r}, which is computed in another block")
    if node.uniform and not operand.uniform:
        raise InvalidGraph(f"{node!r} is uniform, but its operand {operand!r} is not")


def _check_type(node: Node) -> None:
    operation = OPERATIONS.get(node.op)
    if operation is None:
        raise InvalidGraph(f"{node!r} has an unknown operation")
    letters = _letters(operation.signature, len(node.operands))
    dtypes = [*(operand.dtype for operand in node.operands), node.dtype]
    if letters is None or not _fits(letters, dtypes):
        given = ", ".join(map(str, dtypes[:-1]))
        raise InvalidGraph(f"{node!r} has types {given} -> {node.dtype}, not {operation.signature}")
    if not isinstance(node.detail, operation.detail or type(None)):
        raise InvalidGraph(f"{node!r} has the wrong detail {node.detail!r}")
    if (node.op == "constant") != (node.value is not None):
        raise InvalidGraph(f"{node!r} has the wrong value {node.value!r}")


@functools.cache
def _letters(signature: str, count: int) -> str | None:
    """Return the letter of each operand and of the result, or None if their number is wrong."""
    given, result = signature.split("->")
    letters = given.split()
    if letters and letters[-1].endswith("..."):
        last = letters.pop()[0]
        letters += last * (count - len(letters))
    return "".join(letters) + result.strip() if len(letters) == count else None


def _fits(letters: str, dtypes: list[np.dtype]) -> bool:
    types: dict[str, np.dtype] = {}
    return all(
        dtype.kind in _KINDS[letter]
        and (letter != "k" or dtype.itemsize == 4)
        and (letter == "*" or types.setdefault(letter, dtype) == dtype)
        for letter, dtype in zip(letters, dtypes, strict=True)
    )


def _check_loop(graph: Graph, node: Node, known: set[Node]) -> None:
    loop, kept = node.detail, graph.kept.get(node, ())
    if loop.test.parent is not node.block or loop.body.parent is not loop.test:
        raise InvalidGraph(f"{node!r} has its test or its body in another block")
    if graph.loops.get(loop.test) is not node or graph.loops.get(loop.body) is not node:
        raise InvalidGraph(f"{node!r} is not recorded as the loop of its blocks")
    if (loop.count is None) != (loop.condition is not None):
        raise InvalidGraph(f"{node!r} must have either a number of rounds or a condition")
    for k in kept:
        if len({each[k].dtype for each in (node.operands, loop.carried, loop.following)}) > 1:
            raise InvalidGraph(f"{node!r} carries values of different types at place {k}")
    needed = [loop.following[k] for k in kept] + ([loop.condition] if loop.condition else [])
    for part in needed:
        if part not in known or not _encloses(part.block, loop.body):
            raise InvalidGraph(f"{node!r} needs {part!r}, which its rounds do not compute")


def _encloses(outer: Block, inner: Block | None) -> bool:
    while inner is not None and inner is not outer:
        inner = inner.parent
    return inner is outer
