"""The entry into native code, called as by XLA."""

import ctypes
import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import sample

from evo_cpg.native.backend import handler, machine
from evo_cpg.native.engine import EngineWarning
from evo_cpg.native.fuse import fuse

X, SHARED = sample((3, 40)), jnp.ones(5)
EXECUTE = 3


class Frame:
    """Call frame of a program with a shared argument, an individual argument and two results."""

    def __init__(self, stage=EXECUTE):
        def function(x, shared):
            total, path = jax.lax.scan(lambda c, r: (c + r * x, c), x, shared)
            return total, path[1].sum() > 0

        run = jax.jit(lambda shared, x: fuse(lambda x: function(x, shared), x, batch_ndim=1))
        text = run.lower(SHARED, X).as_text()
        (name,) = set(re.findall(r"@evo_cpg_(\w+)", text))
        room = max(int(size) for size in re.findall(r"tensor<(\d+)xui8>", text))
        given = [np.asarray(SHARED), np.asarray(X)]
        self.total, self.flags = np.zeros(X.shape, np.float32), np.zeros((1, 40), bool)
        found = [self.total, self.flags, np.zeros(room, np.uint8)]
        self.kept = [given, found]
        arguments, results = ([self.buffer(x) for x in each] for each in (given, found))
        self.fields = [120, 0, 0, 0, stage, 40, 0, 2, 0, self.at(arguments)]
        self.fields += [40, 0, 3, 0, self.at(results)]
        self.address, _, _ = machine._loaded[name]

    def buffer(self, x):
        return self.at([48, 0, 0, x.ctypes.data, x.ndim, self.at(x.shape)])

    def at(self, numbers):
        """Return the address of numbers of 64 bits in memory."""
        self.kept.append((ctypes.c_int64 * len(numbers))(*numbers))
        return ctypes.addressof(self.kept[-1])

    def run(self):
        call = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(self.address)
        return call(self.at(self.fields))


def test_handler_reads_and_writes_the_arrays_of_a_frame():
    frame = Frame()
    assert frame.run() is None
    np.testing.assert_allclose(frame.total, 6 * X, rtol=1e-6)
    np.testing.assert_array_equal(frame.flags[0], 2 * X.sum(0) > 0)


@pytest.mark.parametrize("stage", [0, 1, 2])
def test_only_the_last_stage_computes(stage):
    frame = Frame(stage)
    assert frame.run() is None and not frame.total.any()


def test_handler_returns_its_version():
    frame = Frame()
    metadata = (ctypes.c_int64 * 5)(40, 24, 0, -1, -1)
    frame.fields[1] = frame.at([32, 1, 0, ctypes.addressof(metadata)])
    assert frame.run() is None and not frame.total.any()
    assert [*np.frombuffer(metadata, np.int32)[6:9]] == [0, 1, 0]


@pytest.mark.parametrize("version", [(1, 0), (0, 0)])
def test_xla_rejects_a_handler_of_another_interface(version, monkeypatch):
    """XLA makes no call with arguments that the handler would misread."""
    monkeypatch.setattr(handler, "_MAJOR", version[0])
    monkeypatch.setattr(handler, "_MINOR", version[1])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", EngineWarning)
        got = jax.jit(lambda x: fuse(lambda x: x * 0.4, x, batch_ndim=1, name="f"))(X)
    assert "f runs on plain JAX" in str(caught[0].message)
    assert "API version" in str(caught[0].message)
    np.testing.assert_array_equal(got, X * np.float32(0.4))
