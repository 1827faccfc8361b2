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

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from evo_cpg.native.backend.code import GrowingTable, Slot

# A vector runs separately while more than this fraction of its individuals is active. Fitted:
# quadrupeds and hexapods take at most 1.07 times as long with fractions from 1/4 to 1/2.
_BUSY = 3 / 8

# AVX-512's instruction that moves chosen numbers of a vector into its first lanes. Bytes of the
# smallest numbers that it handles, and bytes of its vector.
_COMPRESS, _NARROWEST, _VECTOR = "llvm.x86.avx512.mask.compress", 4, 64

# Minimum number of slots at equal distances that are moved by a loop. Fewer slots are moved by code
# without a loop.
_FEWEST_ROUNDS = 16

# IR types by bytes of a number.
Slots = Sequence[Slot]
Tables = Sequence[GrowingTable]

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
    shared = sorted({slot for slot in reads if slot.shared})
    width, stride, most = group.width, group.stride, group.vectors * group.width
    compress = group.compresses and all(x.size * width <= _VECTOR for x in (*own, *tables))
    alike = "\n".join(
        f"  %from{i} = getelementptr i8, ptr %scratch, i64 {slot.start}\n"
        f"  %to{i} = getelementptr i8, ptr %pack, i64 {slot.start}\n"
        f"  %shared{i} = load {_WORDS[slot.size]}, ptr %from{i}\n"
        f"  store {_WORDS[slot.size]} %shared{i}, ptr %to{i}"
        for i, slot in enumerate(shared)
    )
    call = f"{parameters}ptr %{{}}, i64 %n, i64 0"
    body = f"""
define internal void @{name}.group({parameters}ptr %scratch, i64 %n, i64 %count) noinline #0 {{
entry:
  %queue = alloca [{most} x i64]
  %masks = alloca [{group.vectors} x i32]
  %owner = alloca [{width} x i64]
  %pack = getelementptr i8, ptr %scratch, i64 {group.vectors * stride}
  %alone = icmp eq i64 %count, 1
  %enough = select i1 %alone, i32 0, i32 {int(_BUSY * width)}
  br label %vector
vector:
  %v = phi i64 [ 0, %entry ], [ %v_next, %vector_done ]
  %waiting = phi i64 [ 0, %entry ], [ %waiting_now, %vector_done ]
  %offset = mul i64 %v, {stride}
  %base = getelementptr i8, ptr %scratch, i64 %offset
  br label %own_test
own_test:
  %wants = call i32 @{name}.test({call.format("base")})
  %mask_of = getelementptr i32, ptr %masks, i64 %v
  store i32 %wants, ptr %mask_of
  %active = call i32 @llvm.ctpop.i32(i32 %wants)
  %goes_on = icmp ugt i32 %active, %enough
  br i1 %goes_on, label %own_round, label %leave
own_round:
  call void @{name}.round({call.format("base")})
  br label %own_test
leave:
  %rest = phi i32 [ %wants, %own_test ], [ %rest_next, %enqueue ]
  %waiting_now = phi i64 [ %waiting, %own_test ], [ %waiting_next, %enqueue ]
  %none_left = icmp eq i32 %rest, 0
  br i1 %none_left, label %vector_done, label %enqueue
enqueue:
  %which = call i32 @llvm.cttz.i32(i32 %rest, i1 true)
  %which_wide = zext i32 %which to i64
  %first_of = mul i64 %v, {width}
  %individual = add i64 %first_of, %which_wide
  %entry_of = getelementptr i64, ptr %queue, i64 %waiting_now
  store i64 %individual, ptr %entry_of
  %waiting_next = add i64 %waiting_now, 1
  %rest_less = sub i32 %rest, 1
  %rest_next = and i32 %rest, %rest_less
  br label %leave
vector_done:
  %v_next = add i64 %v, 1
  %more_vectors = icmp ult i64 %v_next, %count
  br i1 %more_vectors, label %vector, label %packing
packing:
  %any = icmp ne i64 %waiting_now, 0
  br i1 %any, label %fill, label %done
fill:
{alike}
{_fill_compressed(name, group) if compress else _fill_one_by_one(name, group)}
filled:
  %many = icmp ugt i64 %waiting_now, {width}
  %begun = select i1 %many, i64 {width}, i64 %waiting_now
  br label %packed_round
packed_round:
  %occupied = phi i32 [ %lanes, %filled ], [ %occupied_now, %settled ]
  %called = phi i64 [ %begun, %filled ], [ %called_now, %settled ]
  call void @{name}.round({call.format("pack")})
  %still = call i32 @{name}.test({call.format("pack")})
  %keep_on = and i32 %still, %occupied
  %finished = xor i32 %keep_on, %occupied
  br label %release
release:
  %leaving = phi i32 [ %finished, %packed_round ], [ %leaving_next, %next_leaves ]
  %occupied_now = phi i32 [ %occupied, %packed_round ], [ %occupied_next, %next_leaves ]
  %called_now = phi i64 [ %called, %packed_round ], [ %called_next, %next_leaves ]
  %none_leaves = icmp eq i32 %leaving, 0
  br i1 %none_leaves, label %settled, label %leaves
settled:
  %empty = icmp eq i32 %occupied_now, 0
  br i1 %empty, label %done, label %packed_round
leaves:
  %left_lane = call i32 @llvm.cttz.i32(i32 %leaving, i1 true)
  %left_lane_wide = zext i32 %left_lane to i64
  %left_entry = getelementptr i64, ptr %owner, i64 %left_lane_wide
  %left_individual = load i64, ptr %left_entry
  call void @{name}.out(ptr %scratch, ptr %pack, i64 %left_individual, i64 %left_lane_wide)
  %leaving_less = sub i32 %leaving, 1
  %leaving_next = and i32 %leaving, %leaving_less
  %more_wait = icmp ult i64 %called_now, %waiting_now
  br i1 %more_wait, label %refill, label %vacate
refill:
  %call_entry = getelementptr i64, ptr %queue, i64 %called_now
  %next_one = load i64, ptr %call_entry
  store i64 %next_one, ptr %left_entry
  call void @{name}.in(ptr %scratch, ptr %pack, i64 %next_one, i64 %left_lane_wide)
  %called_more = add i64 %called_now, 1
  br label %next_leaves
vacate:
  %bit_left = shl i32 1, %left_lane
  %without = xor i32 %occupied_now, %bit_left
  br label %next_leaves
next_leaves:
  %occupied_next = phi i32 [ %occupied_now, %refill ], [ %without, %vacate ]
  %called_next = phi i64 [ %called_more, %refill ], [ %called_now, %vacate ]
  br label %release
done:
  ret void
}}"""
    moves = [
        _move(f"@{name}.in", own, group, True, tables),
        _move(f"@{name}.out", sorted(carries), group, False),
    ]
    if compress:
        moves.append(_move_compressed(f"@{name}.in_compressed", own, group, tables))
    return "\n".join([*moves, body])


