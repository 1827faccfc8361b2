"""LLVM in a separate process: its code, and the fallback if the process dies."""

import os
import subprocess
import sys
import threading
import warnings

import jax
import numpy as np
import pytest
from against_jax import sample

from evo_cpg.native import engine, machine_constants, native
from evo_cpg.native.backend import compiler, compiler_process, machine
from evo_cpg.native.backend.compiler_process import Request
from evo_cpg.native.engine import EngineWarning
from evo_cpg.native.fuse import fuse

SEVEN = "define i32 @handler() { ret i32 7 }"


@pytest.fixture(autouse=True)
def tested():
    """Run the self-test of native code before any test replaces processes."""
    engine.target()


def request(text):
    target = machine.host()
    return Request(text, target.processor, target.features, 2)


@pytest.fixture
def compiles(monkeypatch):
    """Compile a module as the library does, in a new process that ends afterwards."""
    compiler._stop()
    yield lambda text: compiler.object_code(request(text))
    compiler._stop()


def test_separate_process_makes_the_same_code(compiles):
    here = compiler_process.object_code(request(SEVEN))
    assert compiles(SEVEN) == here
    assert compiler._process is not None and compiler._process.pid != os.getpid()


def test_process_serves_several_requests(compiles):
    first = compiles(SEVEN)
    process = compiler._process
    with pytest.raises(RuntimeError, match="LLVM IR parsing error"):
        compiles("this is no code")
    assert compiles(SEVEN) == first
    assert process is not None and process.returncode is not None, "an error ends the process"


def test_large_text_ends_the_process(compiles, monkeypatch):
    monkeypatch.setattr(compiler, "_LARGE_TEXT", 1)
    compiles(SEVEN)
    assert compiler._process is None


def test_without_processes_this_process_compiles(compiles, monkeypatch):
    def refuse(*args, **options):
        raise OSError("no more processes")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    assert compiles(SEVEN)
    assert compiler._process is None


def test_program_falls_back_when_compiler_dies(monkeypatch):
    """Replace the compiler by a process that ends as after a stack overflow."""
    compiler._stop()
    start = subprocess.Popen
    command = [sys.executable, "-c", "import os; os.kill(os.getpid(), 11)"]
    monkeypatch.setattr(subprocess, "Popen", lambda _, **options: start(command, **options))
    x = sample((3, 9))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        # No other test uses this number, so the code is not in memory yet.
        got = jax.jit(lambda x: fuse(lambda x: x * 0.7310585, x, batch_ndim=1, name="times"))(x)
    (only,) = [each for each in caught if each.category is EngineWarning]
    assert str(only.message) == (
        "times runs on plain JAX, not as native code: the compiler ended with SIGSEGV"
    )
    np.testing.assert_array_equal(got, x * np.float32(0.7310585))
    monkeypatch.undo()
    compiler._stop()


def test_stack_size_of_other_threads_does_not_change():
    before = threading.stack_size()
    compiler_process._on_large_stack(lambda: b"")
    assert threading.stack_size() == before


def test_errors_of_the_compiler_thread_are_raised():
    with pytest.raises(ZeroDivisionError):
        compiler_process._on_large_stack(lambda: bytes(1 // 0))


def test_code_cut_into_functions_gives_the_same_bits(monkeypatch):
    def program(x):
        def turn(carry, i):
            y = carry + 0.1 * jax.numpy.sin(x * i.astype(x.dtype))
            return jax.numpy.where(y > 0.2, y - carry[::-1], y * carry), y[0] > 0

        return jax.lax.scan(turn, x, jax.numpy.arange(4))

    texts, load = [], native.load

    def note(text, target):
        texts.append(text)
        return load(text, target)

    monkeypatch.setattr(native, "load", note)
    x = sample((5, 37))
    whole = jax.jit(lambda x: fuse(program, x, batch_ndim=1))(x)
    monkeypatch.setattr(machine_constants, "LONGEST_FUNCTION", 20)
    cut = jax.jit(lambda x: fuse(program, x, batch_ndim=1))(x)
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(cut), strict=True):
        np.testing.assert_array_equal(one, other)
    long, short = (max(len(part.splitlines()) for part in t.split("define ")) for t in texts)
    assert texts[1].count("@stretch") > texts[0].count("@stretch") and short <= long
