"""Choose the values to keep in registers and in memory, and reserve places.

The starts and ends of loops cut the code into *stretches*. A value that is used in another stretch
than the one that computes it is stored in memory.

In a stretch all uses are known. The best value to evict from a register is then the one with the
furthest next use (L. A. Belady, IBM Systems Journal 5(2), 1966), and LLVM has nothing to choose.
LLVM's own search would take two thirds of the compile time, which grows faster than the code, and
finds nothing better.
"""

from collections.abc import Iterable, Sequence

from evo_cpg.native import machine_constants
from evo_cpg.native.ir import Graph, GraphBlock, Node, resolve

FRAME_ORIGIN = 8192
"""Bytes from the start of shared memory to the place that its pointer points to.

AVX-512 encodes offsets of up to 128 vectors (8192 bytes), forwards or backwards, in one byte.
"""

_IN_MEMORY = {
    "carried", "constant", "constants", "counter", "list", "loop", "result", "rows", "solve",
    "sums", "totals", "write",
}  # fmt: skip


def live_across(graph: Graph, lists: dict[Node, list[Node]]) -> list[Node]:
    """Return the values that are live across stretches, in the order of their first such use.

    The program is scheduled. ``lists`` are the lists of each loop.
    """
    found: dict[Node, None] = {}
    stretch: dict[Node, int] = {}
    now = 0

    def use(operands: Iterable[Node], block: GraphBlock) -> None:
        for operand in operands:
            node = resolve(operand)
            if node.op in _IN_MEMORY or (node.op == "input" and node.uniform):
                continue
            # Loops read inputs from copies at adjacent places in memory.
            far = block.depth > 0 if node.op == "input" else stretch[node] != now
            if far:
                found[node] = None

    def walk(block: GraphBlock) -> None:
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


class MemoryMap:
    """The places in memory.

    Args:
        step: bytes of which all places are multiples: a cache line for vectors. A single individual
            needs few bytes, which then stay in the first cache.

    Attributes:
        size: bytes of scratch memory of each vector.
        places: bytes of it for each part of the program, by name.
        frame: bytes of shared memory. Vectors use it in turn, so that it stays in the cache.
    """

    def __init__(self, step: int):
        self._step = step
        self._free: dict[int, list[int]] = {}
        self.size = self.frame = 0
        self.places: dict[str, int] = {}

    def reserve(self, size: int, part: str) -> int:
        """Return a permanent place in scratch memory, for a part of the program."""
        place = self.size
        self.size += -(-size // self._step) * self._step
        self.places[part] = self.places.get(part, 0) + self.size - place
        return place

    def borrow(self, size: int) -> int:
        """Return a place in shared memory for use until its release, a released one if possible."""
        free = self._free.get(size)
        if free:
            return free.pop()
        place = self.frame
        self.frame += -(-size // self._step) * self._step
        return place

    def release(self, size: int, place: int) -> None:
        """Free a borrowed place for another value."""
        self._free.setdefault(size, []).append(place)


# A node, and whether its value is held as a vector (else as one scalar for all individuals).
Held = tuple[Node, bool]


class Registers:
    """The values that are in registers.

    Args:
        count: number of vector registers. A fraction ``VALUE_REGISTERS`` of them holds values.

    Attributes:
        names: names of the values that are in registers.
        uses: all remaining uses of each node, the next use last.
    """

    def __init__(self, count: int):
        self._limit = int(machine_constants.VALUE_REGISTERS * count)
        self.names: dict[Held, str] = {}
        self._next_use: dict[Held, int] = {}
        self.uses: dict[Node, list[int]] = {}
        # Nodes that each step uses, in an order that is equal for equal programs.
        self._steps: list[tuple[Node, ...]] = []
        self._now = 0

    def expect(self, nodes: Sequence[Node], result_nodes: Iterable[Node]) -> None:
        """Begin a run of operations with empty registers. Call `pass_on` after each node.

        Args:
            nodes: nodes that will be computed, in order.
            result_nodes: nodes that will be used after these, in order.
        """
        # A missing call of `pass_on` would have kept values in the registers for too long.
        assert self._now == len(self._steps), (
            f"{self._now} of {len(self._steps)} expected uses came"
        )
        self.names, self._next_use, self.uses, self._now = {}, {}, {}, 0
        self._steps = [tuple(dict.fromkeys(map(resolve, node.operands))) for node in nodes]
        self._steps += [(resolve(node),) for node in result_nodes]
        for i in range(len(self._steps) - 1, -1, -1):
            for node in self._steps[i]:
                self.uses.setdefault(node, []).append(i)

    def hold(self, node: Node, wide: bool, name: str) -> None:
        """Record that a value is in a register."""
        self.names[node, wide] = name
        uses = self.uses.get(node)
        self._next_use[node, wide] = uses[-1] if uses else len(self._steps)

    def pass_on(self) -> tuple[list[tuple[Held, str]], list[Node]]:
        """Record that the current operation is done, and evict values if registers are full.

        Returns:
            A list of values that leave the registers and are used again, with their names, and a
            list of nodes that are not used again.
        """
        over = []
        for node in self._steps[self._now]:
            uses = self.uses[node]
            uses.pop()
            for held in ((node, False), (node, True)):
                if held in self.names and uses:
                    self._next_use[held] = uses[-1]
                elif held in self.names:
                    del self.names[held], self._next_use[held]
            if not uses:
                over.append(node)
        self._now += 1
        leaving = []
        while len(self.names) > self._limit:
            held = max(self._next_use, key=self._next_use.__getitem__)
            del self._next_use[held]
            leaving.append((held, self.names.pop(held)))
        return leaving, over

    def empty(self) -> list[tuple[Held, str]]:
        """Remove all values from the registers and return the values that are used again."""
        leaving = [(held, name) for held, name in self.names.items() if self.uses.get(held[0])]
        self.names, self._next_use = {}, {}
        return leaving
