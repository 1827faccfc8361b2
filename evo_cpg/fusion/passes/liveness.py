"""What of a graph is computed where, and what has to be kept in memory for it.

Nodes that nothing needs are left out, and so is what a loop carries for them. A *stretch* is code
between two ends of loops; a value that is used in another stretch than its own crosses memory.
"""

from evo_cpg.fusion import machine_constants
from evo_cpg.fusion.ir.graph import Block, Node, loops_around
from evo_cpg.fusion.passes.schedule import ordered, resolve
from evo_cpg.fusion.unsupported import Unsupported

_NO_CODE = {"input", "carried", "counter", "constant", "opaque", "inside"}
_IN_MEMORY = {
    "carried", "counter", "result", "constant", "rows", "constants", "list", "loop", "solve",
    "sums", "totals",
}  # fmt: skip


class Plan:
    """Order and homes of all that some nodes need.

    Attributes:
        inputs: that are read.
        carried: placeholders of what loops carry, each of which has a place in memory.
        counters: numbers of rounds that are read, likewise.
        crossing: values that are used in other stretches of code than their own.
        packs: whether there are loops that end when all individuals are done.
        operations: number of nodes that become code.

    Raises:
        Unsupported: there are more operations than code is made of.
    """

    def __init__(self, wanted: list[Node], top: Block):
        self._kept: dict[Node, list[int]] = {}
        self._loop_of: dict[Node, tuple[Node, int]] = {}
        needed = sorted(self._needed(wanted), key=_number)
        most = machine_constants.MOST_OPERATIONS
        if len(needed) > most:
            raise Unsupported(f"it has more than {most} operations")
        blocks: dict[Block, list[Node]] = {}
        for node in needed:
            if node.op not in _NO_CODE:
                blocks.setdefault(node.block, []).append(node)
        self.operations = sum(map(len, blocks.values()))
        self._runs = {block: _runs(nodes) for block, nodes in blocks.items()}
        self.inputs = [node for node in needed if node.op == "input"]
        self.carried = [
            node.detail.carried[k] for node, kept in self._kept.items() for k in sorted(kept)
        ]
        self._lists: dict[Node, list[Node]] = {node: [] for node in self._kept}
        self.packs = any(
            node.detail.condition is not None and not node.detail.once for node in self._kept
        )
        self.counters = [node for node in needed if node.op == "counter"]
        for node in needed:
            if node.op == "list":
                self._lists[node.operands[0]].append(node)
        self._stretch: dict[Node, int] = {}
        self._now = 0
        self._crossing: dict[Node, None] = {}
        self._walk(top)
        self._use(wanted, top)
        self.crossing = list(self._crossing)

    def runs(self, block: Block) -> list[tuple[list[Node], Node | None]]:
        """The operations of a block in order, up to each of its loops and behind the last."""
        return self._runs.get(block, [([], None)])

    def kept(self, loop: Node) -> list[int]:
        """Which of what a loop carries is needed."""
        return sorted(self._kept[loop])

    def lists(self, loop: Node) -> list[Node]:
        """The lists of a loop that are needed."""
        return self._lists[loop]

    def _needed(self, wanted: list[Node]) -> dict[Node, None]:
        needed: dict[Node, None] = {}
        waiting = list(wanted)
        while waiting:
            node = waiting.pop()
            if node in needed:
                continue
            needed[node] = None
            if node.op == "loop":
                if node.detail.condition is not None:
                    waiting.append(node.detail.condition)
            elif node.op == "result":
                waiting += self._keep(node.operands[0], node.detail)
            elif node.op == "list":
                loop = self._open(node.operands[0])
                waiting += [node.operands[0], loop.written[node.detail], loop.place]
            elif node.op == "carried":
                waiting += self._keep(*self._loop_of[node])
            elif node.op == "totals":
                waiting += [node.detail.memory, *node.detail.added]
            elif node.op == "accumulate":
                # The loops around it run for its sake, whatever they carry.
                around = loops_around(node)
                for loop in around:
                    self._open(loop)
                waiting += [*node.operands, node.detail.memory, *around]
            else:
                waiting += node.operands
        return needed

    def _open(self, node: Node):
        """What stands in a loop, of which nothing is kept yet."""
        loop = node.detail
        if node not in self._kept:
            self._kept[node] = []
            self._loop_of.update((one, (node, k)) for k, one in enumerate(loop.carried))
        return loop

    def _keep(self, node: Node, number: int) -> list[Node]:
        """What is needed where a loop carries one more value."""
        loop = self._open(node)
        if number in self._kept[node]:
            return []
        self._kept[node].append(number)
        return [node, loop.start[number], loop.following[number]]

    def _walk(self, block: Block) -> None:
        """Go through the code in the order in which it runs."""
        for run, node in self.runs(block):
            for one in run:
                self._use(one.operands, block)
                self._stretch[one] = self._now
            if node is None:
                continue
            loop, kept = node.detail, self._kept[node]
            self._use([loop.start[k] for k in kept], block)
            self._now += 1
            self._walk(loop.test)
            self._now += 1
            self._walk(loop.body)
            if loop.condition is not None:
                self._use([loop.condition], loop.body)
            written = [loop.written[one.detail] for one in self._lists[node]]
            self._use([*(loop.following[k] for k in kept), *written, loop.place], loop.body)
            self._now += 1

    def _use(self, operands, block: Block) -> None:
        for operand in operands:
            node = resolve(operand)
            if node.op in _IN_MEMORY or (node.op == "input" and node.uniform):
                continue
            inside = block.depth > 0 if node.op == "input" else self._stretch[node] != self._now
            if inside:
                self._crossing[node] = None


def _runs(nodes: list[Node]) -> list[tuple[list[Node], Node | None]]:
    runs, start = [], 0
    for stop, node in enumerate(nodes):
        if node.op == "loop":
            runs.append((ordered(nodes[start:stop]), node))
            start = stop + 1
    return [*runs, (ordered(nodes[start:]), None)]


def home(node: Node) -> Node:
    """Whose place in memory holds a value: that of what is carried holds its end as well."""
    return node.operands[0].detail.carried[node.detail] if node.op == "result" else node


def _number(node: Node) -> float:
    return node.number
