"""Helpers that compare fused functions with plain JAX."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.native.fuse import fuse


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
