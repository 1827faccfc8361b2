"""The entry into native code: an XLA FFI handler, written as LLVM IR like the code itself.

XLA calls it with a *call frame* whose layout is that of the public header (``xla/ffi/api/c_api.h``
in `jax.ffi.include_dir()`), on 64-bit machines:

| structure | fields and their offsets in bytes |
|---|---|
| call frame | size 0, extension 8, api 16, stage 32, arguments 40, results 80 |
| arguments, results (within the frame) | size 0, count +16, types +24, pointers +32 |
| buffer | size 0, type 16, data 24, rank 32, dimensions 40 |
| extension | size 0, type 8; of one that asks for metadata: metadata 24 |
| metadata | size 0, version 8 (major +16, minor +20), traits 32 |
| api | size 0, version 16 (major +16), Error_Create 48 |
| arguments of Error_Create | size 0, extension 8, message 16, code 24 |

It reads nothing before it has checked that it is there: the sizes of the structures, the version of
the interface, the number of arrays, and the type and shape of each. What does not fit becomes an
error of XLA; where not even that can be told, because there is no `Error_Create`, the process ends,
as the self-test before native code is first used would find out (`evo_cpg.fusion.engine`).
"""

from collections.abc import Sequence

import numpy as np

from evo_cpg.fusion.backend.code import Variant
from evo_cpg.fusion.ir.graph import Buffer

# Of the interface that this is written for. Before 1.0 of it a later minor version only adds.
_MAJOR, _MINOR = 0, 1

# XLA's numbers of types, by NumPy's character.
_DATA_TYPES = {
    "?": 1, "b": 2, "h": 3, "i": 4, "l": 5, "q": 5, "B": 6, "H": 7, "I": 8, "L": 9, "Q": 9,
    "f": 11, "d": 12,
}  # fmt: skip
_BYTES_TYPE = 6
_INVALID_ARGUMENT = 3

# Least sizes of structures that hold all fields read here, bytes.
_LEAST_FRAME_SIZE = 40  # without arrays
_FRAME_SIZE, _ARRAYS_SIZE, _BUFFER_SIZE, _API_SIZE = 120, 40, 48, 56
_EXTENSION_SIZE, _METADATA_SIZE = 32, 36
_EXECUTE = 3


def handler(
    name: str,
    arguments: Sequence[Buffer],
    results: Sequence[Buffer],
    scratch: int,
    variant: Variant,
) -> str:
    """LLVM IR of a handler ``@name`` that checks its call and runs ``@program``.

    Args:
        name: of the function.
        arguments: what it reads.
        results: what it writes, at least one.
        scratch: bytes of memory that it works in, its last result.
        variant: the kind of code that it runs.
    """
    buffers = [*arguments, *results]
    wanted = ", ".join(
        f"%wanted {{ i32 {_DATA_TYPES[b.dtype.char]}, i32 {1 if b.shared else 2}, i64 {b.rows} }}"
        for b in buffers
    )
    least = 1 if variant.masked else variant.width
    most = variant.width if variant.masked else np.iinfo(np.int64).max
    loads = []
    for k in range(len(buffers)):
        loads.append(f"%s{k} = getelementptr ptr, ptr %data, i64 {k}")
        loads.append(f"%d{k} = load ptr, ptr %s{k}")
    given = ", ".join([*(f"ptr %d{k}" for k in range(len(buffers))), "ptr %scratch", "i64 %n"])
    return _TEMPLATE.format(
        name=name,
        wanted_count=len(buffers),
        wanted=wanted,
        argument_count=len(arguments),
        result_count=len(results),
        all_results=len(results) + 1,
        scratch=scratch,
        least=least,
        most=most,
        loads="\n  ".join(loads),
        given=given,
        major=_MAJOR,
        minor=_MINOR,
        execute=_EXECUTE,
        least_frame_size=_LEAST_FRAME_SIZE,
        frame_size=_FRAME_SIZE,
        buffer_size=_BUFFER_SIZE,
        api_size=_API_SIZE,
        arrays_size=_ARRAYS_SIZE,
        extension_size=_EXTENSION_SIZE,
        metadata_size=_METADATA_SIZE,
        code=_INVALID_ARGUMENT,
        bytes_type=_BYTES_TYPE,
        **_messages(),
    )


_MESSAGES = {
    "m_size": "evo_cpg: this XLA passes structures that are smaller than expected",
    "m_count": "evo_cpg: wrong number of arrays",
    "m_array": "evo_cpg: an array has another type or shape than the code was made for",
    "m_people": "evo_cpg: the code was made for another number of individuals",
}


def _messages() -> dict[str, str]:
    """Constants of the module, and nothing to forget when a message changes its length."""
    lines = [
        f'@{key} = internal constant [{len(text) + 1} x i8] c"{text}\\00"'
        for key, text in _MESSAGES.items()
    ]
    return {"messages": "\n".join(lines)}


