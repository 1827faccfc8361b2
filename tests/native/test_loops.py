"""Loops, branches, sums in memory and fixed points of fused functions agree with JAX."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import assert_agrees, every, fused, sample, with_instructions
from jax import lax
from jax.test_util import check_grads

from evo_cpg.native import machine_constants
from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.frontend.lower import trace
from evo_cpg.native.fuse import fuse, implicit, unset, while_each
from evo_cpg.native.passes import eliminate_dead_code, schedule

COUNTS = [1, 5, 16, 19]
POINTS, SIZE = 9, 30


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


def test_counted_loops_agree_with_jax():
    cases = itertools.product((0, 1, 2, 7), (False, True))
    loops = {case: functools.partial(decay, length=case[0], reverse=case[1]) for case in cases}
    assert_agrees(every(loops), sample((3, 5)))


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


def nested(x):
    """Use the counter, the carry and the stacked rows of outer loops in inner loops."""

    def outer(carry, i):
        def inner(total, row):
            return total + row * i, total

        total, partial = lax.scan(inner, carry[0], carry)

        def search(state):
            return state[0] * 1.5 + 0.1, state[1] + i

        found = lax.while_loop(lambda s: s[0] < carry[1] + i, search, (abs(partial[1]), i))
        return jnp.roll(carry, 1).at[0].set(jnp.sin(total)), (found, partial.sum())

    return lax.scan(outer, x, jnp.arange(3.0))


def stacked(x):
    _, rows = lax.scan(lambda c, _: (c + x, c * x[0]), x, None, length=5)
    again = lax.scan(lambda c, row: (c * 0.5 + row, None), x, rows)[0]
    several = lax.fori_loop(0, 6, lambda i, c: c + rows[i % 5] * i, x)
    some = lax.fori_loop(2, 2 + (x[0] > 0), lambda i, c: c + i, x)
    return again, several, rows[2], rows[::-2].sum(0), some


def updated(x):
    def turn(i, y):
        return lax.dynamic_update_index_in_dim(y, y[(i + 3) % 4] + x[i], i, 0)

    return lax.fori_loop(0, 4, turn, x)


def without_rounds(x):
    nothing = lax.while_loop(lambda c: False, lambda c: c + 1, x)
    return nothing, lax.while_loop(lambda c: c[0] > 100, lambda c: c + 1, x)


@pytest.mark.parametrize("count", [1, 18])
def test_loops_agree_with_jax(count):
    loops = [nested, stacked, updated, without_rounds]
    assert_agrees(every({f.__name__: f for f in loops}), sample((4, count)), rtol=1e-4, atol=1e-5)


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


def test_uniform_branches_agree_with_jax():
    def at(place, x):
        def turn(c, i):
            return lax.switch(i + place, BRANCHES, c), lax.switch(jnp.int32(place), BRANCHES, x)

        return lax.scan(turn, x, jnp.arange(3))

    places = -3, 0, 1, 2, 8
    assert_agrees(every({k: functools.partial(at, k) for k in places}), sample((2, 6)))


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


@pytest.mark.slow
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

    check_grads(jax.jit(total), (0.3, x), 1, ["rev"], atol=1e-6, rtol=1e-6, eps=1e-6)


def scheduled(function, *values):
    builder = Builder()
    inputs = [builder.argument(value.shape, value.dtype) for value in values]
    results = trace(builder, jax.make_jaxpr(function)(*values), inputs)
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


# Skipped branches, and arrays that loops add to.


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


@pytest.mark.parametrize("count", [1, 16, 301])
def test_long_branches_agree_with_jax(count, texts):
    # A branch stretches rounding up to 1.1 * 1.2 * ... * 1.8 = 18 times, and two may be taken.
    assert_agrees(choose, sample((6, count)), rtol=1e-5, atol=18**2 * 2**-24)
    functions = [each for text in texts for each in text.split("define ")]
    assert any("@stretch" in each and "label %inside" in each for each in functions)


def switched(x):
    which = jnp.clip(jnp.floor(x[0] * 3), -1, 4).astype(jnp.int32)
    branches = [lambda y, k=k: long_branch(y, float(k)) for k in range(3)]
    return lax.switch(which, branches, x)


def branch_in_branch(x):
    def inner(x):
        return lax.cond(x[1] > 0, lambda y: long_branch(y, 1.0), lambda y: 2 * y, x)

    return lax.cond(x[0] > 0, lambda y: inner(long_branch(y, 2.0)), lambda y: -y, x)


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


@pytest.mark.parametrize("count", [1, 16, 301])
def test_sums_at_computed_places_agree_with_jax(count, texts):
    assert_agrees(scattered, sample((3, count)), rtol=1e-5, atol=1e-5)
    assert all("select" in text for text in texts)


def unconditional(x):
    def turn(total, k):
        return total.at[k % SIZE].add(x[0] * k, mode="promise_in_bounds"), None

    total, _ = lax.scan(turn, jnp.full(SIZE, 0.5, x.dtype), jnp.arange(50))
    return total.sum(), total[7]


def sums_in_nested_loops(x):
    def inner(total, k):
        return total.at[k].add(x[1] * x[0], mode="promise_in_bounds"), None

    def outer(total, j):
        total, _ = lax.scan(inner, total, jnp.arange(4) + j)
        return total, x[0]

    return lax.scan(outer, jnp.zeros(SIZE, x.dtype), jnp.arange(20))


def sums_in_packed_loops(x):
    """Add in every round of a packed loop, from tables and lists made before the loop."""
    first, list_ = scattered(x)

    def advance(state):
        y, count = state
        total, _ = scattered(y, lambda p, mine: (mine > 0.2) & (list_[p] > 0))
        return y + 0.01 * total[:3] + 0.001 * first[4], count + 1

    return lax.while_loop(lambda s: s[1] < 1 + jnp.floor(3 * s[0][2]), advance, (x, 0.0))


def sums_read_by_their_loop(x):
    """Such a loop cannot use the code for sums, but agrees."""

    def turn(total, k):
        new = total.at[3].add(x[0], mode="promise_in_bounds")
        return new, new[3]

    return lax.scan(turn, jnp.zeros(SIZE, x.dtype), jnp.arange(6))


BRANCHES_AND_SUMS = [
    switched,
    branch_in_branch,
    unconditional,
    sums_in_nested_loops,
    sums_in_packed_loops,
    sums_read_by_their_loop,
]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_branches_and_sums_agree_with_jax(dtype):
    with jax.enable_x64(dtype is np.float64):
        each = every({function.__name__: function for function in BRANCHES_AND_SUMS})
        assert_agrees(each, sample((3, 301), dtype=dtype), rtol=1e-4, atol=1e-4)


def test_a_list_read_one_by_one_is_not_copied(texts):
    def function(x):
        _, mine = lax.scan(lambda c, k: (c, jnp.sin(x[0] * k)), None, jnp.arange(40.0))
        return lax.scan(lambda c, y: (c + y * y, None), x[1], mine)[0]

    assert_agrees(function, sample((3, 21)), rtol=1e-5, atol=1e-5)
    assert all(text.count("store volatile") < 40 for text in texts)


@pytest.mark.slow
def test_derivatives_of_branches_and_sums_agree_with_jax():
    def function(x):
        total, mine = scattered(x)
        return (total**2).sum() + choose(x.repeat(2))[0].sum() + (mine**3).sum()

    x = sample((3, 21))
    got = jax.jit(jax.grad(lambda x: fuse(function, x, batch_ndim=1).sum()))(x)
    expected = jax.jit(jax.grad(lambda x: jax.vmap(function, -1)(x).sum()))(x)
    np.testing.assert_allclose(got, expected, rtol=1e-3, atol=1e-3)


SLOW = pytest.param("sse", marks=pytest.mark.slow)
each_set = pytest.mark.parametrize("instructions", ["avx512", "avx2", SLOW])


def histogram(x, mode="drop"):
    """Add twice to a place of each individual, which may lie outside the array."""
    own = jnp.floor(4 * x[0]).astype(jnp.int32)

    def turn(total, k):
        total = total.at[jnp.stack([own, own])].add(k * x[:2], mode=mode)
        return total.at[own + k.astype(jnp.int32) % 3].add(x[1], mode=mode), None

    return lax.scan(turn, jnp.full(8, 0.5, x.dtype), jnp.arange(5, dtype=x.dtype))[0]


def chosen(x):
    """List the positive numbers of each individual, and sum their squares until they are large."""

    def append(carry, k):
        rows, count = carry
        place = jnp.where(x[k] > 0, count, 9)
        rows = rows.at[place].set(jnp.stack([x[k], x[k] * x[0]]), mode="drop")
        return (rows, count + (x[k] > 0)), None

    start = unset((9, 2), x), jnp.int32(0)
    (rows, count), _ = lax.scan(append, start, jnp.arange(9))

    def total(y):
        def add(sums, k):
            square = (y * rows[k] ** 2).sum()
            return lax.cond(k < count, lambda s: s + square, lambda s: s, sums), None

        return lax.scan(add, 0 * y, jnp.arange(9))[0]

    larger = lax.while_loop(lambda y: (y > 0) & (y < 9), lambda y: y + 0.1 + total(y), x[1])
    return larger, total(x[2]), count


def histogram_in_packed_loop(x):
    """Individuals that have finished add nothing."""

    def advance(state):
        y, rounds = state
        return y + 0.01 * histogram(y)[:3], rounds + 1

    return lax.while_loop(lambda s: s[1] < 1 + jnp.floor(3 * s[0][2]), advance, (x, 0.0))


@each_set
@pytest.mark.parametrize("count", [1, 301])
def test_each_individual_writes_to_its_own_places(count, instructions):
    functions = [histogram, chosen, histogram_in_packed_loop]

    def check():
        # New functions, so that JAX traces them for each set of instructions.
        own = [lambda x, f=f: f(x if f is chosen else x[:3]) for f in functions]
        assert_agrees(every(dict(enumerate(own))), sample((9, count)), rtol=1e-4, atol=1e-4)

    with_instructions(instructions, check)


@each_set
def test_broken_promises_write_within_the_array(instructions):
    """A place outside the array is clamped, although the program promises that there is none."""
    x = 1e6 * sample((3, 40))

    def check():
        run = functools.partial(histogram, mode="promise_in_bounds")
        (got,) = fused(run, x)
        np.testing.assert_array_equal(got[1:-1], 0.5)

    with_instructions(instructions, check)


@pytest.mark.parametrize("function", [histogram, lambda x: chosen(x)[1]])
def test_derivatives_of_own_places_agree_with_jax(function):
    x = sample((9, 21))

    def derivative(run):
        return jax.grad(lambda x: (run(x) ** 2).sum())

    got = jax.jit(derivative(lambda x: fuse(function, x, batch_ndim=1)))(x)
    expected = jax.jit(derivative(jax.vmap(function, -1, -1)))(x)
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-4)
    if function is histogram:
        # The derivative of sums is a native program itself.
        assert_agrees(derivative(function), x, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("instructions", ["avx512", "avx2"])
def test_own_places_have_the_same_bits(instructions):
    x = sample((3, 300))
    (expected,) = with_instructions("host", lambda: fused(lambda x: histogram(x), x))
    (got,) = with_instructions(instructions, lambda: fused(lambda x: histogram(x), x))
    np.testing.assert_array_equal(got, expected)
