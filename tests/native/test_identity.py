"""Equal programs have equal notes, and a noted program needs no lowering."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import fused, sample

from evo_cpg.native import machine_constants, native
from evo_cpg.native.backend import machine
from evo_cpg.native.backend.code import Variant
from evo_cpg.native.frontend import identity
from evo_cpg.native.frontend.primitives import fused_p
from evo_cpg.native.fuse import fuse


def waves(x, factor=3.0, table=(1.0, 2.0), steps=4, turn=jnp.sin):
    def step(carry, row):
        return turn(factor * carry) + row, None

    return jax.lax.scan(step, x, jnp.concatenate([jnp.asarray(table, x.dtype)] * steps))[0]


def note(run=waves, dtype=np.float32, **changes):
    """Return the note of a program for individuals of three numbers."""
    x = sample((3, 8)).astype(dtype)
    made = jax.make_jaxpr(lambda x: fuse(lambda x: run(x, **changes), x, batch_ndim=1))(x)
    (call,) = [each for each in made.jaxpr.eqns if each.primitive is fused_p]
    return identity.note_of(call.params["program"], Variant(machine.host(), 8))


def test_a_note_depends_on_all_that_is_computed(monkeypatch):
    notes = [
        note(),
        note(factor=3.5),
        note(table=(1.0, 2.5)),
        note(steps=5),
        note(turn=jnp.cos),
        note(lambda x: waves(x)[::-1]),
        note(lambda x: (waves(x), x)),
        note(jnp.sum, dtype=np.int32),
        note(jnp.sum),
    ]
    assert None not in notes and len(set(notes)) == len(notes)
    assert note() == notes[0]
    monkeypatch.setattr(machine_constants, "LONGEST_FUNCTION", 20)
    assert note() != notes[0]


def test_a_program_with_python_functions_has_no_note():
    assert note(lambda x: jax.grad(lambda x: fuse(waves, x, batch_ndim=0).sum())(x)) is None


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return an empty folder of machine code, in which notes are kept."""
    before = machine._folder
    machine.keep_code_in(tmp_path)
    monkeypatch.setattr(native, "note_of", identity.note_of)
    yield tmp_path
    machine.keep_code_in(before)


def test_a_noted_program_is_not_lowered_again(folder, monkeypatch):
    x, lowered, lower = sample((3, 40)), [], native.to_llvm
    monkeypatch.setattr(native, "to_llvm", lambda *x: lowered.append(1) or lower(*x))
    first, again = fused(waves, x), fused(waves, x)
    np.testing.assert_array_equal(again[0], first[0])
    assert len(lowered) == 1
    # A new process has no code in memory. Without the file of the code a note is worth nothing.
    (noted,), (code,) = folder.glob("note-*"), folder.glob("native-*")
    name = noted.name.removeprefix("note-")
    monkeypatch.setattr(machine, "_loaded", {})
    monkeypatch.setattr(machine, "_linker", functools.cache(machine._linker.__wrapped__))
    known = machine.recalled(name)
    assert known is not None and code.name == f"native-{known.name}"
    machine._loaded.clear()
    code.unlink()
    assert machine.recalled(name) is None
    noted.write_bytes(b"?")
    assert machine.recalled(name) is None and machine.recalled(None) is None
