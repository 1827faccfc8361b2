"""Assign every value a place: a register, a name that LLVM finds a register for, or memory.

The program processes one *vector* of individuals at a time. Every scalar of the graph becomes
instructions on registers that hold it for 16 individuals (or 8, 4, 1: the machine's width). The
starts and ends of loops cut the code into *stretches* without branches. A value that is used in
several stretches has a *slot* in the scratch memory of its vector, with a number for each
individual. So has a value that a loop carries. A value that leaves the registers within a stretch
goes to memory that all vectors share.

The result is a program in the types of `evo_cpg.native.backend.code`.
"""

import collections
import dataclasses

import numpy as np

from evo_cpg.native import machine_constants
from evo_cpg.native.backend import code
from evo_cpg.native.backend.code import Slot, StretchCode, Template, Variant
from evo_cpg.native.backend.operations import suffix
from evo_cpg.native.backend.select import FRAME, SCRATCH, Selector
from evo_cpg.native.backend.storage import FRAME_ORIGIN, MemoryMap, Registers, live_across
from evo_cpg.native.ir import Graph, GraphBlock, GraphLoop, Node, home, resolve, row_count, runs_of

_BOOL, _INDEX = np.dtype(bool), np.dtype(np.int32)


@dataclasses.dataclass
class _Packed:
    """Values and tables that a packed loop (see `packing`) reads, and nodes that it writes."""

    read: dict[Node, None] = dataclasses.field(default_factory=dict)
    tables: dict[Node, None] = dataclasses.field(default_factory=dict)
    written: set[Node] = dataclasses.field(default_factory=set)


