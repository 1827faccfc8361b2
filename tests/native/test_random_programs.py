"""Random programs and their derivatives, and programs that draw random numbers, agree with JAX."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import assert_agrees, fused, plain
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax

from evo_cpg.native.fuse import fuse
from evo_cpg.native.jax_internals import threefry2x32

COUNT = 21

# Types of the operands and of the result (f, i, b), and the operation. Smooth operations have no
# large derivatives.
SMOOTH = {
    "add": ("ff", "f", lambda a, b: a + b),
    "sub": ("ff", "f", lambda a, b: a - b),
    "mul": ("ff", "f", lambda a, b: a * b),
    "twice": ("f", "f", lambda a: 2.0 * a - 1.0),
    "square": ("f", "f", lambda a: a**2),
    "over": ("ff", "f", lambda a, b: a / (1.0 + b * b)),
    "minus": ("f", "f", lambda a: -a),
    "exp": ("f", "f", lambda a: jnp.exp(-a * a)),
    "tanh": ("f", "f", jnp.tanh),
    "sin": ("f", "f", jnp.sin),
    "cos": ("f", "f", jnp.cos),
    "log": ("f", "f", lambda a: jnp.log(1.0 + a * a)),
    "root": ("f", "f", lambda a: jnp.sqrt(1.0 + a * a)),
    "angle": ("ff", "f", lambda a, b: jnp.arctan2(a, 1.0 + b * b)),
    "choice": ("bff", "f", jnp.where),
}
KINKED = {
    "abs": ("f", "f", jnp.abs),
    "max": ("ff", "f", jnp.maximum),
    "min": ("ff", "f", jnp.minimum),
    "less": ("ff", "b", lambda a, b: a < b),
    "positive": ("f", "b", lambda a: a >= 0),
    "both": ("bb", "b", lambda a, b: a & b),
    "either": ("bb", "b", lambda a, b: a | b),
    "not": ("b", "b", lambda a: ~a),
}
# Dividends are halved: XLA ends the process if, compiling, it divides the least integer by -1.
WHOLE = {
    "i add": ("ii", "i", lambda a, b: a + b),
    "i sub": ("ii", "i", lambda a, b: a - b),
    "i mul": ("ii", "i", lambda a, b: a * b),
    "i div": ("ii", "i", lambda a, b: lax.div(a >> 1, b)),
    "i rem": ("ii", "i", lambda a, b: lax.rem(a >> 1, b)),
    "i floor": ("ii", "i", lambda a, b: (a >> 1) // b),
    "i and": ("ii", "i", lambda a, b: a & b),
    "i xor": ("ii", "i", lambda a, b: a ^ b),
    "i shift": ("ii", "i", lax.shift_left),
    "i down": ("ii", "i", lax.shift_right_arithmetic),
    "i max": ("ii", "i", jnp.maximum),
    "i sign": ("i", "i", jnp.sign),
    "i not": ("i", "i", lambda a: ~a),
    "i choice": ("bii", "i", jnp.where),
    "i less": ("ii", "b", lambda a, b: a < b),
    "i same": ("ii", "b", lambda a, b: a == b),
    "i of b": ("b", "i", lambda a: a.astype(jnp.int32)),
    "f of b": ("b", "f", lambda a: a * 1.5),
    "f of i": ("i", "f", lambda a: (a % 8) * 0.25),
}
CONSTANTS = {"f": [0.0, 1.0, -1.0, 0.5, 3.0, -0.7], "i": [0, 1, -1, 7, 40, -(2**31)], "b": [True]}
NUMPY = {"f": np.float32, "i": np.int32, "b": np.bool_}


@st.composite
def programs(draw, operations):
    """Draw operations on earlier values, and the indices of the results."""
    kinds = [*"fffib"]
    steps = []
    for kind, values in CONSTANTS.items():
        steps.append((kind, draw(st.sampled_from(values))))
        kinds.append(kind)
    for _ in range(draw(st.integers(3, 25))):
        name = draw(st.sampled_from(sorted(operations)))
        expected, kind, _ = operations[name]
        places = []
        for each in expected:
            fitting = [i for i, one in enumerate(kinds) if one == each]
            # Recent values are preferred, so that the program is deep.
            places.append(fitting[-1 - min(draw(st.integers(0, 6)), len(fitting) - 1)])
        steps.append((name, places))
        kinds.append(kind)
    return steps, [max(i for i, one in enumerate(kinds) if one == kind) for kind in "fib"]


def interpreted(program, operations):
    """Return the program as a function, of its constants too if they are passed."""
    steps, results = program

    def run(floats, number, flag, *constants):
        values, given = [*floats, number[0], flag[0]], iter(constants)
        for what, rest in steps:
            if what in operations:
                values.append(operations[what][2](*(values[place] for place in rest)))
            elif constants:
                values.append(next(given)[0])
            else:
                values.append(jnp.asarray(rest, (NUMPY | {"f": floats.dtype})[what]))
        return [jnp.asarray(values[place]) for place in results]

    return run


def inputs():
    draws = np.random.default_rng(0)
    whole = draws.integers(-(2**31), 2**31, (1, COUNT)).astype(np.int32)
    whole[0, :9] = [0, 1, -1, 2, 5, -8, 31, 2**31 - 1, -(2**31)]
    floats = draws.normal(size=(3, COUNT)).astype(np.float32)
    return [jnp.asarray(x) for x in (floats, whole, draws.random((1, COUNT)) < 0.5)]


def compare(function, program):
    """Assert that native code is exact within rounding, measured as JAX's error to float64.

    JAX gets the constants as arguments, so that it cannot repeat errors of constant folding.
    """
    steps, _ = program
    known = [np.full((1, COUNT), v, NUMPY[k]) for k, v in steps if k in NUMPY]
    values = inputs()
    got, rough = fused(function, *values), plain(function, *values, *known)
    with jax.enable_x64(True):
        twice = [x.astype("float64") if x.dtype == "float32" else x for x in (*values, *known)]
        exact = plain(function, *twice)
    for one, other, best in zip(got, rough, exact, strict=True):
        assert one.dtype == other.dtype
        if one.dtype.kind != "f":
            # Rounding may change a comparison, and with it integers and flags.
            sure = other == best.astype(other.dtype)
            assert (one != other)[sure].sum() <= 1
            continue
        finite = np.isfinite(other) & np.isfinite(best)
        one, other, best = one[finite], other[finite], best[finite]
        # JAX may round nothing by chance, so the median error counts too.
        error = np.abs(other - best)
        usual = np.median(error) if error.size else 0.0
        off = np.abs(one - best) > 1e-5 * (1 + np.abs(best)) + 30 * error + 100 * usual
        assert off.sum() <= 1, (one[off], other[off], best[off])


def check(program, operations):
    compare(interpreted(program, operations), program)


def check_derivatives(program, operations):
    def derivatives(floats, *others):
        function = interpreted(program, operations)
        return jax.grad(lambda x: function(x, *others)[0])(floats)

    compare(lambda *values: [derivatives(*values)], program)


EVERY = {**SMOOTH, **KINKED, **WHOLE}
FEW, MANY = settings(max_examples=12), settings(max_examples=1000)


@FEW
@given(programs(EVERY))
def test_values(program):
    check(program, EVERY)


@settings(max_examples=6)
@given(programs({**SMOOTH, **KINKED}))
def test_derivatives(program):
    check_derivatives(program, {**SMOOTH, **KINKED})


@pytest.mark.slow
@MANY
@given(programs(EVERY))
def test_values_of_many(program):
    check(program, EVERY)


@pytest.mark.slow
@settings(max_examples=300)
@given(programs({**SMOOTH, **KINKED}))
def test_derivatives_of_many(program):
    check_derivatives(program, {**SMOOTH, **KINKED})


# Random numbers.

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
