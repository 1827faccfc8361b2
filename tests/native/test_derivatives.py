"""Derivatives of fused functions equal those of plain JAX, and are fused too."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.native.fuse import fuse

# Every kind of operation that moves numbers, and smooth and kinked functions.
OPERATIONS = {
    "slice": lambda x: x[1:, :2],
    "steps": lambda x: x[::2, ::-1],
    "pick": lambda x: x[np.array([2, 0, 2])],
    "transpose": lambda x: jnp.swapaxes(x, 0, 1),
    "stack": lambda x: jnp.stack([x[0], x[1] * x[2]], 1),
    "concatenate": lambda x: jnp.concatenate([x, 2 * x], 1),
    "repeat": lambda x: jnp.broadcast_to(x[:1], x.shape) * x,
    "reshape": lambda x: x.reshape(9, *x.shape[2:])[4:],
    "pad": lambda x: jnp.pad(x, ((1, 0), (0, 2)) + ((0, 0),) * (x.ndim - 2)),
    "split": lambda x: jnp.split(x, 3)[1],
    "set": lambda x: x.at[1].set(3 * x[0]),
    "add at": lambda x: x.at[np.array([0, 0, 2])].add(x**2),
    "sum": lambda x: x.sum(0) ** 3,
    "largest": lambda x: x.max(1),
    "product": lambda x: jnp.einsum("ij...,jk...->ik...", x, x),
    "sines": lambda x: jnp.sin(x) * jnp.cos(x * x),
    "roots": lambda x: jnp.sqrt(1 + x**2) / (2 + jnp.abs(x)),
    "choice": lambda x: jnp.where(x > 0.3, jnp.tanh(x), x**3),
    "bounds": lambda x: jnp.clip(x, -0.5, 0.5) + jnp.maximum(x, 0) * jnp.exp(x),
    "running sum": lambda x: jnp.cumsum(x, 0) ** 2,
    "parts": lambda x: fuse(lambda x: (jnp.sin(x).sum(0), x * x), x[:2] * x[1:], batch_ndim=0)[1],
}


def sample(shape, seed=0, dtype=np.float64):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), dtype)


def weighed(run, x):
    """Return a weighted sum of all results."""
    result = run(x)
    return (result * jnp.cos(jnp.arange(result.size)).reshape(result.shape)).sum()


@pytest.mark.parametrize("name", OPERATIONS)
def test_forward_and_reverse_derivatives_equal_those_of_jax(name, x64):
    function, x, along = OPERATIONS[name], sample((3, 3, 5)), sample((3, 3, 5), 1)

    @functools.partial(jax.jit, static_argnums=0)
    def both(run, x):
        gradient = jax.grad(functools.partial(weighed, run))(x)
        return gradient, jax.jvp(run, (x,), (along,))[1]

    found = both(functools.partial(fuse, function, batch_ndim=1), x)
    expected = both(function, x)
    assert np.abs(expected[0]).max() > 0.1
    for got, each in zip(found, expected, strict=True):
        np.testing.assert_allclose(got, each, rtol=1e-11, atol=1e-13)


def spiral(x, turn):
    """Return a number and a truth value."""
    return jnp.stack([x[0] * jnp.cos(turn) - x[1], x[1] + 0.1 * x[0] ** 2]), x[0] > 0


def path(run, turn, x):
    def advance(x, _):
        x, right = run(x, turn)
        return x, jnp.where(right, x[1], 0.0)

    return jax.lax.scan(jax.checkpoint(advance), x, None, length=5)[1].sum()


def test_hessians_of_a_mapped_scan_equal_those_of_jax(x64):
    """Compare Hessians, mapped over starts, of a sum over a path with a closed-over parameter."""
    turn = jnp.asarray([0.3, 0.7])
    starts = sample((4, 2, 2), 3)

    def fused(x, turn):
        return fuse(spiral, x, turn, batch_ndim=1)

    for differentiate in (jax.hessian, lambda f: jax.jacrev(jax.jacrev(f))):
        got, expected = (
            jax.jit(jax.vmap(differentiate(functools.partial(path, run)), (None, 0)))
            for run in (fused, spiral)
        )
        np.testing.assert_allclose(
            got(turn, starts), expected(turn, starts), rtol=1e-11, atol=1e-13
        )


def test_shared_values_get_the_sum_of_all_gradients(x64):
    x = sample((3, 6))

    def energy(run, weights):
        return (run(lambda x: jnp.sin(weights.reshape(3, *(1,) * (x.ndim - 1)) * x)) ** 2).sum()

    weights = jnp.arange(1.0, 4.0)
    expected = jax.grad(lambda w: energy(lambda f: f(x), w))(weights)
    got = jax.jit(jax.grad(lambda w: energy(lambda f: fuse(f, x, batch_ndim=1), w)))(weights)
    np.testing.assert_allclose(got, expected, rtol=1e-12)
    forward = jax.jit(jax.jacfwd(lambda w: energy(lambda f: fuse(f, x, batch_ndim=1), w)))(weights)
    np.testing.assert_allclose(forward, expected, rtol=1e-12)


def test_a_gradient_is_one_piece_of_code():
    """The backward pass computes the forward pass again, and XLA computes sums alone."""

    def chain(x):
        for i in range(40):
            x = jnp.stack([x[1] * x[2] + 0.1 * i, jnp.abs(x[0]) - x[2], x[0] * x[1]])
        return x

    run = jax.jit(jax.grad(lambda x: fuse(chain, x, batch_ndim=1).sum()))
    text = run.lower(sample((3, 32), 1, "f4")).as_text()
    assert text.count("@evo_cpg_") <= 2
    assert text.count("stablehlo.multiply") == 0


def test_empty_results_keep_their_type(x64):
    """A float32 program and its derivatives stay in float32 if float64 is enabled."""

    def parts(x):
        return x[:0], x * x

    x = sample((3, 4), 1, "f4")
    empty, _ = jax.jit(lambda x: fuse(parts, x, batch_ndim=1))(x)
    assert empty.dtype == np.float32 and empty.shape == (0, 4)
    gradient = jax.jit(jax.grad(lambda x: sum(y.sum() for y in fuse(parts, x, batch_ndim=1))))(x)
    np.testing.assert_allclose(gradient, 2 * x, rtol=1e-6)
