"""From a graph of scalars to LLVM IR: a program that computes it for all individuals.

The program runs over the individuals a *vector* at a time: every scalar of the graph becomes one
instruction on a register that holds it for 16 individuals (or 8, 4, 1: the machine's width). All
that lies between two ends of loops is one *stretch* without branches, a function; what crosses from
one to another has a *slot* in scratch memory, a number for each individual of the vector. What
leaves the registers for a while is in memory that all vectors share. A *driver* loops and calls
them, for one vector, or for several in turn where loops end at different rounds for each individual
(`packing`). The last vector overlaps the one before it where the individuals do not
come out even; where there are fewer than one vector holds, rows are read and written with a mask.

No instruction carries a fast-math flag, and which products are fused with sums is decided before
(`passes.contract`): the bits of an individual's results do not depend on the vector's width.
"""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from evo_cpg.fusion import machine_constants
from evo_cpg.fusion.backend.memory import FRAME, FRAME_ORIGIN, Memory
from evo_cpg.fusion.backend.operations import write
from evo_cpg.fusion.backend.packing import Gang, Place, declared, each_vector, packed_loop
from evo_cpg.fusion.backend.registers import Registers
from evo_cpg.fusion.backend.solve_routine import routine
from evo_cpg.fusion.backend.writer import TYPES, Writer, number
from evo_cpg.fusion.ir.graph import Block, Loop, Node, row_count
from evo_cpg.fusion.passes.liveness import Plan, home
from evo_cpg.fusion.passes.schedule import resolve
from evo_cpg.fusion.unsupported import Unsupported


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
        compresses: whether it closes up the chosen numbers of a vector in one instruction.
    """

    width: int
    masked: bool
    fma: bool
    registers: int
    compresses: bool


class Code(NamedTuple):
    """The text of the function ``@program`` and what goes with it.

    Attributes:
        text: LLVM IR.
        scratch: bytes of memory that it needs.
        operations: number of nodes of the graph that it computes.
    """

    text: str
    scratch: int
    operations: int


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


class _Packed:
    """A loop that is packed: what its rounds read from memory, and what they have written there."""

    def __init__(self):
        self.read: dict[Node, None] = {}
        self.tables: dict[Node, None] = {}
        self.written: set[Node] = set()


class _Emitter:
    """Writes the functions, one for each stretch, and the driver that calls them.

    Of the attributes ``w`` has the lines of the stretch that is being written, ``registers`` and
    ``names`` where its values are. With a gang, the driver's calls are for all of its vectors, but
    for those in ``packed``, the loop whose functions are being written, and while ``alone``.
    """

    def __init__(self, arguments, results, variant: Variant, plan: Plan):
        self.arguments, self.results, self.plan = arguments, results, plan
        self.width, self.masked = variant.width, variant.masked
        self.compresses = variant.compresses
        self.registers = Registers(variant.registers)
        self.w = Writer(variant.width, variant.fma)
        self.memory = Memory(self.w, variant.masked)
        self.globals: list[str] = []
        self.functions: list[str] = []
        self.driver: list[str] = []
        self.label = "vector"
        # Calls of the functions of the present stretch that are written already.
        self.pieces: list[str] = []
        # Of what crosses stretches, and of what left the registers in this one.
        self.slots: dict[Node, int] = {}
        self.spilled: dict[Node, int] = {}
        self.tables: dict[Node, int | str] = {}
        self.ganged = variant.width > 1 and not variant.masked and plan.packs
        self.packed: _Packed | None = None
        self.alone = False
        # What is written once it is known how much memory a vector needs.
        self.late: list[Callable[[Gang], str]] = []
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
        return Code(*self._text(), self.plan.operations)

    @property
    def _takes_turns(self) -> bool:
        """Whether the driver's calls are for all vectors of a gang."""
        return self.ganged and self.packed is None and not self.alone

    def _begin(self) -> None:
        """A new stretch, in which nothing is known yet."""
        self.w.lines = []
        # Names of values that LLVM finds registers for: truth values, and whole numbers for all.
        self.names: dict[Node, str] = {}
        self.memory.buffers = {}

    def _cut(self) -> None:
        """Go on in another function, if this one is long.

        The time and the stack that LLVM takes grow faster than a function. All that is used again
        goes through memory. Nothing may be held by its name alone where this is called.
        """
        if len(self.w.lines) >= machine_constants.LONGEST_FUNCTION:
            self._empty_registers()
            self.pieces.append(self._function())
            self.w.lines = []

    def _empty_registers(self) -> None:
        """Put all that is used again into memory."""
        for (node, wide), name in self.registers.empty():
            if wide != node.uniform:
                self._spill(node, name)
        for node, name in self.names.items():
            if self.registers.is_used_again(node):
                self._spill(node, name)
        self.names = {}

    def _spill(self, node: Node, name: str) -> None:
        """Keep a value in the memory that vectors share, unless it is in memory already."""
        if node in self.spilled or home(node) in self.slots:
            return
        self.spilled[node] = place = self.memory.borrow(self._row_bytes(node))
        self.memory.store(name, node.dtype, self.memory.borrowed(place), node.uniform)

    def _function(self, result: str = "", kind: str = "void") -> str:
        """Write a function of the lines that there are; return a call of it, without the result."""
        name = f"stretch{len(self.functions)}"
        buffers = [f"ptr noalias {buffer}, " for buffer in self.memory.buffers]
        body = ["entry:", *self._valid(), *self.w.lines, f"ret {kind} {result}"]
        # Not inlined: within the driver's loops LLVM would take constants out of them, thousands,
        # and spill each as a whole vector.
        self.functions.append(
            f"define internal {kind} @{name}({''.join(buffers)}ptr noalias %scratch, i64 %n, "
            f"i64 %first) noinline #0 {{\n" + "\n".join(body) + "\n}"
        )
        given = "".join(buffers).replace(" noalias", "")
        return f"call {kind} @{name}({given}ptr %scratch, i64 %n, i64 %first)"

    def _end(self, result: str = "", kind: str = "i1") -> str:
        """The stretch as a function of its own, called by the driver; the name of its result."""
        if not self.w.lines and not result and not self.pieces:
            return ""
        kind = kind if result else "void"
        if self.pieces:
            # The pieces take turns for each vector, for what they hand on is in shared memory.
            last = self._function(result, kind)
            found = "%result" if result else ""
            calls = [*self.pieces, f"{found} = {last}" if result else last]
            self.w.lines, result, self.pieces = calls, found, []
        call = self._function(result, kind)
        name = call.partition("@")[2].partition("(")[0]
        given = "".join(f"ptr {buffer}, " for buffer in self.memory.buffers)
        if self._takes_turns:
            self.late.append(functools.partial(each_vector, name, given, given))
            self.driver.append(
                f"call void @{name}.gang({given}ptr %scratch, i64 %n, i64 %first, i64 %count)"
            )
            return ""
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
                self._cut()
            if loop is not None:
                self._loop(loop, loop.detail)

    def _operation(self, node: Node) -> None:
        if node.op == "rows":
            self._rows(node)
        elif node.op == "constants":
            self._constants(node)
        elif node.op == "sums":
            self._sums(node)
        elif node.op == "solve":
            self._solve(node)
        elif node.op == "totals":
            self.tables[node] = self.tables[node.detail.memory]
            self._wrote(node)
        elif node.op == "accumulate":
            self._accumulate(node)
        elif node.op not in ("result", "list"):
            name = self._lookup(node) if node.op == "lookup" else self._write(node)
            self._hold(node, not node.uniform, name)
            if node in self.slots:
                self._store(name, node, self.slots[node])
                self._wrote(node)

    def _wrote(self, node: Node) -> None:
        if self.packed is not None:
            self.packed.written.add(node)

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
            if wide != node.uniform:
                self._spill(node, name)

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
        source = self.w.let(f"add i64 %i, {row}")
        value = self.memory.load_row(f"%b{number}", source, dtype, False)
        place = self.w.let(f"mul i64 %i, {size}")
        place = self.w.let(f"add i64 {place}, {start}")
        self.memory.store(value, dtype, self.memory.at(place))
        self.w.lines = [
            "br label %head",
            "head:",
            "%i = phi i64 [ 0, %entry ], [ %j, %head ]",
            *self.w.lines,
            "%j = add i64 %i, 1",
            f"%more = icmp slt i64 %j, {len(run)}",
            "br i1 %more, label %head, label %copied",
            "copied:",
        ]
        self._end()
        self._begin()

    def _rows(self, node: Node) -> None:
        """Write a table of computed numbers."""
        size = self._row_bytes(node)
        start = self.tables[node] = self.memory.room(size * len(node.operands))
        for i, operand in enumerate(node.operands):
            self._store(self._ref(operand, node.uniform), node, start + i * size)
        self._wrote(node)

    def _sums(self, node: Node) -> None:
        """Begin sums in memory of their own."""
        size = self._row_bytes(node)
        start = self.tables[node] = self.memory.room(size * len(node.operands))
        self._wrote(node)
        first = node.operands[0]
        if first.value is not None and all(operand is first for operand in node.operands):
            self._fill(node, start, size, first)
            return
        for i, operand in enumerate(node.operands):
            self._store(self._ref(operand), node, start + i * size)
            self._cut()

    def _fill(self, node: Node, start: int, size: int, value: Node) -> None:
        """Write the same constant to all rows, by a loop in a function of its own."""
        t = self.w.type_of(node.dtype, False)
        name = f"fill.{self.w.suffix(t)}"
        self.w.declared[name] = (
            f"define internal void @{name}(ptr %to, {t} %value, i64 %count) noinline #0 {{\n"
            "entry:\nbr label %row\nrow:\n"
            "%i = phi i64 [ 0, %entry ], [ %j, %row ]\n"
            f"%steps = mul i64 %i, {size}\n"
            "%place = getelementptr i8, ptr %to, i64 %steps\n"
            f"store {t} %value, ptr %place, align {node.dtype.itemsize}\n"
            "%j = add i64 %i, 1\n%more = icmp ult i64 %j, %count\n"
            "br i1 %more, label %row, label %done\ndone:\nret void\n}"
        )
        to, filled = self.memory.at(start), self._ref(value)
        self.w.lines.append(f"call void @{name}(ptr {to}, {t} {filled}, i64 {len(node.operands)})")

    def _solve(self, node: Node) -> None:
        """Put equations in memory and call the function that solves them."""
        size, dtype = self._row_bytes(node), node.dtype
        start = self.memory.room(size * len(node.operands))
        for i, operand in enumerate(node.operands):
            self._store(self._ref(operand, node.uniform), node, start + i * size)
        answers = start + (len(node.operands) - node.detail) * size
        self.tables[node] = answers
        t = self.w.type_of(dtype, node.uniform)
        name = f"solve.{self.w.suffix(t)}"
        if self.w.fma:
            fma = f"llvm.fma.{self.w.suffix(t)}"
            self.w.declared[fma] = f"declare {t} @{fma}({t}, {t}, {t})"
        if self.width > 1:
            flags = f"<{self.width} x i1>"
            any_of = f"llvm.vector.reduce.or.v{self.width}i1"
            self.w.declared[any_of] = f"declare i1 @{any_of}({flags})"
        self.w.declared[name] = routine(name, t, size, dtype.itemsize, self.w.fma)
        H, b = self.memory.at(start), self.memory.at(answers)
        # Registers do not outlast a call.
        self._empty_registers()
        self.w.lines.append(f"call void @{name}(ptr {H}, ptr {b}, i64 {node.detail})")
        self._wrote(node)

    def _accumulate(self, node: Node) -> None:
        """Add to a number in memory."""
        place, value = node.operands
        base = self.memory.at(self.tables[node.detail.memory])
        steps = self.w.let(f"mul i32 {self._ref(place, True)}, {self._row_bytes(node)}")
        pointer = self.w.let(f"getelementptr i8, ptr {base}, i32 {steps}")
        t = self.w.type_of(node.dtype, False)
        before = self.memory.load(node.dtype, pointer)
        add = "fadd" if node.dtype.kind == "f" else "add"
        self.memory.store(
            self.w.let(f"{add} {t} {before}, {self._ref(value)}"), node.dtype, pointer
        )

    def _constants(self, node: Node) -> None:
        values = node.detail.values
        t = "i8" if node.dtype.kind == "b" else TYPES[node.dtype.char]
        name = self.tables[node] = f"@table{len(self.globals)}"
        items = ", ".join(f"{t} {number(value, node.dtype)}" for value in values)
        self.globals.append(f"{name} = internal constant [{len(values)} x {t}] [{items}], align 64")

    def _lookup(self, node: Node) -> str:
        table, place = node.operands
        where = self.tables[table]
        if self.packed is not None and not isinstance(where, str):
            self.packed.tables[table] = None
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
                self._cut()

    # Loops.

    def _loop(self, node: Node, loop: Loop) -> None:
        """Carried values live in their slots; a round reads all that it needs before it writes."""
        kept, lists = self.plan.kept(node), self.plan.lists(node)
        for k in kept:
            self._store(self._ref(loop.start[k]), loop.carried[k], self.slots[loop.carried[k]])
            self._used()
            self._cut()
            self._wrote(loop.carried[k])
        for one in lists:
            self.tables[one] = self.memory.room(self._row_bytes(one) * (loop.count or 1))
            self._wrote(one)
        self._end()
        if self._takes_turns and loop.once:
            self._apart(loop, kept)
            return
        if self._takes_turns and loop.condition is not None:
            self._pack(node, loop, kept)
            return
        self._around(loop, kept, lists)

    def _around(self, loop: Loop, kept: list[int], lists: list[Node]) -> None:
        """The driver's lines of a loop or a branch, and the functions of its stretches."""
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
            self._count(loop, f"%{counter}")
        self._begin()
        self._round(loop, kept, lists)
        self._end()
        if loop.once:
            self.driver += [f"br label %{after}", f"{after}:"]
        else:
            self.driver[phi] = (
                f"%{counter} = phi i32 [ 0, %{before} ], [ %next{number}, %{self.label} ]"
            )
            self.driver += [f"%next{number} = add i32 %{counter}, 1", f"br label %{head}"]
            self.driver.append(f"{after}:")
        self.label = after
        self._begin()

    def _apart(self, loop: Loop, kept: list[int]) -> None:
        """A branch that each vector of a gang takes by itself, as a function of one vector."""
        name, outside, label = f"branch{len(self.functions)}", self.driver, self.label
        parameters = f"{self._buffers()}ptr {FRAME}, "
        self.driver, self.label, self.alone = [], "entry", True
        self._around(loop, kept, [])
        lines = "\n".join([*self.driver, "ret void"])
        self.functions.append(
            f"define internal void @{name}({parameters}ptr %scratch, i64 %n, i64 %first) #0 {{\n"
            f"entry:\n{lines}\n}}"
        )
        self.driver, self.label, self.alone = outside, label, False
        self.late.append(functools.partial(each_vector, name, parameters, parameters))
        self.driver.append(
            f"call void @{name}.gang({parameters}ptr %scratch, i64 %n, i64 %first, i64 %count)"
        )

    def _count(self, loop: Loop, counter: str) -> None:
        """Put the number of the round where it is read."""
        self._wrote(loop.counter)
        slot, number = self.slots[loop.counter], len(self.functions)
        if self._takes_turns:
            name = f"count{number}"
            self.functions.append(
                f"define internal void @{name}"
                "(i32 %round, ptr %scratch, i64 %n, i64 %first) #0 {\n"
                f"%place = getelementptr i8, ptr %scratch, i64 {slot}\n"
                "store i32 %round, ptr %place\nret void\n}"
            )
            round_ = "i32 %round, "
            self.late.append(functools.partial(each_vector, name, round_, round_))
            self.driver.append(
                f"call void @{name}.gang(i32 {counter}, ptr %scratch, i64 %n, i64 %first, "
                "i64 %count)"
            )
            return
        place = f"%place{self.w.count}"
        self.driver.append(f"{place} = getelementptr i8, ptr %scratch, i64 {slot}")
        self.driver.append(f"store i32 {counter}, ptr {place}")

    def _test(self, loop: Loop) -> str:
        """Whether any individual wants another round."""
        active, flag = self._wanting(loop)
        if self.width == 1:
            return self._end(active)
        name = f"llvm.vector.reduce.or.v{self.width}i1"
        self.w.declared[name] = f"declare i1 @{name}({flag})"
        return self._end(self.w.let(f"call i1 @{name}({flag} {active})"))

    def _wanting(self, loop: Loop) -> tuple[str, str]:
        """Who wants another round, and the type of that."""
        self._begin()
        condition = loop.condition
        assert condition is not None
        self._block(loop.test, [condition])
        active, flag = self._ref(condition), self.w.type_of(np.dtype(bool), False)
        if self.masked:
            active = self.w.let(f"and {flag} {active}, %valid")
        return active, flag

    def _pack(self, node: Node, loop: Loop, kept: list[int]) -> None:
        """A loop whose individuals are packed together; its functions are of one vector."""
        packed = self.packed = _Packed()
        name, outside, label = f"loop{len(self.functions)}", self.driver, self.label
        parameters = f"{self._buffers()}ptr {FRAME}, "
        whole = f"{parameters}ptr %scratch, i64 %n, i64 %first"

        self.driver, self.label = [], "entry"
        active, flag = self._wanting(loop)
        bits = self.w.let(f"bitcast {flag} {active} to i{self.width}")
        mask = self._end(self.w.let(f"zext i{self.width} {bits} to i32"), "i32")
        test = "\n".join([*self.driver, f"ret i32 {mask}"])
        self.functions.append(
            f"define internal i32 @{name}.test({whole}) #0 {{\nentry:\n{test}\n}}"
        )
        # Of who is moved the test was made before: a round comes first.
        tested = set(packed.written)

        self.driver, self.label = [], "entry"
        if loop.counter in self.slots:
            raise Unsupported("a loop with a condition that reads the number of its round")
        self._begin()
        self._round(loop, kept, self.plan.lists(node))
        self._end()
        lines = "\n".join([*self.driver, "ret void"])
        self.functions.append(
            f"define internal void @{name}.round({whole}) #0 {{\nentry:\n{lines}\n}}"
        )

        self.packed, self.driver, self.label = None, outside, label
        carries = [self._place(loop.carried[k]) for k in kept]
        reads = [self._place(x) for x in packed.read if x in tested or x not in packed.written]
        for table in packed.tables:
            if table not in packed.written:
                reads += self._rows_of(table)
        self.late.append(
            lambda gang: packed_loop(name, parameters, parameters, gang, reads, carries)
        )
        self.w.declared.update(declared(self.width, self.compresses))
        self.driver.append(f"call void @{name}.gang({parameters}ptr %scratch, i64 %n, i64 %count)")
        self._begin()

    def _place(self, node: Node) -> Place:
        return Place(self.slots[node], node.dtype.itemsize, node.uniform)

    def _rows_of(self, table: Node) -> list[Place]:
        """The places of a table in scratch memory."""
        start, size = self.tables[table], self._row_bytes(table)
        assert isinstance(start, int)
        rows = row_count(table)
        return [Place(start + i * size, table.dtype.itemsize, table.uniform) for i in range(rows)]

    def _buffers(self) -> str:
        """All buffers as parameters, with a comma behind."""
        count = len(self.arguments) + len(self.results)
        return "".join(f"ptr %b{k}, " for k in range(count))

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
            pointer = self.memory.borrowed(self.spilled[node])
            name = self.memory.load(node.dtype, pointer, node.uniform)
        elif node.op == "input" and node not in self.slots:
            number, row = node.detail
            name = self.memory.load_row(f"%b{number}", row, node.dtype, node.uniform)
        else:
            if self.packed is not None:
                self.packed.read[home(node)] = None
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

    def _text(self) -> tuple[str, int]:
        """The IR of the whole program, and the scratch memory that it needs."""
        size = self.memory.size
        # An odd number of lines: the same place of different vectors is not in the same set.
        line = machine_constants.CACHE_LINE
        stride = (size // line | 1) * line + line
        gang = Gang(machine_constants.GANG, self.width, stride, self.compresses)
        own = (gang.vectors + 1) * gang.stride if self.ganged else size
        driver = [
            f"define internal void @program({self._buffers()}ptr %scratch, i64 %n) #0 {{",
            "entry:",
            # Behind all that vectors have of their own.
            f"{FRAME} = getelementptr i8, ptr %scratch, i64 {own + FRAME_ORIGIN}",
            "br label %vector",
            "vector:",
            f"%first = phi i64 [ 0, %entry ], [ %next, %{self.label} ]",
        ]
        if self.ganged:
            driver += [
                "%left = sub i64 %n, %first",
                f"%begun = add i64 %left, {self.width - 1}",
                f"%whole = udiv i64 %begun, {self.width}",
                f"%fewer = icmp ult i64 %whole, {gang.vectors}",
                f"%count = select i1 %fewer, i64 %whole, i64 {gang.vectors}",
                *self.driver,
                f"%next = add i64 %first, {gang.vectors * self.width}",
                "%more = icmp slt i64 %next, %n",
            ]
        else:
            driver += [
                *self._valid(),
                *self.driver,
                # The last vector ends with the last individual.
                f"%stop = add i64 %first, {self.width}",
                f"%left = sub i64 %n, {self.width}",
                "%within = icmp slt i64 %stop, %left",
                "%next = select i1 %within, i64 %stop, i64 %left",
                "%more = icmp slt i64 %stop, %n",
            ]
        driver += ["br i1 %more, label %vector, label %done", "done:", "ret void", "}"]
        declarations = self.w.declared.values()
        late = [finish(gang) for finish in self.late]
        text = "\n".join([*self.globals, *declarations, *self.functions, *late, *driver])
        return text, own + self.memory.frame_size
