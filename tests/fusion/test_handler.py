"""The entry into native code takes nothing but what it was made for."""

import ctypes
import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import sample

from evo_cpg.fusion import engine
from evo_cpg.fusion.backend import machine
from evo_cpg.fusion.fuse import fuse

ROWS, PEOPLE = 3, 40
ARRAYS = "wrong number of arrays"
ARRAY = "another type or shape"
NUMBER = "another number of individuals"
SIZE = "structures that are smaller than expected"


def lowered(count):
    """A program with numbers that all share, one that it reads, and two results."""

    def run(shared, x):
        def function(x):
            total, path = jax.lax.scan(lambda c, r: (c + r * x, c), x, shared)
            return total, path[1].sum() > 0

        return fuse(function, x, batch_ndim=1)

    text = jax.jit(run).lower(jnp.ones(5), jnp.ones((ROWS, count))).as_text()
    (name,) = set(re.findall(r"@(evo_cpg_\w+)", text))
    return name, max(int(size) for size in re.findall(r"tensor<(\d+)xui8>", text))


def struct(*shape, dtype="float32"):
    return jax.ShapeDtypeStruct(shape, dtype)


def call(name, room, given=None, results=None):
    given = [jnp.ones(5), sample((ROWS, PEOPLE))] if given is None else given
    results = RESULTS if results is None else results
    rooms = [] if room is None else [room]
    return jax.block_until_ready(jax.ffi.ffi_call(name, (*results, *rooms))(*given))


def room(size):
    return struct(size, dtype="uint8")


def test_what_fits_is_computed():
    name, size = lowered(PEOPLE)
    x = sample((ROWS, PEOPLE))
    total, positive, _ = call(name, room(size))
    np.testing.assert_allclose(total, 6 * x, rtol=1e-6)
    np.testing.assert_array_equal(positive[0], 2 * x.sum(0) > 0)
    call(name, room(size + 1))
    assert call(
        name,
        room(size),
        [jnp.ones(5), sample((ROWS, 7 * PEOPLE))],
        [struct(ROWS, 7 * PEOPLE), struct(1, 7 * PEOPLE, dtype=bool)],
    )[0].shape == (ROWS, 7 * PEOPLE)


X, SHARED = sample((ROWS, PEOPLE)), jnp.ones(5)
FLAGS = struct(1, PEOPLE, dtype=bool)
RESULTS = [struct(ROWS, PEOPLE), FLAGS]
WRONG = {
    "an argument too few": ([X], RESULTS, ARRAYS),
    "an argument too many": ([SHARED, X, X], RESULTS, ARRAYS),
    "a result too few": ([SHARED, X], RESULTS[:1], ARRAYS),
    "a result too many": ([SHARED, X], [*RESULTS, RESULTS[0]], ARRAYS),
    "another type": ([SHARED, X.astype("int32")], RESULTS, ARRAY),
    "another type that all share": ([SHARED.astype("int32"), X], RESULTS, ARRAY),
    "another type of result": ([SHARED, X], [RESULTS[0], struct(1, PEOPLE)], ARRAY),
    "another type of the first": ([SHARED, X], [struct(ROWS, PEOPLE, dtype="int32"), FLAGS], ARRAY),
    "an axis too few": ([SHARED, X[0]], RESULTS, ARRAY),
    "an axis too many": ([SHARED, X[None]], RESULTS, ARRAY),
    "an axis too few in the first result": ([SHARED, X], [struct(PEOPLE), RESULTS[1]], ARRAY),
    "no axis": ([jnp.float32(1), X], RESULTS, ARRAY),
    "fewer rows": ([SHARED, X[1:]], RESULTS, ARRAY),
    "fewer rows that all share": ([SHARED[1:], X], RESULTS, ARRAY),
    "more rows of a result": ([SHARED, X], [struct(ROWS + 1, PEOPLE), RESULTS[1]], ARRAY),
    "fewer individuals in one": ([SHARED, X[:, 1:]], RESULTS, ARRAY),
    "more individuals": ([SHARED, X], [RESULTS[0], struct(1, PEOPLE + 1, dtype=bool)], ARRAY),
    "fewer individuals than a vector": (
        [SHARED, X[:, :1]], [struct(ROWS, 1), struct(1, 1, dtype=bool)], NUMBER
    ),
    "nobody": ([SHARED, X[:, :0]], [struct(ROWS, 0), struct(1, 0, dtype=bool)], NUMBER),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_other_arrays_are_refused(name):
    target, size = lowered(PEOPLE)
    given, results, message = WRONG[name]
    with pytest.raises(jax.errors.JaxRuntimeError, match=f"evo_cpg: .*{message}"):
        call(target, room(size), given, results)


def test_too_little_room_is_refused():
    target, size = lowered(PEOPLE)
    for wrong in (room(size - 1), struct(size, dtype="int8"), struct(size, dtype="float32")):
        with pytest.raises(jax.errors.JaxRuntimeError, match=ARRAY):
            call(target, wrong)


@pytest.mark.parametrize("count", [1, 3])
def test_code_for_few_is_not_for_many(count):
    """That for one individual computes any number, one after the other."""
    if count > 1 and engine.target().bytes // 4 <= count:
        pytest.skip("vectors are that short")
    target, size = lowered(count)
    if count == 1:
        np.testing.assert_allclose(call(target, room(size))[0], 6 * X, rtol=1e-6)
        return
    with pytest.raises(jax.errors.JaxRuntimeError, match=NUMBER):
        call(target, room(size))


class Frame:
    """A call as XLA makes it, of which every part can be made wrong."""

    def __init__(
        self, target, frame_size=120, api_size=56, buffer_size=48, list_size=40, major=0, stage=3,
        rank=None,
    ):  # fmt: skip
        self.messages = []
        create = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)

        @create
        def complain(record):
            fields = (ctypes.c_int64 * 4).from_address(record)
            assert fields[0] == 32
            self.messages.append((ctypes.string_at(fields[2]).decode(), fields[3]))
            return 1234

        self.kept = [complain]
        api = [api_size, 0, 0, 0, major, 0, ctypes.cast(complain, ctypes.c_void_p).value]
        self.result = np.zeros((ROWS, PEOPLE), np.float32)
        arrays = [np.ones(5, np.float32), np.asarray(X)]
        # As XLA gives it: aligned.
        scratch = np.zeros(1 << 16, np.uint8)
        scratch = scratch[-scratch.ctypes.data % 64 :][: 1 << 15]
        found = [self.result, np.zeros((1, PEOPLE), bool), scratch]
        types = {"f": 11, "?": 1, "B": 6}

        def buffers(values):
            return self.at([
                self.at([
                    buffer_size, 0, types[x.dtype.char], x.ctypes.data, rank or x.ndim,
                    self.at(x.shape),
                ])
                for x in values
            ])  # fmt: skip

        self.kept += [arrays, found]
        self.frame = [frame_size, 0, self.at(api), 0, stage, list_size, 0, 2, 0, buffers(arrays)]
        self.frame += [list_size, 0, 3, 0, buffers(found)]
        self.address, _, _ = machine._loaded[target.removeprefix("evo_cpg_")]

    def at(self, numbers):
        """Where in memory numbers of 64 bits stand now."""
        self.kept.append((ctypes.c_int64 * len(numbers))(*numbers))
        return ctypes.addressof(self.kept[-1])

    def run(self):
        handler = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(self.address)
        return handler(self.at(self.frame))


