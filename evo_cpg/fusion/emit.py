"""From a graph of scalars to LLVM IR: a program that computes it for all individuals.

The program runs over the individuals a *vector* at a time: every scalar of the graph becomes one
instruction on a register that holds it for 16 individuals (or 8, 4, 1: the machine's width). All
that lies between two ends of loops is one *stretch* without branches, a function; what crosses from
one to another has a *slot* in scratch memory, a number for each individual of the vector, and so
has what leaves the registers for a while. A *driver* loops and calls them. The last vector overlaps
the one before it where the individuals do not come out even; where there are fewer than one vector
holds, rows are read and written with a mask.

No instruction carries a fast-math flag, and which products are fused with sums is decided before
(`evo_cpg.fusion.sums`): the bits of an individual's results do not depend on the vector's width.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evo_cpg.fusion.graph import Block, Loop, Node
from evo_cpg.fusion.ir import TYPES, Writer, number
from evo_cpg.fusion.liveness import Plan, home
from evo_cpg.fusion.memory import Memory
from evo_cpg.fusion.operations import write
from evo_cpg.fusion.order import resolve
from evo_cpg.fusion.registers import Registers


class Buffer(NamedTuple):
    """An array that goes into or out of the function.

    Attributes:
        rows: numbers for each individual.
        dtype: of the numbers.
        shared: whether there is one set of them for all individuals.
    """

    rows: int
    dtype: np.dtype
    shared: bool = False


class Variant(NamedTuple):
    """What the machine code is made for.

    Attributes:
        width: individuals in a vector.
        masked: fewer individuals than that.
        fma: whether the processor multiplies and adds in one instruction.
        registers: for vectors, that it has.
    """

    width: int
    masked: bool
    fma: bool
    registers: int


class Code(NamedTuple):
    """The text of the function ``@program`` and what goes with it.

    Attributes:
        text: LLVM IR.
        scratch: bytes of memory that it needs.
    """

    text: str
    scratch: int


def emit(
    arguments: Sequence[Buffer],
    results: Sequence[tuple[Buffer, list[Node]]],
    top: Block,
    variant: Variant,
) -> Code:
    """The function that computes nodes for all individuals.

    Args:
        arguments: buffers; the key of an input node is (number of the buffer, row).
        results: buffers, and the node of each row.
        top: the block of the whole program.
        variant: the kind of code.

    Raises:
        Unsupported: there are more operations than code is made of.
    """
    plan = Plan([node for _, nodes in results for node in nodes], top)
    return _Emitter(arguments, results, variant, plan).emit(top)


class _Emitter:
    """Writes the functions, one for each stretch, and the driver that calls them.

    Of the attributes ``w`` has the lines of the stretch that is being written, ``registers`` and
    ``names`` where its values are.
    """

    def __init__(self, arguments, results, variant: Variant, plan: Plan):
        self.arguments, self.results, self.plan = arguments, results, plan
        self.width, self.masked = variant.width, variant.masked
        self.registers = Registers(variant.registers)
        self.w = Writer(variant.width, variant.fma)
        self.memory = Memory(self.w, variant.masked)
        self.globals: list[str] = []
        self.functions: list[str] = []
        self.driver: list[str] = []
        self.label = "vector"
        # Of what crosses stretches, and of what left the registers in this one.
        self.slots: dict[Node, int] = {}
        self.spilled: dict[Node, int] = {}
        self.tables: dict[Node, int | str] = {}
        self._begin()

    def emit(self, top: Block) -> Code:
        """The whole program."""
        crossing = set(self.plan.crossing)
        self._copy_inputs([node for node in self.plan.inputs if node in crossing])
        for node in [*self.plan.carried, *self.plan.counters, *self.plan.crossing]:
            if node not in self.slots:
                self.slots[node] = self.memory.room(self._row_bytes(node))
        self._block(top, [node for _, nodes in self.results for node in nodes])
        self._write_results()
        self._end()
        return Code(self._text(), self.memory.size)

    def _begin(self) -> None:
        """A new stretch, in which nothing is known yet."""
        self.w.lines = []
        # Names of values that LLVM finds registers for: truth values, and whole numbers for all.
        self.names: dict[Node, str] = {}
        self.memory.buffers = {}

    def _end(self, result: str = "") -> str:
        """The stretch as a function of its own, called by the driver; the name of its result."""
        if not self.w.lines and not result:
            return ""
        name = f"@stretch{len(self.functions)}"
        kind = "i1" if result else "void"
        parameters = [f"ptr noalias {buffer}" for buffer in self.memory.buffers]
        parameters += ["ptr noalias %scratch", "i64 %n", "i64 %first"]
        body = [*self._valid(), *self.w.lines, f"ret {kind} {result}"]
        # Not inlined: within the driver's loops LLVM would take constants out of them, thousands,
        # and spill each as a whole vector.
        self.functions.append(
            f"define internal {kind} {name}({', '.join(parameters)}) noinline #0 {{\n"
            + "\n".join(body)
            + "\n}"
        )
        given = ", ".join(each.replace(" noalias", "") for each in parameters)
        call = f"call {kind} {name}({given})"
        found = f"%found{len(self.functions)}" if result else ""
        self.driver.append(f"{found} = {call}" if result else call)
        return found

    # Code without branches.

    def _block(self, block: Block, wanted: list[Node]) -> None:
        """The operations of a block; what is wanted in the end, in the order of its use."""
        for run, loop in self.plan.runs(block):
            uses = wanted if loop is None else [loop.detail.start[k] for k in self.plan.kept(loop)]
            self._expect(run, uses)
            for node in run:
                self._operation(node)
                self._used()
            if loop is not None:
                self._loop(loop, loop.detail)

    def _operation(self, node: Node) -> None:
        if node.op == "rows":
            self._rows(node)
        elif node.op == "constants":
            self._constants(node)
        elif node.op not in ("result", "list"):
            name = self._lookup(node) if node.op == "lookup" else self._write(node)
            self._hold(node, not node.uniform, name)
            if node in self.slots:
                self._store(name, node, self.slots[node])

    def _write(self, node: Node) -> str:
        return write(self.w, node, [self._ref(one, node.uniform) for one in node.operands])

    # Registers.

    def _expect(self, run: list[Node], wanted: list[Node]) -> None:
        """Begin a stretch; `_used` is to be called after each operation and each use in the end."""
        self.registers.expect(run, wanted)
        for node, place in self.spilled.items():
            self.memory.give_back(self._row_bytes(node), place)
        self.spilled = {}

    def _used(self) -> None:
        leaving, over = self.registers.pass_on()
        for node in over:
            if node in self.spilled:
                self.memory.give_back(self._row_bytes(node), self.spilled.pop(node))
        for (node, wide), name in leaving:
            kept = node in self.spilled or home(node) in self.slots
            if not kept and wide != node.uniform:
                self.spilled[node] = place = self.memory.borrow(self._row_bytes(node))
                self._store(name, node, place)

    def _hold(self, node: Node, wide: bool, name: str) -> None:
        if node.dtype.kind == "f" or (wide and self.width > 1 and node.dtype.kind in "iu"):
            self.registers.hold(node, wide, name)
        else:
            self.names[node] = name

    # Memory.

    def _row_bytes(self, node: Node) -> int:
        return node.dtype.itemsize * (1 if node.uniform else self.width)

    def _store(self, value: str, node: Node, place: int) -> None:
        self.memory.store(value, node.dtype, place, node.uniform)

    def _copy_inputs(self, nodes: list[Node]) -> None:
        """Bring rows that loops read close together: far apart they compete for cache and pages.

        Rows that lie one behind the other are copied by a loop.
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
            start = self.memory.room(size * len(run))
            self.slots.update((node, start + i * size) for i, node in enumerate(run))
            self._copy_rows(run, start, size)

    def _copy_rows(self, run: list[Node], start: int, size: int) -> None:
        dtype, (number, row) = run[0].dtype, run[0].detail
        k = self.w.count
        before, head, self.label = self.label, f"copy{k}", f"copied{k}"
        source = self.w.let(f"add i64 %i{k}, {row}")
        value = self.memory.load_row(f"%b{number}", source, dtype, False)
        place = self.w.let(f"mul i64 %i{k}, {size}")
        place = self.w.let(f"add i64 {place}, {start}")
        self.memory.store(value, dtype, self.memory.at(place))
        self.driver += [
            f"br label %{head}",
            f"{head}:",
            f"%i{k} = phi i64 [ 0, %{before} ], [ %j{k}, %{head} ]",
            *self.w.lines,
            f"%j{k} = add i64 %i{k}, 1",
            f"%more{k} = icmp slt i64 %j{k}, {len(run)}",
            f"br i1 %more{k}, label %{head}, label %{self.label}",
            f"{self.label}:",
        ]
        self._begin()

    def _rows(self, node: Node) -> None:
        """Write a table of computed numbers."""
        size = self._row_bytes(node)
        start = self.tables[node] = self.memory.room(size * len(node.operands))
        for i, operand in enumerate(node.operands):
            self._store(self._ref(operand, node.uniform), node, start + i * size)

    def _constants(self, node: Node) -> None:
        values = node.detail.values
        t = "i8" if node.dtype.kind == "b" else TYPES[node.dtype.char]
        name = self.tables[node] = f"@table{len(self.globals)}"
        items = ", ".join(f"{t} {number(value, node.dtype)}" for value in values)
        self.globals.append(f"{name} = internal constant [{len(values)} x {t}] [{items}], align 64")

    def _lookup(self, node: Node) -> str:
        table, place = node.operands
        where = self.tables[table]
        base = where if isinstance(where, str) else self.memory.at(where)
        index = self._ref(place, place.uniform)
        shared = table.op == "constants" or table.uniform
        return self.memory.look_up(base, index, node.dtype, shared, place.uniform)

    def _write_results(self) -> None:
        for k, (buffer, nodes) in enumerate(self.results):
            for row, node in enumerate(nodes):
                base = f"%b{len(self.arguments) + k}"
                self.memory.store_row(self._ref(node), base, row, buffer.dtype)
                self._used()

    # Loops.

    def _loop(self, node: Node, loop: Loop) -> None:
        """Carried values live in their slots; a round reads all that it needs before it writes."""
        kept, lists = self.plan.kept(node), self.plan.lists(node)
        for k in kept:
            self._store(self._ref(loop.start[k]), loop.carried[k], self.slots[loop.carried[k]])
            self._used()
        for one in lists:
            self.tables[one] = self.memory.room(self._row_bytes(one) * (loop.count or 1))
        self._end()
        number = self.w.count = self.w.count + 1
        counter, head, body, after = (
            f"{word}{number}" for word in ("round", "head", "body", "after")
        )
        before, self.label = self.label, head
        self.driver += [f"br label %{head}", f"{head}:"]
        phi = len(self.driver)
        self.driver.append("")
        if loop.condition is None:
            more = f"%more{number}"
            self.driver.append(f"{more} = icmp slt i32 %{counter}, {loop.count}")
        else:
            more = self._test(loop)
        self.driver += [f"br i1 {more}, label %{body}, label %{after}", f"{body}:"]
        self.label = body
        if loop.counter in self.slots:
            place = f"%place{number}"
            self.driver.append(
                f"{place} = getelementptr i8, ptr %scratch, i64 {self.slots[loop.counter]}"
            )
            self.driver.append(f"store i32 %{counter}, ptr {place}")
        self._begin()
        self._round(loop, kept, lists)
        self._end()
        self.driver[phi] = (
            f"%{counter} = phi i32 [ 0, %{before} ], [ %next{number}, %{self.label} ]"
        )
        self.driver += [f"%next{number} = add i32 %{counter}, 1", f"br label %{head}", f"{after}:"]
        self.label = after
        self._begin()

    def _test(self, loop: Loop) -> str:
        """Whether any individual wants another round."""
        self._begin()
        condition = loop.condition
        assert condition is not None
        self._block(loop.test, [condition])
        active, flag = self._ref(condition), self.w.type_of(np.dtype(bool), False)
        if self.masked:
            active = self.w.let(f"and {flag} {active}, %valid")
        if self.width == 1:
            return self._end(active)
        name = f"llvm.vector.reduce.or.v{self.width}i1"
        self.w.declared[name] = f"declare i1 @{name}({flag})"
        return self._end(self.w.let(f"call i1 @{name}({flag} {active})"))

    def _round(self, loop: Loop, kept: list[int], lists: list[Node]) -> None:
        # What goes from one place to another is read before any is written.
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
            steps = self.w.let(f"mul i32 {self._ref(loop.place, True)}, {self._row_bytes(one)}")
            start = self.memory.at(self.tables[one])
            pointer = self.w.let(f"getelementptr i8, ptr {start}, i32 {steps}")
            self.memory.store(self._ref(value), one.dtype, pointer)
            self._used()
        copies = [(k, self._copy(loop, k)) for k in moved]
        for k in kept:
            value = self._ref(ends[k])
            self._used()
            if old:
                value = self._unless_done(loop, k, value)
                self._used()
            self._store(value, loop.carried[k], self.slots[loop.carried[k]])
        for k, place in copies:
            node = loop.carried[k]
            self._store(self.memory.load(node.dtype, place), node, self.slots[node])

    def _copy(self, loop: Loop, k: int) -> int:
        """What comes to be carried, kept aside; where."""
        node = loop.carried[k]
        value = self._ref(loop.following[k])
        if loop.condition is not None:
            value = self._unless_done(loop, k, value)
        place = self.memory.room(self._row_bytes(node))
        self._store(value, node, place)
        self._used()
        return place

    def _unless_done(self, loop: Loop, k: int, value: str) -> str:
        """Who wants no more rounds stays as it is."""
        node, condition = loop.carried[k], loop.condition
        assert condition is not None
        active, flag = self._ref(condition), self.w.type_of(np.dtype(bool), False)
        t, old = self.w.type_of(node.dtype, False), self._ref(node)
        return self.w.let(f"select {flag} {active}, {t} {value}, {t} {old}")

    # Names.

    def _ref(self, node: Node, uniform: bool = False) -> str:
        """The name of a value, spread over a vector unless it is wanted once for all."""
        node = resolve(node)
        if node.value is not None:
            return self.w.literal(node.value, node.dtype, uniform)
        name = self.registers.name(node, not node.uniform) or self.names.get(node)
        wide = not (node.uniform and uniform) and self.width > 1
        if node.uniform and wide:
            spread = self.registers.name(node, True)
            if spread is None:
                spread = self._spread(node, name or self._fetch(node))
                self.registers.hold(node, True, spread)
            return spread
        return name or self._fetch(node)

    def _fetch(self, node: Node) -> str:
        """Read a value that is in memory."""
        if node in self.spilled:
            name = self.memory.load(node.dtype, self.spilled[node], node.uniform)
        elif node.op == "input" and node not in self.slots:
            number, row = node.detail
            name = self.memory.load_row(f"%b{number}", row, node.dtype, node.uniform)
        else:
            name = self.memory.load(node.dtype, self.slots[home(node)], node.uniform)
        self._hold(node, not node.uniform, name)
        return name

    def _spread(self, node: Node, name: str) -> str:
        """A value that all share as a vector."""
        t, scalar = self.w.type_of(node.dtype, False), TYPES[node.dtype.char]
        one = self.w.let(f"insertelement {t} poison, {scalar} {name}, i32 0")
        zeros = f"<{self.width} x i32> zeroinitializer"
        return self.w.let(f"shufflevector {t} {one}, {t} poison, {zeros}")

    def _valid(self) -> list[str]:
        """Which individuals of a vector exist."""
        if not self.masked:
            return []
        lanes, wide = ", ".join(f"i64 {i}" for i in range(self.width)), f"<{self.width} x i64>"
        zeros = f"<{self.width} x i32> zeroinitializer"
        return [
            f"%one = insertelement {wide} poison, i64 %n, i32 0",
            f"%all = shufflevector {wide} %one, {wide} poison, {zeros}",
            f"%valid = icmp ult {wide} <{lanes}>, %all",
        ]

    def _text(self) -> str:
        buffers = len(self.arguments) + len(self.results)
        parameters = ", ".join([*(f"ptr %b{k}" for k in range(buffers)), "ptr %scratch", "i64 %n"])
        driver = [
            f"define internal void @program({parameters}) #0 {{",
            "entry:",
            "br label %vector",
            "vector:",
            f"%first = phi i64 [ 0, %entry ], [ %next, %{self.label} ]",
            *self._valid(),
            *self.driver,
            # The last vector ends with the last individual.
            f"%stop = add i64 %first, {self.width}",
            f"%left = sub i64 %n, {self.width}",
            "%within = icmp slt i64 %stop, %left",
            "%next = select i1 %within, i64 %stop, i64 %left",
            "%more = icmp slt i64 %stop, %n",
            "br i1 %more, label %vector, label %done",
            "done:",
            "ret void",
            "}",
        ]
        declared = self.w.declared.values()
        return "\n".join([*self.globals, *declared, *self.functions, *driver])
