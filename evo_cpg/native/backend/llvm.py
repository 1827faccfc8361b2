"""Print an allocated program as LLVM IR.

Every stretch becomes a function. The *driver* function ``@program`` loops over vectors and calls
the stretches. If loops end at different rounds for each individual, the driver runs several vectors
in turn (`evo_cpg.native.backend.packing`). If the number of individuals is not a multiple of the
width, the last vector overlaps the one before. `evo_cpg.native.native` ensures at least one full
vector.

No instruction has a fast-math flag. So the bits of an individual's results do not depend on the
vector's width.
"""

from collections.abc import Callable, Sequence

from evo_cpg.native import machine_constants
from evo_cpg.native.backend.code import Code, Copy, Item, LoopCode, Slot, Step, Stretch, Table
from evo_cpg.native.backend.memory import FRAME_ORIGIN
from evo_cpg.native.backend.packing import VectorGroup, each_vector, packed_loop
from evo_cpg.native.backend.select import FRAME
from evo_cpg.native.backend.writer import TYPES, number

_GIVEN = "ptr %scratch, i64 %n, i64 %first"


def print_llvm(code: Code) -> tuple[str, int]:
    """Return the LLVM IR of the program, and its bytes of working memory."""
    return _Printer(code).text()


class _Printer:
    """Writer of the functions, one for each stretch, and of the driver that calls them.

    If vectors form groups, the driver calls a function for all vectors of a group. In a packed loop
    and in a branch per vector, ``grouped`` is false and each call is for one vector.
    """

    def __init__(self, code: Code):
        self.code = code
        variant, size = code.variant, code.size
        # An odd number of cache lines for each vector. So equal places of different vectors are in
        # different cache sets.
        line = machine_constants.CACHE_LINE
        stride = (size // line | 1) * line + line
        fitting = max(machine_constants.LARGEST_GROUP // stride, 1)
        vectors = min(machine_constants.VECTOR_GROUP, fitting)
        self.group = VectorGroup(vectors, variant.width, stride)
        self.own = (self.group.vectors + 1) * stride if code.grouped else size
        count = len(code.arguments) + len(code.results)
        self.buffers = "".join(f"ptr %b{k}, " for k in range(count))
        self.functions: list[str] = []
        self.group_functions: list[str] = []
        self.driver: list[str] = []
        self.label = "vector"
        self.grouped = code.grouped

    def text(self) -> tuple[str, int]:
        """Print the whole program."""
        self._items(self.code.items)
        driver = [
            f"define internal void @program({self.buffers}ptr %scratch, i64 %n) #0 {{",
            "entry:",
            # The shared memory begins after the scratch memory of all vectors.
            f"{FRAME} = getelementptr i8, ptr %scratch, i64 {self.own + FRAME_ORIGIN}",
            "br label %vector",
            "vector:",
            f"%first = phi i64 [ 0, %entry ], [ %next, %{self.label} ]",
            *(self._group_lines() if self.code.grouped else self._vector_lines()),
            "br i1 %more, label %vector, label %done",
            "done:",
            "ret void",
            "}",
        ]
        tables = [_table(each) for each in self.code.tables]
        called = self.code.functions.values()
        text = "\n".join([*tables, *called, *self.functions, *self.group_functions, *driver])
        return text, self.own + self.code.frame

    def _vector_lines(self) -> list[str]:
        width = self.code.variant.width
        return [
            *self.driver,
            # The last vector ends with the last individual.
            f"%stop = add i64 %first, {width}",
            f"%left = sub i64 %n, {width}",
            "%within = icmp slt i64 %stop, %left",
            "%next = select i1 %within, i64 %stop, i64 %left",
            "%more = icmp slt i64 %stop, %n",
        ]

    def _group_lines(self) -> list[str]:
        vectors, width = self.group.vectors, self.group.width
        return [
            "%left = sub i64 %n, %first",
            f"%begun = add i64 %left, {width - 1}",
            f"%whole = udiv i64 %begun, {width}",
            f"%fewer = icmp ult i64 %whole, {vectors}",
            f"%count = select i1 %fewer, i64 %whole, i64 {vectors}",
            *self.driver,
            f"%next = add i64 %first, {vectors * width}",
            "%more = icmp slt i64 %next, %n",
        ]

    def _items(self, items: Sequence[Item]) -> str:
        """Print code and return the name of the last result."""
        result = ""
        for item in items:
            if isinstance(item, Stretch):
                result = self._stretch(item)
            elif isinstance(item, Copy):
                self._copy(item)
            elif item.packed is not None:
                self._packed(item, *item.packed)
            elif item.per_vector:
                self._per_vector(item)
            else:
                self._loop(item)
        return result

    # Functions.

    def _function(
        self, lines: Sequence[str], buffers: Sequence[str], result: str = "", kind: str = "void"
    ) -> str:
        """Write a function of some lines and return its name."""
        name = f"stretch{len(self.functions)}"
        pointers = "".join(f"ptr noalias {buffer}, " for buffer in buffers)
        body = "\n".join(["entry:", *lines, f"ret {kind} {result}"])
        # Not inlined: LLVM would move thousands of constants out of the driver's loops and spill
        # each as a whole vector.
        self.functions.append(
            f"define internal {kind} @{name}({pointers}ptr noalias %scratch, i64 %n, i64 %first) "
            f"noinline #0 {{\n{body}\n}}"
        )
        return name

    def _stretch(self, stretch: Stretch) -> str:
        """Print a stretch and its call, and return the name of its result."""
        *before, last = [
            (_lines(piece.steps), piece.buffers, "".join(f"ptr {b}, " for b in piece.buffers))
            for piece in stretch.pieces
        ]
        lines, buffers, given = last
        result, kind = stretch.result, stretch.kind
        if before:
            # All pieces run for one vector before the next, because they share memory.
            calls = [
                f"call void @{self._function(part, own)}({passed}{_GIVEN})"
                for part, own, passed in before
            ]
            name = self._function(lines, buffers, result, kind)
            result = "%result" if result else ""
            lines = [*calls, _call(result, kind, name, f"{given}{_GIVEN}")]
        name = self._function(lines, buffers, result, kind)
        return self._call_function(name, given, bool(result), kind)

    def _call_function(
        self, name: str, given: str, has_result: bool = False, kind: str = "void"
    ) -> str:
        """Call a function for one vector or for a group, and return the name of the result."""
        if self.grouped:
            self._call_for_group(name, given, given)
            return ""
        found = f"%found{len(self.functions)}" if has_result else ""
        self.driver.append(_call(found, kind, name, f"{given}{_GIVEN}"))
        return found

    def _call_for_group(self, name: str, parameters: str, given: str) -> None:
        self.group_functions.append(each_vector(name, parameters, self.group))
        self.driver.append(f"call void @{name}.group({given}{_GIVEN}, i64 %count)")

    def _copy(self, copy: Copy) -> None:
        lines = [
            "br label %head",
            "head:",
            "%i = phi i64 [ 0, %entry ], [ %j, %head ]",
            *_lines([copy.step]),
            "%j = add i64 %i, 1",
            f"%more = icmp slt i64 %j, {copy.rows}",
            "br i1 %more, label %head, label %copied",
            "copied:",
        ]
        self._call_function(self._function(lines, [copy.buffer]), f"ptr {copy.buffer}, ")

    # Loops.

    def _loop(self, item: LoopCode) -> str:
        """Print the driver's lines of a loop or a branch, which has no result."""
        number, loop = item.number, item.loop
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
            more = self._items(item.test)
        self.driver += [f"br i1 {more}, label %{body}, label %{after}", f"{body}:"]
        self.label = body
        if item.counter is not None:
            self._count(item.counter, counter, number)
        self._items(item.body)
        if loop.once:
            self.driver += [f"br label %{after}", f"{after}:"]
        else:
            self.driver[phi] = (
                f"%{counter} = phi i32 [ 0, %{before} ], [ %next{number}, %{self.label} ]"
            )
            self.driver += [f"%next{number} = add i32 %{counter}, 1", f"br label %{head}"]
            self.driver.append(f"{after}:")
        self.label = after
        return ""

    def _count(self, slot: int, counter: str, number: int) -> None:
        """Store the number of the round in its slot."""
        if not self.grouped:
            place = f"%place{number}"
            self.driver.append(f"{place} = getelementptr i8, ptr %scratch, i64 {slot}")
            self.driver.append(f"store i32 %{counter}, ptr {place}")
            return
        name = f"count{len(self.functions)}"
        self.functions.append(
            f"define internal void @{name}(i32 %round, {_GIVEN}) #0 {{\n"
            f"%place = getelementptr i8, ptr %scratch, i64 {slot}\n"
            "store i32 %round, ptr %place\nret void\n}"
        )
        self._call_for_group(name, "i32 %round, ", f"i32 %{counter}, ")

    def _per_vector(self, item: LoopCode) -> None:
        """Print a branch that each vector of a group takes separately, as a function."""
        name = f"branch{len(self.functions)}"
        parameters = f"{self.buffers}ptr {FRAME}, "
        lines, _ = self._separately(lambda: self._loop(item))
        self._of_one_vector("void", name, parameters, [*lines, "ret void"])
        self._call_for_group(name, parameters, parameters)

    def _packed(self, item: LoopCode, reads: Sequence[Slot], carries: Sequence[Slot]) -> None:
        """Print a loop with packed individuals. Its functions work on one vector."""
        name = f"loop{len(self.functions)}"
        parameters = f"{self.buffers}ptr {FRAME}, "
        lines, mask = self._separately(lambda: self._items(item.test))
        self._of_one_vector("i32", f"{name}.test", parameters, [*lines, f"ret i32 {mask}"])
        lines, _ = self._separately(lambda: self._items(item.body))
        self._of_one_vector("void", f"{name}.round", parameters, [*lines, "ret void"])
        self.group_functions.append(packed_loop(name, parameters, self.group, reads, carries))
        self.driver.append(f"call void @{name}.group({parameters}ptr %scratch, i64 %n, i64 %count)")

    def _separately(self, write: Callable[[], str]) -> tuple[list[str], str]:
        """Return the driver's lines for code of one vector, and the name of its result."""
        outside = self.driver, self.label, self.grouped
        self.driver, self.label, self.grouped = [], "entry", False
        result = write()
        lines = self.driver
        self.driver, self.label, self.grouped = outside
        return lines, result

    def _of_one_vector(self, kind: str, name: str, parameters: str, lines: list[str]) -> None:
        body = "\n".join(lines)
        self.functions.append(
            f"define internal {kind} @{name}({parameters}{_GIVEN}) #0 {{\nentry:\n{body}\n}}"
        )


def _lines(steps: Sequence[Step]) -> list[str]:
    return [
        template.text.format(*operands, *range(first, first + template.names))
        for template, operands, first in steps
    ]


def _call(result: str, kind: str, name: str, given: str) -> str:
    return f"{f'{result} = ' if result else ''}call {kind} @{name}({given})"


def _table(table: Table) -> str:
    t = "i8" if table.dtype.kind == "b" else TYPES[table.dtype.char]
    items = ", ".join(f"{t} {number(value, table.dtype)}" for value in table.values)
    return f"{table.name} = internal constant [{len(table.values)} x {t}] [{items}], align 64"