def test_a_call_frame_is_what_the_header_says():
    frame = Frame(lowered(PEOPLE)[0])
    assert frame.run() is None and not frame.messages
    np.testing.assert_allclose(frame.result, 6 * X, rtol=1e-6)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"frame_size": 112}, SIZE),
        ({"list_size": 32}, SIZE),
        ({"major": 1}, SIZE),
        ({"buffer_size": 40}, ARRAY),
        ({"rank": 2}, ARRAY),
    ],
)
def test_another_interface_is_refused(wrong, message):
    frame = Frame(lowered(PEOPLE)[0], **wrong)
    assert frame.run() == 1234
    ((text, code),) = frame.messages
    assert text.startswith("evo_cpg: ") and message in text and code == 3
    assert not frame.result.any()


@pytest.mark.parametrize("wrong", [{"api_size": 48}, {"frame_size": 32}])
def test_without_a_way_to_complain_the_process_ends(wrong):
    """Nothing is read astray, and nothing uncomputed passes for a result."""
    script = f"""
from test_handler import Frame, PEOPLE, lowered
frame = Frame(lowered(PEOPLE)[0], **{wrong})
print("ready", flush=True)
frame.run()
"""
    paths = [str(Path(__file__).parent), str(Path(__file__).parents[2])]
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
    )  # fmt: skip
    assert run.stdout == "ready\n" and run.returncode < 0


@pytest.mark.parametrize("stage", [0, 1, 2])
def test_only_the_last_stage_computes(stage):
    frame = Frame(lowered(PEOPLE)[0], stage=stage)
    assert frame.run() is None and not frame.messages and not frame.result.any()


def test_which_interface_it_is_for():
    frame = Frame(lowered(PEOPLE)[0])
    metadata = (ctypes.c_int64 * 5)(40, 24, 0, -1, -1)
    frame.frame[1] = frame.at([32, 1, 0, ctypes.addressof(metadata)])
    assert frame.run() is None and not frame.result.any()
    frame.frame[1] = frame.at([24, 1, 0, 0])
    assert frame.run() is None
    frame.frame[1] = frame.at([32, 1, 0, frame.at([32])])
    assert frame.run() is None
    assert [*np.frombuffer(metadata, np.int32)[6:8]] == [0, 1] and metadata[4] & 0xFFFFFFFF == 0
