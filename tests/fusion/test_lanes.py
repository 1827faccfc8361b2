"""What is the same for several parts is computed side by side, with the same results."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.fusion.graph import Graph
from evo_cpg.fusion.kernels import fuse, side_by_side, together, unfused
from evo_cpg.spatial.linear import cross, inverse_symmetric, lift, matmul, matvec

LEGS = 4


def sample(shape, seed=0, dtype=np.float64):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), dtype)


def limbs(hip, turn, trunk, legs=LEGS):
    """A program like that of a walker: trunk to legs, legs to trunk, and back.

    Args:
        hip: ``(3, legs, ...)``.
        turn: ``(3, 3, legs, ...)``.
        trunk: ``(3, ...)``.
        legs: how many.
    """
    places = np.random.default_rng(5).normal(size=(3, legs)) * [[1.0], [0.0], [1.0]]
    hip = side_by_side(hip)
    arm = trunk[:, None] + jnp.sin(hip) + lift(places, hip)
    spread = matmul(turn, jnp.swapaxes(turn, 0, 1)) + 0.1 * arm[:, None] * arm[None]
    inverse = inverse_symmetric(spread + 3.0 * lift(np.eye(3), spread[:, :, 0], spread.ndim))
    force = matvec(inverse, cross(arm, hip))
    touches = arm[2] > trunk[2][None]
    force, push = together((jnp.where(touches[None], force, 0.5 * force), abs(arm[0])))
    trunk = trunk + 0.3 * force.sum(1) / (1.0 + (push * force[1]).max(0))[None]
    effort = (force * force).sum((0, 1))[None, None]
    hip = hip + 0.1 * force - 0.2 * trunk[:, None] * effort
    return trunk, hip, hip[:, 1:3].sum(1) * hip[0, 3 % legs][None]


def arguments(legs=LEGS, batch=(6,)):
    return (
        sample((3, legs, *batch)),
        0.5 * sample((3, 3, legs, *batch), 1),
        sample((3, *batch), 2),
    )


@pytest.mark.parametrize(
    ("legs", "batch"), [(1, (6,)), (2, (2, 3)), (LEGS, ()), (LEGS, (6,)), (LEGS, (16,))]
)
def test_results_are_those_of_the_function(legs, batch, x64):
    values = arguments(legs, batch)
    run = functools.partial(limbs, legs=legs)
    fused = jax.jit(functools.partial(fuse, run, batch_ndim=len(batch)))(*values)
    for got, wanted in zip(fused, jax.jit(run)(*values), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-10, atol=1e-12)


def test_four_legs_take_hardly_more_operations_than_one(x64):
    """One leg needs no lanes; four without lanes would take four times as many."""

    def operations(legs):
        run = functools.partial(limbs, legs=legs)
        text = jax.jit(functools.partial(fuse, run, batch_ndim=1)).lower(*arguments(legs))
        return text.as_text().count("stablehlo.multiply")

    assert operations(LEGS) < 2 * operations(1)


def test_derivatives_and_vmap(x64):
    values = arguments()

    def loss(run, *values):
        return sum((x**2).sum() for x in run(*values))

    got = jax.jit(jax.grad(functools.partial(loss, functools.partial(fuse, limbs, batch_ndim=1))))(
        *values
    )
    np.testing.assert_allclose(
        got, jax.jit(jax.grad(functools.partial(loss, limbs)))(*values), rtol=1e-9
    )
    one = functools.partial(fuse, limbs, batch_ndim=0)
    mapped = jax.jit(jax.vmap(one, in_axes=-1, out_axes=-1))(*values)
    for got, wanted in zip(mapped, jax.jit(limbs)(*values), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-10, atol=1e-12)


def test_what_is_closed_over_may_be_traced_and_differentiated(x64):
    hip, *_ = arguments()

    def energy(run, scale):
        return (run(lambda hip: limbs(scale * hip, 0.0 * hip[None] + 1.0, hip[:, 0])[0]) ** 2).sum()

    fused = functools.partial(energy, lambda function: fuse(function, hip, batch_ndim=1))
    plain = functools.partial(energy, lambda function: function(hip))
    for differentiate in (lambda function: function, jax.grad):
        got, wanted = (jax.jit(differentiate(run))(0.7) for run in (fused, plain))
        assert float(got) == pytest.approx(float(wanted), rel=1e-10)


def test_lanes_of_which_only_some_are_used_or_that_change_places(x64):
    """What does not concern all of them in the same way is computed for each alone."""

    def mixed(x):
        x = side_by_side(x)
        y = jnp.concatenate([x[:, 1:], x[:, :1]], 1) * x
        weighted = unfused(lambda y: jnp.tensordot(jnp.ones((2, 3)), y, 1), y)
        return y, y[:, :3].sum(1), x[:, ::-1] - y, x[:, 0] * y[:, 2], weighted, x.min((0, 1))

    x = sample((3, LEGS))
    fused = jax.jit(functools.partial(fuse, mixed, batch_ndim=0))(x)
    for got, wanted in zip(fused, mixed(x), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("individuals", [3, 8, 16, 48, 64])
def test_conditions_that_differ_from_lane_to_lane(x64, individuals, dtype):
    """Their arrays are as long as those of the numbers, with what is added to these."""
    first = np.array([True, False, False, True])[:LEGS]

    def chosen(x, among):
        return jnp.where(among, x, x * x)

    x = np.random.default_rng(0).normal(size=(2, LEGS, individuals)).astype(dtype)
    got = jax.jit(lambda x: fuse(lambda x: chosen(side_by_side(x), first[None]), x, batch_ndim=1))(
        x
    )
    np.testing.assert_array_equal(got, chosen(x, first[:, None]))


def test_packing_undoes_taking_apart():
    graph = Graph()
    f32 = np.dtype("f4")
    scalars = tuple(graph.input(i, f32) for i in range(3))
    whole = graph.pack(scalars)
    assert whole.lanes == 3
    assert graph.pack(tuple(graph.lane(whole, i) for i in range(3))) is whole
    turned = graph.pack(tuple(graph.lane(whole, i) for i in (1, 2, 0)))
    assert turned is not whole
    two = graph.constant(2, f32)
    assert graph.pack((two, two, two)) is two
    different = graph.pack((two, graph.constant(3, f32), two))
    assert graph.lane(different, 1).value == 3
    assert graph.lane(graph.add(different, two), 1).value == 5
    assert graph.lane_sum(different).value == 7
    assert graph.add(whole, two).lanes == 3
