"""Random programs on scalars, and their derivatives, agree with JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import fused, plain
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax

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
FEW, MANY = settings(max_examples=25), settings(max_examples=1000)


@FEW
@given(programs(EVERY))
def test_values(program):
    check(program, EVERY)


@settings(max_examples=12)
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
