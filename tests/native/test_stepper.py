"""Repeated calls of a program for one individual, without XLA."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import sample, with_instructions
from test_same_bits import ROWS, natively, step

from evo_cpg.native import engine
from evo_cpg.native.backend import llvm
from evo_cpg.native.ir import Unsupported
from evo_cpg.native.native import Stepper

START = 0.5 * sample((ROWS,), 3)


def advance(state, push):
    x, none, count, flag = state
    found, rounds = step(x + push)
    return found, none, count + rounds, flag ^ (rounds > 1)


def states(start, pushes):
    """Return the numbers after each call."""
    state = jnp.asarray(start), jnp.zeros((0,)), jnp.int32(0), jnp.asarray(True)
    stepper = Stepper(advance, state, jnp.zeros(ROWS), "a test")
    found = []
    for push in pushes:
        stepper(push)
        found.append([x.copy() for x in stepper.leaves])
    return found


PUSHES = 0.1 * sample((4, ROWS), 5)


@pytest.mark.parametrize("instructions", ["host", "avx2", "sse"])
def test_calls_have_the_bits_of_a_population(instructions):
    found = with_instructions(instructions, lambda: states(START, PUSHES))
    x, total = np.repeat(START[:, None], 16, 1), 0
    for (numbers, none, count, _), push in zip(found, PUSHES, strict=True):
        there = x + push[:, None]
        x, rounds = with_instructions(instructions, lambda there=there: natively(step, there))
        total += rounds[0]
        np.testing.assert_array_equal(numbers, x[:, 0])
        assert (none.size, count) == (0, total)


def test_denormal_numbers_become_zero_as_in_xla():
    tiny, one = jnp.full(1, 1e-38), jnp.ones(1)
    stepper = Stepper(lambda x, y: x * y, tiny, one, "a test")
    stepper(np.ones(1))
    assert stepper.leaves[0] == jax.jit(lambda x, y: x * y)(tiny, one) == 0


def test_plain_jax_has_no_stepper():
    with engine.using(engine.Engine("jax")), pytest.raises(Unsupported, match="not native code"):
        states(START, PUSHES)


def test_near_pointers_keep_every_place():
    access = "%v{} = getelementptr i8, ptr %{}, i64 {}"
    places = [(b, x) for b in ("scratch", "frame") for x in (-9000, -4, 0, 124, 256, 4000, 1 << 20)]
    body = "\n".join(access.format(k, *place) for k, place in enumerate(places))
    text = llvm._with_near_pointers(body)
    found = re.findall(r"%(\w+) = getelementptr i8, ptr %(\w+), i64 (-?\d+)", text)
    middles = {name.replace("middle", "near"): (b, int(x)) for name, b, x in found}
    for k, (base, place) in enumerate(places):
        name, offset = middles[f"v{k}"]
        base_of_name, middle = middles.get(name, (name, 0))
        assert (base_of_name, middle + offset) == (base, place)
    used = {name for name, _ in middles.values() if name.startswith("near")}
    assert len(used) == llvm._POINTERS
