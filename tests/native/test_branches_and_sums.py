"""Skipped branches, and arrays that loops add to, agree with JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import assert_agrees, fused, sample
from jax import lax

from evo_cpg.native import native
from evo_cpg.native.fuse import fuse

COUNTS = [1, 5, 16, 37, 301]
POINTS, SIZE = 9, 30


@pytest.fixture
def texts(monkeypatch):
    """Collect the code of all compiled programs."""
    found, load = [], native.load
    monkeypatch.setattr(
        native, "load", lambda text, *args: (found.append(text), load(text, *args))[1]
    )
    return found


def long_branch(x, k):
    """Compute so many operations that skipping them is worth a jump."""
    for i in range(8):
        x = x + 0.1 * jnp.sin(x * (i + 1.0) + k)
    return x


def choose(x):
    def turn(carry, k):
        number = k.astype(x.dtype)
        condition = x[0] * (number - 2.0) > 0.3
        new = lax.cond(
            condition,
            lambda c: (long_branch(c, number), c[0]),
            lambda c: (c, jnp.float32(2)),
            carry,
        )
        return new[0], (new[1], new[0][1] > 0)

    return lax.scan(turn, x, jnp.arange(5))


@pytest.mark.parametrize("count", COUNTS)
def test_long_branches_agree_with_jax(count, texts):
    # A branch stretches rounding up to 1.1 * 1.2 * ... * 1.8 = 18 times, and two may be taken.
    assert_agrees(choose, sample((6, count)), rtol=1e-5, atol=18**2 * 2**-24)
    assert any("icmp slt i32 %round" in text and "%body" in text for text in texts)


def test_a_long_branch_of_a_switch_agrees_with_jax(texts):
    def function(x):
        which = jnp.clip(jnp.floor(x[0] * 3), -1, 4).astype(jnp.int32)
        branches = [lambda y, k=k: long_branch(y, float(k)) for k in range(3)]
        return lax.switch(which, branches, x)

    assert_agrees(function, sample((6, 37)), rtol=1e-5, atol=1e-6)


def test_nested_branches_agree_with_jax():
    def inner(x):
        return lax.cond(x[1] > 0, lambda y: long_branch(y, 1.0), lambda y: 2 * y, x)

    def function(x):
        return lax.cond(x[0] > 0, lambda y: inner(long_branch(y, 2.0)), lambda y: -y, x)

    assert_agrees(function, sample((6, 37)), rtol=1e-5, atol=1e-6)


def test_a_skipped_branch_has_no_effect():
    """Individuals that skip a branch of `cond` do not depend on others that take the branch."""

    def function(x):
        def divide(y):
            return long_branch(1.0 / (y - y[0]), 0.0) + jnp.log(y)

        return lax.cond(x[0] > 0, divide, lambda y: y, x)

    x = sample((6, 37))
    (got,) = fused(function, x)
    np.testing.assert_array_equal(got[:, x[0] <= 0], np.asarray(x)[:, x[0] <= 0])


def scattered(x, active=None):
    """Return sums at computed places, in rounds that some individuals skip."""
    places = jnp.asarray(np.random.default_rng(2).integers(0, SIZE, (POINTS, 3)), jnp.int32)
    table = jnp.stack([x[0] * k for k in range(POINTS)])

    def turn(total, p):
        mine, where = table[p], places[p]

        def add(total):
            values = long_branch(jnp.stack([mine, x[1] * mine, x[2]]), 0.5)
            return total.at[where].add(values, mode="promise_in_bounds")

        go = mine > 0.2 if active is None else active(p, mine)
        return lax.cond(go, add, lambda total: total, total), mine

    return lax.scan(turn, jnp.zeros(SIZE, x.dtype), jnp.arange(POINTS))


@pytest.mark.parametrize("count", COUNTS)
def test_sums_at_computed_places_agree_with_jax(count, texts):
    assert_agrees(scattered, sample((3, count)), rtol=1e-5, atol=1e-5)
    assert all("select" in text for text in texts)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_unconditional_sums_agree_with_jax(dtype):
    def function(x):
        def turn(total, k):
            return total.at[k % SIZE].add(x[0] * k, mode="promise_in_bounds"), None

        total, _ = lax.scan(turn, jnp.full(SIZE, 0.5, x.dtype), jnp.arange(50))
        return total.sum(), total[7]

    with jax.enable_x64(dtype is np.float64):
        assert_agrees(function, sample((3, 21), dtype=dtype), rtol=1e-5, atol=1e-5)


def test_sums_in_nested_loops_agree_with_jax():
    def function(x):
        def inner(total, k):
            return total.at[k].add(x[1] * x[0], mode="promise_in_bounds"), None

        def outer(total, j):
            total, _ = lax.scan(inner, total, jnp.arange(4) + j)
            return total, x[0]

        return lax.scan(outer, jnp.zeros(SIZE, x.dtype), jnp.arange(20))

    assert_agrees(function, sample((3, 21)), rtol=1e-5, atol=1e-5)


def test_sums_in_packed_loops_agree_with_jax():
    """Add in every round of a packed loop, from tables and lists made before the loop."""

    def function(x):
        first, list_ = scattered(x)

        def advance(state):
            y, count = state
            total, _ = scattered(y, lambda p, mine: (mine > 0.2) & (list_[p] > 0))
            return y + 0.01 * total[:3] + 0.001 * first[4], count + 1

        return lax.while_loop(lambda s: s[1] < 1 + jnp.floor(3 * s[0][2]), advance, (x, 0.0))

    assert_agrees(function, sample((3, 301)), rtol=1e-4, atol=1e-4)


def test_a_sum_that_its_loop_reads_agrees_with_jax():
    """A loop that reads its sums cannot use the code for sums, but agrees."""

    def function(x):
        def turn(total, k):
            new = total.at[3].add(x[0], mode="promise_in_bounds")
            return new, new[3]

        return lax.scan(turn, jnp.zeros(SIZE, x.dtype), jnp.arange(6))

    assert_agrees(function, sample((3, 21)))


def test_a_list_read_one_by_one_is_not_copied(texts):
    def function(x):
        _, mine = lax.scan(lambda c, k: (c, jnp.sin(x[0] * k)), None, jnp.arange(40.0))
        return lax.scan(lambda c, y: (c + y * y, None), x[1], mine)[0]

    assert_agrees(function, sample((3, 21)), rtol=1e-5, atol=1e-5)
    assert all(text.count("store volatile") < 40 for text in texts)


def test_derivatives_of_branches_and_sums_agree_with_jax():
    def function(x):
        total, mine = scattered(x)
        return (total**2).sum() + choose(x.repeat(2))[0].sum() + (mine**3).sum()

    x = sample((3, 21))
    got = jax.jit(jax.grad(lambda x: fuse(function, x, batch_ndim=1).sum()))(x)
    expected = jax.jit(jax.grad(lambda x: jax.vmap(function, -1)(x).sum()))(x)
    np.testing.assert_allclose(got, expected, rtol=1e-3, atol=1e-3)


def test_sums_at_places_of_each_individual_run_on_jax():
    def function(x):
        own = jnp.clip(jnp.floor(5 * x[0]), 0, 9).astype(jnp.int32)

        def turn(total, k):
            return total.at[own].add(x[1], mode="promise_in_bounds"), None

        return lax.scan(turn, jnp.zeros(10, x.dtype), jnp.arange(4))[0]

    with pytest.warns(UserWarning, match="no rule for adding to places that differ"):
        assert_agrees(function, sample((3, 21)))
