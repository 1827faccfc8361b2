"""Print an allocated program as LLVM IR, and the handler by which XLA calls it.

Every stretch becomes a function. The *driver* function ``@program`` loops over vectors and calls
the stretches. If loops end at different rounds for each individual, the driver runs several vectors
in turn (`evo_cpg.native.backend.packing`). If the number of individuals is not a multiple of the
width, the last vector overlaps the one before. `evo_cpg.native.native` ensures at least one full
vector.

No instruction has a fast-math flag. So the bits of an individual's results do not depend on the
vector's width.
"""

import collections
import functools
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from evo_cpg.native import machine_constants
from evo_cpg.native.backend.code import Code, Item, LoopCode, RowCopies, Step, StretchCode
from evo_cpg.native.backend.operations import TYPES, FunctionText, number
from evo_cpg.native.backend.packing import VectorGroup, each_vector, packed_loop
from evo_cpg.native.backend.select import FRAME
from evo_cpg.native.backend.storage import FRAME_ORIGIN

_GIVEN = "ptr %scratch, i64 %n, i64 %first"

# Version of the XLA FFI interface.
_MAJOR, _MINOR = 0, 1

# Bits of x86's control register: denormal results and denormal operands count as zero.
_FLUSH = 0x8040

# XLA's number for the extension that requests metadata, and for the stage that computes.
_METADATA, _EXECUTE = 1, 3


