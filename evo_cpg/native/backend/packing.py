"""Pack individuals together in loops with a different number of rounds for each individual.

A single vector would repeat the loop until its last individual is done. All its lanes would then be
computed for one individual. So the vectors of a *group* enter such a loop together. Each vector
runs separately while many of its individuals are active. The remaining active individuals then move
into the lanes of a packed vector in scratch memory. When an individual is done, the next active
individual takes its lane. All values that the loop reads are copied to the packed vector, and
carried values are copied back. An instruction of AVX-512 moves chosen numbers of a vector into its
first lanes. On such a processor the packed vector is first filled with many individuals at a time,
because quadrupeds would take 1.1 times as long otherwise.

A result does not depend on the lane that computes it. So the bits of an individual's results do not
depend on the other individuals.
"""

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from evo_cpg.native.backend.code import GrowingTable, Slot
from evo_cpg.native.backend.operations import FunctionText

# A vector runs separately while more than this fraction of its individuals is active. Fitted:
# quadrupeds and hexapods take at most 1.07 times as long with fractions from 1/4 to 1/2.
_BUSY = 3 / 8

# AVX-512's instruction that moves chosen numbers of a vector into its first lanes. Bytes of the
# smallest numbers that it handles, and bytes of its vector.
_COMPRESS, _NARROWEST, _VECTOR = "llvm.x86.avx512.mask.compress", 4, 64

# Minimum number of slots at equal distances that are moved by a loop. Fewer slots are moved by code
# without a loop.
_FEWEST_ROUNDS = 16

Slots = Sequence[Slot]
Tables = Sequence[GrowingTable]

# IR types by bytes of a number.
_WORDS = {1: "i8", 2: "i16", 4: "i32", 8: "i64"}


class VectorGroup(NamedTuple):
    """A group of vectors that run together.

    Attributes:
        vectors: maximum number of vectors.
        width: number of individuals of each vector.
        stride: bytes of scratch memory of each vector. The packed vector's memory comes last.
        compresses: whether one instruction moves chosen numbers of a vector into its first lanes.
    """

    vectors: int
    width: int
    stride: int
    compresses: bool


def packed_loop(
    name: str, parameters: str, group: VectorGroup, reads: Slots, carries: Slots, tables: Tables
) -> str:
    """Return the function ``@name.group``, which runs a loop for all vectors of a group.

    The function calls ``@name.test`` and ``@name.round`` for one vector at a time. The result of
    the test has a bit for each individual that needs another round.

    Args:
        name: name of the loop.
        parameters: parameters of both functions before the scratch memory, with types and a
            trailing comma.
        group: the vectors.
        reads: slots that the loop reads.
        carries: slots that the loop changes.
        tables: growing tables that the loop reads.
    """
    own = sorted({slot for slot in reads if not slot.shared} | set(carries))
    width, most = group.width, group.vectors * group.width
    compress = group.compresses and all(x.size * width <= _VECTOR for x in (*own, *tables))
    given = f"{parameters}ptr %scratch, i64 %n, i64 %count"
    f = FunctionText(f"internal void @{name}.group({given}) noinline")
    call = f"{parameters}ptr {{}}, i64 %n, i64 0"
    # The individuals that wait. The first ones are those of the packed lanes, in order.
    queue, waiting = f.room(f"[{most} x i64]"), f.room("i64")
    masks = f.room(f"[{group.vectors} x i32]")
    f.store("i64", 0, waiting)
    pack = f.at("%scratch", group.vectors * group.stride)
    alone = f.let("icmp eq i64 %count, 1")
    enough = f.let(f"select i1 {alone}, i32 0, i32 {int(_BUSY * width)}")
    with f.each("%count") as vector:
        base, first = f.at("%scratch", vector, group.stride), f.let(f"mul i64 {vector}, {width}")
        with f.repeat() as leave:
            wants = f.let(f"call i32 @{name}.test({call.format(base)})")
            active = f.let(f"call i32 @llvm.ctpop.i32(i32 {wants})")
            leave(f.let(f"icmp ule i32 {active}, {enough}"))
            f.do(f"call void @{name}.round({call.format(base)})")
        f.store("i32", wants, f.at(masks, vector, 4))
        with f.each_bit(wants) as lane:
            last = f.load("i64", waiting)
            f.store("i64", f.let(f"add i64 {first}, {lane}"), f.at(queue, last, 8))
            f.store("i64", f.let(f"add i64 {last}, 1"), waiting)
    most = f.load("i64", waiting)
    with f.where(f.let(f"icmp ne i64 {most}, 0")):
        for slot in sorted({slot for slot in reads if slot.shared}):
            kind = _WORDS[slot.size]
            f.store(kind, f.load(kind, f.at("%scratch", slot.start)), f.at(pack, slot.start))
        if compress:
            _fill_compressed(f, name, pack, masks, width)
        else:
            _fill_one_by_one(f, name, pack, queue, most, width)
        _run_packed(f, name, call.format(pack), pack, queue, most, width)
    moves = [
        _move(f"@{name}.in", own, group, True, tables),
        _move(f"@{name}.out", sorted(carries), group, False),
    ]
    if compress:
        moves.append(_move_compressed(f"@{name}.in_compressed", own, group, tables))
    return "\n".join([*moves, f.text()])


