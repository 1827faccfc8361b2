"""Time spent on native code is measured."""

import functools
import threading
import time

import jax
import jax.numpy as jnp
import pytest

from evo_cpg.native import engine, machine_constants, native
from evo_cpg.native.fuse import fuse
from evo_cpg.native.stopwatch import counted, measuring


def test_time_counts_within_the_block_alone():
    with counted():
        time.sleep(0.02)
    with measuring() as spent, counted():
        time.sleep(0.02)
        with counted(compiler=True):
            time.sleep(0.02)
    assert 0.04 <= spent.seconds < 10
    assert 0.02 <= spent.compiler <= spent.seconds - 0.02
    before = spent.seconds
    with counted():
        time.sleep(0.01)
    assert spent.seconds == before


def test_other_threads_do_not_count():
    def work():
        with counted():
            time.sleep(0.02)

    with measuring() as spent:
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    assert spent.seconds == 0


@pytest.mark.skipif(not engine.is_native(), reason="no native code here")
def test_the_compiler_counts_only_for_new_code():
    """A second function with equal code needs no LLVM."""

    def made():
        # No other test uses this number, so its code does not exist yet.
        function = functools.partial(fuse, lambda x: x * 1.2345678 + 8.7654321, batch_ndim=1)
        return jax.jit(functools.partial(function, name="a sum"))

    spents = []
    for _ in range(2):
        with measuring() as spent:
            made()(jnp.arange(4.0))
        spents.append(spent)
    first, second = spents
    assert 0 < first.compiler < first.seconds
    assert second.compiler == 0 < second.seconds
    (made,) = first.programs
    assert made.name == "a sum" and made.operations == 1
    assert 0 < made.writing < first.seconds and first.compiler <= made.compiling


@pytest.mark.skipif(not engine.is_native(), reason="no native code here")
@pytest.mark.parametrize(("roots", "warned"), [(2, False), (4, True)])
def test_a_large_program_warns_before_it_compiles(monkeypatch, roots, warned):
    monkeypatch.setattr(machine_constants, "MANY_OPERATIONS", 3)
    events = []
    load = native.load
    monkeypatch.setattr(native, "load", lambda *given: (events.append("compile"), load(*given))[1])
    monkeypatch.setattr(engine, "_warn_once", events.append)

    def function(x):
        for _ in range(roots):
            x = jnp.sqrt(x)
        return x

    jax.jit(functools.partial(fuse, function, batch_ndim=1))(jnp.arange(4.0))
    assert len(events) == 1 + warned and events[-1] == "compile"
    assert not warned or "more than 3 operations" in events[0]
