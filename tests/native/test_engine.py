"""Plain JAX computes the smallest part that has no native code, and a warning names it."""

import ctypes
import functools
import subprocess
import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import sample, warned

from evo_cpg.native import engine, machine_constants, native
from evo_cpg.native.backend import machine
from evo_cpg.native.engine import Engine, described, using
from evo_cpg.native.fuse import fuse
from evo_cpg.native.ir import Unsupported


@pytest.fixture(autouse=True)
def cleared_caches():
    """Clear the caches of one process before and after a test."""
    folder = machine._folder
    caches = engine.warn_once, engine._wrong, machine.host, machine._llvm
    for cached in caches:
        cached.cache_clear()
    yield
    machine.keep_code_in(folder)
    for cached in caches:
        cached.cache_clear()


def calls(run, *args):
    """Return the number of pieces of native code that the lowered program calls."""
    return jax.jit(run).lower(*args).as_text().count("custom_call @evo_cpg_")


def smooth(x):
    return jnp.sin(x) * x[0][None]


def ordered(x):
    return jnp.sort(x, 0)


def part(function, x, **options):
    return fuse(function, x, batch_ndim=x.ndim - 1, **options)


def whole(x):
    """Call a part that cannot be native code between two parts that can."""
    x = part(smooth, x * x[1][None])
    return part(smooth, part(ordered, x, name="the order") + 1.0)


def assert_right(got, function, x):
    with using(Engine("jax")):
        np.testing.assert_allclose(got, function(x), rtol=1e-5, atol=1e-6)


def half(x):
    """Call two parts that can be native code in a program that cannot."""
    return jnp.sort(part(smooth, x), 0) + part(smooth, 2 * x)


@pytest.mark.parametrize(
    ("function", "name", "named", "count"),
    [(whole, "all", "the order", 2), (half, "sorting", "sorting", 2), (ordered, "", "ordered", 0)],
)
def test_jax_computes_the_smallest_part(function, name, named, count):
    x = sample((3, 9))
    run = functools.partial(fuse, function, batch_ndim=1, name=name)
    got, said = warned(jax.jit(run), x)
    assert said == [f"{named} runs on plain JAX, not as native code: no rule for sort"]
    assert_right(got, function, x)
    again, said = warned(jax.jit(lambda x: run(x)), x)
    assert said == []
    assert_right(again, function, x)
    assert calls(run, x) == count


def test_derivatives_are_named_after_their_functions():
    """Native code has a rule for the function, but not for its derivative's scatter."""

    def pick(x):
        places = (x[:2] > 0).astype(int)
        return jnp.outer(x, x)[places, places[::-1]] ** 2

    x = sample((3, 9))
    run = jax.vmap(functools.partial(fuse, pick, batch_ndim=0), -1, -1)
    got, said = warned(jax.jit(jax.grad(lambda x: run(x).sum())), x)
    (only,) = said
    assert only.startswith("the derivative of ") and "pick runs on plain JAX" in only
    np.testing.assert_allclose(got, jax.grad(lambda x: jax.vmap(pick, -1)(x).sum())(x), rtol=1e-6)


def test_engine_jax_uses_no_native_code():
    x = sample((3, 9))
    run = functools.partial(fuse, smooth, batch_ndim=1)
    assert calls(run, x) == 1
    with using(Engine("jax")):
        assert calls(lambda x: run(x), x) == 0
        assert described(Engine("jax")) == {"engine": "jax"}
    own = described(Engine())
    assert own["engine"] == "native" and own["vector_bytes"] in (16, 32, 64)
    assert described(Engine("native", own["instructions"])) == own


def assert_falls_back(reason):
    """Assert that two programs cause one warning, and that engine "native" raises."""
    x = sample((3, 9))

    def both(x):
        return fuse(smooth, x, batch_ndim=1) + fuse(lambda x: x * x, x, batch_ndim=1)

    got, said = warned(jax.jit(both), x)
    (only,) = said
    assert only.startswith("Plain JAX computes everything, slowly. No native code: ")
    assert reason in only
    assert_right(got, both, x)
    with using(Engine("native")), pytest.raises(Unsupported, match=reason):
        fuse(smooth, x, batch_ndim=1)


def test_a_missing_llvmlite_falls_back(monkeypatch):
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    monkeypatch.setitem(sys.modules, "llvmlite.binding", None)
    assert_falls_back("llvmlite cannot be imported")