def _fill_one_by_one(name: str, group: VectorGroup) -> str:
    """Write code that fills the lanes of the packed vector with the first individuals."""
    return f"""  br label %lane
lane:
  %s = phi i64 [ 0, %fill ], [ %s_next, %lane ]
  %lanes_before = phi i32 [ 0, %fill ], [ %lanes, %lane ]
  %taken = icmp ult i64 %s, %waiting_now
  ; A lane that is left over is filled like the first: no number in it may be without meaning.
  %turn = select i1 %taken, i64 %s, i64 0
  %turn_entry = getelementptr i64, ptr %queue, i64 %turn
  %new_individual = load i64, ptr %turn_entry
  %lane_owner = getelementptr i64, ptr %owner, i64 %s
  store i64 %new_individual, ptr %lane_owner
  call void @{name}.in(ptr %scratch, ptr %pack, i64 %new_individual, i64 %s)
  %s_narrow = trunc i64 %s to i32
  %lane_bit = shl i32 1, %s_narrow
  %lanes_more = or i32 %lanes_before, %lane_bit
  %lanes = select i1 %taken, i32 %lanes_more, i32 %lanes_before
  %s_next = add i64 %s, 1
  %more_lanes = icmp ult i64 %s_next, {group.width}
  br i1 %more_lanes, label %lane, label %filled"""


