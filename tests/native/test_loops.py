"""Loops, branches and fixed points of fused functions agree with JAX."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import assert_agrees, fused, sample
from jax import lax

from evo_cpg.native import machine_constants
from evo_cpg.native.converge import implicit, while_each
from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.frontend.lower import trace_closed
from evo_cpg.native.fuse import fuse
from evo_cpg.native.passes.dead_code import eliminate_dead_code
from evo_cpg.native.passes.schedule import schedule

COUNTS = [1, 2, 5, 16, 19]


def decay(x, length, reverse=False):
    """Run a scan with a carry of several types, read rows, stacked rows and constants."""
    rates = jnp.linspace(0.5, 1.5, 7)[:length]
    own = jnp.stack([x[0] * k for k in range(7)])[:length]
    closed = jnp.cos(x[1])

    def turn(carry, row):
        x, count, alive, _ = carry
        rate, mine, number = row
        new = x * rate + closed * mine
        return (new, count + number, alive & (new[0] < 2), 1.0), (new[:2], x[0] > 0, 3.0 * rate)

    start = x, jnp.int32(5), jnp.bool_(True), 1.0
    return lax.scan(turn, start, (rates, own, jnp.arange(length)), reverse=reverse, length=length)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("length", [0, 1, 2, 7])
def test_counted_loops_agree_with_jax(length, reverse):
    assert_agrees(lambda x: decay(x, length, reverse), sample((3, 5)))


@pytest.mark.parametrize("count", COUNTS)
def test_loops_agree_with_jax_for_any_number_of_individuals(count):
    assert_agrees(lambda x: decay(x, 4), sample((3, count)))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("count", [17, 40, 301])
def test_loops_with_individual_numbers_of_rounds_agree_with_jax(count, dtype):
    """Run 0 to 60 rounds repeatedly, with tables, truth values and inner loops."""
    with jax.enable_x64(dtype is np.float64):
        x = sample((3, count), dtype=dtype)
        rounds = np.random.default_rng(1).geometric(0.2, (4, count)) % 61
        rounds[:, : count // 3] = 0
        rounds[:, count // 3] = 60

        def whole(x, rounds):
            table = jnp.stack([x[0] * k for k in range(5)])

            def turn(total, mine):
                def advance(state):
                    place, number, up, count = state
                    number = jnp.where(up, 1, -1) * table[number % 5] * 0.1 + jnp.sin(place)
                    smaller = lax.while_loop(lambda v: jnp.abs(v) > 0.3, lambda v: 0.5 * v, number)
                    return place + smaller, count, smaller > x[1], count + 1

                start = total, jnp.int32(0), jnp.bool_(True), jnp.int32(0)
                place, *_, up, count = lax.while_loop(lambda s: s[3] < mine, advance, start)
                return place + up, (place, count)

            return lax.scan(turn, x[2], rounds)

        assert_agrees(whole, x, jnp.asarray(rounds, jnp.int32), rtol=1e-5, atol=1e-5)


def test_vectors_run_alone_if_their_memory_is_large(monkeypatch):
    """Results are equal to the last bit if no two vectors run together."""

    def decayed(x):
        return fuse(
            lambda x: lax.while_loop(lambda v: jnp.abs(v) > 0.1, lambda v: 0.7 * v, x),
            x,
            batch_ndim=1,
        )

    x = sample((40,))
    expected = jax.jit(decayed)(x)
    monkeypatch.setattr(machine_constants, "LARGEST_GROUP", 1)
    np.testing.assert_array_equal(jax.jit(lambda x: decayed(x))(x), expected)
    assert (np.abs(expected) <= 0.1).all()


def test_nested_loops_agree_with_jax():
    """Inner loops use the counter, the carry and the stacked rows of outer loops."""

    def outer(carry, i):
        def inner(total, row):
            return total + row * i, total

        total, partial = lax.scan(inner, carry[0], carry)

        def search(state):
            return state[0] * 1.5 + 0.1, state[1] + i

        found = lax.while_loop(lambda s: s[0] < carry[1] + i, search, (abs(partial[1]), i))
        return jnp.roll(carry, 1).at[0].set(jnp.sin(total)), (found, partial.sum())

    assert_agrees(
        lambda x: lax.scan(outer, x, jnp.arange(3.0)), sample((4, 18)), rtol=1e-4, atol=1e-5
    )


def test_stacked_values_may_be_read_again():
    def function(x):
        _, rows = lax.scan(lambda c, _: (c + x, c * x[0]), x, None, length=5)
        again = lax.scan(lambda c, row: (c * 0.5 + row, None), x, rows)[0]
        several = lax.fori_loop(0, 6, lambda i, c: c + rows[i % 5] * i, x)
        some = lax.fori_loop(2, 2 + (x[0] > 0), lambda i, c: c + i, x)
        return again, several, rows[2], rows[::-2].sum(0), some

    assert_agrees(function, sample((3, 9)), rtol=1e-5)


def test_updates_at_the_counter_agree_with_jax():
    def function(x):
        def turn(i, y):
            return lax.dynamic_update_index_in_dim(y, y[(i + 3) % 4] + x[i], i, 0)

        return lax.fori_loop(0, 4, turn, x)

    assert_agrees(function, sample((4, 6)))


def collatz(start):
    def advance(state):
        n, rounds = state
        return jnp.where(n % 2 == 0, n // 2, 3 * n + 1), rounds + 1

    return lax.while_loop(lambda state: state[0] != 1, advance, (start, 0))


@pytest.mark.parametrize("count", COUNTS)
def test_finished_individuals_do_not_change(count):
    """Run 1 to 111 rounds. The last vector holds fewer individuals than the others."""
    assert_agrees(lambda x: collatz(x[0]), jnp.arange(1, 1 + count)[None] * 27 % 83 + 1)


def test_loops_of_no_rounds_agree_with_jax():
    def function(x):
        nothing = lax.while_loop(lambda c: False, lambda c: c + 1, x)
        return nothing, lax.while_loop(lambda c: c[0] > 100, lambda c: c + 1, x)

    for count in (1, 4):
        assert_agrees(function, sample((2, count)))


def test_nan_ends_the_loop_of_one_individual_only():
    """NaN makes the condition of one individual false. The other individuals continue."""

    def function(x):
        def advance(state):
            return state[0] * state[0] + x[0], state[1] + 1

        return lax.while_loop(lambda s: (s[0] < 50) & (s[1] < 9), advance, (x[0] * x[1], 0))

    x = sample((2, 9), 4).at[0, 3].set(jnp.nan).at[0, 5].set(jnp.inf) + 1
    assert_agrees(function, x, rtol=1e-4)


BRANCHES = [lambda x: x * 2, lambda x: jnp.sin(x), lambda x: x.at[0].set(7.0)]


def test_branches_that_depend_on_the_individual_agree_with_jax():
    places = jnp.array([0, 1, 2, -5, 9, 1])
    assert_agrees(lambda x, i: lax.switch(i, BRANCHES, x), sample((2, 6)), places)
    assert_agrees(lambda x: lax.cond(x[0] > x[1], *BRANCHES[:2], x), sample((2, 6)))


@pytest.mark.parametrize("place", [-3, 0, 1, 2, 8])
def test_uniform_branches_agree_with_jax(place):
    def function(x):
        def turn(c, i):
            return lax.switch(i + place, BRANCHES, c), lax.switch(jnp.int32(place), BRANCHES, x)

        return lax.scan(turn, x, jnp.arange(3))

    assert_agrees(function, sample((2, 6)))


def kepler(given):
    """Return the angle of a planet from its eccentricity and mean angle, by Newton's method."""

    def closer(angle):
        eccentricity, mean = given
        miss = angle - eccentricity * jnp.sin(angle) - mean
        return angle - miss / (1 - eccentricity * jnp.cos(angle)), jnp.abs(miss)

    def search(angle):
        def continues(state):
            return (state[1] > 1e-15) & (state[2] < 20)

        def advance(state):
            return *closer(state[0]), state[2] + 1

        count = jnp.zeros(angle.shape, jnp.int32)
        found, _, _ = while_each(continues, advance, (angle, jnp.ones_like(angle), count))
        return found, found

    return implicit(search, lambda angle: closer(angle)[0], given[1], given[1])


