"""LLVM in a separate process: its code, and the fallback if the process dies."""

import functools
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import sample, warned

from benchmarks.machine import monitored
from evo_cpg.native import engine, machine_constants, native
from evo_cpg.native.backend import compiler_process, llvm, machine
from evo_cpg.native.backend.compiler_process import Request
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
    machine._stop()
    yield lambda text: machine.object_code(request(text))
    machine._stop()


def test_separate_process_makes_the_same_code(compiles):
    here = compiler_process.object_code(request(SEVEN))
    assert compiles(SEVEN) == here
    assert machine._process is not None and machine._process.pid != os.getpid()


def test_process_serves_several_requests(compiles):
    first = compiles(SEVEN)
    process = machine._process
    with pytest.raises(RuntimeError, match="LLVM IR parsing error"):
        compiles("this is no code")
    assert compiles(SEVEN) == first
    assert process is not None and process.returncode is not None, "an error ends the process"


def test_large_text_ends_the_process(compiles, monkeypatch):
    monkeypatch.setattr(machine, "_LARGE_TEXT", 1)
    compiles(SEVEN)
    assert machine._process is None


def test_without_processes_this_process_compiles(compiles, monkeypatch):
    def refuse(*args, **options):
        raise OSError("no more processes")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    assert compiles(SEVEN)
    assert machine._process is None


def test_program_falls_back_when_compiler_dies(monkeypatch):
    """Replace the compiler by a process that ends as after a stack overflow."""
    machine._stop()
    start = subprocess.Popen
    command = [sys.executable, "-c", "import os; os.kill(os.getpid(), 11)"]
    monkeypatch.setattr(subprocess, "Popen", lambda _, **options: start(command, **options))
    x = sample((3, 9))
    # No other test uses this number, so the code is not in memory yet.
    got, said = warned(jax.jit(lambda x: fuse(lambda x: x * 0.7310585, x, batch_ndim=1)), x)
    (only,) = said
    assert only.endswith("runs on plain JAX, not as native code: the compiler ended with SIGSEGV")
    np.testing.assert_array_equal(got, x * np.float32(0.7310585))
    monkeypatch.undo()
    machine._stop()


def test_code_cut_into_functions_gives_the_same_bits(texts, monkeypatch):
    def program(x):
        def turn(carry, i):
            y = carry + 0.1 * jnp.sin(x * i.astype(x.dtype))
            return jnp.where(y > 0.2, y - carry[::-1], y * carry), y[0] > 0

        return jax.lax.scan(turn, x, jnp.arange(4))

    x = sample((5, 37))
    whole = jax.jit(lambda x: fuse(program, x, batch_ndim=1))(x)
    monkeypatch.setattr(machine_constants, "LONGEST_FUNCTION", 20)
    cut = jax.jit(lambda x: fuse(program, x, batch_ndim=1))(x)
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(cut), strict=True):
        np.testing.assert_array_equal(one, other)
    long, short = (max(len(part.splitlines()) for part in t.split("define ")) for t in texts)
    assert texts[1].count("@stretch") > texts[0].count("@stretch") and short <= long


# The time spent.


@pytest.mark.skipif(not engine.is_native(), reason="no native code here")
def test_new_code_reports_its_size_and_time():
    with monitored(native.WRITING, native.COMPILING) as spent:
        jax.jit(functools.partial(fuse, lambda x: x * 1.2345678, batch_ndim=1, name="a product"))(
            jnp.arange(4.0)
        )
    ((writing, made),), ((compiling, named),) = spent.values()
    assert made["name"] == named["name"] == "a product" and made["operations"] == 1
    assert writing > 0 and compiling > 0


# What XLA and the compiler refuse or warn about.

X = sample((3, 40))


@pytest.mark.parametrize("version", [(1, 0), (0, 0)])
def test_xla_rejects_a_handler_of_another_interface(version, monkeypatch):
    """XLA makes no call with arguments that the handler would misread."""
    monkeypatch.setattr(llvm, "_MAJOR", version[0])
    monkeypatch.setattr(llvm, "_MINOR", version[1])
    got, said = warned(jax.jit(lambda x: fuse(lambda x: x * 0.4, x, batch_ndim=1, name="f")), X)
    assert "f runs on plain JAX" in said[0] and "API version" in said[0]
    np.testing.assert_array_equal(got, X * np.float32(0.4))


@pytest.mark.skipif(not engine.is_native(), reason="no native code here")
@pytest.mark.parametrize(("roots", "warns"), [(2, False), (4, True)])
def test_a_large_program_warns_before_it_compiles(monkeypatch, roots, warns):
    monkeypatch.setattr(machine_constants, "MANY_OPERATIONS", 3)
    events = []
    load = native.load
    monkeypatch.setattr(native, "load", lambda *given: (events.append("compile"), load(*given))[1])
    monkeypatch.setattr(engine, "warn_once", events.append)

    def function(x):
        for _ in range(roots):
            x = jnp.sqrt(x)
        return x

    jax.jit(functools.partial(fuse, function, batch_ndim=1))(jnp.arange(4.0))
    assert len(events) == 1 + warns and events[-1] == "compile"
    assert not warns or "more than 3 operations" in events[0]