_TEMPLATE = """
%wanted = type {{ i32, i32, i64 }}
declare void @llvm.trap()
@arrays = internal constant [{wanted_count} x %wanted] [{wanted}]
{messages}

define internal ptr @complain(ptr %api, ptr %message) {{
  %record = alloca [4 x i64], align 8
  store i64 32, ptr %record
  %r1 = getelementptr i64, ptr %record, i64 1
  store i64 0, ptr %r1
  %r2 = getelementptr i64, ptr %record, i64 2
  store ptr %message, ptr %r2
  %r3 = getelementptr i64, ptr %record, i64 3
  store i64 {code}, ptr %r3
  %place = getelementptr i8, ptr %api, i64 48
  %create = load ptr, ptr %place
  %error = call ptr %create(ptr %record)
  ret ptr %error
}}

; Whether an array is what is wanted; %n is the number of individuals, -1 where it is not known yet.
define internal i1 @fits(ptr %buffer, ptr %want, i64 %n) {{
entry:
  %size = load i64, ptr %buffer
  %large = icmp uge i64 %size, {buffer_size}
  br i1 %large, label %type, label %no
type:
  %typep = getelementptr i8, ptr %buffer, i64 16
  %type_is = load i32, ptr %typep
  %type_want = load i32, ptr %want
  %same = icmp eq i32 %type_is, %type_want
  br i1 %same, label %rank, label %no
rank:
  %rankp = getelementptr i8, ptr %buffer, i64 32
  %rank_is = load i64, ptr %rankp
  %wantp = getelementptr i8, ptr %want, i64 4
  %rank_want = load i32, ptr %wantp
  %rank_wide = zext i32 %rank_want to i64
  %equal = icmp eq i64 %rank_is, %rank_wide
  br i1 %equal, label %rows, label %no
rows:
  %dimsp = getelementptr i8, ptr %buffer, i64 40
  %dims = load ptr, ptr %dimsp
  %rows_is = load i64, ptr %dims
  %rowsp = getelementptr i8, ptr %want, i64 8
  %rows_want = load i64, ptr %rowsp
  %enough = icmp eq i64 %rows_is, %rows_want
  br i1 %enough, label %individuals, label %no
individuals:
  %one = icmp eq i32 %rank_want, 1
  br i1 %one, label %yes, label %second
second:
  %np = getelementptr i64, ptr %dims, i64 1
  %n_is = load i64, ptr %np
  %n_same = icmp eq i64 %n_is, %n
  ret i1 %n_same
yes:
  ret i1 true
no:
  ret i1 false
}}

define ptr @{name}(ptr %frame) #0 {{
entry:
  %data = alloca ptr, i64 {wanted_count}, align 8
  %frame_size = load i64, ptr %frame
  %frame_told = icmp uge i64 %frame_size, {least_frame_size}
  br i1 %frame_told, label %extended, label %lost
lost:
  call void @llvm.trap()
  unreachable
extended:
  %extp = getelementptr i8, ptr %frame, i64 8
  %ext = load ptr, ptr %extp
  %none = icmp eq ptr %ext, null
  br i1 %none, label %staging, label %asking
asking:
  %ext_size = load i64, ptr %ext
  %ext_large = icmp uge i64 %ext_size, {extension_size}
  br i1 %ext_large, label %kinds, label %staging
kinds:
  %kindp = getelementptr i8, ptr %ext, i64 8
  %kind = load i32, ptr %kindp
  %metadata = icmp eq i32 %kind, 1
  br i1 %metadata, label %answer, label %staging
answer:
  %metap = getelementptr i8, ptr %ext, i64 24
  %meta = load ptr, ptr %metap
  %meta_size = load i64, ptr %meta
  %meta_large = icmp uge i64 %meta_size, {metadata_size}
  br i1 %meta_large, label %version, label %nothing
version:
  %majorp = getelementptr i8, ptr %meta, i64 24
  store i32 {major}, ptr %majorp
  %minorp = getelementptr i8, ptr %meta, i64 28
  store i32 {minor}, ptr %minorp
  %traitsp = getelementptr i8, ptr %meta, i64 32
  store i32 0, ptr %traitsp
  ret ptr null
staging:
  %stagep = getelementptr i8, ptr %frame, i64 32
  %stage = load i32, ptr %stagep
  %runs = icmp eq i32 %stage, {execute}
  br i1 %runs, label %sizes, label %nothing
nothing:
  ret ptr null
sizes:
  %apip = getelementptr i8, ptr %frame, i64 16
  %api = load ptr, ptr %apip
  %api_size = load i64, ptr %api
  %api_large = icmp uge i64 %api_size, {api_size}
  br i1 %api_large, label %versions, label %lost
versions:
  %api_majorp = getelementptr i8, ptr %api, i64 32
  %api_major = load i32, ptr %api_majorp
  %major_same = icmp eq i32 %api_major, {major}
  %frame_large = icmp uge i64 %frame_size, {frame_size}
  %framed = and i1 %major_same, %frame_large
  br i1 %framed, label %lists, label %bad_size
lists:
  %args_sizep = getelementptr i8, ptr %frame, i64 40
  %args_size = load i64, ptr %args_sizep
  %args_large = icmp uge i64 %args_size, {arrays_size}
  %rets_sizep = getelementptr i8, ptr %frame, i64 80
  %rets_size = load i64, ptr %rets_sizep
  %rets_large = icmp uge i64 %rets_size, {arrays_size}
  %both = and i1 %args_large, %rets_large
  br i1 %both, label %counts, label %bad_size
bad_size:
  %e_size = call ptr @complain(ptr %api, ptr @m_size)
  ret ptr %e_size
counts:
  %args_nump = getelementptr i8, ptr %frame, i64 56
  %args_num = load i64, ptr %args_nump
  %rets_nump = getelementptr i8, ptr %frame, i64 96
  %rets_num = load i64, ptr %rets_nump
  %args_same = icmp eq i64 %args_num, {argument_count}
  %rets_same = icmp eq i64 %rets_num, {all_results}
  %counted = and i1 %args_same, %rets_same
  br i1 %counted, label %people, label %bad_count
bad_count:
  %e_count = call ptr @complain(ptr %api, ptr @m_count)
  ret ptr %e_count
people:
  %argsp = getelementptr i8, ptr %frame, i64 72
  %args = load ptr, ptr %argsp
  %retsp = getelementptr i8, ptr %frame, i64 112
  %rets = load ptr, ptr %retsp
  %firstp = load ptr, ptr %rets
  %first_size = load i64, ptr %firstp
  %first_large = icmp uge i64 %first_size, {buffer_size}
  br i1 %first_large, label %first_ranks, label %bad_array
first_ranks:
  %first_rankp = getelementptr i8, ptr %firstp, i64 32
  %first_rank = load i64, ptr %first_rankp
  %matrix = icmp eq i64 %first_rank, 2
  br i1 %matrix, label %count_people, label %bad_array
count_people:
  %first_dimsp = getelementptr i8, ptr %firstp, i64 40
  %first_dims = load ptr, ptr %first_dimsp
  %np = getelementptr i64, ptr %first_dims, i64 1
  %n = load i64, ptr %np
  %n_least = icmp sge i64 %n, {least}
  %n_most = icmp sle i64 %n, {most}
  %n_good = and i1 %n_least, %n_most
  br i1 %n_good, label %next, label %bad_people
bad_people:
  %e_people = call ptr @complain(ptr %api, ptr @m_people)
  ret ptr %e_people
next:
  %k = phi i64 [ 0, %count_people ], [ %onward, %take ]
  %some_left = icmp slt i64 %k, {wanted_count}
  br i1 %some_left, label %look, label %room
look:
  %is_argument = icmp slt i64 %k, {argument_count}
  %k_result = sub i64 %k, {argument_count}
  %list = select i1 %is_argument, ptr %args, ptr %rets
  %place = select i1 %is_argument, i64 %k, i64 %k_result
  %bufferp = getelementptr ptr, ptr %list, i64 %place
  %buffer = load ptr, ptr %bufferp
  %want = getelementptr %wanted, ptr @arrays, i64 %k
  %good = call i1 @fits(ptr %buffer, ptr %want, i64 %n)
  br i1 %good, label %take, label %bad_array
take:
  %datap = getelementptr i8, ptr %buffer, i64 24
  %data_is = load ptr, ptr %datap
  %slot = getelementptr ptr, ptr %data, i64 %k
  store ptr %data_is, ptr %slot
  %onward = add i64 %k, 1
  br label %next
bad_array:
  %e_array = call ptr @complain(ptr %api, ptr @m_array)
  ret ptr %e_array
room:
  %scratchpp = getelementptr ptr, ptr %rets, i64 {result_count}
  %scratchb = load ptr, ptr %scratchpp
  %scratch_size = load i64, ptr %scratchb
  %scratch_large = icmp uge i64 %scratch_size, {buffer_size}
  br i1 %scratch_large, label %scratch_types, label %bad_array
scratch_types:
  %scratch_typep = getelementptr i8, ptr %scratchb, i64 16
  %scratch_type = load i32, ptr %scratch_typep
  %scratch_bytes = icmp eq i32 %scratch_type, {bytes_type}
  %scratch_rankp = getelementptr i8, ptr %scratchb, i64 32
  %scratch_rank = load i64, ptr %scratch_rankp
  %scratch_row = icmp eq i64 %scratch_rank, 1
  %scratch_known = and i1 %scratch_bytes, %scratch_row
  br i1 %scratch_known, label %scratch_sizes, label %bad_array
scratch_sizes:
  %scratch_dimsp = getelementptr i8, ptr %scratchb, i64 40
  %scratch_dims = load ptr, ptr %scratch_dimsp
  %scratch_is = load i64, ptr %scratch_dims
  %scratch_enough = icmp sge i64 %scratch_is, {scratch}
  br i1 %scratch_enough, label %run, label %bad_array
run:
  %scratchp = getelementptr i8, ptr %scratchb, i64 24
  %scratch = load ptr, ptr %scratchp
  {loads}
  call void @program({given})
  ret ptr null
}}
"""