PLANETS = jnp.stack([jnp.linspace(0.01, 0.4, 11), jnp.linspace(-2.0, 3.0, 11)])


def derivatives(given):
    """Return the derivatives in closed form, by mean = angle - eccentricity sin(angle)."""
    angle = kepler(given)
    return jnp.stack([jnp.sin(angle), jnp.ones_like(angle)]) / (1 - given[0] * jnp.cos(angle))[None]


def test_searches_agree_with_jax(x64):
    given = PLANETS.astype("float64")
    (angle,) = fused(kepler, given)
    np.testing.assert_allclose(angle - given[0] * np.sin(angle), given[1], atol=1e-14)
    assert_agrees(kepler, given, rtol=1e-13)


def test_derivatives_of_searches_equal_the_closed_form(x64):
    """Check both modes, in JAX and fused, differentiated outside and inside the program."""
    given = PLANETS.astype("float64")
    expected = derivatives(given)
    for run in (kepler, functools.partial(fuse, kepler, batch_ndim=1)):
        backward = jax.jit(jax.grad(lambda given, run=run: run(given).sum()))(given)
        np.testing.assert_allclose(backward, expected, rtol=1e-11)
        forward = [
            jax.jit(lambda x, d, run=run: jax.jvp(run, (x,), (d,))[1])(given, direction)
            for direction in jnp.broadcast_to(jnp.eye(2)[..., None], (2, *given.shape))
        ]
        np.testing.assert_allclose(forward, expected, rtol=1e-11)
    for differentiate in (jax.grad, jax.jacfwd):
        (within,) = fused(differentiate(kepler), given)
        np.testing.assert_allclose(within, expected, rtol=1e-11)


