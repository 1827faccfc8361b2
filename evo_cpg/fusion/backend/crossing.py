"""Which values are used in another stretch of code than their own, so that they cross memory.

A *stretch* is the code between two ends of loops.
"""

from collections.abc import Iterable

from evo_cpg.fusion.ir.graph import Block, Graph, Node, resolve

_IN_MEMORY = {
    "accumulate", "carried", "counter", "result", "constant", "rows", "constants", "list", "loop",
    "solve", "sums", "totals",
}  # fmt: skip


def crossing(graph: Graph, lists: dict[Node, list[Node]]) -> list[Node]:
    """Return the values that cross memory, in the order of their first such use.

    Args:
        graph: a scheduled program.
        lists: the lists of each loop.
    """
    found: dict[Node, None] = {}
    stretch: dict[Node, int] = {}
    now = 0

    def use(operands: Iterable[Node], block: Block) -> None:
        for operand in operands:
            node = resolve(operand)
            if node.op in _IN_MEMORY or (node.op == "input" and node.uniform):
                continue
            # Loops read inputs from memory close together.
            far = block.depth > 0 if node.op == "input" else stretch[node] != now
            if far:
                found[node] = None

    def walk(block: Block) -> None:
        """Go through the code in the order in which it runs."""
        nonlocal now
        for run, node in graph.runs.get(block, ()):
            for one in run:
                use(one.operands, block)
                stretch[one] = now
            if node is None:
                continue
            loop, kept = node.detail, graph.kept[node]
            use([node.operands[k] for k in kept], block)
            now += 1
            walk(loop.test)
            now += 1
            walk(loop.body)
            if loop.condition is not None:
                use([loop.condition], loop.body)
            use([loop.following[k] for k in kept], loop.body)
            if lists[node]:
                use([*(loop.written[one.detail] for one in lists[node]), loop.place], loop.body)
            now += 1

    walk(graph.top)
    use(graph.wanted, graph.top)
    return list(found)
