"""Rewrite sums so that every product in them is added as it is made.

A processor multiplies and adds in one instruction, ``a b + c``, and rounds once. Written as sums of
dot products, ``(a b + c d) + (e f + g h)``, four products take two plain multiplications, two such
instructions and an addition; as a chain, ``((a b + c d) + e f) + g h``, one multiplication and
three of them. Where a sum has other terms they come first: ``((x + a b) + c d)``.

Which products are added so is decided here, never by the compiler: the numbers are then the same
with vectors of any width.

| operation | what it is |
|---|---|
| ``fma`` | a b + c |
| ``fms`` | a b - c |
| ``fnma`` | c - a b |
"""

import collections

from evo_cpg.fusion.ir.graph import Graph, Node, loops_around

_SUMS = {"add", "sub"}


def chain_sums(graph: Graph, wanted: list[Node], reorder: bool = True) -> None:
    """Turn all sums behind the wanted nodes into chains of fused products, in place.

    What other programs compute is left alone, and what they are given is not taken apart.

    Args:
        graph: whose nodes they are.
        wanted: the results.
        reorder: add in another order than is written; if not, only products are fused.
    """
    order = _operands_first(wanted)
    uses = collections.Counter(wanted)
    for node in order:
        uses.update(behind(node))
    inner = {node for node in order if reorder and _is_sum(node) and uses[node] == 1}
    taken = {
        operand
        for node in order
        if _is_sum(node)
        for operand in node.operands
        if operand in inner and _goes_with(operand, node)
    }
    for node in order:
        if _is_sum(node) and node not in taken:
            chain = _chain(node, taken, uses)
            for i, part in enumerate(chain, 1):
                part.number = node.number - 1 + i / (len(chain) + 1)
    for node in order:
        if _is_sum(node):
            _fuse_product(node, uses)
    # Sums are no longer what they were made as.
    graph.forget()


def behind(node: Node) -> tuple[Node, ...]:
    """All that must be known before a node is."""
    if node.op == "inside":
        return node.operands
    if node.op == "opaque":
        return () if node.detail is None else (node.detail,)
    if node.op == "totals":
        return (node.detail.memory, *node.detail.added)
    if node.op == "accumulate":
        return (*node.operands, *loops_around(node))
    if node.op != "loop":
        return node.operands
    loop = node.detail
    condition = () if loop.condition is None else (loop.condition,)
    return (*node.operands, *condition, *loop.following, loop.place, *loop.written)


def _is_sum(node: Node) -> bool:
    return node.op in _SUMS and node.dtype.kind == "f"


def _goes_with(operand: Node, node: Node) -> bool:
    """Whether both are computed at the same place, once for all or for each individual."""
    return operand.block is node.block and operand.uniform == node.uniform


def _chain(root: Node, taken: set[Node], uses: collections.Counter) -> list[Node]:
    """One sum, with as many additions as before; returns those before the last."""
    sums, terms = [], []
    waiting = [(root, True)]
    while waiting:
        node, positive = waiting.pop()
        if node is root or (node in taken and _goes_with(node, root)):
            sums.append(node)
            first, second = node.operands
            waiting.append((second, positive == (node.op == "add")))
            waiting.append((first, positive))
        else:
            terms.append((node, positive))
    if len(sums) == 1:
        return []
    terms.sort(key=lambda term: _is_product(term[0], root, uses))
    start = next(i for i, (_, positive) in enumerate(terms) if positive)
    total = terms.pop(start)[0]
    for node, (term, positive) in zip(reversed(sums), terms, strict=True):
        node.op = "add" if positive else "sub"
        node.operands = (total, term)
        total = node
    return sums[:0:-1]


def _is_product(node: Node, into: Node, uses: collections.Counter) -> bool:
    return node.op == "mul" and uses[node] == 1 and _goes_with(node, into)


def _fuse_product(node: Node, uses: collections.Counter) -> None:
    """Make one operation of a sum and one of its products."""
    first, second = node.operands
    if _is_product(second, node, uses):
        node.op = "fma" if node.op == "add" else "fnma"
        node.operands = (*second.operands, first)
    elif _is_product(first, node, uses):
        node.op = "fma" if node.op == "add" else "fms"
        node.operands = (*first.operands, second)


def _operands_first(wanted: list[Node]) -> list[Node]:
    """The wanted nodes and all behind them."""
    order: dict[Node, None] = {}
    stack = [(node, False) for node in reversed(wanted)]
    while stack:
        node, expanded = stack.pop()
        if node in order:
            continue
        if expanded:
            order[node] = None
        else:
            stack.append((node, True))
            stack.extend((operand, False) for operand in reversed(behind(node)))
    return list(order)
