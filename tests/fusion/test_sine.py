"""Sine and cosine in kernels against NumPy in float64, and that they stay in the kernel."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.fusion.kernels import fuse


def both(x):
    return jnp.sin(x), jnp.cos(x)


def fused(x):
    # Compiled as for users: the last digits rest on fused multiply-adds.
    function = functools.partial(fuse, both, batch_ndim=1)
    return jax.jit(function, compiler_options={"xla_backend_optimization_level": 3})(x)


@pytest.mark.parametrize("largest", [1e-3, np.pi / 2, 3.3, 100.0, 1e4])
def test_they_are_right_to_float32(largest):
    x = np.random.default_rng(0).uniform(-largest, largest, (8, 20_000)).astype(np.float32)
    for got, exact in zip(fused(x), both_exact(x), strict=True):
        assert np.abs(got - exact).max() < 1.5e-7


def both_exact(x):
    return np.sin(x.astype(float)), np.cos(x.astype(float))


def test_small_angles_keep_all_their_digits():
    x = np.logspace(-30, -2, 200, dtype=np.float32)[None]
    sine, cosine = fused(x)
    np.testing.assert_allclose(sine, np.sin(x.astype(float)), rtol=1.3e-7)
    np.testing.assert_allclose(cosine, np.cos(x.astype(float)), rtol=1.3e-7)


def test_what_is_not_finite_gives_nan():
    sine, cosine = fused(np.array([[np.inf, -np.inf, np.nan]], np.float32))
    assert np.isnan(sine).all()
    assert np.isnan(cosine).all()


def test_constants():
    """Of a constant, too, where the exact places of the maximum and the zero are rounded."""

    def function(x):
        return x * jnp.sin(np.float32(1.25)) + jnp.cos(np.float32(-2.5))

    x = np.ones((1, 4), np.float32)
    got = jax.jit(functools.partial(fuse, function, batch_ndim=1))(x)
    np.testing.assert_allclose(got, np.sin(1.25) + np.cos(-2.5), atol=3e-7)


def test_float64_is_left_to_the_library(x64):
    x = np.linspace(-10, 10, 64)[None]
    for got, exact in zip(fused(x), both_exact(x), strict=True):
        np.testing.assert_allclose(got, exact, rtol=0, atol=4e-16)


def test_they_need_no_kernel_of_their_own():
    x = np.ones((12, 16), np.float32)
    program = jax.jit(functools.partial(fuse, both, batch_ndim=1)).lower(x).as_text()
    assert "stablehlo.sine" not in program
    assert "stablehlo.cosine" not in program