def _fill_one_by_one(
    f: FunctionText, name: str, pack: str, queue: str, most: str, width: int
) -> None:
    """Write code that fills the lanes of the packed vector with the first individuals."""
    with f.each(width) as lane:
        # A lane that is left over is filled like the first: no number in it may be without meaning.
        taken = f.let(f"icmp ult i64 {lane}, {most}")
        turn = f.let(f"select i1 {taken}, i64 {lane}, i64 0")
        individual = f.load("i64", f.at(queue, turn, 8))
        f.do(f"call void @{name}.in(ptr %scratch, ptr {pack}, i64 {individual}, i64 {lane})")


def _fill_compressed(f: FunctionText, name: str, pack: str, masks: str, width: int) -> None:
    """Write code that fills the packed lanes from one vector after another."""
    lanes = f.room("i64")
    f.store("i64", 0, lanes)
    with f.each("%count") as vector:
        wants, lane = f.load("i32", f.at(masks, vector, 4)), f.load("i64", lanes)
        come = f.let(f"call i32 @llvm.ctpop.i32(i32 {wants})")
        come, room = f.let(f"zext i32 {come} to i64"), f.let(f"sub i64 {width}, {lane}")
        enter = f.let(f"call i64 @llvm.umin.i64(i64 {come}, i64 {room})")
        f.store("i64", f.let(f"add i64 {lane}, {enter}"), lanes)
        with f.where(f.let(f"icmp ne i64 {enter}, 0")):
            given = f"i64 {vector}, i64 {lane}, i32 {wants}, i64 {enter}"
            f.do(f"call void @{name}.in_compressed(ptr %scratch, ptr {pack}, {given})")


def _run_packed(
    f: FunctionText, name: str, given: str, pack: str, queue: str, most: str, width: int
) -> None:
    """Write the rounds of the packed vector, in which waiting individuals replace finished ones."""
    lanes, called = f.room("i32"), f.room("i64")
    filled = f.let(f"call i64 @llvm.umin.i64(i64 {most}, i64 {width})")
    f.store("i64", filled, called)
    above = f.let(f"shl i64 1, {filled}")
    f.store("i32", f.let(f"trunc i64 {f.let(f'sub i64 {above}, 1')} to i32"), lanes)
    with f.repeat() as leave:
        f.do(f"call void @{name}.round({given})")
        still, occupied = f.let(f"call i32 @{name}.test({given})"), f.load("i32", lanes)
        going = f.let(f"and i32 {still}, {occupied}")
        with f.each_bit(f.let(f"xor i32 {going}, {occupied}")) as lane:
            own, moved = f.at(queue, lane, 8), f"ptr %scratch, ptr {pack}, i64 {{}}, i64 {lane}"
            f.do(f"call void @{name}.out({moved.format(f.load('i64', own))})")
            following = f.load("i64", called)
            more = f.let(f"icmp ult i64 {following}, {most}")
            with f.where(more):
                individual = f.load("i64", f.at(queue, following, 8))
                f.store("i64", individual, own)
                f.do(f"call void @{name}.in({moved.format(individual)})")
                f.store("i64", f.let(f"add i64 {following}, 1"), called)
            with f.where(f.let(f"xor i1 {more}, true")):
                bit = f.let(f"shl i32 1, {f.let(f'trunc i64 {lane} to i32')}")
                f.store("i32", f.let(f"xor i32 {f.load('i32', lanes)}, {bit}"), lanes)
        leave(f.let(f"icmp eq i32 {f.load('i32', lanes)}, 0"))


def _series(slots: Iterable[Slot]) -> list[tuple[int, int, int, Any]]:
    """Group consecutive slots of one size at equal distances.

    Return the first place, the bytes of a number, the distance, and the number of places.
    """
    found: list[tuple[int, int, int, Any]] = []
    for start, size, _ in slots:
        if found and found[-1][1] == size:
            first, _, step, count = found[-1]
            apart = start - first - (count - 1) * step
            if count == 1 or apart == step:
                found[-1] = first, size, apart, count + 1
                continue
        found.append((start, size, 0, 1))
    return found


