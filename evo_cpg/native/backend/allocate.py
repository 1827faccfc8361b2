"""Assign every value a place: a register, a name that LLVM finds a register for, or memory.

The program processes one *vector* of individuals at a time. Every scalar of the graph becomes
instructions on registers that hold it for 16 individuals (or 8, 4, 1: the machine's width). The
starts and ends of loops cut the code into *stretches* without branches. A value that is used in
several stretches has a *slot* in the scratch memory of its vector, with a number for each
individual. So has a value that a loop carries. A value that leaves the registers within a stretch
goes to memory that all vectors share.

The result is a program in the types of `evo_cpg.native.backend.code`.
"""

import dataclasses
from collections.abc import Iterable, Sequence

from evo_cpg.native import machine_constants
from evo_cpg.native.backend.code import (
    Code,
    Copy,
    Item,
    LoopCode,
    Piece,
    Slot,
    Step,
    Stretch,
    Table,
    Template,
    Variant,
)
from evo_cpg.native.backend.memory import FRAME_ORIGIN, Memory, live_across
from evo_cpg.native.backend.registers import Registers
from evo_cpg.native.backend.select import FRAME, SCRATCH, Selector
from evo_cpg.native.ir.graph import (
    Block,
    Graph,
    Loop,
    Node,
    home,
    resolve,
    row_count,
    runs_of,
    table_values,
)


def allocate(graph: Graph, variant: Variant) -> Code:
    """Return the program in which every value has a place: a register, an LLVM name or memory.

    Args:
        graph: a program. An unscheduled program keeps the order of its nodes.
        variant: the kind of code.
    """
    if not graph.runs:
        graph = dataclasses.replace(graph, runs=runs_of(graph))
    return _Allocator(graph, variant).code()


class _Packed:
    """Values and tables that a packed loop (see `packing`) reads, and nodes that it writes."""

    def __init__(self):
        self.read: dict[Node, None] = {}
        self.tables: dict[Node, None] = {}
        self.written: set[Node] = set()


