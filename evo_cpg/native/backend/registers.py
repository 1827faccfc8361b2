"""Track which values are in registers, and choose the values to evict.

In code without branches all uses are known. The best value to evict is the one with the furthest
next use (L. A. Belady, IBM Systems Journal 5(2), 1966). LLVM then has nothing to choose. LLVM's own
search would take two thirds of the compile time, which grows faster than the code, and finds
nothing better.
"""

from collections.abc import Iterable, Sequence

from evo_cpg.native import machine_constants
from evo_cpg.native.ir.graph import Node, resolve

# A node, and whether its value is held as a vector (else as one scalar for all individuals).
Held = tuple[Node, bool]


class Registers:
    """The names of values that are in registers.

    Args:
        count: number of vector registers. A fraction ``VALUE_REGISTERS`` of them holds values.
    """

    def __init__(self, count: int):
        self._limit = int(machine_constants.VALUE_REGISTERS * count)
        self._names: dict[Held, str] = {}
        self._next_use: dict[Held, int] = {}
        # All remaining uses of each node, the next use last.
        self._uses: dict[Node, list[int]] = {}
        # Nodes that each step uses, in an order that is equal for equal programs.
        self._steps: list[tuple[Node, ...]] = []
        self._now = 0

    def expect(self, nodes: Sequence[Node], result_nodes: Iterable[Node]) -> None:
        """Begin a run of operations with empty registers. Call `pass_on` after each node.

        Args:
            nodes: nodes that will be computed, in order.
            result_nodes: nodes that will be used after these, in order.
        """
        self._names, self._next_use, self._uses, self._now = {}, {}, {}, 0
        self._steps = [tuple(dict.fromkeys(map(resolve, node.operands))) for node in nodes]
        self._steps += [(resolve(node),) for node in result_nodes]
        for i in range(len(self._steps) - 1, -1, -1):
            for node in self._steps[i]:
                self._uses.setdefault(node, []).append(i)

    def hold(self, node: Node, wide: bool, name: str) -> None:
        """Record that a value is in a register."""
        self._names[node, wide] = name
        uses = self._uses.get(node)
        self._next_use[node, wide] = uses[-1] if uses else len(self._steps)

    def name(self, node: Node, wide: bool) -> str | None:
        """Return the name of a value in a register, or None if the value is in no register."""
        return self._names.get((node, wide))

    def pass_on(self) -> tuple[list[tuple[Held, str]], list[Node]]:
        """Record that the current operation is done, and evict values if registers are full.

        Returns:
            A list of values that leave the registers and are used again, with their names, and a
            list of nodes that are not used again.
        """
        over = [node for node in self._steps[self._now] if self._is_over(node)]
        self._now += 1
        leaving = []
        while len(self._names) > self._limit:
            held = max(self._next_use, key=self._next_use.__getitem__)
            del self._next_use[held]
            leaving.append((held, self._names.pop(held)))
        return leaving, over

    def is_used_again(self, node: Node) -> bool:
        """Return whether the expected code uses a node again."""
        return bool(self._uses.get(node))

    def empty(self) -> list[tuple[Held, str]]:
        """Remove all values from the registers and return the values that are used again."""
        leaving = [(held, name) for held, name in self._names.items() if self._uses.get(held[0])]
        self._names, self._next_use = {}, {}
        return leaving

    def _is_over(self, node: Node) -> bool:
        """Remove the current use of a node and return whether it was the last use."""
        uses = self._uses[node]
        uses.pop()
        for held in ((node, False), (node, True)):
            if held in self._names:
                if uses:
                    self._next_use[held] = uses[-1]
                else:
                    del self._names[held], self._next_use[held]
        return not uses