def _places(
    f: FunctionText, slots: list[Slot], tables: Tables, base: str, width: int
) -> Iterator[tuple[int, str]]:
    """Iterate over the bytes of a number and its place, with loops over places at equal distances.

    Irregular places are moved without a loop, so the processor fetches many numbers at a time. The
    code moves the rows of a table that are in use for any of ``width`` individuals at ``base``.
    """
    series, t = _series(slots), f"<{width} x i32>"
    for table in tables:
        extents = f.let(f"load {t}, ptr {f.at(base, table.extent)}, align 4")
        most = f.let(f"call i32 @llvm.vector.reduce.umax.v{width}i32({t} {extents})")
        count = f.let(f"zext i32 {most} to i64")
        series.append((table.start, table.size, table.step, count))
    for start, size, step, count in series:
        if isinstance(count, int) and count < _FEWEST_ROUNDS:
            yield from ((size, f"{start + k * step}") for k in range(count))
            continue
        with f.each(count) as turn:
            yield size, f.let(f"add i64 {f.let(f'mul i64 {turn}, {step}')}, {start}")


def _move(
    name: str, slots: list[Slot], group: VectorGroup, enters: bool, tables: Tables = ()
) -> str:
    """Write a function that moves an individual's numbers into a packed lane, or back."""
    given = "ptr %scratch, ptr %pack, i64 %individual, i64 %lane"
    f = FunctionText(f"internal void {name}({given}) noinline")
    home = f.let(f"urem i64 %individual, {group.width}")
    base = f.at("%scratch", f.let(f"udiv i64 %individual, {group.width}"), group.stride)
    sizes = sorted({4, *(slot.size for slot in slots), *(table.size for table in tables)})
    far = {size: f.at(base, home, size) for size in sizes}
    near = {size: f.at("%pack", "%lane", size) for size in sizes}
    source, target = (far, near) if enters else (near, far)
    for size, place in _places(f, slots, tables, far[4], 1):
        kind, start = _WORDS[size], f.at(source[size], place)
        end = f.at(target[size], place)
        value = f.let(f"load volatile {kind}, ptr {start}")
        f.do(f"store volatile {kind} {value}, ptr {end}")
    return f.text()


def _move_compressed(name: str, slots: list[Slot], group: VectorGroup, tables: Tables) -> str:
    """Write a function that moves the chosen individuals of a vector into consecutive lanes.

    The first vector fills all lanes, because every lane must hold valid numbers. Its individuals
    that are not chosen stay in the lanes that are left over.
    """
    width = group.width
    bits, flags = f"i{width}", f"<{width} x i1>"
    given = "ptr %scratch, ptr %pack, i64 %vector, i64 %lane, i32 %which, i64 %enter"
    f = FunctionText(f"internal void {name}({given}) noinline")
    base = f.at("%scratch", "%vector", group.stride)
    chosen = f.let(f"bitcast {bits} {f.let(f'trunc i32 %which to {bits}')} to {flags}")
    above = f.let("shl i64 1, %enter")
    entering, begins = f.let(f"sub i64 {above}, 1"), f.let("icmp eq i64 %lane, 0")
    written = f.let(f"select i1 {begins}, i64 -1, i64 {entering}")
    written = f.let(f"bitcast {bits} {f.let(f'trunc i64 {written} to {bits}')} to {flags}")
    for size, place in _places(f, slots, tables, base, width):
        kept, word = _WORDS[size], _WORDS[max(size, _NARROWEST)]
        narrow, wide = f"<{width} x {kept}>", f"<{width} x {word}>"
        grow, shrink = ("bitcast", "bitcast") if kept == word else ("zext", "trunc")
        start, end = f.at(base, place), f.at(f.at("%pack", "%lane", size), place)
        value = f.let(f"load volatile {narrow}, ptr {start}, align {size}")
        value = f.let(f"{grow} {narrow} {value} to {wide}")
        given = f"{wide} {value}, {wide} {value}, {flags} {chosen}"
        value = f.let(f"call {wide} @{_COMPRESS}.v{width}{word}({given})")
        value = f.let(f"{shrink} {wide} {value} to {narrow}")
        given = f"{narrow} {value}, ptr {end}, i32 {size}, {flags} {written}"
        f.do(f"call void @llvm.masked.store.v{width}{kept}.p0({given})")
    return f.text()


@contextlib.contextmanager
def each_vector(f: FunctionText, start: str, count: str, width: int) -> Iterator[str]:
    """Run the code of a ``with`` statement for some vectors, from an individual on.

    The number of a vector's first individual is ``%first``. The last vector ends with the last
    individual, so it may overlap the one before.
    """
    last = f.let(f"sub i64 %n, {width}")
    with f.each(count) as vector:
        here = f.let(f"add i64 {start}, {f.let(f'mul i64 {vector}, {width}')}")
        f.do(f"%first = call i64 @llvm.smin.i64(i64 {here}, i64 {last})")
        yield vector
