"""Fused functions and their derivatives agree with the unfused functions."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import assert_agrees, fused, sample

from evo_cpg.creature.algebra.linear import (
    cross,
    expand_dims_like,
    inverse_symmetric,
    matmul,
    matvec,
)
from evo_cpg.native.fuse import fuse, symmetric, while_each

LEGS = 4


def body(m, v):
    """Compute some linear algebra, as for an articulated body."""
    for _ in range(2):
        spd = matmul(m, jnp.swapaxes(m, 0, 1)) + expand_dims_like(np.eye(3), m, m.ndim)
        m = 0.3 * matmul(inverse_symmetric(spd), m)
        v = cross(matvec(m, v), v) + 0.1 * jnp.sin(v)
    return m, v


def limbs(hip, turn, trunk):
    """Compute a program like a walker's: from trunk to legs, from legs to trunk, and back.

    Args:
        hip: ``(3, legs, ...)``.
        turn: ``(3, 3, legs, ...)``.
        trunk: ``(3, ...)``.
    """
    places = np.random.default_rng(5).normal(size=(3, LEGS)) * [[1.0], [0.0], [1.0]]
    arm = trunk[:, None] + jnp.sin(hip) + expand_dims_like(places, hip)
    spread = matmul(turn, jnp.swapaxes(turn, 0, 1)) + 0.1 * arm[:, None] * arm[None]
    inverse = inverse_symmetric(symmetric(spread) + 3.0 * expand_dims_like(np.eye(3), spread))
    force = matvec(inverse, cross(arm, hip))
    force = jnp.where((arm[2] > trunk[2][None])[None], force, 0.5 * force)
    trunk = trunk + 0.3 * force.sum(1) / (1.0 + (abs(arm[0]) * force[1]).max(0))[None]
    effort = (force * force).sum((0, 1))[None, None]
    hip = hip + 0.1 * force - 0.2 * trunk[:, None] * effort
    return trunk, hip, hip[:, 1:3].sum(1) * hip[0, 3][None]


def of_body(batch):
    return sample((3, 3, *batch), dtype=np.float64), sample((3, *batch), 1, np.float64)


def of_limbs(batch):
    shapes = (3, LEGS, *batch), (3, 3, LEGS, *batch), (3, *batch)
    return [0.5 * sample(shape, i, np.float64) for i, shape in enumerate(shapes)]


@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (37,)])
@pytest.mark.parametrize(("function", "arguments"), [(body, of_body), (limbs, of_limbs)])
def test_any_number_of_batch_axes_agrees_with_jax(function, arguments, batch, x64):
    values = arguments(batch)
    got = jax.jit(functools.partial(fuse, function, batch_ndim=len(batch)))(*values)
    for one, other in zip(got, jax.jit(function)(*values), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize(("function", "arguments"), [(body, of_body), (limbs, of_limbs)])
def test_vmap_and_derivatives_agree_with_jax(function, arguments, x64):
    values = tuple(arguments((4,)))

    def loss(run, *values):
        return sum((x**2).sum() for x in run(*values))

    one = functools.partial(fuse, function, batch_ndim=0)
    mapped = jax.jit(jax.vmap(one, in_axes=-1, out_axes=-1))(*values)
    for got, expected in zip(mapped, jax.jit(function)(*values), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-13)
    every = functools.partial(fuse, function, batch_ndim=1)
    along = tuple(jnp.cos(7 * x) for x in values)
    for one in (
        lambda run, x: jax.grad(functools.partial(loss, run))(*x),
        lambda run, x: jax.jvp(functools.partial(loss, run), x, along)[1],
    ):
        got, expected = (jax.jit(functools.partial(one, run))(values) for run in (every, function))
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-12)


def test_vmap_over_some_arguments_agrees_with_jax():
    def function(x, y):
        return x * y[0] + y.sum()

    x, y = sample((3, 5)), sample((3, 5), 1)
    run = functools.partial(fuse, function, batch_ndim=0)
    for axes in ((1, None), (None, 1), (1, 1)):
        values = [v if axis is not None else v[:, 0] for v, axis in zip((x, y), axes, strict=True)]
        got = jax.jit(jax.vmap(run, axes))(*values)
        np.testing.assert_allclose(got, jax.vmap(function, axes)(*values), rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_closed_over_values_may_be_traced_and_differentiated(x64):
    x = sample((3, 4), dtype=np.float64)

    def energy(run, weights):
        return (run(lambda x: jnp.sin(weights.reshape(3, *(1,) * (x.ndim - 1)) * x)) ** 2).sum()

    def natively(function):
        return fuse(function, x, batch_ndim=1)

    weights = jnp.arange(1.0, 4.0)
    unfused = functools.partial(energy, lambda function: function(x))
    for differentiate in (lambda function: function, jax.grad, jax.jacfwd):
        got = jax.jit(differentiate(functools.partial(energy, natively)))(weights)
        np.testing.assert_allclose(got, differentiate(unfused)(weights), rtol=1e-12)


def test_closed_over_values_may_be_mapped():
    x, weights = sample((3, 4)), sample((5, 3), 1)
    got = jax.jit(
        jax.vmap(lambda w: fuse(lambda x: jnp.sin(x) * w[0] + w[1:].sum(), x, batch_ndim=1))
    )(weights)
    expected = jax.vmap(lambda w: jnp.sin(x) * w[0] + w[1:].sum())(weights)
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6)


def test_empty_arrays_are_allowed():
    """A body without joints has an angle array ``(0, n)``."""

    def function(x, none):
        return x + none.sum(0)[None], 2 * none, none > 0

    x, none = sample((3, 5)), jnp.zeros((0, 5), jnp.float32)
    got = fused(function, x, none)
    np.testing.assert_array_equal(got[0], x)
    assert [part.shape for part in got[1:]] == [(0, 5), (0, 5)] and got[2].dtype == bool
    nobody = jax.jit(functools.partial(fuse, function, batch_ndim=1))(x[:, :0], none[:, :0])
    assert [part.shape for part in nobody] == [(3, 0), (0, 0), (0, 0)]


def test_results_may_be_arguments_constants_or_equal():
    def function(x, y):
        return x, jnp.float32(3), y, x[0], x, np.arange(2), jnp.zeros((2, 2), bool), x[::-1]

    assert_agrees(function, sample((3, 5)), jnp.arange(10).reshape(2, 5))


@pytest.mark.parametrize("batch", [(1,), (3,), (8,), (21,)])
def test_precisions_may_mix(batch, x64):
    def mixed(x):
        rough = x.astype(jnp.float32) * 3
        return rough, (rough.astype(jnp.float64) + x) * x, x > 0, (10 * x).astype(jnp.int64)

    assert_agrees(mixed, sample((3, *batch), dtype=np.float64), rtol=1e-14)


def test_a_float32_program_agrees_in_float64(x64):
    def function(x):
        return (x.astype("float64") + 1e-12 - x.astype("float64")).astype("float32") * 1e12

    assert_agrees(function, sample((2, 17)), rtol=1e-3)


def of_each(row):
    """Return a number and a truth value of a row ``(3, ...)``, with different constants."""
    return row * expand_dims_like(np.arange(1.0, 4.0), row) + row.sum(0)[None], row[0] > 0


@pytest.mark.parametrize("legs", [(3,), (2, 2)])
def test_a_part_may_have_a_batch_within_an_individual(legs):
    """Legs are a batch within the individual, as batch axes or by `vmap`."""
    x = sample((3, *legs, 5))

    def mapped(x):
        run = functools.partial(fuse, of_each, batch_ndim=0)
        for _ in legs:
            run = jax.vmap(run, -1, -1)
        return run(x)

    for run in (mapped, functools.partial(fuse, of_each, batch_ndim=len(legs))):
        for got, expected in zip(fused(run, x), of_each(x), strict=True):
            np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6)


def test_a_symmetric_matrix_reads_its_upper_half():
    m = sample((3, 3, 4))
    (got,) = fused(symmetric, m)
    expected = [[m[min(i, j), max(i, j)] for j in range(3)] for i in range(3)]
    np.testing.assert_array_equal(got, np.array(expected))
    assert symmetric(m) is m


# Derivatives.


def spiral(x, turn):
    """Return a number and a truth value."""
    return jnp.stack([x[0] * jnp.cos(turn) - x[1], x[1] + 0.1 * x[0] ** 2]), x[0] > 0


def path(run, turn, x):
    def advance(x, _):
        x, right = run(x, turn)
        return x, jnp.where(right, x[1], 0.0)

    return jax.lax.scan(jax.checkpoint(advance), x, None, length=5)[1].sum()


@pytest.mark.slow
def test_hessians_of_a_mapped_scan_equal_those_of_jax(x64):
    """Compare Hessians, mapped over starts, of a sum over a path with a closed-over parameter."""
    turn = jnp.asarray([0.3, 0.7])
    starts = sample((4, 2, 2), 3, np.float64)

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


def test_a_gradient_is_one_piece_of_code():
    """The backward pass computes the forward pass again, and XLA computes sums alone."""

    def chain(x):
        for i in range(40):
            x = jnp.stack([x[1] * x[2] + 0.1 * i, jnp.abs(x[0]) - x[2], x[0] * x[1]])
        return x

    run = jax.jit(jax.grad(lambda x: fuse(chain, x, batch_ndim=1).sum()))
    text = run.lower(sample((3, 32), 1)).as_text()
    assert text.count("@evo_cpg_") <= 2
    assert text.count("stablehlo.multiply") == 0


def walk(start, size):
    """Return a number, what it grew by in each of three steps, and a truth value."""

    def one(x, k):
        x = x + size * jnp.sin(x + k)
        return x, x[0] * size

    (x, y), each = jax.lax.scan(one, start, jnp.arange(3.0))
    return x * y, each.sum(0), x > 0


@pytest.mark.parametrize("results", [slice(0, 1), slice(0, 3, 2), slice(0, 3)])
def test_derivatives_of_loops_equal_those_of_jax(results, x64):
    """Reverse mode, and forward mode along few and many directions. One number is special."""
    starts, size = sample((2, 20), 3, np.float64), jnp.asarray(0.3)

    def total(run, start, size):
        found = [jnp.sin(x).sum() for x in run(start, size)[results] if x.dtype != bool]
        return sum(found)

    def native(start, size):
        return fuse(lambda x: walk(x, size), start, batch_ndim=1)

    for differentiate in (jax.grad, jax.jacfwd):
        for places in (0, 1):
            got, expected = (
                jax.jit(differentiate(functools.partial(total, run), places))(starts, size)
                for run in (native, walk)
            )
            np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-14)


def test_a_search_for_one_number_is_differentiated_forwards(x64):
    def root(x):
        """Return the square root by Newton's method."""
        advance = lambda y: 0.5 * (y + x / y)  # noqa: E731
        return while_each(lambda y: abs(y * y - x) > 1e-15 * x, advance, advance(x))

    x = jnp.array([2.0, 5.0])
    _, slope = jax.jvp(lambda x: fuse(root, x, batch_ndim=1), (x,), (jnp.ones(2),))
    np.testing.assert_allclose(slope, 0.5 / np.sqrt(x), rtol=1e-9)