def test_derivatives_of_a_search_by_shared_values(x64):
    """Compare the derivatives of a pytree with finite differences."""

    def settle(gain, x):
        def closer(state):
            # One step of Newton's method for a = tanh(gain b + x0), b = 0.4 a + x1.
            _, (b,) = state
            tangent = jnp.tanh(gain * b + x[0])
            slope = gain * (1 - tangent * tangent)
            new = (tangent + slope * (x[1] - b)) / (1 - 0.4 * slope)
            return new, (0.4 * new + x[1],)

        def search(state):
            state = lax.fori_loop(0, 30, lambda _, state: closer(state), state)
            return state, state

        start = x[0], (x[1],)
        a, (b,) = implicit(search, closer, start, start)
        return a * b

    x = sample((2, 7), dtype=np.float64)

    def total(gain, x):
        return fuse(lambda x: settle(gain, x), x, batch_ndim=1).sum()

    by_gain, by_x = jax.jit(jax.grad(total, (0, 1)))(0.3, x)
    step = 1e-6
    total = jax.jit(total)
    by_gain, by_x = float(by_gain), np.asarray(by_x)
    assert by_gain == pytest.approx(
        float(total(0.3 + step, x) - total(0.3 - step, x)) / 2e-6, rel=1e-7
    )
    for i in range(2):
        moved = [total(0.3, x.at[i, 4].add(sign * step)) for sign in (1, -1)]
        assert by_x[i, 4] == pytest.approx(float(moved[0] - moved[1]) / 2e-6, rel=1e-7)


def scheduled(function, *values):
    builder = Builder()
    inputs = [builder.argument(value.shape, value.dtype) for value in values]
    results = trace_closed(builder, jax.make_jaxpr(function)(*values), inputs)
    return schedule(eliminate_dead_code(builder.graph(results)))


def test_unused_values_are_not_carried():
    def function(x):
        def turn(carry, _):
            useful, waste, apart = carry
            return (useful * x, waste * useful, apart + 1.0), (waste, useful)

        (useful, _, _), (_, path) = lax.scan(turn, (x, x, x), None, length=3)
        return useful, path[2]

    graph = scheduled(function, np.ones(2, np.float32))
    (_, loop), _ = graph.runs[graph.top]
    assert len(graph.kept[loop]) == 2
    assert sum(node.op == "list" for node in graph.nodes) == 2
    ((body, _),) = graph.runs[loop.detail.body]
    assert [node.op for node in body] == ["mul", "mul"]


def test_invariants_are_computed_before_the_loop():
    def function(x):
        return lax.scan(lambda c, _: (c * jnp.sqrt(x[0] * x[1]), None), x, None, length=3)[0]

    graph = scheduled(function, np.ones(2, np.float32))
    (before, loop), _ = graph.runs[graph.top]
    assert [node.op for node in before] == ["mul", "sqrt"]
    ((body, _),) = graph.runs[loop.detail.body]
    assert {node.op for node in body} == {"mul"}


def test_inner_loops_skip_individuals_that_left_the_outer():
    """The inner loop's condition is combined with the outer loop's condition."""

    def function(x):
        def inner(y):
            return lax.while_loop(lambda y: y[0] > 1, lambda y: 0.5 * y, y)

        def outer(state):
            y, rounds = state
            return inner(y) + x, rounds - 1

        return lax.while_loop(lambda state: state[1] > 0, outer, (x, x[1]))[0]

    graph = scheduled(function, np.ones(2, np.float32))
    (_, outside), _ = graph.runs[graph.top]
    (_, inside), _ = graph.runs[outside.detail.body]
    wants, condition = inside.detail.condition, outside.detail.condition
    assert wants.op == "and" and condition.op == "gt"
    assert {node.op for node in wants.operands} == {"gt"}
    assert_agrees(function, jnp.abs(sample((2, 40))) * jnp.array([[20.0], [3.0]]))
