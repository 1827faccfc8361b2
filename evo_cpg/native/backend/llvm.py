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
import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from evo_cpg.native import machine_constants
from evo_cpg.native.backend.code import Code, FunctionCode, Item, LoopCode, StretchCode
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

    The driver's lines are for the vector with the memory ``%scratch`` and the first individual
    ``%first``. If vectors form groups, a function repeats them for each vector of a group.
    ``grouped`` is false within it, and in the functions of a packed loop.

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
        self.driver = FunctionText(f"internal void @program({self.buffers}ptr %scratch, i64 %n)")
        self.grouped = code.grouped

    def text(self) -> tuple[str, int]:
        """Return the LLVM IR of the whole program, and its bytes of working memory."""
        f, width, most = self.driver, self.group.width, self.group.vectors
        begin, end = self._clock({})
        # The shared memory begins after the scratch memory of all vectors.
        f.do(*begin, f"{FRAME} = getelementptr i8, ptr %scratch, i64 {self.own + FRAME_ORIGIN}")
        if self.grouped:
            with f.each(_quotient(f, "%n", most * width)) as group:
                f.do(f"%first = mul i64 {group}, {most * width}")
                vectors = _quotient(f, f.let("sub i64 %n, %first"), width)
                f.do(f"%count = call i64 @llvm.umin.i64(i64 {vectors}, i64 {most})")
                self._items(self.code.items)
        else:
            with each_vector(f, "0", _quotient(f, "%n", width), width):
                self._items(self.code.items)
        f.do(*end)
        tables = [f"@ticks = global [{len(self.ticks)} x i64] zeroinitializer"] * self.timed
        for name, values in self.code.tables.items():
            dtype = values.dtype
            t = "i8" if dtype.kind == "b" else TYPES[dtype.char]
            items = ", ".join(f"{t} {number(value, dtype)}" for value in values)
            tables.append(f"{name} = internal constant [{len(values)} x {t}] [{items}], align 64")
        text = "\n".join([*tables, *self.code.functions.values(), *self.functions, f.text()])
        return text, self.own + self.code.frame

    def _items(self, items: Sequence[Item]) -> str:
        """Print code and return the name of the last result."""
        result = ""
        for item in items:
            if isinstance(item, StretchCode):
                result = self._stretch(item)
            elif item.packed is not None:
                name, parameters = f"loop{len(self.functions)}", f"{self.buffers}ptr {FRAME}, "
                self._of_one_vector("i32", f"{name}.test", parameters, item.test)
                self._of_one_vector("void", f"{name}.round", parameters, item.body)
                self.functions.append(packed_loop(name, parameters, self.group, *item.packed))
                given = f"{parameters}ptr %scratch, i64 %n, i64 %count"
                self.driver.do(f"call void @{name}.group({given})")
            elif item.loop.once:
                # Each vector of a group takes the branch separately.
                with self._each_vector(f"{self.buffers}ptr {FRAME}, "):
                    self._loop(item)
            else:
                self._loop(item)
        return result

    # Functions.

    def _stretch(self, item: StretchCode) -> str:
        """Print the functions of a stretch and their calls, and return the name of the result."""
        *before, last = item.functions
        # All functions run for one vector before the next, because they share memory.
        with self._each_vector("".join(f"ptr {buffer}, " for buffer in last.buffers)):
            self.driver.do(*[self._function(each) for each in before])
            call = self._function(last, item.kind, item.result)
            if item.result:
                return self.driver.let(call)
            self.driver.do(call)
        return ""

    def _function(self, function: FunctionCode, kind: str = "void", result: str = "") -> str:
        """Print a function and return the text of its call."""
        (steps, buffers, parts), name = function, f"stretch{len(self.functions)}"
        begin, end = self._clock(parts)
        lines = [
            template.text.format(*operands, *range(first, first + template.names))
            for template, operands, first in steps
        ]
        body = "\n".join([*begin, *lines, *end, f"ret {kind} {result}"])
        if self.code.variant.width == 1:
            body = _with_near_pointers(body)
        pointers = "".join(f"ptr noalias {buffer}, " for buffer in buffers)
        # Not inlined: LLVM would move thousands of constants out of the driver's loops and spill
        # each as a whole vector.
        self.functions.append(
            f"; {', '.join(filter(None, parts))}\n"
            f"define internal {kind} @{name}({pointers}ptr noalias %scratch, i64 %n, i64 %first) "
            f"noinline #0 {{\n{body}\n}}"
        )
        given = "".join(f"ptr {buffer}, " for buffer in buffers)
        return f"call {kind} @{name}({given}{_GIVEN})"

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

    def _of_one_vector(self, kind: str, name: str, parameters: str, items: Sequence[Item]) -> None:
        """Print code as a function of one vector, which returns the last result."""
        with self._apart(f"{kind} @{name}({parameters}{_GIVEN})") as f:
            result = self._items(items)
        self.functions.append(f.text(f"{kind} {result}"))

    @contextlib.contextmanager
    def _apart(self, head: str) -> Iterator[FunctionText]:
        """Print the code of a ``with`` statement as a function of one vector."""
        outside = self.driver, self.grouped
        self.driver, self.grouped = FunctionText(f"internal {head}"), False
        yield self.driver
        self.driver, self.grouped = outside

    @contextlib.contextmanager
    def _each_vector(self, parameters: str) -> Iterator[None]:
        """Print the code of a ``with`` statement for a vector, or for each vector of a group.

        The code of a group becomes a function. Its parameters are the values that the code uses,
        with types and a trailing comma.
        """
        if not self.grouped:
            yield
            return
        name = f"group{len(self.functions)}"
        head = f"void @{name}({parameters}ptr %group, i64 %n, i64 %start, i64 %count)"
        with self._apart(head) as f, each_vector(f, "%start", "%count", self.group.width) as vector:
            place = f.let(f"mul i64 {vector}, {self.group.stride}")
            f.do(f"%scratch = getelementptr i8, ptr %group, i64 {place}")
            yield
        self.functions.append(f.text())
        self.driver.do(f"call void @{name}({parameters}{_GIVEN}, i64 %count)")

    # Loops.

    def _loop(self, item: LoopCode) -> None:
        """Print the driver's lines of a loop or a branch."""
        f, loop = self.driver, item.loop
        if loop.once:
            with f.where(self._items(item.test)):
                self._items(item.body)
        elif loop.count is None:
            with f.repeat() as leave:
                leave(f.let(f"xor i1 {self._items(item.test)}, true"))
                self._items(item.body)
        else:
            with f.each(loop.count) as turn:
                if item.counter is not None:
                    value = f"%counter{item.counter}"
                    f.do(f"{value} = trunc i64 {turn} to i32")
                    with self._each_vector(f"i32 {value}, "):
                        self.driver.store("i32", value, self.driver.at("%scratch", item.counter))
                self._items(item.body)