def test_an_instruction_set_that_the_processor_lacks_raises():
    lacking = "neon" if machine.host().name != "neon" else "avx2"
    with using(Engine("native", lacking)), pytest.raises(Unsupported, match=f"has no {lacking}"):
        fuse(smooth, sample((3, 9)), batch_ndim=1)


def trying(monkeypatch, tmp_path, code):
    """Run another program instead of the self-test, and return the list of its runs."""
    machine.keep_code_in(tmp_path)
    run, runs = subprocess.run, []

    def other(command, **options):
        runs.append(command)
        return run([sys.executable, "-c", code], **options)

    monkeypatch.setattr(engine, "subprocess", types.SimpleNamespace(**vars(subprocess)))
    monkeypatch.setattr(engine.subprocess, "run", other)
    return runs


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import os; os.abort()", "the self-test failed"),
        ("raise ArithmeticError('they differ')", "exit status 1: ArithmeticError: they differ"),
        ("import time; time.sleep(60)", "the self-test could not run"),
    ],
)
def test_a_failing_self_test_falls_back(code, reason, monkeypatch, tmp_path):
    runs = trying(monkeypatch, tmp_path, code)
    if "sleep" in code:
        monkeypatch.setattr(machine_constants, "LONGEST_SELF_TEST", 0.2)
    assert_falls_back(reason)
    # Each instruction set is tried once.
    assert len({run[-1] for run in runs}) == len(runs) > 0
    assert not list(tmp_path.glob("native-tried-*"))


def test_the_self_test_runs_once_for_each_version(monkeypatch, tmp_path):
    runs = trying(monkeypatch, tmp_path, "")
    own = engine.target()
    assert len(runs) == 1 and runs[0][1:] == ["-m", "evo_cpg.native.self_test", own.name]
    others = (own, "another"), (own._replace(name="other"), jax.__version__)
    records = [machine.self_test_record(*each) for each in ((own, jax.__version__), *others)]
    assert [record.exists() for record in records] == [True, False, False]
    engine._wrong.cache_clear()
    assert engine.target() == own and len(runs) == 1
    # Every process tests if there is no folder for code.
    machine.keep_code_in(None)
    engine._wrong.cache_clear()
    assert engine.target() == own and len(runs) == 2


@pytest.mark.parametrize("fault", ["ValueError: no idea", "RuntimeError: LLVM IR parsing error"])
def test_an_error_in_the_compilation_falls_back(fault, monkeypatch):
    make = native.to_llvm

    def fails(*args):
        if "ValueError" in fault:
            raise ValueError("no idea\nat all")
        code = make(*args)
        return code._replace(text=code.text.replace("fmul", "fnothing"))

    monkeypatch.setattr(native, "to_llvm", fails)
    x = sample((3, 9))
    got, said = warned(jax.jit(lambda x: fuse(smooth, x, batch_ndim=1)), x)
    assert len(said) == 1
    assert said[0].startswith(f"smooth runs on plain JAX, not as native code: {fault}")
    assert_right(got, smooth, x)


@pytest.fixture
def seven(tmp_path, monkeypatch):
    """Return a loader of a function: its result, and the number of compilations so far."""
    machine.keep_code_in(tmp_path)
    compiled, make = [], machine.object_code

    def compile_and_count(request):
        compiled.append(request)
        return make(request)

    monkeypatch.setattr(machine, "object_code", compile_and_count)

    def load():
        monkeypatch.setattr(machine, "_loaded", {})
        monkeypatch.setattr(machine, "_linker", functools.cache(machine._linker.__wrapped__))
        _, address = machine.load("define i32 @handler() { ret i32 7 }", machine.host())
        return ctypes.CFUNCTYPE(ctypes.c_int)(address)(), len(compiled)

    return load


@pytest.mark.parametrize("damage", ["cut", "empty", "changed"])
def test_damaged_code_on_disk_is_compiled_again(seven, tmp_path, damage):
    assert seven() == (7, 1)
    (file,) = tmp_path.glob("native-*")
    whole = file.read_bytes()
    damaged = {"cut": whole[:-1], "empty": b"", "changed": whole[:9] + b"?" + whole[10:]}
    file.write_bytes(damaged[damage])
    assert seven() == (7, 2)
    assert file.read_bytes() == whole
    assert seven() == (7, 2)


def test_without_a_folder_code_is_compiled_again(seven, tmp_path):
    machine.keep_code_in(tmp_path / "nowhere")
    assert seven() == (7, 1)
    assert seven() == (7, 2)
