"""Graphs of native code between two passes: as text, and verified."""

import functools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from evo_cpg.native.ir import (
    NO_CODE,
    OPERATIONS,
    Graph,
    GraphBlock,
    GraphRun,
    Node,
    resolve,
    runs_of,
)


def show(graph: Graph) -> str:
    """Return a program as text.

    A line has the number of a node, its type (with ``u`` if it is uniform), its operation, the
    numbers of its operands, and the part that it comes from. The blocks of a loop are indented.
    Only computed nodes are shown.
    """
    runs = graph.runs or runs_of(graph)
    lines = [
        f"argument {k}: {'shared ' if each.shared else ''}{each.dtype}[{each.rows}]"
        for k, each in enumerate(graph.arguments)
    ]
    lines += _block_lines(graph, runs, graph.top)
    lines += [
        f"part {k}, {part.name}: {_names(part.results)}" for k, part in enumerate(graph.parts)
    ]
    for k, (buffer, nodes) in enumerate(graph.results):
        lines.append(f"result {k}: {buffer.dtype}[{buffer.rows}] = {_names(nodes)}")
    return "\n".join(lines)


def _block_lines(
    graph: Graph, runs: Mapping[GraphBlock, Sequence[GraphRun]], block: GraphBlock
) -> Iterator[str]:
    for run in runs.get(block, ()):
        for node in run.nodes:
            detail = "" if node.detail is None else f" {node.detail}"
            if isinstance(node.detail, bytes):
                detail = f" {np.frombuffer(node.detail, node.dtype).tolist()}"
            kind = f"{node.dtype}{' u' if node.uniform else ''}"
            made = f"{_names([node])}: {kind} = {node.op} {_names(node.operands)}{detail}".rstrip()
            yield f"{made}  ; {node.part}" if node.part else made
        if run.loop is None:
            continue
        loop, kept = run.loop.detail, graph.kept.get(run.loop, ())
        kind = "branch" if loop.once else "while" if loop.condition else f"repeat {loop.count}"
        yield f"{_names([run.loop])} = {kind}"
        for k in kept:
            yield f"  carry {_names([loop.carried[k]])} from {_names([run.loop.operands[k]])}"
        yield from (f"  {line}" for line in _block_lines(graph, runs, loop.test))
        if loop.condition is not None:
            yield f"  if {_names([loop.condition])}"
        yield from (f"    {line}" for line in _block_lines(graph, runs, loop.body))
        for k in kept:
            yield f"  next {_names([loop.carried[k]])} = {_names([loop.following[k]])}"
        if loop.written:
            yield f"  write {_names(loop.written)} at {_names([loop.index])}"


def _names(nodes: Iterable[Node]) -> str:
    return ", ".join(
        f"%{node.number:g}" if node.value is None else str(node.value)
        for node in map(resolve, nodes)
    )


class InvalidGraph(AssertionError):
    """The graph breaks a rule of the intermediate representation."""


def verify(graph: Graph) -> Graph:
    """Return the graph if it is valid.

    Raises:
        InvalidGraph: if a node has the wrong type, or uses a node that is not known in its place.
    """
    known: set[Node] = set()
    last = 0.0
    for node in graph.nodes:
        if node.number <= last:
            raise InvalidGraph(f"{node!r} follows a node with a greater or equal number")
        last = node.number
        _check_node(graph, node, known)
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


def verifying(stages: Callable[..., Iterable]) -> Callable[..., Iterator]:
    """Return `evo_cpg.native.compile.stages` with a check of each graph."""

    @functools.wraps(stages)
    def run(*given: Any, **named: Any) -> Iterator[tuple[str, Graph]]:
        for name, graph in stages(*given, **named):
            try:
                verify(graph)
            except InvalidGraph as error:
                raise InvalidGraph(f"{name}: {error}") from None
            yield name, graph

    return run


def _check_node(graph: Graph, node: Node, known: set[Node]) -> None:
    """Check a node against the earlier nodes, and add the node to them.

    Raises:
        InvalidGraph: if the node has a wrong type, a wrong operand or a wrong loop.
    """
    operation = OPERATIONS.get(node.op)
    if operation is None:
        raise InvalidGraph(f"{node!r} has an unknown operation")
    letters = _letters(operation.signature, len(node.operands))
    dtypes = [*(operand.dtype for operand in node.operands), node.dtype]
    # Kinds of NumPy types by the letters of signatures.
    kinds = {"f": "f", "i": "iu", "n": "fiu", "b": "b", "k": "i", "a": "fiub", "*": "fiub"}
    types: dict = {}
    fits = letters is not None and all(
        dtype.kind in kinds[letter]
        and (letter != "k" or dtype.itemsize == 4)
        and (letter == "*" or types.setdefault(letter, dtype) == dtype)
        for letter, dtype in zip(letters, dtypes, strict=True)
    )
    if not fits:
        given = ", ".join(map(str, dtypes[:-1]))
        raise InvalidGraph(f"{node!r} has types {given} -> {node.dtype}, not {operation.signature}")
    if not isinstance(node.detail, operation.detail or type(None)):
        raise InvalidGraph(f"{node!r} has the wrong detail {node.detail!r}")
    if (node.op == "constant") != (node.value is not None):
        raise InvalidGraph(f"{node!r} has the wrong value {node.value!r}")
    for operand in [node.operands[k] for k in graph.kept.get(node, range(len(node.operands)))]:
        if operand not in known:
            raise InvalidGraph(f"{node!r} uses {operand!r} before it is made")
        # Totals are read after the loop that adds to them.
        if node.op != "totals" and not operand.block.encloses(node.block):
            raise InvalidGraph(f"{node!r} uses {operand!r}, which is computed in another block")
        if node.uniform and not operand.uniform:
            raise InvalidGraph(f"{node!r} is uniform, but its operand {operand!r} is not")
    known.add(node)
    if node.op != "loop":
        return
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
        if part not in known or not part.block.encloses(loop.body):
            raise InvalidGraph(f"{node!r} needs {part!r}, which its rounds do not compute")


@functools.cache
def _letters(signature: str, count: int) -> str | None:
    """Return the letter of each operand and of the result, or None if their number is wrong."""
    given, result = signature.split("->")
    letters = given.split()
    if letters and letters[-1].endswith("..."):
        last = letters.pop()[0]
        letters += last * (count - len(letters))
    return "".join(letters) + result.strip() if len(letters) == count else None


def _check_schedule(graph: Graph, block: GraphBlock, computed: set[Node]) -> None:
    """Check a block in the order of its computation, and add its nodes to the computed nodes.

    Raises:
        InvalidGraph: if a node is scheduled before its operands, twice, or in another block.
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