def _quotient(f: FunctionText, dividend: str, divisor: int) -> str:
    """Divide and round up."""
    return f.let(f"udiv i64 {f.let(f'add i64 {dividend}, {divisor - 1}')}, {divisor}")


# An access to memory at a known place, and the bytes that a one-byte offset reaches.
_PLACE, _REACH = re.compile(r"getelementptr i8, ptr (%scratch|%frame), i64 (-?\d+)$", re.M), 256

# Number of pointers. x86 has 16 registers for pointers, and a function has up to six others.
_POINTERS = 10


def _with_near_pointers(body: str) -> str:
    """Return a function with pointers to its busiest places, so that most offsets take one byte.

    Code of a single individual runs only once in a step, so the processor waits for instructions.
    These offsets make it an eighth shorter.
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


def print_handler(arguments: int, results: int, flushes: bool) -> str:
    """Return LLVM IR of ``@handler``, an XLA FFI handler that runs ``@program``.

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
        arguments: number of arrays that the program reads.
        results: number of arrays that it writes, at least one. Scratch memory comes after them.
        flushes: whether the handler makes an x86 processor flush denormal numbers to zero, as XLA
            does, because they take a hundred times as long. Calls of `Stepper` need it.
    """
    f = FunctionText("ptr @handler(ptr %frame)")

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


def call_frame(
    arguments: Sequence[np.ndarray], results: Sequence[np.ndarray], lanes: int = 1
) -> np.ndarray:
    """Return a call frame with which any program can call a handler.

    Args:
        arguments: arrays that the program reads.
        results: arrays that it writes, then its scratch memory.
        lanes: number of individuals, on the last axes of the arrays.
    """
    buffers = [x for x in (*arguments, *results) if x.size]
    read = sum(x.size > 0 for x in arguments)
    # In words of 8 bytes: the frame, pointers to the buffers, dimensions (1, lanes), the buffers.
    pointers, dimensions = 16, 16 + len(buffers)
    words = np.ones(dimensions + 2 + 6 * len(buffers), np.int64)
    places = words.ctypes.data + 8 * np.arange(words.size)
    words[1], words[4], words[dimensions + 1] = 0, _EXECUTE, lanes
    words[9], words[14] = places[pointers], places[pointers + read]
    for i, x in enumerate(buffers):
        own = dimensions + 2 + 6 * i
        words[pointers + i] = places[own]
        words[own + 3], words[own + 5] = x.ctypes.data, places[dimensions]
    return words