def _fill_compressed(name: str, group: VectorGroup) -> str:
    """Write code that fills the packed lanes from one vector after another."""
    return f"""  br label %row
row:
  %r = phi i64 [ 0, %fill ], [ %r_next, %row_done ]
  %s = phi i64 [ 0, %fill ], [ %s_next, %row_done ]
  %row_mask = getelementptr i32, ptr %masks, i64 %r
  %row_wants = load i32, ptr %row_mask
  %come = call i32 @llvm.ctpop.i32(i32 %row_wants)
  %come_wide = zext i32 %come to i64
  %room = sub i64 {group.width}, %s
  %enter = call i64 @llvm.umin.i64(i64 %come_wide, i64 %room)
  %s_next = add i64 %s, %enter
  %none_enters = icmp eq i64 %enter, 0
  br i1 %none_enters, label %row_done, label %take_lanes
take_lanes:
  call void @{name}.in_compressed(ptr %scratch, ptr %pack, i64 %r, i64 %s, i32 %row_wants, \
i64 %enter)
  br label %row_done
row_done:
  %r_next = add i64 %r, 1
  %more_rows = icmp ult i64 %r_next, %count
  %more_room = icmp ult i64 %s_next, {group.width}
  %more_enter = and i1 %more_rows, %more_room
  br i1 %more_enter, label %row, label %note
note:
  call void @llvm.memcpy.p0.p0.i64(ptr %owner, ptr %queue, i64 {8 * group.width}, i1 false)
  %taken_lanes = trunc i64 %s_next to i32
  %above = shl i32 1, %taken_lanes
  %lanes = sub i32 %above, 1
  br label %filled"""


class _Series(NamedTuple):
    """Places in memory at equal distances.

    Attributes:
        start: first place, bytes.
        size: bytes of one individual's number.
        step: bytes from one place to the next.
        count: number of places, or its LLVM name.
    """

    start: int
    size: int
    step: int
    count: Any


def _series(slots: Iterable[Slot], tables: Tables) -> list[_Series]:
    """Group slots at equal distances, if there are at least ``_FEWEST_ROUNDS``, and add tables."""
    found: list[_Series] = []
    for start, size, _ in slots:
        if found and found[-1].size == size:
            last = found[-1]
            step = start - last.start - (last.count - 1) * last.step
            if last.count == 1 or step == last.step:
                found[-1] = last._replace(step=step, count=last.count + 1)
                continue
        found.append(_Series(start, size, 0, 1))
    return [
        part
        for one in found
        for part in (
            [one]
            if one.count >= _FEWEST_ROUNDS
            else [_Series(one.start + k * one.step, one.size, 0, 1) for k in range(one.count)]
        )
    ] + [_Series(t.start, t.size, t.step, f"%rows{k}") for k, t in enumerate(tables)]


def _rows_in_use(tables: Tables, base: str, width: int) -> str:
    """Write code that finds the most rows in use for any of some individuals, for each table."""
    t = f"<{width} x i32>"
    return "".join(
        f"""  %extent{k} = getelementptr i8, ptr {base}, i64 {table.extent}
  %extents{k} = load {t}, ptr %extent{k}, align 4
  %most{k} = call i32 @llvm.vector.reduce.umax.v{width}i32({t} %extents{k})
  %rows{k} = zext i32 %most{k} to i64
"""
        for k, table in enumerate(tables)
    )


def _through(series: list[_Series], lines: Callable[[int, int, str], list[str]]) -> str:
    """Write the code for each place, with loops over places at equal distances.

    Irregular places are moved without a loop, so the processor fetches many numbers at a time.

    Args:
        series: places.
        lines: function that returns lines of code, given a unique number, the bytes of a number,
            and the place.
    """
    written, label = [], "entry"
    for i, (start, size, step, count) in enumerate(series):
        if count == 1:
            written += lines(i, size, f"{start}")
            continue
        written += [
            f"br label %stretch{i}",
            f"stretch{i}:",
            f"%turn{i} = phi i64 [ 0, %{label} ], [ %turn_next{i}, %stretch{i} ]",
            f"%steps{i} = mul i64 %turn{i}, {step}",
            f"%place{i} = add i64 %steps{i}, {start}",
            *lines(i, size, f"%place{i}"),
            f"%turn_next{i} = add i64 %turn{i}, 1",
            f"%turn_more{i} = icmp ult i64 %turn_next{i}, {count}",
            f"br i1 %turn_more{i}, label %stretch{i}, label %behind{i}",
            f"behind{i}:",
        ]
        label = f"behind{i}"
    return "\n".join(f"  {line}" for line in written)