class _Allocator:
    """Allocator that walks through the code in the order of its computation.

    ``steps`` belong to the current piece, ``pieces`` are the earlier pieces of the current stretch,
    and ``items`` are the code of the current block. ``registers`` and ``names`` hold the places of
    the stretch's values. ``packed`` belongs to the current packed loop, and is None elsewhere.
    """

    def __init__(self, graph: Graph, variant: Variant):
        self.graph, self.variant = graph, variant
        self.width = variant.width
        self.lists: dict[Node, list[Node]] = {loop: [] for loop in graph.kept}
        for node in graph.nodes:
            if node.op == "list":
                self.lists[node.operands[0]].append(node)
        self.select = Selector(variant)
        self.registers = Registers(variant.target.registers)
        self.memory = Memory()
        self.tables: dict[Node, int | str] = {}
        self.constants: list[Table] = []
        self.count = 0
        # Places of values used across stretches, and of values spilled in the current stretch.
        self.slots: dict[Node, int] = {}
        self.spilled: dict[Node, int] = {}
        ends = [loop.detail for loop in graph.kept if loop.detail.condition is not None]
        self.grouped = self.width > 1 and not all(x.once for x in ends)
        self.packed: _Packed | None = None
        self.per_vector = False
        self.pieces: list[Piece] = []
        self.items: list[Item] = []
        self._begin()

    def code(self) -> Code:
        """Allocate the whole program."""
        graph = self.graph
        across = live_across(graph, self.lists)
        far = set(across)
        self._copy_inputs([node for node in graph.nodes if node.op == "input" and node in far])
        carried = [loop.detail.carried[k] for loop, kept in graph.kept.items() for k in kept]
        counters = [node for node in graph.nodes if node.op == "counter"]
        for node in [*carried, *counters, *across]:
            if node not in self.slots:
                self.slots[node] = self.memory.reserve(self._row_bytes(node))
        self._block(graph.top, graph.result_nodes)
        for k, (buffer, nodes) in enumerate(graph.results):
            base = self._buffer(len(graph.arguments) + k)
            template = self.select.store_row(buffer.dtype)
            for row, node in enumerate(nodes):
                name = self._ref(node)
                self.buffers[base] = None
                self._let(template, name, base, row)
                self._used()
                self._cut()
        self._end()
        return Code(
            graph.arguments,
            tuple(buffer for buffer, _ in graph.results),
            self.variant,
            self.items,
            self.constants,
            self.select.functions,
            self.memory.size,
            self.memory.frame,
            self.grouped,
        )

    @property
    def _in_group(self) -> bool:
        """Return whether all vectors of a group run the current code together."""
        return self.grouped and self.packed is None and not self.per_vector

    # Steps, pieces, stretches.

    def _let(self, template: Template, *operands: str | int) -> str:
        """Add a step and return the name of its result."""
        first = self.count + 1
        self.count += template.names
        self.lines += template.lines
        self.steps.append(Step(template, operands, first))
        if template.result:
            return f"%v{first + template.result - 1}"
        return operands[0]  # pyright: ignore[reportReturnType]

    def _begin(self) -> None:
        """Begin an empty stretch."""
        self.steps: list[Step] = []
        self.lines = 0
        # Names of values that LLVM finds registers for: truth values and uniform integers.
        self.names: dict[Node, str] = {}
        self.buffers: dict[str, None] = {}

    def _cut(self) -> None:
        """Continue in a new function, if the current function is long.

        LLVM's time and stack grow faster than the length of a function. Values that are used again
        go through memory. Names of values from before a cut are not valid after it.
        """
        if self.lines >= machine_constants.LONGEST_FUNCTION:
            self._empty_registers()
            self._end_piece()

    def _end_piece(self) -> None:
        self.pieces.append(Piece(self.steps, tuple(self.buffers)))
        self.steps, self.lines = [], 0

    def _end(self, result: str = "", kind: str = "void") -> None:
        """End the stretch."""
        if self.steps or result or self.pieces:
            self._end_piece()
            self.items.append(Stretch(self.pieces, result, kind))
            self.pieces = []

    # Registers.

    def _empty_registers(self) -> None:
        """Empty all registers. Store in memory the values that are used again."""
        for (node, wide), name in self.registers.empty():
            if wide != node.uniform:
                self._spill(node, name)
        for node, name in self.names.items():
            if self.registers.is_used_again(node):
                self._spill(node, name)
        self.names = {}

    def _spill(self, node: Node, name: str) -> None:
        """Store a value in shared memory, unless the value is in memory already."""
        if node in self.spilled or home(node) in self.slots:
            return
        self.spilled[node] = place = self.memory.borrow(self._row_bytes(node))
        self.buffers[FRAME] = None
        self._let(self.select.store(node.dtype, node.uniform, FRAME), name, place - FRAME_ORIGIN)

    def _expect(self, run: Sequence[Node], result_nodes: list[Node]) -> None:
        """Begin a run of operations. Call `_used` after each operation and each use of a result."""
        self.registers.expect(run, result_nodes)
        for node, place in self.spilled.items():
            self.memory.release(self._row_bytes(node), place)
        self.spilled = {}

    def _used(self) -> None:
        leaving, over = self.registers.pass_on()
        for node in over:
            if node in self.spilled:
                self.memory.release(self._row_bytes(node), self.spilled.pop(node))
        for (node, wide), name in leaving:
            if wide != node.uniform:
                self._spill(node, name)

    def _hold(self, node: Node, wide: bool, name: str) -> None:
        kind = node.dtype.kind
        if kind == "f" or (wide and self.width > 1 and kind in "iu"):
            self.registers.hold(node, wide, name)
        else:
            self.names[node] = name

    # Values.

    def _ref(self, node: Node, uniform: bool = False) -> str:
        """Return the LLVM name of a value: of a scalar if ``uniform``, else of a vector."""
        node = resolve(node)
        if node.value is not None:
            return self.select.literal(node.value, node.dtype, uniform)
        name = self.registers.name(node, not node.uniform) or self.names.get(node)
        if node.uniform and not uniform and self.width > 1:
            spread = self.registers.name(node, True)
            if spread is None:
                spread = self._let(self.select.spread(node.dtype), name or self._fetch(node))
                self.registers.hold(node, True, spread)
            return spread
        return name or self._fetch(node)

    def _fetch(self, node: Node) -> str:
        """Load a value from memory and return its name."""
        if node in self.spilled:
            self.buffers[FRAME] = None
            template = self.select.load(node.dtype, node.uniform, FRAME)
            name = self._let(template, self.spilled[node] - FRAME_ORIGIN)
        elif node.op == "input" and node not in self.slots:
            number, row = node.detail
            base = self._buffer(number)
            self.buffers[base] = None
            name = self._let(self.select.load_row(node.dtype, node.uniform), base, row)
        else:
            if self.packed is not None:
                self.packed.read[home(node)] = None
            name = self._load(node, self.slots[home(node)])
        self._hold(node, not node.uniform, name)
        return name

    @staticmethod
    def _buffer(number: int) -> str:
        return f"%b{number}"

    # Memory.

    def _row_bytes(self, node: Node) -> int:
        return node.dtype.itemsize * (1 if node.uniform else self.width)

    def _load(self, node: Node, place: int) -> str:
        return self._let(self.select.load(node.dtype, node.uniform, SCRATCH), place)

    def _store(self, value: str, node: Node, place: int) -> None:
        self._let(self.select.store(node.dtype, node.uniform, SCRATCH), value, place)

    def _address(self, place: int) -> str:
        return self._let(self.select.address(SCRATCH), place)

    def _wrote(self, node: Node) -> None:
        if self.packed is not None:
            self.packed.written.add(node)

    def _copy_inputs(self, nodes: list[Node]) -> None:
        """Copy rows that loops read to adjacent places.

        Rows far apart compete for cache and pages.
        """
        runs: list[list[Node]] = []
        for node in sorted(nodes, key=lambda node: node.detail):
            number, row = node.detail
            if runs and runs[-1][-1].detail == (number, row - 1):
                runs[-1].append(node)
            else:
                runs.append([node])
        for run in runs:
            size = self._row_bytes(run[0])
            start = self.memory.reserve(size * len(run))
            self.slots.update((node, start + i * size) for i, node in enumerate(run))
            number, row = run[0].detail
            base = self._buffer(number)
            self._let(self.select.copy_row(run[0].dtype), base, row, size, start)
            self.items.append(Copy(self.steps[0], len(run), base))
            self._begin()

    # Code without branches.

    def _block(self, block: Block, result_nodes: list[Node]) -> None:
        """Allocate the operations and loops of a block.

        The result nodes are used after the block, in the given order.
        """
        for run, loop in self.graph.runs.get(block, [([], None)]):
            uses = (
                result_nodes if loop is None else [loop.operands[k] for k in self.graph.kept[loop]]
            )
            self._expect(run, uses)
            for node in run:
                self._operation(node)
                self._used()
                self._cut()
            if loop is not None:
                self._loop(loop, loop.detail)

    def _operation(self, node: Node) -> None:
        special = _SPECIAL.get(node.op)
        if special is not None:
            special(self, node)
            return
        if node.op == "lookup":
            name = self._lookup(node)
        else:
            uniform = node.uniform
            operands = [self._ref(one, uniform) for one in node.operands]
            name = self._let(self.select.operation(node), *operands)
        self._hold(node, not node.uniform, name)
        if node in self.slots:
            self._store(name, node, self.slots[node])
            self._wrote(node)

    def _rows(self, node: Node) -> None:
        """Write a table of computed numbers to memory."""
        self.tables[node] = self._store_operands(node)
        self._wrote(node)

    def _store_operands(self, node: Node) -> int:
        """Write the operands of a node to consecutive places in memory. Return the first place."""
        size = self._row_bytes(node)
        start = self.memory.reserve(size * len(node.operands))
        for i, operand in enumerate(node.operands):
            self._store(self._ref(operand, node.uniform), node, start + i * size)
        return start

    def _sums(self, node: Node) -> None:
        """Write the initial values of sums to memory."""
        size, first = self._row_bytes(node), node.operands[0]
        start = self.tables[node] = self.memory.reserve(size * len(node.operands))
        self._wrote(node)
        if first.value is not None and all(operand is first for operand in node.operands):
            to = self._address(start)
            self._let(self.select.fill(node.dtype), to, self._ref(first), len(node.operands))
            return
        for i, operand in enumerate(node.operands):
            self._store(self._ref(operand), node, start + i * size)
            self._cut()

    def _totals(self, node: Node) -> None:
        self.tables[node] = self.tables[node.operands[0]]
        self._wrote(node)

    def _solve(self, node: Node) -> None:
        """Write equations to memory and call the function that solves them."""
        start = self._store_operands(node)
        behind = (len(node.operands) - node.detail) * self._row_bytes(node)
        answers = self.tables[node] = start + behind
        template = self.select.solve(node.dtype, node.uniform)
        H, b = self._address(start), self._address(answers)
        # A call clobbers the registers.
        self._empty_registers()
        self._let(template, H, b, node.detail)
        self._wrote(node)

    def _accumulate(self, node: Node) -> None:
        """Add a value to the number at an index of an array in memory."""
        index, value, memory = node.operands
        base = self._address(self.tables[memory])  # pyright: ignore[reportArgumentType]
        steps = self._let(self.select.times(), self._ref(index, True), self._row_bytes(node))
        pointer = self._let(self.select.element(), base, steps)
        before = self._let(self.select.load(node.dtype, False, ""), pointer)
        total = self._let(self.select.add(node.dtype), before, self._ref(value))
        self._let(self.select.store(node.dtype, False, ""), total, pointer)

    def _constants(self, node: Node) -> None:
        name = self.tables[node] = f"@table{len(self.constants)}"
        self.constants.append(Table(name, table_values(node), node.dtype))

    def _lookup(self, node: Node) -> str:
        table, index = node.operands
        where = self.tables[table]
        if self.packed is not None and not isinstance(where, str):
            self.packed.tables[table] = None
        base = where if isinstance(where, str) else self._address(where)
        name = self._ref(index, index.uniform)
        shared = table.op == "constants" or table.uniform
        return self._let(self.select.look_up(node.dtype, shared, index.uniform), base, name)

    # Loops.

    def _loop(self, node: Node, loop: Loop) -> None:
        """Allocate a loop. Its carried values are in their slots."""
        kept, lists = self.graph.kept[node], self.lists[node]
        for k in kept:
            self._store(self._ref(node.operands[k]), loop.carried[k], self.slots[loop.carried[k]])
            self._used()
            self._cut()
            self._wrote(loop.carried[k])
        for one in lists:
            self.tables[one] = self.memory.reserve(self._row_bytes(one) * (loop.count or 1))
            self._wrote(one)
        self._end()
        self._begin()
        per_vector = self._in_group and loop.once
        if self._in_group and loop.condition is not None and not loop.once:
            self._pack(node, loop)
            return
        before, self.per_vector = self.per_vector, self.per_vector or per_vector
        outside, self.items = self.items, []
        self.count += 1
        number = self.count
        if loop.condition is not None:
            flags = self._active(loop)
            # A vector continues while any of its individuals continues.
            result = flags if self.width == 1 else self._let(self.select.any_of(), flags)
            self._end(result, "i1")
        test, self.items = self.items, []
        counter = None
        if loop.counter in self.slots:
            counter = self.slots[loop.counter]
            self._wrote(loop.counter)
        body = self._round(node, loop)
        self.items = outside
        self.items.append(LoopCode(loop, number, counter, test, body, per_vector))
        self.per_vector = before

    def _pack(self, node: Node, loop: Loop) -> None:
        """Allocate a loop whose active individuals are packed. Its functions work on one vector."""
        packed = self.packed = _Packed()
        outside, self.items = self.items, []
        self._end(self._let(self.select.mask(), self._active(loop)), "i32")
        test, self.items = self.items, []
        # The test has selected the individuals to pack, so the code of packed ones begins with a
        # round.
        tested = set(packed.written)
        body = self._round(node, loop)
        self.packed, self.items = None, outside
        carries = [self._slot(loop.carried[k]) for k in self.graph.kept[node]]
        reads = [self._slot(x) for x in packed.read if x in tested or x not in packed.written]
        for table in packed.tables:
            if table not in packed.written:
                reads += self._rows_of(table)
        self.items.append(LoopCode(loop, 0, None, test, body, packed=(reads, carries)))

    def _slot(self, node: Node) -> Slot:
        return Slot(self.slots[node], node.dtype.itemsize, node.uniform)

    def _rows_of(self, table: Node) -> Iterable[Slot]:
        """Iterate over the slots of a table in scratch memory."""
        start, size = self.tables[table], self._row_bytes(table)
        assert isinstance(start, int)
        for i in range(row_count(table)):
            yield Slot(start + i * size, table.dtype.itemsize, table.uniform)

    def _active(self, loop: Loop) -> str:
        """Allocate the test of a loop and return the name of the condition."""
        condition = loop.condition
        assert condition is not None
        self._begin()
        self._block(loop.test, [condition])
        return self._ref(condition)

    def _round(self, node: Node, loop: Loop) -> list[Item]:
        """Allocate a round of a loop and return its code."""
        self._begin()
        kept, lists = self.graph.kept[node], self.lists[node]
        # A carried value that moves to another slot is read before any slot is written.
        carried = set(loop.carried)
        ends = {k: resolve(loop.following[k]) for k in kept}
        moved = [k for k in kept if ends[k] in carried and ends[k] is not loop.carried[k]]
        kept = [k for k in kept if k not in moved]
        written = [loop.written[one.detail] for one in lists]
        old = [] if loop.condition is None else [loop.condition]
        uses = [*written, *(ends[k] for k in moved)]
        for k in kept:
            uses += [ends[k], *([loop.carried[k]] if old else [])]
        self._block(loop.body, [*uses, *old])
        for one, value in zip(lists, written, strict=True):
            assert loop.index is not None
            steps = self._let(
                self.select.times(), self._ref(loop.index, True), self._row_bytes(one)
            )
            start = self._address(self.tables[one])  # pyright: ignore[reportArgumentType]
            pointer = self._let(self.select.element(), start, steps)
            self._let(self.select.store(one.dtype, False, ""), self._ref(value), pointer)
            self._used()
            self._cut()
        copies = [(k, self._copy(loop, k)) for k in moved]
        for k in kept:
            value = self._ref(ends[k])
            self._used()
            if old:
                value = self._unless_done(loop, k, value)
                self._used()
            self._store(value, loop.carried[k], self.slots[loop.carried[k]])
            self._cut()
        for k, place in copies:
            one = loop.carried[k]
            self._store(self._load(one, place), one, self.slots[one])
        self._end()
        self._begin()
        return self.items

    def _copy(self, loop: Loop, k: int) -> int:
        """Copy the next carried value to a temporary place and return the place."""
        node = loop.carried[k]
        value = self._ref(loop.following[k])
        if loop.condition is not None:
            value = self._unless_done(loop, k, value)
        place = self.memory.reserve(self._row_bytes(node))
        self._store(value, node, place)
        self._used()
        return place

    def _unless_done(self, loop: Loop, k: int, value: str) -> str:
        """Return the new value for individuals that continue, and the old value for the others."""
        node, condition = loop.carried[k], loop.condition
        assert condition is not None
        flags = self._ref(condition)
        return self._let(self.select.choose(node.dtype), flags, value, self._ref(node))


_SPECIAL = {
    "accumulate": _Allocator._accumulate,
    "constants": _Allocator._constants,
    "list": lambda self, node: None,
    "result": lambda self, node: None,
    "rows": _Allocator._rows,
    "solve": _Allocator._solve,
    "sums": _Allocator._sums,
    "totals": _Allocator._totals,
}
