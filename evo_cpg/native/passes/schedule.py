"""Order operations so that few computed values wait for a later use.

A waiting value takes a register, or is stored and loaded again. If the operations stay in the order
of the traced program, these stores and loads are a quarter of all instructions.
"""

import dataclasses
from collections.abc import Iterator

from evo_cpg.native.ir.graph import Graph, Node, resolve, runs_of


def schedule(graph: Graph) -> Graph:
    """Return the program with the operations of each block in the order of their computation."""
    return dataclasses.replace(graph, runs=runs_of(graph, ordered))


def ordered(run: list[Node]) -> list[Node]:
    """Return the operations of a run in order.

    An operation comes shortly before its first use. Operands of an operation are computed in
    reverse order of their numbers. An operation whose operands are all computed comes at once if it
    is the last user of some value.
    """
    return _Order(run).nodes


class _Order:
    def __init__(self, run: list[Node]):
        inside = set(run)
        self.nodes: list[Node] = []
        self._done: set[Node] = set()
        self._operands: dict[Node, list[Node]] = {}
        self._users: dict[Node, list[Node]] = {node: [] for node in run}
        for node in run:
            operands = dict.fromkeys(map(resolve, node.operands))
            self._operands[node] = sorted((x for x in operands if x in inside), key=_number)
            for operand in self._operands[node]:
                self._users[operand].append(node)
        # Number of operands of each node still to compute, and number of its remaining uses.
        self._missing = {node: len(operands) for node, operands in self._operands.items()}
        self._left = {node: len(users) for node, users in self._users.items()}
        for root in reversed(run):
            if not self._users[root]:
                self._compute(root)

    def _compute(self, root: Node) -> None:
        started, stack = set(), [(root, False)]
        while stack:
            node, ready = stack.pop()
            if node in self._done:
                continue
            if ready:
                self._put(node)
            elif node not in started:
                started.add(node)
                stack.append((node, True))
                stack.extend((operand, False) for operand in self._operands[node])

    def _put(self, node: Node) -> None:
        """Append a node and ready nodes that free at least as many registers as they take."""
        stack = [node]
        while stack:
            node = stack.pop()
            if node in self._done:
                continue
            self._done.add(node)
            self.nodes.append(node)
            for operand in self._operands[node]:
                self._left[operand] -= 1
            for user in self._users[node]:
                self._missing[user] -= 1
            stack.extend(user for user in self._touched(node) if self._frees(user))

    def _touched(self, node: Node) -> Iterator[Node]:
        """Iterate over nodes that may have become ready, or the last user of some value."""
        yield from self._users[node]
        for operand in self._operands[node]:
            if self._left[operand] == 1:
                yield from self._users[operand]

    def _frees(self, node: Node) -> bool:
        ready = node not in self._done and not self._missing[node]
        return ready and any(self._left[operand] == 1 for operand in self._operands[node])


def _number(node: Node) -> float:
    return node.number
