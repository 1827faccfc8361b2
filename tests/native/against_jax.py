"""Helpers that compare fused functions with plain JAX."""

import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.native.engine import Engine, EngineWarning, using
from evo_cpg.native.fuse import fuse
from evo_cpg.native.ir import Unsupported


def sample(shape, seed=0, dtype=np.float32):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), dtype)


def fused(function, *args, batch_ndim=1):
    """Return the leaves of the results that native code computes, mapped over the last axes."""
    run = jax.jit(functools.partial(fuse, function, batch_ndim=batch_ndim))
    return [np.asarray(leaf) for leaf in jax.tree.leaves(run(*args))]


def plain(function, *args, batch_ndim=1):
    """Return the leaves of the results that plain JAX computes, mapped over the last axes."""
    for _ in range(batch_ndim):
        function = jax.vmap(function, in_axes=-1, out_axes=-1)
    return [np.asarray(leaf) for leaf in jax.tree.leaves(jax.jit(function)(*args))]


def assert_agrees(function, *args, batch_ndim=1, rtol=1e-6, atol=1e-6):
    """Assert that native code and JAX agree in numbers, types, shapes, NaN and infinities."""
    got, expected = (run(function, *args, batch_ndim=batch_ndim) for run in (fused, plain))
    assert [x.dtype for x in got] == [x.dtype for x in expected]
    for one, other in zip(got, expected, strict=True):
        exact = one.dtype.kind != "f"
        tolerance = {"rtol": 0, "atol": 0} if exact else {"rtol": rtol, "atol": atol}
        np.testing.assert_allclose(one, other, strict=True, **tolerance)


def with_instructions(instructions, run):
    """Return the result of a function by an instruction set, or skip the test without the set."""
    try:
        with using(Engine("native", instructions)):
            return run()
    except Unsupported as error:
        pytest.skip(str(error))


def warned(run, *args):
    """Return the result and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = jax.block_until_ready(run(*args))
    assert all(each.category is EngineWarning for each in caught)
    return result, [str(each.message) for each in caught]
