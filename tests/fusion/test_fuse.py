"""Fused functions give what the same functions give unfused, and are few kernels."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evo_cpg.fusion.graph import Graph
from evo_cpg.fusion.kernels import fuse, symmetric, together, unfused
from evo_cpg.fusion.schedule import KERNEL_ARRAYS, KERNEL_SIZE, cut, read_by
from evo_cpg.spatial.linear import cross, inverse_symmetric, matmul, matvec

# Every kind of operation that moves numbers about, and the sums.
MOVES = {
    "slice": lambda x: x[1:, :2],
    "steps": lambda x: x[::2, ::-1],
    "pick": lambda x: x[np.array([2, 0])],
    "transpose": lambda x: jnp.swapaxes(x, 0, 1),
    "stack": lambda x: jnp.stack([x[0], x[1]], 1),
    "concatenate": lambda x: jnp.concatenate([x, 2 * x], 1),
    "repeat": lambda x: jnp.broadcast_to(x[:1], x.shape) + x,
    "reshape": lambda x: x.reshape(9, *x.shape[2:])[4:],
    "pad": lambda x: jnp.pad(x, ((1, 0), (0, 2)) + ((0, 0),) * (x.ndim - 2)),
    "split": lambda x: jnp.split(x, 3)[1],
    "sum": lambda x: x.sum(0),
    "largest": lambda x: x.max(1),
    "smallest": lambda x: x.min((0, 1)),
    "any": lambda x: jnp.where((x > 0.5).any(0), 1.0, 0.0),
    "all": lambda x: jnp.where((x > -1.5).all(1), x[0], 0.0),
    "product with a matrix": lambda x: (
        np.arange(6.0).reshape(2, 3).astype("f") @ x[:, 0]
        if x.ndim == 2
        else jnp.tensordot(np.arange(6.0).reshape(2, 3).astype("f"), x[:, 0], 1)
    ),
}


def sample(shape, seed=0, dtype=np.float32):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), dtype)


@pytest.mark.parametrize("name", MOVES)
def test_moving_and_summing(name):
    x = sample((3, 3, 5))
    fused = jax.jit(lambda x: fuse(MOVES[name], x, batch_ndim=1))(x)
    np.testing.assert_allclose(fused, MOVES[name](x), rtol=1e-6, atol=1e-6)


def test_elementwise_operations():
    def everything(x, y):
        return (
            jnp.sin(x) * jnp.cos(y) + jnp.tanh(x * y) - jnp.exp(-(x**2)),
            jnp.sqrt(jnp.abs(x)) / (1.0 + y**2) + x**3 - x**-1,
            jnp.where(x > y, jnp.maximum(x, 0.0), jnp.minimum(-y, 1.0)),
            jnp.clip(x, -0.5, 0.5) * jnp.sign(y),
            jnp.arctan2(x, y) + jnp.arccos(jnp.clip(x, -0.9, 0.9)) + jax.nn.sigmoid(y),
            (x > 0) & ~(y > 0),
        )

    x, y = sample((2, 7), 1), sample((2, 7), 2)
    fused = jax.jit(functools.partial(fuse, everything, batch_ndim=1))(x, y)
    for got, wanted in zip(fused, everything(x, y), strict=True):
        assert got.dtype == wanted.dtype
        np.testing.assert_allclose(got, wanted, rtol=3e-6, atol=1e-6)


def body(m, v, wave=jnp.sin):
    """Enough linear algebra for several kernels."""
    for _ in range(12):
        spd = matmul(m, jnp.swapaxes(m, 0, 1)) + lift_identity(m)
        m = 0.3 * matmul(inverse_symmetric(spd), m)
        v = cross(matvec(m, v), v) + 0.1 * wave(v)
    return m, v


def lift_identity(m):
    return jnp.eye(3, dtype=m.dtype).reshape(3, 3, *(1,) * (m.ndim - 2))


@pytest.mark.parametrize("batch", [(), (6,), (2, 3)])
def test_any_number_of_batch_axes(batch, x64):
    m, v = sample((3, 3, *batch), dtype=np.float64), sample((3, *batch), 1, np.float64)
    fused = jax.jit(functools.partial(fuse, body, batch_ndim=len(batch)))(m, v)
    for got, wanted in zip(fused, body(m, v), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-14)


def test_vmap_and_derivatives(x64):
    m, v = sample((3, 3, 4), dtype=np.float64), sample((3, 4), 1, np.float64)

    def loss(run, m, v):
        return sum((x**2).sum() for x in run(m, v))

    fused = functools.partial(fuse, body, batch_ndim=1)
    one = functools.partial(fuse, body, batch_ndim=0)
    mapped = jax.jit(jax.vmap(one, in_axes=-1, out_axes=-1))(m, v)
    for got, wanted in zip(mapped, body(m, v), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-14)
    for differentiate in (jax.grad, jax.jacfwd):
        got = jax.jit(differentiate(functools.partial(loss, fused)))(m, v)
        wanted = differentiate(functools.partial(loss, body))(m, v)
        np.testing.assert_allclose(got, wanted, rtol=1e-10, atol=1e-14)


def test_what_is_closed_over_may_be_traced_and_differentiated(x64):
    x = sample((3, 4), dtype=np.float64)

    def energy(run, weights):
        return (run(lambda x: jnp.sin(weights.reshape(3, *(1,) * (x.ndim - 1)) * x)) ** 2).sum()

    def fused(function):
        return fuse(function, x, batch_ndim=1)

    weights = jnp.arange(1.0, 4.0)
    assert jax.jit(functools.partial(energy, fused))(weights) == pytest.approx(
        float(energy(lambda function: function(x), weights)), rel=1e-12
    )
    got = jax.jit(jax.grad(functools.partial(energy, fused)))(weights)
    wanted = jax.grad(functools.partial(energy, lambda function: function(x)))(weights)
    np.testing.assert_allclose(got, wanted, rtol=1e-12)


def test_a_part_left_to_xla_and_values_wanted_together():
    big = np.random.default_rng(3).normal(size=(40, 3)).astype("f")

    def outer(x):
        y = unfused(lambda x: (jnp.tensordot(big, x, 1), 2 * x), x * x)
        first, second = together((y[0] + 1.0, y[1][:, None] * y[1][None]))
        return first.sum(0) + x[0], symmetric(second)

    x = sample((3, 5))
    fused = jax.jit(lambda x: fuse(outer, x, batch_ndim=1))(x)
    for got, wanted in zip(fused, outer(x), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-5, atol=1e-5)


def test_empty_arrays():
    """A body without joints has angles ``(0, n)``."""

    def function(x, none):
        return x + none.sum(0)[None], 2 * none

    x, none = sample((3, 5)), jnp.zeros((0, 5), jnp.float32)
    fused = jax.jit(functools.partial(fuse, function, batch_ndim=1))(x, none)
    np.testing.assert_array_equal(fused[0], x)
    assert fused[1].shape == (0, 5)


def test_precisions_do_not_mix_in_a_kernel(x64):
    def mixed(x):
        rough = x.astype(jnp.float32) * 3
        return rough, (rough.astype(jnp.float64) + x) * x

    x = sample((3, 5), dtype=np.float64)
    fused = jax.jit(lambda x: fuse(mixed, x, batch_ndim=1))(x)
    for got, wanted in zip(fused, mixed(x), strict=True):
        assert got.dtype == wanted.dtype
        np.testing.assert_allclose(got, wanted, rtol=1e-12)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: jax.lax.scan(lambda c, _: (c * x, None), x, length=3)[0],
        lambda x: jnp.sort(x, 0),
        lambda x: x[jnp.argmax(x, 0)],
    ],
)
def test_what_is_not_scalar_arithmetic_is_refused(function):
    with pytest.raises(NotImplementedError, match="fused"):
        jax.jit(lambda x: fuse(function, x, batch_ndim=1)).lower(sample((3, 5)))


def test_constants_fold_and_equal_things_are_one():
    graph = Graph()
    f32 = np.dtype("f4")
    x, y = graph.input(0, f32), graph.input(1, f32)
    zero, one, two = (graph.constant(value, f32) for value in (0, 1, 2))
    assert graph.add(graph.multiply(zero, x), y) is y
    assert graph.multiply(x, one) is x
    assert graph.add(x, y) is graph.add(y, x)
    assert graph.add(two, one).value == 3
    assert graph.subtract(x, graph.negate(y)) is graph.add(x, y)
    minus = graph.multiply(graph.constant(-2, f32), x)
    assert graph.add(y, minus) is graph.subtract(y, graph.multiply(two, x))


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), min_size=1, max_size=400))
def test_cutting_keeps_the_order_and_the_limits(links):
    """Any graph of sums: each piece needs only inputs and earlier pieces."""
    graph = Graph()
    nodes = [graph.input(i, np.dtype("f4")) for i in range(3)]
    for i, j in links:
        nodes.append(graph.add(nodes[-1 - i % len(nodes)], nodes[-1 - j % len(nodes)]))
    wanted = nodes[-5:]
    stored, computed = set(nodes[:3]), set()
    for piece, kept in cut(wanted):
        operands = read_by(piece)
        assert stored.issuperset(operands)
        assert computed.isdisjoint(piece)
        assert len(piece) <= KERNEL_SIZE
        assert len(operands) + max(len(operands), len(kept)) <= KERNEL_ARRAYS
        computed.update(piece)
        stored.update(kept)
    assert stored.issuperset(wanted)


def test_there_are_few_kernels():
    """What it is for. Costly functions get kernels of their own, so here there are none."""
    program = functools.partial(body, wave=jnp.abs)
    m, v = sample((3, 3, 32)), sample((3, 32), 1)

    def kernels(function):
        text = jax.jit(function).lower(m, v).compile().as_text()
        return text.count(" fusion(")

    assert kernels(functools.partial(fuse, program, batch_ndim=1)) * 8 < kernels(program)


def test_what_is_cheap_is_computed_again_and_not_stored():
    """A value that takes one operation from what a later kernel reads anyway is not passed on."""
    graph = Graph()
    x = [graph.input(i, np.dtype(np.float32)) for i in range(KERNEL_ARRAYS)]
    doubled = [graph.add(each, each) for each in x]
    wanted = [
        graph.multiply(graph.multiply(a, b), c)
        for a, b, c in zip(doubled, doubled[1:], x, strict=False)
    ]
    pieces = cut(
        [*wanted, graph.call(lambda y: (y,), [np.array(wanted[:1])], [((), x[0].dtype)])[0].item()]
    )
    kept = {node for _, kept in pieces for node in kept}
    assert len([piece for piece, _ in pieces if not piece[0].costly]) > 1
    assert not kept & set(doubled)
