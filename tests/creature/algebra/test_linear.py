"""Small matrices with components first, against NumPy with components last."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.creature.algebra import linear

pytestmark = pytest.mark.usefixtures("x64")

BATCH = (4, 5)


def draw(*shape: int) -> jax.Array:
    return jnp.asarray(np.random.default_rng(shape).normal(size=(*shape, *BATCH)))


def last(x) -> np.ndarray:
    """A matrix field with its two leading axes moved to the end."""
    return np.moveaxis(np.asarray(x), (0, 1), (-2, -1))


def test_products_equal_numpy():
    """Compare every product with `@`, to rounding (1e-13)."""
    a, b, c, d, v, w = draw(2, 3), draw(3, 4), draw(4, 3), draw(2, 4), draw(3), draw(2)
    pairs = {
        "matmul": (linear.matmul(a, b), last(a) @ last(b)),
        "matmul_t": (linear.matmul_t(a, c), last(a) @ np.swapaxes(last(c), -1, -2)),
        "t_matmul": (linear.t_matmul(a, d), np.swapaxes(last(a), -1, -2) @ last(d)),
    }
    for name, (ours, expected) in pairs.items():
        np.testing.assert_allclose(last(ours), expected, atol=1e-13, err_msg=name)
    expected = np.einsum("ij...,j...->i...", a, v), np.einsum("ij...,i...->j...", a, w)
    np.testing.assert_allclose(linear.matvec(a, v), expected[0], atol=1e-13)
    np.testing.assert_allclose(linear.matvec_t(a, w), expected[1], atol=1e-13)
    np.testing.assert_allclose(linear.dot(v, v), (v * v).sum(0), rtol=1e-13)


def test_cross_and_skew_equal_numpy():
    """Compare with `numpy.cross` along the first axis, and with the product as a matrix."""
    rng = np.random.default_rng(0)
    a, b = jnp.asarray(rng.normal(size=(2, 3, *BATCH)))
    expected = np.cross(a, b, axis=0)
    np.testing.assert_allclose(linear.cross(a, b), expected, atol=1e-14)
    np.testing.assert_allclose(linear.matvec(linear.skew(a), b), expected, atol=1e-14)


@pytest.mark.parametrize("size", [1, 2, 3])
def test_closed_form_inverses_equal_numpy(size):
    """Invert a thousand symmetric positive definite matrices of condition up to 1e3, in float64.

    The tolerance is 1e-9 of the largest element. A determinant by cofactors loses up to the square
    of the condition number times 1e-16. (A joint of a body ten times as long as thick has 1e2.)
    """
    rng = np.random.default_rng(size)
    basis = np.linalg.qr(rng.normal(size=(1000, size, size)))[0]
    values = 10.0 ** rng.uniform(-1.5, 1.5, (1000, 1, size))
    matrices = (basis * values) @ np.swapaxes(basis, 1, 2)
    ours = last(linear.inverse_symmetric(jnp.asarray(np.moveaxis(matrices, 0, -1))))
    expected = np.linalg.inv(matrices)
    error = np.abs(ours - expected).max((1, 2)) / np.abs(expected).max((1, 2))
    assert error.max() < 1e-9


def test_inverse_of_other_sizes_raises():
    with pytest.raises(ValueError, match="needs a matrix of size 1 to 3, got 4"):
        linear.inverse_symmetric(jnp.eye(4))


def test_lift_lines_up_the_first_axes():
    """Match (3,) with the first axis of (3, 2, 5), in the precision of the latter."""
    x = np.ones((3, 2, 5), np.float32)
    lifted = linear.expand_dims_like(np.array([1.0, 2.0, 3.0]), jnp.asarray(x))
    assert lifted.shape == (3, 1, 1)
    assert lifted.dtype == np.float32
    np.testing.assert_array_equal((lifted * x)[:, 1, 4], [1, 2, 3])
