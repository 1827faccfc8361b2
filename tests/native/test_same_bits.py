"""The bits of an individual's results depend on its own arguments alone."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import plain, sample, with_instructions
from jax.sharding import PartitionSpec

from evo_cpg.native.backend import machine
from evo_cpg.native.fuse import fuse

ROWS = 5


def step(x):
    """Compute sums of products, elementary functions, a loop, and a loop of individual length."""
    mixed = x[0] * x[1] + x[2] * x[3] - x[4] * x[0]
    waves = jnp.sin(mixed) + jnp.exp(-jnp.abs(x)) * jnp.cos(x[::-1]) + jnp.tanh(mixed * x)

    def turn(carry, i):
        carry = 0.9 * carry + jnp.roll(carry, 1, 0) * waves / (1 + i)
        return carry, carry[0] * carry[1] + carry[2]

    end, path = jax.lax.scan(turn, waves, jnp.arange(4.0))

    def wants_more(state):
        root, count = state
        return (jnp.abs(root * root - 1 - x[0] * x[0]) > 0.01) & (count < 9)

    def newton(state):
        root, count = state
        return root - (root * root - 1 - x[0] * x[0]) / (2 * root), count + 1

    root, count = jax.lax.while_loop(wants_more, newton, (3 + jnp.abs(x[1]), jnp.int32(0)))
    found = jnp.stack([*(end + path.sum(0))[:3], root, x[3] + path[1] * root])
    return jnp.tanh(found) + 0.01 * found, count


def trial(x):
    """Compute a program with sums of products before and after the step."""
    first, count = fuse(step, x * x[0] + x[1] * x[2], batch_ndim=0)
    second, _ = fuse(step, 0.5 * first + x * x[4], batch_ndim=0)
    return first[0] * second + first[1] * x, count


def natively(function, x):
    """Run native code with the individuals on the last axis."""
    run = jax.vmap(functools.partial(fuse, function, batch_ndim=0), -1, -1)
    return [np.asarray(leaf) for leaf in jax.tree.leaves(jax.jit(run)(x))]


ALL = 0.5 * sample((ROWS, 112), 3)


@functools.cache
def of_all():
    return natively(trial, ALL)


def assert_same(got, expected):
    for one, other in zip(got, expected, strict=True):
        np.testing.assert_array_equal(one.view("u4"), other.view("u4"))


def test_the_program_agrees_with_jax():
    """The other tests of this file would prove nothing without this."""
    assert_close(of_all(), plain(trial, ALL))
    assert len(np.unique(of_all()[1])) > 2


def assert_close(got, expected):
    """Assert closeness of all individuals but a few whose loops end in another round."""
    same = got[1] == expected[1]
    assert same.mean() > 0.95
    np.testing.assert_allclose(got[0][:, same], expected[0][:, same], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("count", [1, 2, 3, 15, 16, 17, 40, 111])
def test_bits_do_not_depend_on_the_number_of_individuals(count):
    assert_same(natively(trial, ALL[:, :count]), [x[..., :count] for x in of_all()])


def test_bits_do_not_depend_on_place_and_neighbours():
    order = np.random.default_rng(0).permutation(112)
    assert_same(natively(trial, ALL[:, order]), [x[..., order] for x in of_all()])
    strangers = sample(ALL.shape, 9).at[:, 40].set(ALL[:, 40]).at[:, 41].set(jnp.nan)
    assert_same([x[..., 40] for x in natively(trial, strangers)], [x[..., 40] for x in of_all()])


def test_bits_do_not_depend_on_the_kind_of_run():
    """Run all at once, in a JAX loop, with one or two batch axes, and on two devices."""
    assert_same(natively(trial, ALL), of_all())
    parts = ALL.reshape(ROWS, 7, 16)
    run = functools.partial(fuse, trial, batch_ndim=1)
    _, stacked = jax.jit(lambda x: jax.lax.scan(lambda _, x: (None, run(x)), None, x))(
        jnp.moveaxis(parts, 1, 0)
    )
    for got, expected in zip(stacked, of_all(), strict=True):
        got = np.moveaxis(np.asarray(got), 0, -2).reshape(expected.shape)
        assert_same([got], [expected])
    double = jax.jit(functools.partial(fuse, trial, batch_ndim=2))(parts)
    for got, expected in zip(double, of_all(), strict=True):
        assert_same([np.asarray(got).reshape(expected.shape)], [expected])
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:2]), ("devices",))
    split = jax.shard_map(
        run,
        mesh=mesh,
        in_specs=PartitionSpec(None, "devices"),
        out_specs=(PartitionSpec(None, "devices"), PartitionSpec("devices")),
    )
    assert_same([np.asarray(x) for x in jax.jit(split)(ALL)], of_all())
    # XLA has to gather the individuals before a call without `shard_map`.
    sharding = jax.sharding.NamedSharding(mesh, PartitionSpec(None, "devices"))
    assert_same(natively(trial, jax.device_put(ALL, sharding)), of_all())


@pytest.mark.parametrize("count", [1, 5, 112])
def test_bits_do_not_depend_on_the_surrounding_program(count):
    """The part's arguments and results may be sums and products in the outer program."""
    x = ALL[:, :count]

    def around(x):
        """Return the part's exact arguments and results too."""
        given = x * x[0] + x[1] * x[2]
        found, rounds = fuse(step, given, batch_ndim=0)
        return given, found, rounds, found * x + given * found[0], jnp.sin(found[1] + x[3])

    given, *found = natively(around, x)[:3]
    assert_same(natively(step, jnp.asarray(given)), found)


def test_equal_code_is_loaded_once():
    of_all()
    before = machine.code_bytes()
    assert before > 0
    again = jax.jit(jax.vmap(functools.partial(fuse, lambda x: trial(x), batch_ndim=0), -1, -1))
    assert_same([np.asarray(x) for x in again(ALL)], of_all())
    assert machine.code_bytes() == before


def on(instructions):
    return with_instructions(instructions, lambda: natively(lambda x: trial(x), ALL))


@pytest.mark.parametrize("instructions", ["avx512", "avx2", "neon"])
def test_bits_do_not_depend_on_the_vector_width(instructions):
    """All of these instruction sets multiply and add in one instruction."""
    assert_same(on(instructions), on("host"))


def test_without_fused_multiply_add_results_are_close():
    assert_close(on("sse"), on("host"))
