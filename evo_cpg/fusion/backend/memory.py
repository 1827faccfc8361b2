"""Which values live in memory, and where, in bytes.

A *stretch* is the code between two ends of loops. A value that is used in another stretch than its
own crosses memory.
"""

from collections.abc import Iterable

from evo_cpg.fusion import machine_constants
from evo_cpg.fusion.ir.graph import Block, Graph, Node, resolve

FRAME_ORIGIN = 8192
"""Where the pointer to shared memory points to in it: AVX-512 tells offsets of up to 128 vectors in
one byte."""

_IN_MEMORY = {
    "accumulate", "carried", "counter", "result", "constant", "rows", "constants", "list", "loop",
    "solve", "sums", "totals",
}  # fmt: skip


def live_across(graph: Graph, lists: dict[Node, list[Node]]) -> list[Node]:
    """Return the values that are live across stretches, in the order of their first such use.

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
            # Loops read inputs that were brought close together in memory.
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
                use([*(loop.written[one.detail] for one in lists[node]), loop.index], loop.body)
            now += 1

    walk(graph.top)
    use(graph.result_nodes, graph.top)
    return list(found)


class Memory:
    """Hands out places.

    Attributes:
        size: bytes of scratch memory, which each vector has for itself.
        frame: bytes of shared memory. Vectors that take turns use the same, so that it stays in the
            cache.
    """

    def __init__(self):
        self._free: dict[int, list[int]] = {}
        self.size = self.frame = 0

    def reserve(self, size: int) -> int:
        """Return a place in scratch memory for good."""
        place = self.size
        self.size += _lines(size)
        return place

    def borrow(self, size: int) -> int:
        """Return a place in shared memory until it is given back, likely still in the cache."""
        free = self._free.get(size)
        if free:
            return free.pop()
        place = self.frame
        self.frame += _lines(size)
        return place

    def release(self, size: int, place: int) -> None:
        """Let a borrowed place be used for something else."""
        self._free.setdefault(size, []).append(place)


def _lines(size: int) -> int:
    """Round up to whole lines of the cache."""
    line = machine_constants.CACHE_LINE
    return -(-size // line) * line
