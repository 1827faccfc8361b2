"""Random numbers drawn in fused functions equal those of JAX."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import assert_agrees, fused, plain

from evo_cpg.native.frontend.threefry import threefry2x32
from evo_cpg.native.fuse import fuse

SEEDS = jnp.array([0, 1, 42, -7, 2**31 - 1, -(2**31), 12345], jnp.int32)[None]

EXACT = {
    "bits": lambda key: jax.random.bits(key, (3,)),
    "short bits": lambda key: jax.random.bits(key, (5,), "uint8"),
    "folded": lambda key: jax.random.key_data(jax.random.fold_in(key, 77)),
    "split": lambda key: jax.random.key_data(jax.random.split(key, 3)),
    "uniform": lambda key: jax.random.uniform(key, (2, 3), minval=-1.0, maxval=3.0),
    "one": lambda key: jax.random.uniform(key),
    "whole": lambda key: jax.random.randint(key, (4,), -3, 17),
    "coins": lambda key: jax.random.bernoulli(key, 0.3, (6,)),
    "of each": lambda key: jax.vmap(jax.random.uniform)(jax.random.split(key, 4)),
}


@pytest.mark.parametrize("name", EXACT)
def test_random_numbers_equal_those_of_jax_bit_for_bit(name):
    def draw(seed):
        return EXACT[name](jax.random.key(seed[0]))

    for got, expected in zip(fused(draw, SEEDS), plain(draw, SEEDS), strict=True):
        np.testing.assert_array_equal(got, expected, strict=True)


def test_normal_numbers_agree_with_jax():
    """Only the last digits of the inverse error function may differ."""
    assert_agrees(lambda seed: jax.random.normal(jax.random.key(seed[0]), (8,)), SEEDS)


def test_random_numbers_of_a_shared_key_agree_with_jax():
    """Draw as a controller draws its noise: equal for all individuals, new in each step."""

    def path(run, words):
        def advance(x, i):
            key = jax.random.fold_in(jax.random.wrap_key_data(words), i)
            words_now = jax.random.key_data(key)

            def step(x):
                return 0.5 * x + jax.random.uniform(jax.random.wrap_key_data(words_now))

            x = run(step, x)
            return x, x

        return jax.lax.scan(advance, jnp.zeros(9), jnp.arange(5))[1]

    key = jax.random.key_data(jax.random.key(3))
    got = jax.jit(functools.partial(path, lambda f, x: fuse(f, x, batch_ndim=1)))(key)
    expected = jax.jit(functools.partial(path, lambda f, x: f(x)))(key)
    np.testing.assert_allclose(got, expected, rtol=1e-6)

    def inside(seed):
        return path(lambda f, x: f(x), jax.random.PRNGKey(seed[0]))

    assert_agrees(inside, SEEDS)


def test_published_threefry_vectors_are_reproduced():
    """The reference implementation of Salmon et al. lists them (kat_vectors of Random123)."""
    words = [
        ((0, 0), (0, 0), (0x6B200159, 0x99BA4EFE)),
        ((0xFFFFFFFF,) * 2, (0xFFFFFFFF,) * 2, (0x1CB996FC, 0xBB002BE7)),
        ((0x13198A2E, 0x03707344), (0x243F6A88, 0x85A308D3), (0xC4923A9C, 0x483DF7A0)),
    ]
    for key, counter, expected in words:
        given = (np.uint32(word) for word in (*key, *counter))
        with np.errstate(over="ignore"):
            assert tuple(int(word) for word in threefry2x32(*given)) == expected