def _move(
    name: str, slots: list[Slot], group: VectorGroup, enters: bool, tables: Tables = ()
) -> str:
    """Write a function that moves an individual's numbers into a packed lane, or back."""
    lanes = "".join(
        f"""  %far_lane{size} = mul i64 %home_lane, {size}
  %near_lane{size} = mul i64 %lane, {size}
  %far{size} = getelementptr i8, ptr %base, i64 %far_lane{size}
  %near{size} = getelementptr i8, ptr %pack, i64 %near_lane{size}
"""
        for size in sorted({4, *(slot.size for slot in slots), *(table.size for table in tables)})
    )

    source, target = ("far", "near") if enters else ("near", "far")

    def move(i: int, size: int, start: str) -> list[str]:
        return [
            f"%from{i} = getelementptr i8, ptr %{source}{size}, i64 {start}",
            f"%to{i} = getelementptr i8, ptr %{target}{size}, i64 {start}",
            f"%value{i} = load volatile {_WORDS[size]}, ptr %from{i}",
            f"store volatile {_WORDS[size]} %value{i}, ptr %to{i}",
        ]

    return f"""
define internal void {name}(ptr %scratch, ptr %pack, i64 %individual, i64 %lane) noinline #0 {{
entry:
  %vector = udiv i64 %individual, {group.width}
  %home_lane = urem i64 %individual, {group.width}
  %offset = mul i64 %vector, {group.stride}
  %base = getelementptr i8, ptr %scratch, i64 %offset
{lanes}{_rows_in_use(tables, "%far4", 1)}{_through(_series(slots, tables), move)}
  ret void
}}"""


def _move_compressed(name: str, slots: list[Slot], group: VectorGroup, tables: Tables) -> str:
    """Write a function that moves the chosen individuals of a vector into consecutive lanes.

    The first vector fills all lanes, because every lane must hold valid numbers. Its individuals
    that are not chosen stay in the lanes that are left over.
    """
    width = group.width
    bits, flags = f"i{width}", f"<{width} x i1>"

    def move(i: int, size: int, start: str) -> list[str]:
        kept, word = _WORDS[size], _WORDS[max(size, _NARROWEST)]
        narrow, wide = f"<{width} x {kept}>", f"<{width} x {word}>"
        grow, shrink = ("bitcast", "bitcast") if kept == word else ("zext", "trunc")
        return [
            f"%from{i} = getelementptr i8, ptr %base, i64 {start}",
            f"%lane_of{i} = getelementptr {kept}, ptr %pack, i64 %lane",
            f"%to{i} = getelementptr i8, ptr %lane_of{i}, i64 {start}",
            f"%value{i} = load volatile {narrow}, ptr %from{i}, align {size}",
            f"%wide{i} = {grow} {narrow} %value{i} to {wide}",
            f"%close{i} = call {wide} @{_COMPRESS}.v{width}{word}"
            f"({wide} %wide{i}, {wide} %wide{i}, {flags} %chosen)",
            f"%narrow{i} = {shrink} {wide} %close{i} to {narrow}",
            f"call void @llvm.masked.store.v{width}{kept}.p0"
            f"({narrow} %narrow{i}, ptr %to{i}, i32 {size}, {flags} %written)",
        ]

    return f"""
define internal void {name}(ptr %scratch, ptr %pack, i64 %vector, i64 %lane, i32 %which, \
i64 %enter) noinline #0 {{
entry:
  %offset = mul i64 %vector, {group.stride}
  %base = getelementptr i8, ptr %scratch, i64 %offset
  %chosen_bits = trunc i32 %which to {bits}
  %chosen = bitcast {bits} %chosen_bits to {flags}
  %above = shl i64 1, %enter
  %entering = sub i64 %above, 1
  %begins = icmp eq i64 %lane, 0
  %written_wide = select i1 %begins, i64 -1, i64 %entering
  %written_bits = trunc i64 %written_wide to {bits}
  %written = bitcast {bits} %written_bits to {flags}
{_rows_in_use(tables, "%base", width)}{_through(_series(slots, tables), move)}
  ret void
}}"""


def each_vector(name: str, parameters: str, group: VectorGroup) -> str:
    """Return the function ``@name.group``, which calls ``@name`` for every vector of a group.

    Args:
        name: name of a function of one vector.
        parameters: its parameters before the scratch memory, with types and a trailing comma.
        group: the vectors.
    """
    return f"""
define internal void @{name}.group({parameters}ptr %scratch, i64 %n, i64 %first, i64 %count) #0 {{
entry:
  %last = sub i64 %n, {group.width}
  br label %vector
vector:
  %v = phi i64 [ 0, %entry ], [ %next, %vector ]
  %offset = mul i64 %v, {group.stride}
  %base = getelementptr i8, ptr %scratch, i64 %offset
  %before = mul i64 %v, {group.width}
  %here = add i64 %first, %before
  %within = icmp slt i64 %here, %last
  %start = select i1 %within, i64 %here, i64 %last
  call void @{name}({parameters}ptr %base, i64 %n, i64 %start)
  %next = add i64 %v, 1
  %more = icmp ult i64 %next, %count
  br i1 %more, label %vector, label %done
done:
  ret void
}}"""
