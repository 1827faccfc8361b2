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


def by_native(function, *args, batch_ndim=1):
    """Return the results that native code computes, mapped over the last axes, as arrays."""
    run = jax.jit(functools.partial(fuse, function, batch_ndim=batch_ndim))
    return jax.tree.map(np.asarray, run(*args))


def by_jax(function, *args, batch_ndim=1):
    """Return the results that plain JAX computes, mapped over the last axes, as arrays."""
    for _ in range(batch_ndim):
        function = jax.vmap(function, in_axes=-1, out_axes=-1)
    return jax.tree.map(np.asarray, jax.jit(function)(*args))


def fused(*given, **options):
    """Return the leaves of `by_native`."""
    return jax.tree.leaves(by_native(*given, **options))


def plain(*given, **options):
    """Return the leaves of `by_jax`."""
    return jax.tree.leaves(by_jax(*given, **options))


def assert_agrees(function, *args, batch_ndim=1, rtol=1e-6, atol=1e-6):
    """Assert that native code and JAX agree in numbers, types, shapes, NaN and infinities."""
    got, expected = (run(function, *args, batch_ndim=batch_ndim) for run in (by_native, by_jax))
    assert_equal(got, expected, rtol, atol)


def assert_equal(got, expected, rtol, atol):
    """Assert that trees of arrays agree. Whole numbers and truth values are equal."""

    def compare(path, one, other):
        exact = other.dtype.kind != "f"
        tolerance = {"rtol": 0, "atol": 0} if exact else {"rtol": rtol, "atol": atol}
        name = jax.tree_util.keystr(path)
        assert one.dtype == other.dtype, name
        np.testing.assert_allclose(one, other, err_msg=name, strict=True, **tolerance)

    jax.tree_util.tree_map_with_path(compare, got, expected)


def every(functions):
    """Return a function that computes all of these, because one program compiles faster."""
    return lambda *args: {name: function(*args) for name, function in functions.items()}


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
