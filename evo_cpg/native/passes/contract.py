"""Rewrite sums as chains of multiply-adds.

A processor computes ``a b + c`` in one instruction, a multiply-add, and rounds once. The sum of dot
products ``(a b + c d) + (e f + g h)`` takes two multiplications, two multiply-adds and an addition.
The chain ``((a b + c d) + e f) + g h`` takes one multiplication and three multiply-adds. Other
terms of a sum come first: ``((x + a b) + c d)``.

This pass chooses the products that become multiply-adds. LLVM fuses no others. So the results are
equal for vectors of any width. Each part of the program is rewritten independently. So a part has
the same results alone and within a larger program.

| operation | meaning |
|---|---|
| ``fma`` | a b + c |
| ``fms`` | a b - c |
| ``fnma`` | c - a b |
"""

import collections
import dataclasses
import itertools
from collections.abc import Iterable, Sequence

from evo_cpg.native.ir.graph import Change, Graph, Node, Part, rewrite

_SUMS = {"add", "sub"}


def contract_multiply_adds(graph: Graph) -> Graph:
    """Return the program with the sums of each part as chains of multiply-adds."""
    changes: dict[Node, Change] = {}
    reached: set[Node] = set()

    def reach(nodes: Iterable[Node]) -> None:
        reached.update(nodes)
        reached.update([node.operands[0] for node in nodes if node.op == "opaque"])

    reach(_part(graph, graph.result_nodes))
    # Inner parts come before the parts that contain them.
    for part in reversed(graph.parts):
        if not reached.isdisjoint(part.results):
            contraction = _Contraction(graph, part)
            changes |= contraction.changes
            reach(contraction.nodes)
    # Nodes of a rewritten sum may have other users that no result needs.
    nodes = [node for node in graph.nodes if node in reached]
    return rewrite(dataclasses.replace(graph, nodes=nodes), changes)


class _Contraction:
    """The new sums of a part.

    Other parts stay unchanged. Sums that are their arguments are not merged into other sums.

    Attributes:
        changes: replacement of each rewritten node.
        nodes: nodes of the part, each with its operands.
    """

    def __init__(self, graph: Graph, part: Part):
        self.changes: dict[Node, Change] = {}
        self.nodes = _part(graph, part.results)
        every = itertools.chain(part.results, *self.nodes.values())
        self._uses = uses = collections.Counter(every)
        sums = [node for node in self.nodes if node.op in _SUMS and node.dtype.kind == "f"]
        inner = {node for node in sums if part.reorder and uses[node] == 1}
        self._taken = {
            operand
            for node in sums
            for operand in node.operands
            if operand in inner and _goes_with(operand, node)
        }
        for node in sums:
            if node not in self._taken:
                self._chain(node)
        for node in sums:
            self._fuse_product(node)

    def _chain(self, root: Node) -> None:
        """Rewrite nested sums as one chain with the same number of additions and subtractions."""
        sums, terms = [], []
        waiting = [(root, True)]
        while waiting:
            node, positive = waiting.pop()
            if node is root or (node in self._taken and _goes_with(node, root)):
                sums.append(node)
                first, second = node.operands
                waiting.append((second, positive == (node.op == "add")))
                waiting.append((first, positive))
            else:
                terms.append((node, positive))
        if len(sums) == 1:
            return
        terms.sort(key=lambda term: self._is_product(term[0], root))
        start = next(i for i, (_, positive) in enumerate(terms) if positive)
        total = terms.pop(start)[0]
        # The root is the last link and keeps its number. The others come shortly before it.
        for i, (node, (term, positive)) in enumerate(zip(reversed(sums), terms, strict=True)):
            after = len(sums) - 1 - i
            number = root.number - after / len(sums) if after else root.number
            self.changes[node] = Change("add" if positive else "sub", (total, term), number)
            total = node

    def _fuse_product(self, node: Node) -> None:
        """Fuse a sum with one of its products."""
        op, (first, second), number = self.changes.get(node) or (
            node.op, node.operands, node.number
        )  # fmt: skip
        if self._is_product(second, node):
            fused = "fma" if op == "add" else "fnma"
            self.changes[node] = Change(fused, (*second.operands, first), number)
        elif self._is_product(first, node):
            fused = "fma" if op == "add" else "fms"
            self.changes[node] = Change(fused, (*first.operands, second), number)

    def _is_product(self, node: Node, into: Node) -> bool:
        return node.op == "mul" and self._uses[node] == 1 and _goes_with(node, into)


def _goes_with(operand: Node, node: Node) -> bool:
    """Return whether two nodes are in one block and are both uniform or both not."""
    return operand.block is node.block and operand.uniform == node.uniform


def _part(graph: Graph, result_nodes: Iterable[Node]) -> dict[Node, Sequence[Node]]:
    """Return result nodes and all nodes they depend on in their part, each with its operands."""
    found: dict[Node, Sequence[Node]] = {}
    entered: set[int] = set()
    waiting = list(result_nodes)
    while waiting:
        node = waiting.pop()
        if node not in found:
            found[node] = uses = _used(node, graph, entered)
            waiting.extend(uses)
    return found


def _used(node: Node, graph: Graph, entered: set[int]) -> Sequence[Node]:
    """Return all nodes of its part that a node depends on.

    Args:
        node: the node.
        graph: the program.
        entered: numbers of inner parts whose arguments were already returned, updated in place.
    """
    if node.op == "opaque":
        # A result of an inner part depends on its arguments. An argument depends on no inner node.
        if node.detail is None or node.detail in entered:
            return ()
        entered.add(node.detail)
        return graph.parts[node.detail].arguments
    if node.op == "accumulate":
        return (*node.operands, *graph.around(node))
    if node.op != "loop":
        return node.operands
    loop = node.detail
    single = [each for each in (loop.condition, loop.index) if each is not None]
    return (*node.operands, *single, *loop.following, *loop.written)
