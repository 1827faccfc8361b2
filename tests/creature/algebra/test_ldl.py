"""Symmetric equations: solutions, derivatives and the cost in fused code."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.native import engine, machine_constants
from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.frontend.lower import trace
from evo_cpg.native.fuse import fuse, solve_symmetric
from evo_cpg.native.ldl import factorize, solve_factorized


def definite(count, seed=0):
    """Return symmetric positive definite matrices ``(5, 5, count)``."""
    root = np.random.default_rng(seed).normal(size=(5, 5, count))
    return np.einsum("ikn,jkn->ijn", root, root) + 0.1 * np.eye(5)[..., None]


def test_solutions_equal_numpys(x64):
    H, b = definite(7), np.random.default_rng(1).normal(size=(5, 7))
    expected = np.linalg.solve(np.moveaxis(H, -1, 0), b.T[..., None])[..., 0].T
    for find in (solve_symmetric, lambda H, b: solve_factorized(factorize(H), b)):
        np.testing.assert_allclose(quick_jit(find)(H, b), expected, rtol=1e-10, atol=1e-12)


def test_factors_equal_featherstones(x64):
    """Compare with ``L^T D L``, L with a unit diagonal, computed from the lower triangle alone."""
    H = definite(1)[..., 0]
    rows, inverse_pivots = factorize(jnp.asarray(np.tril(H)))
    L = np.eye(5)
    for k, row in enumerate(rows):
        L[k, :k] = row
    np.testing.assert_allclose(L.T @ np.diag(1 / inverse_pivots) @ L, H, rtol=1e-12, atol=1e-12)


def test_derivatives_equal_those_of_the_inverse(x64):
    """Check ``d(H^-1 b) = H^-1 (db - dH H^-1 b)`` in forward and reverse mode."""
    H, b = definite(1)[..., 0], np.arange(5.0)
    change, other = definite(1, 2)[..., 0], np.ones(5)
    x = np.linalg.solve(H, b)
    expected = np.linalg.solve(H, other - change @ x)
    moved = jax.jvp(solve_symmetric, (H, b), (change, other))[1]
    np.testing.assert_allclose(moved, expected, rtol=1e-9)
    weights = np.arange(1.0, 6.0)
    by_H, by_b = jax.grad(lambda H, b: weights @ solve_symmetric(H, b), (0, 1))(H, b)
    assert (by_H * change).sum() + by_b @ other == pytest.approx(weights @ expected, rel=1e-9)


def test_zeros_between_limbs_cost_no_operations():
    """Solve for a root with two uncoupled limbs: no fill-in, and no operation on it."""

    def limbs(x):
        H = jnp.zeros((5, 5)).at[np.diag_indices(5)].set(10.0 + x[:5])
        # Unknowns 1 to 4 are coupled to 0, and also 2 to 1 and 4 to 3.
        places = np.array([(1, 0), (2, 0), (2, 1), (3, 0), (4, 0), (4, 3)])
        return factorize(H.at[tuple(places.T)].set(x[5:]))

    builder = Builder()
    closed = jax.make_jaxpr(limbs)(np.zeros(11, np.float32))
    rows = trace(builder, closed, [builder.argument((11,), np.float32)])[:5]
    between = [rows[3][1], rows[3][2], rows[4][1], rows[4][2]]
    assert [node.value for node in between] == [0, 0, 0, 0]
    assert all(node.value is None for node in (*rows[2], rows[3][0], rows[4][0], rows[4][3]))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("count", [1, 7, 37])
def test_native_loop_solves_as_numpy_does(monkeypatch, dtype, count):
    """Zeros of only some matrices in a vector may not be skipped."""
    monkeypatch.setattr(machine_constants, "LONGEST_ELIMINATION", 0)
    with jax.enable_x64(dtype is np.float64):
        H, b = definite(count), np.random.default_rng(1).normal(size=(5, count))
        for k in range(0, count, 3):
            H[1:3, 3:, k] = H[3:, 1:3, k] = 0
        H[0, 4] = H[4, 0] = 0
        expected = np.linalg.solve(np.moveaxis(H, -1, 0), b.T[..., None])[..., 0].T

        def run(H, b):
            return fuse(solve_symmetric, H, b, batch_ndim=1)

        program = jax.jit(run).lower(jnp.asarray(H, dtype), jnp.asarray(b, dtype))
        assert ("evo_cpg_" in program.as_text()) == engine.is_native()
        got = program.compile()(jnp.asarray(H, dtype), jnp.asarray(b, dtype))
        scale = np.abs(expected).max()
        assert np.abs(got - expected).max() < (1e-12 if dtype is np.float64 else 1e-4) * scale
