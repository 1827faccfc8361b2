"""Models built of known numbers and, with the recorded decisions, of traced numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.creature.algebra.decisions import (
    chosen,
    recording_decisions,
    replaying_decisions,
    searched,
)
from evo_cpg.creature.algebra.numerics import is_traced, xp


def build(x, y):
    """Return the area of the larger of two squares, and a root of z^2 = x."""
    largest = chosen(lambda: int(np.argmax([x, y])))
    area = xp.array([x, y])[largest] ** 2
    root = searched(lambda: float(np.sqrt(x)), lambda root: abs(root * root - x) < 1)
    return area, root - (root * root - x) / (2 * root)


def test_replay_keeps_the_recorded_decisions():
    with recording_decisions() as choices:
        known = build(2.0, 3.0)
    assert known == (9.0, pytest.approx(np.sqrt(2.0)))
    assert not is_traced(known)

    def area(y):
        with replaying_decisions(choices):
            return build(2.0, y)[0]

    def root(x):
        with replaying_decisions(choices):
            return build(x, 3.0)[1]

    assert float(jax.grad(area)(3.0)) == 6.0
    # The recorded square is used even if the other square is larger.
    assert float(area(jnp.asarray(1.0))) == 1.0
    np.testing.assert_allclose(jax.grad(root)(2.0), 0.5 / np.sqrt(2.0), rtol=1e-6)


def test_records_are_equal_if_their_decisions_are():
    def recorded(x, y):
        with recording_decisions() as choices:
            build(x, y)
        return choices

    assert recorded(2.0, 3.0) == recorded(1.0, 4.0)
    assert recorded(2.0, 3.0) != recorded(4.0, 3.0)
    with recording_decisions() as fewer:
        pass
    assert recorded(2.0, 3.0) != fewer


def test_decisions_within_decisions_are_not_recorded():
    with recording_decisions() as choices:
        assert chosen(lambda: chosen(lambda: 3) + 1) == 4
    with replaying_decisions(choices):
        assert chosen(lambda: 0) == 4


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_an_array_of_known_and_traced_numbers(dtype):
    with jax.enable_x64(dtype is np.float64):
        made = jax.jit(lambda x: xp.array([[1.0, x], [x * 2, 4.0]]))(dtype(3.0))
    assert made.dtype == dtype
    assert made.tolist() == [[1.0, 3.0], [6.0, 4.0]]
    assert isinstance(xp.array([[1, 2]], float), np.ndarray)


def test_scalars_do_not_change_the_precision_of_arrays():
    assert type(xp.sin(1.0)) is float
    assert (xp.sin(1.0) * jnp.ones(2, jnp.float32)).dtype == jnp.float32
    np.testing.assert_allclose(jax.jit(xp.linalg.norm)(np.array([3.0, 4.0])), 5.0, rtol=1e-6)