class Allocator:
    """Allocator that walks through the code in the order of its computation.

    An unscheduled program keeps the order of its nodes.

    ``part`` is the part of the program that the current code is for. ``steps`` belong to the
    current function, ``functions`` are the earlier functions of the current stretch, and ``items``
    are the code of the current block. ``registers`` and ``names`` hold the places of the stretch's
    values. ``packed`` belongs to the current packed loop. ``in_group`` is true if all vectors of a
    group run the current code together. It is false in a packed loop and in a branch.
    """

    def __init__(self, graph: Graph, variant: Variant):
        if not graph.runs:
            graph = dataclasses.replace(graph, runs=runs_of(graph))
        self.graph, self.variant = graph, variant
        self.width = variant.width
        self.lists: dict[Node, list[Node]] = {loop: [] for loop in graph.kept}
        for node in graph.nodes:
            if node.op == "list":
                self.lists[node.operands[0]].append(node)
        self.select = Selector(self.width, variant.target.fma)
        self.registers = Registers(variant.target.registers)
        widest = max([node.dtype.itemsize for node in graph.nodes], default=1)
        self.memory = MemoryMap(machine_constants.CACHE_LINE if self.width > 1 else widest)
        self.tables: dict[Node, int | str] = {}
        self.constants: dict[str, np.ndarray] = {}
        # Places of the number of rows in use, of tables that are not written at their start.
        self.extents: dict[Node, int] = {}
        self.count = 0
        self.part = ""
        self.spills: collections.Counter[str] = collections.Counter()
        # Places of values used across stretches, and of values spilled in the current stretch.
        self.slots: dict[Node, int] = {}
        self.spilled: dict[Node, int] = {}
        ends = [loop.detail for loop in graph.kept if loop.detail.condition is not None]
        self.grouped = self.in_group = self.width > 1 and not all(x.once for x in ends)
        self.packed = _Packed()
        self.items: list[code.Item] = []
        self._begin()

    def allocated(self) -> code.Code:
        """Return the program in which every value has a register, an LLVM name or memory."""
        graph = self.graph
        across = live_across(graph, self.lists)
        far = set(across)
        # Copy rows that loops read to adjacent places. Rows far apart compete for cache and pages.
        inputs = [node for node in graph.nodes if node.op == "input" and node in far]
        runs: list[list[Node]] = []
        for node in sorted(inputs, key=lambda node: node.detail):
            number, row = node.detail
            if runs and runs[-1][-1].detail == (number, row - 1):
                runs[-1].append(node)
            else:
                runs.append([node])
        for run in runs:
            size = self._row_bytes(run[0])
            start = self.memory.reserve(size * len(run), run[0].part)
            self.slots.update((node, start + i * size) for i, node in enumerate(run))
            number, row = run[0].detail
            self.buffers[f"%b{number}"] = None
            self._let(self.select.copy_rows(run[0].dtype), f"%b{number}", row, len(run), start)
        self._end()
        carried = [loop.detail.carried[k] for loop, kept in graph.kept.items() for k in kept]
        counters = [node for node in graph.nodes if node.op == "counter"]
        for node in [*carried, *counters, *across]:
            if node not in self.slots:
                self.slots[node] = self.memory.reserve(self._row_bytes(node), node.part)
        self._block(graph.top, graph.result_nodes)
        for k, (buffer, nodes) in enumerate(graph.results):
            base = f"%b{len(graph.arguments) + k}"
            template = self.select.store_row(buffer.dtype)
            for row, node in enumerate(nodes):
                name = self._ref(node)
                self.buffers[base] = None
                self._let(template, name, base, row)
                self._used()
                self._cut()
        self._end()
        self.registers.expect((), ())
        return code.Code(
            graph.arguments,
            tuple(buffer for buffer, _ in graph.results),
            self.variant,
            self.items,
            self.constants,
            self.select.functions,
            self.memory.size,
            self.memory.frame,
            self.grouped,
            self.spills,
            self.memory.places,
        )

    # Steps and stretches.

    def _let(self, template: Template | str, *operands: str | int) -> str:
        """Add a step, or a line of text as a step, and return the name of its result."""
        if isinstance(template, str):
            template = self.select.line(template)
        first = self.count + 1
        self.count += template.names
        self.lines += template.lines
        self.parts[self.part] = self.parts.get(self.part, 0) + template.lines
        self.steps.append(code.Step(template, operands, first))
        if template.result:
            return f"%v{first + template.result - 1}"
        return operands[0]  # pyright: ignore[reportReturnType]

    def _begin(self) -> None:
        """Begin an empty stretch."""
        self.functions: list[code.FunctionCode] = []
        # Names of values that LLVM finds registers for: truth values and uniform integers.
        self.names: dict[Node, str] = {}
        self.buffers: dict[str, None] = {}
        self._begin_function()

    def _begin_function(self) -> None:
        self.steps: list[code.Step] = []
        self.lines = 0
        # Lines of each part in the current function.
        self.parts: dict[str, int] = {}

    def _cut(self) -> None:
        """Continue in a new function, if the current function is long.

        LLVM's time and stack grow faster than the length of a function. Values that are used again
        go through memory. Names of values from before a cut are not valid after it.
        """
        if self.lines >= machine_constants.LONGEST_FUNCTION:
            self._empty_registers()
            self._end_function()

    def _end(self, result: str = "", kind: str = "void") -> None:
        """End the stretch, and begin the next one."""
        if self.steps or result or self.functions:
            self._end_function()
            self.items.append(StretchCode(self.functions, result, kind))
        self._begin()

    def _end_function(self) -> None:
        self.functions.append(code.FunctionCode(self.steps, tuple(self.buffers), self.parts))
        self._begin_function()

    # Registers.

    def _empty_registers(self) -> None:
        """Empty all registers. Store in memory the values that are used again."""
        for (node, wide), name in self.registers.empty():
            if wide != node.uniform:
                self._spill(node, name)
        for node, name in self.names.items():
            if self.registers.uses.get(node):
                self._spill(node, name)
        self.names = {}

    def _spill(self, node: Node, name: str) -> None:
        """Store a value in shared memory, unless the value is in memory already."""
        if node in self.spilled or home(node) in self.slots:
            return
        self.spilled[node] = place = self.memory.borrow(self._row_bytes(node))
        self.buffers[FRAME] = None
        self.spills[self.part] += 1
        self._let(self.select.store(node.dtype, node.uniform, FRAME), name, place - FRAME_ORIGIN)

    def _used(self) -> None:
        """Note that the current operation, or the current use of a result, is done."""
        leaving, over = self.registers.pass_on()
        for node in over:
            if node in self.spilled:
                self.memory.release(self._row_bytes(node), self.spilled.pop(node))
        for (node, wide), name in leaving:
            if wide != node.uniform:
                self._spill(node, name)

    def _hold(self, node: Node, name: str) -> None:
        kind = node.dtype.kind
        wide = not node.uniform
        if kind == "f" or (wide and self.width > 1 and kind in "iu"):
            self.registers.hold(node, wide, name)
        else:
            self.names[node] = name

    def _ref(self, node: Node, uniform: bool = False) -> str:
        """Return the LLVM name of a value: of a scalar if ``uniform``, else of a vector."""
        node = resolve(node)
        if node.value is not None:
            return self.select.literal(node.value, node.dtype, uniform)
        name = self.registers.names.get((node, not node.uniform)) or self.names.get(node)
        if node.uniform and not uniform and self.width > 1:
            spread = self.registers.names.get((node, True))
            if spread is None:
                spread = self._let(self.select.spread(node.dtype), name or self._fetch(node))
                self.registers.hold(node, True, spread)
            return spread
        return name or self._fetch(node)

    # Memory.

    def _fetch(self, node: Node) -> str:
        """Load a value from memory and return its name."""
        if node in self.spilled:
            self.buffers[FRAME] = None
            self.spills[self.part] += 1
            template = self.select.load(node.dtype, node.uniform, FRAME)
            name = self._let(template, self.spilled[node] - FRAME_ORIGIN)
        elif node.op == "input" and node not in self.slots:
            number, row = node.detail
            base = f"%b{number}"
            self.buffers[base] = None
            name = self._let(self.select.load_row(node.dtype, node.uniform), base, row)
        else:
            self.packed.read[home(node)] = None
            template = self.select.load(node.dtype, node.uniform, SCRATCH)
            name = self._let(template, self.slots[home(node)])
        self._hold(node, name)
        return name

    def _row_bytes(self, node: Node) -> int:
        return node.dtype.itemsize * (1 if node.uniform else self.width)

    def _store(self, value: str, node: Node, place: int) -> None:
        self._let(self.select.store(node.dtype, node.uniform, SCRATCH), value, place)

    def _address(self, place: int) -> str:
        return self._let(f"getelementptr i8, ptr {SCRATCH}, i64 {{0}}", place)

    # Code without branches.

    def _block(self, block: GraphBlock, result_nodes: list[Node]) -> None:
        """Allocate the operations and loops of a block.

        The result nodes are used after the block, in the given order. After each use, `_used` must
        be called.
        """
        for run, loop in self.graph.runs.get(block, [([], None)]):
            uses = (
                result_nodes if loop is None else [loop.operands[k] for k in self.graph.kept[loop]]
            )
            self.registers.expect(run, uses)
            for node, place in self.spilled.items():
                self.memory.release(self._row_bytes(node), place)
            self.spilled = {}
            for node in run:
                self.part = node.part
                self._operation(node)
                self._used()
                self._cut()
            if loop is not None:
                self._loop(loop, loop.detail)

    def _operation(self, node: Node) -> None:
        if node.op in ("list", "result"):
            return
        if node.op in ("constants", "rows", "solve", "sums", "totals"):
            self._table(node)
            return
        if node.op == "write":
            self._write(node)
            return
        if node.op == "lookup":
            table, index = node.operands
            self.packed.tables[table] = None
            shared = table.op == "constants" or table.uniform
            template = self.select.read(node.dtype, shared, index.uniform)
            name = self._let(template, self._places(table, index))
        else:
            operands = [self._ref(one, node.uniform) for one in node.operands]
            name = self._let(self.select.operation(node), *operands)
        self._hold(node, name)
        if node in self.slots:
            self._store(name, node, self.slots[node])
            self.packed.written.add(node)

    def _places(self, table: Node, index: Node) -> str:
        """Return the address of a table's number at an index, or each individual's address."""
        where = self.tables[table]
        base = where if isinstance(where, str) else self._address(where)
        shared = table.op == "constants" or table.uniform
        template = self.select.places(table.dtype, shared, index.uniform)
        return self._let(template, base, self._ref(index, index.uniform))

    def _write(self, node: Node) -> None:
        """Write to the numbers of a table from an index on, for individuals with a flag."""
        (index, valid, *_), memory, (count, adds) = node.operands, node.operands[-1], node.detail
        places, going = self._places(memory, index), self._ref(valid)
        one, known = index.uniform or self.width == 1, valid.value is not None
        step = f"getelementptr i8, {'ptr' if one else f'<{self.width} x ptr>'} {{0}}, i64 {{1}}"
        template = self.select.write(node.dtype, (one, adds, known))
        for k, value in enumerate(node.operands[2 : 2 + count]):
            own = self._let(step, places, k * self._row_bytes(memory))
            self._let(template, self._ref(value), own, going)
        if memory in self.extents:
            self._extend(self.extents[memory], index, count, going)

    def _extend(self, slot: int, index: Node, count: int, going: str) -> None:
        """Note that a table has rows up to an index and some more, for individuals with a flag."""
        t, flags = (self.select.type_of(each, False) for each in (_INDEX, _BOOL))
        none, size = (self.select.literal(x, _INDEX, False) for x in (0, count))
        end = self._let(f"add {t} {{0}}, {{1}}", self._ref(index), size)
        end = self._let(f"select {flags} {{0}}, {t} {{1}}, {t} {{2}}", going, end, none)
        last = self._let(self.select.load(_INDEX, False, SCRATCH), slot)
        last = self._let(f"call {t} @llvm.umax.{suffix(t)}({t} {{0}}, {t} {{1}})", last, end)
        self._let(self.select.store(_INDEX, False, SCRATCH), last, slot)

    def _table(self, node: Node) -> None:
        """Give a table its place, and write its numbers to memory."""
        if isinstance(node.detail, bytes):
            name = self.tables[node] = f"@table{len(self.constants)}"
            self.constants[name] = np.frombuffer(node.detail, node.dtype)
            return
        self.packed.written.add(node)
        if node.op == "totals":
            self.tables[node] = self.tables[node.operands[0]]
            return
        size, count, first = self._row_bytes(node), len(node.operands), node.operands[0]
        start = self.tables[node] = self.memory.reserve(size * count, node.part)
        equal = node.op == "sums" and {*node.operands} == {first}
        if equal and first.detail is True:
            extent = _INDEX.itemsize * self.width
            place = self.extents[node] = self.memory.reserve(extent, node.part)
            none = self.select.literal(0, _INDEX, False)
            self._let(self.select.store(_INDEX, False, SCRATCH), none, place)
            return
        if equal and first.value is not None:
            to = self._address(start)
            self._let(self.select.fill(node.dtype), to, self._ref(first), count)
            return
        for i, operand in enumerate(node.operands):
            self._store(self._ref(operand, node.uniform), node, start + i * size)
            if node.op == "sums":
                self._cut()
        if node.op == "solve":
            # A function replaces the right-hand side, which comes last, by the solution.
            answers = self.tables[node] = start + (count - node.detail) * size
            template = self.select.solve(node.dtype, node.uniform)
            H, b = self._address(start), self._address(answers)
            # A call clobbers the registers.
            self._empty_registers()
            self._let(template, H, b, node.detail)

    # Loops.

    def _loop(self, node: Node, loop: GraphLoop) -> None:
        """Allocate a loop or a branch."""
        self._enter(node, loop)
        in_group, self.in_group = self.in_group, self.in_group and loop.condition is None
        packs = in_group and not self.in_group and not loop.once
        if packs:
            self.packed = _Packed()
        outside, self.items = self.items, []
        if loop.condition is not None:
            self._end(*self._test(loop, loop.condition, packs))
        test, self.items = self.items, []
        # The test has selected the individuals to pack, so the code of packed ones begins with a
        # round.
        tested = set(self.packed.written)
        counter = None
        if loop.counter in self.slots:
            counter = self.slots[loop.counter]
            self.packed.written.add(loop.counter)
        body = self._round(node, loop)
        self.items, self.in_group = outside, in_group
        packed = self._moved(node, loop, tested) if packs else None
        self.items.append(code.LoopCode(loop, counter, test, body, packed))

    def _enter(self, node: Node, loop: GraphLoop) -> None:
        """Store the initial carried values of a loop in their slots, and give its lists places."""
        self.part = node.part
        for k in self.graph.kept[node]:
            self._store(self._ref(node.operands[k]), loop.carried[k], self.slots[loop.carried[k]])
            self._used()
            self._cut()
            self.packed.written.add(loop.carried[k])
        for one in self.lists[node]:
            size = self._row_bytes(one) * (loop.count or 1)
            self.tables[one] = self.memory.reserve(size, node.part)
            self.packed.written.add(one)
        self._end()

    def _test(self, loop: GraphLoop, condition: Node, packs: bool) -> tuple[str, str]:
        """Allocate the test of a loop, and return the name and the type of its result.

        The result has a bit for each individual if the loop ``packs``. Else the result is true if
        the condition holds for any individual.
        """
        self._block(loop.test, [condition])
        name = self._ref(condition)
        self._used()
        flags, bits = self.select.type_of(_BOOL, False), f"i{self.width}"
        if packs:
            mask = self._let(f"bitcast {flags} {{0}} to {bits}", name)
            return self._let(f"zext {bits} {{0}} to i32", mask), "i32"
        if self.width > 1:
            reduction = f"llvm.vector.reduce.or.v{self.width}i1"
            name = self._let(f"call i1 @{reduction}({flags} {{0}})", name)
        return name, "i1"

    def _moved(self, node: Node, loop: GraphLoop, tested: set[Node]) -> code.Packed:
        """Return what is moved into a packed vector, and back.

        ``tested`` are the nodes that the test writes.
        """
        packed, carries = self.packed, [loop.carried[k] for k in self.graph.kept[node]]
        reads = [x for x in packed.read if x in tested or x not in packed.written]
        carries, reads = (
            [Slot(self.slots[x], x.dtype.itemsize, x.uniform) for x in each]
            for each in (carries, reads)
        )
        growing = []
        for table in packed.tables:
            start, size = self.tables[table], self._row_bytes(table)
            extent = self.extents.get(table.operands[0]) if table.op == "totals" else None
            if extent is not None and table not in packed.written:
                assert isinstance(start, int)
                growing.append(code.GrowingTable(start, table.dtype.itemsize, size, extent))
            elif table not in packed.written and isinstance(start, int):
                reads += [
                    Slot(start + i * size, table.dtype.itemsize, table.uniform)
                    for i in range(row_count(table))
                ]
        return reads, carries, growing

    def _round(self, node: Node, loop: GraphLoop) -> list[code.Item]:
        """Allocate a round of a loop and return its code."""
        kept, lists, condition = self.graph.kept[node], self.lists[node], loop.condition
        # A carried value that moves to another slot is read before any slot is written.
        carried = set(loop.carried)
        ends = {k: resolve(loop.following[k]) for k in kept}
        moved = [k for k in kept if ends[k] in carried and ends[k] is not loop.carried[k]]
        kept = [k for k in kept if k not in moved]
        written = [loop.written[one.detail] for one in lists]
        uses = [*written, *(ends[k] for k in moved)]
        for k in kept:
            uses += [ends[k], *([] if condition is None else [loop.carried[k]])]
        self._block(loop.body, [*uses, *([] if condition is None else [condition])])
        # A list has one place for all individuals.
        self.part, to_all = node.part, (True, False, True)
        for one, value in zip(lists, written, strict=True):
            assert loop.index is not None
            pointer, template = self._places(one, loop.index), self.select.write(one.dtype, to_all)
            self._let(template, self._ref(value), pointer, "true")
            self._used()
            self._cut()
        places = []
        for k in moved:
            one, value = loop.carried[k], self._unless_done(loop, k, self._ref(ends[k]))
            places.append(self.memory.reserve(self._row_bytes(one), node.part))
            self._store(value, one, places[-1])
            self._used()
        for k in kept:
            value = self._ref(ends[k])
            self._used()
            if condition is not None:
                value = self._unless_done(loop, k, value)
                self._used()
            self._store(value, loop.carried[k], self.slots[loop.carried[k]])
            self._cut()
        if condition is not None:
            self._used()
        for k, place in zip(moved, places, strict=True):
            one = loop.carried[k]
            value = self._let(self.select.load(one.dtype, one.uniform, SCRATCH), place)
            self._store(value, one, self.slots[one])
        self._end()
        return self.items

    def _unless_done(self, loop: GraphLoop, k: int, value: str) -> str:
        """Return the new value for individuals that continue, and the old value for the others."""
        node, condition = loop.carried[k], loop.condition
        if condition is None:
            return value
        t, flags = (self.select.type_of(each, False) for each in (node.dtype, _BOOL))
        text = f"select {flags} {{0}}, {t} {{1}}, {t} {{2}}"
        going = self._ref(condition)
        return self._let(text, going, value, self._ref(node))
