"""Which values are in registers, and which of them has to leave.

Code without branches is known to its end, so the best choice is known too: the value whose next
use is furthest away (L. A. Belady, IBM Systems Journal 5(2), 1966). LLVM is left with nothing to
choose: its own search takes a time that grows faster than the code, two thirds of all compiling,
and finds nothing better.
"""

from collections.abc import Iterable, Sequence

from evo_cpg.fusion import machine_constants
from evo_cpg.fusion.ir.graph import Node, resolve

# A value as a number for each individual, or once for all of them.
Held = tuple[Node, bool]


class Registers:
    """The names of values that are in registers.

    Args:
        count: registers that the processor has; three quarters of them hold values.
    """

    def __init__(self, count: int):
        self._limit = int(machine_constants.VALUE_REGISTERS * count)
        self._names: dict[Held, str] = {}
        self._next_use: dict[Held, int] = {}
        # Of each node all that is to come, the next one last.
        self._uses: dict[Node, list[int]] = {}
        # What each step uses, in an order that is the same for equal programs.
        self._steps: list[tuple[Node, ...]] = []
        self._now = 0

    def expect(self, nodes: Sequence[Node], result_nodes: Iterable[Node]) -> None:
        """Begin with nothing.

        Args:
            nodes: what will be computed, in order; `pass_on` is to be called after each.
            result_nodes: what will be used after that, in order, likewise.
        """
        self._names, self._next_use, self._uses, self._now = {}, {}, {}, 0
        self._steps = [tuple(dict.fromkeys(map(resolve, node.operands))) for node in nodes]
        self._steps += [(resolve(node),) for node in result_nodes]
        for i in range(len(self._steps) - 1, -1, -1):
            for node in self._steps[i]:
                self._uses.setdefault(node, []).append(i)

    def hold(self, node: Node, wide: bool, name: str) -> None:
        """A value is in a register now."""
        self._names[node, wide] = name
        uses = self._uses.get(node)
        self._next_use[node, wide] = uses[-1] if uses else len(self._steps)

    def name(self, node: Node, wide: bool) -> str | None:
        """The name of a value, if it is in a register."""
        return self._names.get((node, wide))

    def pass_on(self) -> tuple[list[tuple[Held, str]], list[Node]]:
        """Go on to the next operation.

        Returns:
            Values that leave the registers and are used again, with their names; and nodes that
            are used no more.
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
        """Return whether the code that was expected still uses a node."""
        return bool(self._uses.get(node))

    def empty(self) -> list[tuple[Held, str]]:
        """Take all values out of the registers; return those that are used again."""
        leaving = [(held, name) for held, name in self._names.items() if self._uses.get(held[0])]
        self._names, self._next_use = {}, {}
        return leaving

    def _is_over(self, node: Node) -> bool:
        """Whether the use of a node that is now was its last one."""
        uses = self._uses[node]
        uses.pop()
        for held in ((node, False), (node, True)):
            if held in self._names:
                if uses:
                    self._next_use[held] = uses[-1]
                else:
                    del self._names[held], self._next_use[held]
        return not uses