@pytest.mark.parametrize("count", [1, 20])
def test_tangents_share_the_work_of_a_program(count, x64):
    """Many individuals share it within each program, and the tangents of one fill a vector."""

    def parts(x, scale):
        def one(x, k):
            return fuse(lambda x: x * jnp.exp(-x * x) * scale, x, batch_ndim=x.ndim - 1), x[0]

        x, heights = jax.lax.scan(one, x, None, length=4)
        return x, heights[1:].sum(0)

    starts = sample((2, count), 3, np.float64)

    def outer(run, scale):
        return run(starts * scale[:2, None] + scale[2], scale[0])

    got, expected = (
        jax.jit(jax.jacfwd(functools.partial(outer, run)))(jnp.array([0.5, 0.7, 0.2]))
        for run in (lambda *x: fuse(lambda y: parts(y, x[1]), x[0], batch_ndim=1), parts)
    )
    for one, other in zip(got, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_empty_results_keep_their_type(x64):
    """A float32 program and its derivatives stay in float32 if float64 is enabled."""

    def parts(x):
        return x[:0], x * x

    x = sample((3, 4), 1)
    empty, _ = jax.jit(lambda x: fuse(parts, x, batch_ndim=1))(x)
    assert empty.dtype == np.float32 and empty.shape == (0, 4)
    gradient = jax.jit(jax.grad(lambda x: sum(y.sum() for y in fuse(parts, x, batch_ndim=1))))(x)
    np.testing.assert_allclose(gradient, 2 * x, rtol=1e-6)