class Printer:
    """Writer of an allocated program: a function for each stretch, and the driver that calls them.

    If vectors form groups, the driver calls a function for all vectors of a group. In a packed loop
    and in a branch per vector, ``grouped`` is false and each call is for one vector.

    If ``timed``, the code adds the clock ticks of each function to the global ``@ticks``, and those
    of the whole program as its first number. ``ticks`` are then the parts of each number.
    """

    def __init__(self, code: Code, timed: bool = False):
        self.code, self.timed = code, timed
        self.ticks: list[Mapping[str, int]] = []
        variant, size = code.variant, code.size
        # An odd number of cache lines for each vector. So equal places of different vectors are in
        # different cache sets.
        line = machine_constants.CACHE_LINE
        stride = (size // line | 1) * line + line
        fitting = max(machine_constants.LARGEST_GROUP // stride, 1)
        vectors = min(machine_constants.VECTOR_GROUP, fitting)
        self.group = VectorGroup(vectors, variant.width, stride, variant.target.compresses)
        self.own = (self.group.vectors + 1) * stride if code.grouped else size
        count = len(code.arguments) + len(code.results)
        self.buffers = "".join(f"ptr %b{k}, " for k in range(count))
        self.functions: list[str] = []
        self.group_functions: list[str] = []
        self.driver: list[str] = []
        self.label = "vector"
        self.grouped = code.grouped

    def text(self) -> tuple[str, int]:
        """Return the LLVM IR of the whole program, and its bytes of working memory."""
        begin, end = self._clock({})
        self._items(self.code.items)
        vectors, width = self.group.vectors, self.group.width
        lines = [
            *self.driver,
            # The last vector ends with the last individual.
            f"%stop = add i64 %first, {width}",
            f"%left = sub i64 %n, {width}",
            "%within = icmp slt i64 %stop, %left",
            "%next = select i1 %within, i64 %stop, i64 %left",
            "%more = icmp slt i64 %stop, %n",
        ]
        if self.code.grouped:
            lines = [
                "%left = sub i64 %n, %first",
                f"%begun = add i64 %left, {width - 1}",
                f"%whole = udiv i64 %begun, {width}",
                f"%fewer = icmp ult i64 %whole, {vectors}",
                f"%count = select i1 %fewer, i64 %whole, i64 {vectors}",
                *self.driver,
                f"%next = add i64 %first, {vectors * width}",
                "%more = icmp slt i64 %next, %n",
            ]
        driver = [
            f"define internal void @program({self.buffers}ptr %scratch, i64 %n) #0 {{",
            "entry:",
            *begin,
            # The shared memory begins after the scratch memory of all vectors.
            f"{FRAME} = getelementptr i8, ptr %scratch, i64 {self.own + FRAME_ORIGIN}",
            "br label %vector",
            "vector:",
            f"%first = phi i64 [ 0, %entry ], [ %next, %{self.label} ]",
            *lines,
            "br i1 %more, label %vector, label %done",
            "done:",
            *end,
            "ret void",
            "}",
        ]
        tables = [f"@ticks = global [{len(self.ticks)} x i64] zeroinitializer"] * self.timed
        for name, values in self.code.tables.items():
            dtype = values.dtype
            t = "i8" if dtype.kind == "b" else TYPES[dtype.char]
            items = ", ".join(f"{t} {number(value, dtype)}" for value in values)
            tables.append(f"{name} = internal constant [{len(values)} x {t}] [{items}], align 64")
        called = self.code.functions.values()
        text = "\n".join([*tables, *called, *self.functions, *self.group_functions, *driver])
        return text, self.own + self.code.frame

    def _items(self, items: Sequence[Item]) -> str:
        """Print code and return the name of the last result."""
        result = ""
        for item in items:
            if isinstance(item, StretchCode):
                functions = []
                for steps, buffers, parts in item.functions:
                    begin, end = self._clock(parts)
                    lines = [*begin, *_lines(steps), *end]
                    functions.append((lines, buffers, "".join(f"ptr {b}, " for b in buffers)))
                *before, last = functions
                lines, buffers, given = last
                found, kind = item.result, item.kind
                if before:
                    # All functions run for one vector before the next, because they share memory.
                    calls = [
                        _call("", "void", self._function(part, own), passed)
                        for part, own, passed in before
                    ]
                    name = self._function(lines, buffers, found, kind)
                    found = "%result" if found else ""
                    lines = [*calls, _call(found, kind, name, given)]
                name = self._function(lines, buffers, found, kind)
                result = self._call_function(name, given, bool(found), kind)
            elif isinstance(item, RowCopies):
                lines = [
                    "br label %head",
                    "head:",
                    "%i = phi i64 [ 0, %entry ], [ %j, %head ]",
                    *_lines([item.step]),
                    "%j = add i64 %i, 1",
                    f"%more = icmp slt i64 %j, {item.rows}",
                    "br i1 %more, label %head, label %copied",
                    "copied:",
                ]
                self._call_function(self._function(lines, [item.buffer]), f"ptr {item.buffer}, ")
            elif item.packed is not None:
                # The functions of a packed loop work on one vector.
                name, parameters = f"loop{len(self.functions)}", f"{self.buffers}ptr {FRAME}, "
                for kind, what, items in (("i32", "test", item.test), ("void", "round", item.body)):
                    run = functools.partial(self._items, items)
                    self._of_one_vector(kind, f"{name}.{what}", run)
                self.group_functions.append(packed_loop(name, parameters, self.group, *item.packed))
                self.driver.append(
                    f"call void @{name}.group({parameters}ptr %scratch, i64 %n, i64 %count)"
                )
            elif item.per_vector:
                # Each vector of a group takes the branch separately.
                name, parameters = f"branch{len(self.functions)}", f"{self.buffers}ptr {FRAME}, "
                self._of_one_vector("void", name, functools.partial(self._loop, item))
                self._call_for_group(name, parameters, parameters)
            else:
                self._loop(item)
        return result

    # Functions.

    def _clock(self, parts: Mapping[str, int]) -> tuple[list[str], list[str]]:
        """Return the lines before and after code of some parts whose ticks are counted."""
        if not self.timed:
            return [], []
        # Programs may not read the cycles of an ARM processor, but a slower clock.
        clock = "steady" if self.code.variant.target.name == "neon" else "cycle"
        now = f"call i64 @llvm.read{clock}counter()"
        self.ticks.append(parts)
        return [f"%clock.begin = {now}"], [
            f"%clock.end = {now}",
            "%clock.took = sub i64 %clock.end, %clock.begin",
            f"%clock.place = getelementptr i64, ptr @ticks, i64 {len(self.ticks) - 1}",
            "%clock.old = atomicrmw add ptr %clock.place, i64 %clock.took monotonic",
        ]

    def _function(
        self, lines: Sequence[str], buffers: Sequence[str], result: str = "", kind: str = "void"
    ) -> str:
        """Write a function of some lines and return its name."""
        name = f"stretch{len(self.functions)}"
        pointers = "".join(f"ptr noalias {buffer}, " for buffer in buffers)
        body = "\n".join([*lines, f"ret {kind} {result}"])
        if self.code.variant.width == 1:
            body = _with_near_pointers(body)
        # Not inlined: LLVM would move thousands of constants out of the driver's loops and spill
        # each as a whole vector.
        self.functions.append(
            f"define internal {kind} @{name}({pointers}ptr noalias %scratch, i64 %n, i64 %first) "
            f"noinline #0 {{\nentry:\n{body}\n}}"
        )
        return name

    def _call_function(
        self, name: str, given: str, has_result: bool = False, kind: str = "void"
    ) -> str:
        """Call a function for one vector or for a group, and return the name of the result."""
        if self.grouped:
            self._call_for_group(name, given, given)
            return ""
        found = f"%found{len(self.functions)}" if has_result else ""
        self.driver.append(_call(found, kind, name, given))
        return found

    def _call_for_group(self, name: str, parameters: str, given: str) -> None:
        self.group_functions.append(each_vector(name, parameters, self.group))
        self.driver.append(f"call void @{name}.group({given}{_GIVEN}, i64 %count)")

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
            # Store the number of the round in its slot.
            if self.grouped:
                name = f"count{len(self.functions)}"
                f = FunctionText(f"internal void @{name}(i32 %round, {_GIVEN})")
                f.store("i32", "%round", f.at("%scratch", item.counter))
                self.functions.append(f.text())
                self._call_for_group(name, "i32 %round, ", f"i32 %{counter}, ")
            else:
                place = f"%place{number}"
                self.driver += [
                    f"{place} = getelementptr i8, ptr %scratch, i64 {item.counter}",
                    f"store i32 %{counter}, ptr {place}",
                ]
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

    def _of_one_vector(self, kind: str, name: str, write: Callable[[], str]) -> None:
        """Print code of one vector as a function, which returns the last result."""
        outside = self.driver, self.label, self.grouped
        self.driver, self.label, self.grouped = [], "entry", False
        result = write()
        body = "\n".join([*self.driver, f"ret {kind} {result}".rstrip()])
        self.driver, self.label, self.grouped = outside
        self.functions.append(
            f"define internal {kind} @{name}({self.buffers}ptr {FRAME}, {_GIVEN}) #0 {{\n"
            f"entry:\n{body}\n}}"
        )


def _lines(steps: Sequence[Step]) -> list[str]:
    return [
        template.text.format(*operands, *range(first, first + template.names))
        for template, operands, first in steps
    ]


# An access to memory at a known place, and the bytes that a one-byte offset reaches.
_PLACE, _REACH = re.compile(r"getelementptr i8, ptr (%scratch|%frame), i64 (-?\d+)$", re.M), 256

# Number of pointers. x86 has 16 registers for pointers, and a function has up to six others.
_POINTERS = 10


def _with_near_pointers(body: str) -> str:
    """Return a function with pointers to its busiest places, so that most offsets take one byte.

    Code of a single individual runs only once in a step, so it is as slow as it is long: the
    processor waits for instructions. These offsets make it an eighth shorter.
    """
    places = [(base, int(place) // _REACH) for base, place in _PLACE.findall(body)]
    near = [key for key, _ in collections.Counter(places).most_common(_POINTERS)]

    def nearer(found: re.Match) -> str:
        key, place = (found[1], int(found[2]) // _REACH), int(found[2]) % _REACH
        if key not in near:
            return found[0]
        return f"getelementptr i8, ptr %near{near.index(key)}, i64 {place - _REACH // 2}"

    # LLVM does not look into the empty assembly, so it keeps the pointer.
    lines = [
        f"%middle{k} = getelementptr i8, ptr {base}, i64 {part * _REACH + _REACH // 2}\n"
        f'%near{k} = call ptr asm "", "=r,0"(ptr %middle{k})'
        for k, (base, part) in enumerate(near)
    ]
    return "\n".join([*lines, _PLACE.sub(nearer, body)])


def _call(result: str, kind: str, name: str, given: str) -> str:
    return f"{f'{result} = ' if result else ''}call {kind} @{name}({given}{_GIVEN})"


def print_handler(name: str, arguments: int, results: int, flushes: bool) -> str:
    """Return LLVM IR of the entry into native code, an XLA FFI handler that runs ``@program``.

    XLA calls the handler with a *call frame*. The public header ``xla/ffi/api/c_api.h`` in
    `jax.ffi.include_dir()` defines its layout. On 64-bit machines:

    | structure | fields and their offsets in bytes |
    |---|---|
    | call frame | extension 8, stage 32, arguments 40, results 80 |
    | arguments, results (within the frame) | pointers +32 |
    | buffer | data 24, dimensions 40 |
    | extension | type 8, metadata 24 (only in a request for metadata) |
    | metadata | version 24 (major, minor), traits 32 |

    A call needs no checks of types and shapes, because `evo_cpg.native.native.evaluate` makes all
    calls, with the arrays of the compiled program. A user does not call a handler directly: its
    name is a hash of its code. XLA refuses to register a handler for another version of the
    interface, and the self-test of `evo_cpg.native.engine` tests the layout in a separate process.
    So a changed layout in a new XLA does not harm the user's process.

    Args:
        name: name of the function.
        arguments: number of arrays that the program reads.
        results: number of arrays that it writes, at least one. Scratch memory comes after them.
        flushes: whether the handler makes an x86 processor flush denormal numbers to zero, as XLA
            does, because they take a hundred times as long. Calls of `Stepper` need it.
    """
    f = FunctionText(f"ptr @{name}(ptr %frame)")

    def field(kind: str, base: str, offset: int) -> str:
        """Load a field of a structure."""
        return f.load(kind, f.at(base, offset))

    extension = field("ptr", "%frame", 8)
    plain = f.let(f"icmp eq ptr {extension}, null")
    # Without an extension, the zeros of its pointer are read as its type.
    extension = f.let(f"select i1 {plain}, ptr %frame, ptr {extension}")
    asks = f.let(f"icmp eq i32 {field('i32', extension, 8)}, {_METADATA}")
    with f.where(asks):
        version = f.at(field("ptr", extension, 24), 24)
        f.store("[3 x i32]", f"[i32 {_MAJOR}, i32 {_MINOR}, i32 0]", version)
    executes = f.let(f"icmp eq i32 {field('i32', '%frame', 32)}, {_EXECUTE}")
    with f.where(f.let(f"select i1 {asks}, i1 false, i1 {executes}")):
        read, written = field("ptr", "%frame", 72), field("ptr", "%frame", 112)
        buffers = [field("ptr", read, 8 * k) for k in range(arguments)]
        buffers += [field("ptr", written, 8 * k) for k in range(results + 1)]
        given = ", ".join(f"ptr {field('ptr', buffer, 24)}" for buffer in buffers)
        count = field("i64", field("ptr", buffers[arguments], 40), 8)
        before, within = f.room("i32"), f.room("i32")
        if flushes:
            f.do(f"call void @llvm.x86.sse.stmxcsr(ptr {before})")
            f.store("i32", f.let(f"or i32 {f.load('i32', before)}, {_FLUSH}"), within)
            f.do(f"call void @llvm.x86.sse.ldmxcsr(ptr {within})")
        f.do(f"call void @program({given}, i64 {count})")
        if flushes:
            f.do(f"call void @llvm.x86.sse.ldmxcsr(ptr {before})")
    return f.text("ptr null")


def call_frame(arguments: Sequence[np.ndarray], results: Sequence[np.ndarray]) -> np.ndarray:
    """Return a call frame with which any program can call a handler for one individual.

    Args:
        arguments: arrays that the program reads.
        results: arrays that it writes, then its scratch memory.
    """
    buffers = [x for x in (*arguments, *results) if x.size]
    read = sum(x.size > 0 for x in arguments)
    # In words of 8 bytes: the frame, pointers to the buffers, dimensions (1, 1), the buffers.
    pointers, dimensions = 16, 16 + len(buffers)
    words = np.ones(dimensions + 2 + 6 * len(buffers), np.int64)
    places = words.ctypes.data + 8 * np.arange(words.size)
    words[1], words[4] = 0, _EXECUTE
    words[9], words[14] = places[pointers], places[pointers + read]
    for i, x in enumerate(buffers):
        own = dimensions + 2 + 6 * i
        words[pointers + i] = places[own]
        words[own + 3], words[own + 5] = x.ctypes.data, places[dimensions]
    return words
