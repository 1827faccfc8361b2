"""The order of operations, and the choice of values in registers."""

import functools

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import with_instructions
from hypothesis import given, settings
from jax import lax

from evo_cpg.native.backend.storage import Registers
from evo_cpg.native.engine import Engine, using
from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.fuse import fuse
from evo_cpg.native.passes import ordered

INPUTS, REGISTERS = 5, 8
LIMIT = 6  # Two of eight registers are spare.


@st.composite
def programs(draw):
    """Draw operations in the order of their creation, and the results."""
    builder = Builder()
    known = list(builder.argument((INPUTS,), np.float32))
    made = []
    for _ in range(draw(st.integers(1, 60))):
        pair = [known[draw(st.integers(0, len(known) - 1))] for _ in range(2)]
        node = builder.make("max", pair, np.float32)
        if node not in made:
            known.append(node)
            made.append(node)
    used = {operand for node in made for operand in node.operands}
    return made, [node for node in made if node not in used]


@given(programs())
@settings(deadline=None)
def test_order_computes_all_of_it_operands_first(program):
    made, _ = program
    order = ordered(made)
    assert sorted(order, key=made.index) == made
    place = {node: i for i, node in enumerate(order)}
    for node in made:
        assert all(place.get(operand, -1) < place[node] for operand in node.operands)


def test_operations_that_free_registers_come_early():
    """Order sums of neighbours, made level by level: each pair is added before the next pair."""
    builder = Builder()
    rows = list(builder.argument((16,), np.float32))
    made = []
    while len(rows) > 1:
        rows = [builder.apply("add", a, b) for a, b in zip(rows[::2], rows[1::2], strict=True)]
        made += rows

    def most_waiting(order):
        waiting, most = set(), 0
        for node in order:
            waiting -= set(node.operands)
            waiting.add(node)
            most = max(most, len(waiting))
        return most

    assert most_waiting(made) == 8
    assert most_waiting(ordered(made)) == 4


@given(programs())
@settings(deadline=None)
def test_no_choice_reads_memory_less_often(program):
    order, expected = program
    steps = [*({*node.operands} for node in order), *({node} for node in expected)]
    registers, reads = Registers(REGISTERS), 0
    registers.expect(order, expected)
    for i, needed in enumerate(steps):
        for node in needed:
            if registers.names.get((node, True)) is None:
                reads += 1
                registers.hold(node, True, "read")
        if i < len(order):
            registers.hold(order[i], True, "computed")
        registers.pass_on()
        assert sum(registers.names.get((node, True)) is not None for node in held(steps)) <= LIMIT
    assert reads <= reads_of_least_recently_used(order, steps)


def held(steps):
    return {node for needed in steps for node in needed}


def reads_of_least_recently_used(order, steps):
    """Return the reads of memory under another eviction policy. Unused values leave at once."""
    last, reads = {}, 0
    ends = {node: i for i, needed in enumerate(steps) for node in needed}
    for i, needed in enumerate(steps):
        reads += sum(node not in last for node in needed)
        last |= dict.fromkeys([*needed, *order[i : i + 1]], i)
        for node in list(last):
            if ends.get(node, -1) <= i:
                del last[node]
        while len(last) > LIMIT:
            del last[min(last, key=last.get)]
    return reads


@pytest.mark.parametrize(
    "instructions",
    ["host", *(pytest.param(name, marks=pytest.mark.slow) for name in ("avx2", "sse"))],
)
@pytest.mark.parametrize("count", [*(pytest.param(n, marks=pytest.mark.slow) for n in (1, 3)), 40])
def test_many_waiting_values_are_kept(count, instructions):
    """Each of a hundred products is used twice, far apart."""

    def function(x, xp=jnp):
        products = [x[i] * x[i + 1] for i in range(100)]
        there, back = xp.ones_like(x[0]), xp.ones_like(x[0])
        for product in products:
            there = xp.maximum(there * 0.5, product)
        for product in reversed(products):
            back = xp.minimum(back * 0.5, product)
        return there, back, xp.stack(products)

    x = np.random.default_rng(0).normal(size=(101, count)).astype(np.float32)
    run = functools.partial(fuse, function, batch_ndim=1)
    found = with_instructions(instructions, lambda: jax.jit(run)(x))
    for got, expected in zip(found, function(x, np), strict=True):
        np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("counted", [True, False])
def test_values_may_swap_places_in_a_loop(counted):
    """Each place takes the value of the next place before that value is overwritten."""
    rounds = jnp.array([0.0, 1.0, 2.0, 5.0, 41.0, 3.0])

    def function(x, rounds):
        def turn(carry):
            row, done = carry
            return jnp.concatenate([row[1:], 1.5 * row[:1]]), done + 1

        if counted:
            return lax.scan(lambda c, _: (turn(c), None), (x, rounds), None, length=7)[0]
        return lax.while_loop(lambda carry: carry[1] < rounds, turn, (x, jnp.zeros_like(rounds)))

    x = jnp.arange(40 * 6, dtype=jnp.float32).reshape(40, 6)
    with using(Engine("native")):
        found = jax.jit(functools.partial(fuse, function, batch_ndim=1))(x, rounds)
    for got, expected in zip(found, jax.vmap(function, -1, -1)(x, rounds), strict=True):
        np.testing.assert_array_equal(got, expected)
