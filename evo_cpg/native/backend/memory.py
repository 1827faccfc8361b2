"""Choose the values to keep in memory, and reserve their places.

The starts and ends of loops cut the code into *stretches*. A value that is used in another stretch
than the one that computes it is stored in memory.
"""

from collections.abc import Iterable

from evo_cpg.native import machine_constants
from evo_cpg.native.ir.graph import Block, Graph, Node, resolve

FRAME_ORIGIN = 8192
"""Bytes from the start of shared memory to the place that its pointer points to.

AVX-512 encodes offsets of up to 128 vectors (8192 bytes), forwards or backwards, in one byte.
"""

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
            # Loops read inputs from copies at adjacent places in memory.
            far = block.depth > 0 if node.op == "input" else stretch[node] != now
            if far:
                found[node] = None

    def walk(block: Block) -> None:
        """Walk through the code in the order of its computation."""
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
    """Allocator of places in memory.

    Attributes:
        size: bytes of scratch memory of each vector.
        frame: bytes of shared memory. Vectors use it in turn, so that it stays in the cache.
    """

    def __init__(self):
        self._free: dict[int, list[int]] = {}
        self.size = self.frame = 0

    def reserve(self, size: int) -> int:
        """Return a permanent place in scratch memory."""
        place = self.size
        self.size += _lines(size)
        return place

    def borrow(self, size: int) -> int:
        """Return a place in shared memory for use until its release.

        Reuse a released place first.
        """
        free = self._free.get(size)
        if free:
            return free.pop()
        place = self.frame
        self.frame += _lines(size)
        return place

    def release(self, size: int, place: int) -> None:
        """Free a borrowed place for another value."""
        self._free.setdefault(size, []).append(place)


def _lines(size: int) -> int:
    """Round a size up to whole cache lines, bytes."""
    line = machine_constants.CACHE_LINE
    return -(-size // line) * line
