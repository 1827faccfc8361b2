"""Every operation on scalars, at ordinary and extreme numbers, against JAX on a CPU."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import assert_agrees, fused, sample
from jax import lax

INFINITE = [np.inf, -np.inf, np.nan]
FLOATS = jnp.array([0, -0.0, 0.5, -0.5, 1.5, 2.5, -2.5, 1, -1, 3.7, 1e-3, 300, 3e9, -3e9, 1e20])
FLOATS = jnp.concatenate([FLOATS, -jnp.array([7.0, 200, 1e20]), jnp.array(INFINITE)])

# All pairs of these numbers.
PAIRS = jnp.stack([x.reshape(-1) for x in jnp.meshgrid(FLOATS, FLOATS)])


def pairs(dtype):
    """Return all pairs of integers next to zero and next to the limits of the type."""
    ends = np.iinfo(dtype)
    values = [*range(-4, 5), 7, 8, 31, 32, 33, 40, 63, 64, 100, ends.min, ends.min + 1, ends.max]
    bits = 8 * np.dtype(dtype).itemsize
    values = np.array([value % 2**bits for value in values], f"u{bits // 8}").view(dtype)
    return jnp.stack([jnp.asarray(x.reshape(-1)) for x in np.meshgrid(values, values)])


OF_TWO_FLOATS = {
    "sum and difference": lambda x, y: (x + y, x - y),
    "product": lambda x, y: x * y,
    "quotient": lambda x, y: x / y,
    "remainder": lambda x, y: lax.rem(x, y),
    "modulo": lambda x, y: jnp.mod(x, y),
    "extremes": lambda x, y: (jnp.maximum(x, y), jnp.minimum(x, y)),
    "comparisons": lambda x, y: (x < y, x <= y, x > y, x >= y, x == y, x != y),
    "choice": lambda x, y: jnp.where(x < y, x, 2 * y),
    "angle": lambda x, y: jnp.arctan2(x, y),
    "clamped": lambda x, y: (lax.clamp(y, x, np.float32(3)), lax.clamp(np.float32(-1), x, y)),
}


@pytest.mark.parametrize("name", OF_TWO_FLOATS)
def test_operations_on_two_floats_agree_with_jax(name):
    assert_agrees(lambda x: OF_TWO_FLOATS[name](x[0], x[1]), PAIRS)


OF_ONE_FLOAT = {
    "sign": lambda x: (jnp.sign(x), jnp.abs(x), -x),
    "rounding": lambda x: (jnp.floor(x), jnp.ceil(x), jnp.rint(x)),
    "rounding halves up": lambda x: lax.round(x, lax.RoundingMethod.AWAY_FROM_ZERO),
    "bounds": lambda x: (jnp.clip(x, -1, 2), jnp.maximum(x, 1.0), jnp.minimum(-1.0, x)),
    "bounds of nothing": lambda x: (jnp.maximum(x, np.nan), jnp.minimum(np.float32(np.nan), x)),
    "finite": lambda x: (jnp.isfinite(x), jnp.isnan(x), jnp.isinf(x)),
    "powers": lambda x: (x**2, x**3, x**-1, x**-2, x**7, lax.integer_pow(x, 0), jnp.square(x)),
    "roots": lambda x: (jnp.sqrt(x), lax.rsqrt(x), jnp.cbrt(x)),
    "divided": lambda x: (x / 4, x / -0.5, x / 3, 1 / x, x / np.float32(0)),
    "neutral": lambda x: (x + 0, 1 * x, x - 0, x / 1, 0 - x, x * -1, x * -2, 0 - (0 - x)),
    "smooth": lambda x: (jnp.exp(x), jnp.log(x), jnp.tanh(x), jax.nn.sigmoid(x), jnp.log1p(x)),
    "bits": lambda x: lax.bitcast_convert_type(x, jnp.int32) & 0x7FFFFF,
}


@pytest.mark.parametrize("name", OF_ONE_FLOAT)
def test_operations_on_one_float_agree_with_jax(name):
    assert_agrees(OF_ONE_FLOAT[name], FLOATS)


def test_zero_times_a_non_finite_number_is_zero():
    """Differs from JAX, as documented: factors of a creature's zeros are never computed."""
    (got,) = fused(lambda x: 0.0 * x, jnp.array([1.0, *INFINITE]))
    np.testing.assert_array_equal(got, np.zeros(4))


WHOLE = ["int32", "uint32", "int8", "uint8", "int16", "uint16"]

OF_TWO_WHOLE = {
    "arithmetic": lambda x, y: (x + y, x - y, x * y),
    "quotient": lambda x, y: lax.div(x, y),
    "remainder": lambda x, y: lax.rem(x, y),
    "bits": lambda x, y: (x & y, x | y, x ^ y, ~x),
    "shift to the left": lambda x, y: lax.shift_left(x, y),
    "shifts to the right": lambda x, y: (
        lax.shift_right_logical(x, y),
        lax.shift_right_arithmetic(x, y),
    ),
    "extremes": lambda x, y: (jnp.maximum(x, y), jnp.minimum(x, y), lax.clamp(y, x, y)),
    "comparisons": lambda x, y: (x < y, x <= y, x > y, x >= y, x == y, x != y),
    "of one": lambda x, y: (jnp.sign(x), jnp.abs(y), x**2, x**3),
    "choice": lambda x, y: jnp.where(x == y, x, y),
}


@pytest.mark.parametrize("dtype", WHOLE[:4])
def test_operations_on_two_integers_agree_with_jax(dtype):
    """Division by zero, overflow and shifts by more than all bits are included."""

    def every(x):
        return {name: function(x[0], x[1]) for name, function in OF_TWO_WHOLE.items()}

    assert_agrees(every, pairs(dtype))


@pytest.mark.parametrize("dtype", ["int64", "uint64"])
def test_operations_on_two_long_integers_agree_with_jax(dtype, x64):
    test_operations_on_two_integers_agree_with_jax(dtype)


@pytest.mark.parametrize("divisor", [0, -1, 1, 3, -8, -(2**31)])
def test_constant_divisors_and_dividends_agree_with_jax(divisor):
    constant = np.int32(divisor)

    def every(x):
        return (
            *(operate(x[0], constant) for operate in (lax.div, lax.rem)),
            *(operate(constant, x[0]) for operate in (lax.div, lax.rem)),
        )

    assert_agrees(every, pairs("int32"))


def test_quotients_of_constants_agree_with_numpy():
    """XLA would end the process if it compiled the last two quotients."""
    least = -(2**31)
    cases = [(7, 2, 3, 1), (-7, 2, -3, -1), (7, -2, -3, 1), (5, 0, -1, 5), (least, -1, least, 0)]
    divided = [(np.int32(a), np.int32(b)) for a, b, _, _ in cases]

    def every(x):
        return jnp.stack([x + operate(a, b) for operate in (lax.div, lax.rem) for a, b in divided])

    got = fused(every, jnp.zeros(3, jnp.int32))[0][:, 0]
    assert got.tolist() == [case[2] for case in cases] + [case[3] for case in cases]


@pytest.mark.parametrize("by", [0, 1, 31, 32, 77, -1])
def test_constant_shifts_agree_with_jax(by):
    shifts = lax.shift_left, lax.shift_right_logical, lax.shift_right_arithmetic

    def every(x):
        return [
            shift(x[0].astype(dtype), jnp.asarray(by, "int32").astype(dtype))
            for shift in shifts
            for dtype in ("int32", "uint32")
        ]

    assert_agrees(every, pairs("int32"))


def test_bit_operations_on_conditions_agree_with_jax():
    x = sample((3, 8)) > 0
    x = x.at[0].set(x[1])
    assert_agrees(lambda x: (x[0] & x[1], x[0] | x[2], x[0] ^ x[1], ~x[0], x[0] == x[2]), x)
    assert_agrees(
        lambda x: (x[0] & True, x[0] | False, x.any(), x.all(), jnp.where(x[0], x[1], False)), x
    )
    assert_agrees(lambda x: (x.sum(), x.astype(float).sum(), jnp.argmax(x), x[0] < x[1]), x)


@pytest.mark.parametrize("to", [*WHOLE, "bool", "float32"])
def test_conversions_agree_with_jax(to):
    """A float that is too large becomes the largest integer, and NaN becomes 0."""
    sources = [FLOATS, *(jnp.resize(pairs(source)[0], FLOATS.shape) for source in WHOLE)]
    assert_agrees(lambda *values: [x.astype(to) for x in values], *sources)


@pytest.mark.parametrize("to", ["int64", "uint64", "float64", "int32"])
def test_long_conversions_agree_with_jax(to, x64):
    sources = [jnp.resize(pairs(source)[0], FLOATS.shape) for source in ("int64", "uint64")]
    sources.append(FLOATS.astype("float64"))
    assert_agrees(lambda *values: [x.astype(to) for x in values], *sources)


def test_constants_are_converted_like_numbers():
    constants = jnp.array([np.nan, 1e20, -1e20, 2.0**31, 5.7, -5.7])
    for to in ("int32", "uint32"):
        expected = constants.astype(to)
        (got,) = fused(lambda x, to=to: constants.astype(to) + x, jnp.zeros((1, 3), to))
        np.testing.assert_array_equal(got, np.repeat(expected[:, None], 3, 1))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_elementary_functions_in_both_precisions(dtype, x64):
    def every(x, y):
        inside = x / (1 + jnp.abs(x))
        return (
            jnp.sin(x) * jnp.cos(y) + jnp.tanh(x * y) - jnp.exp(-(x**2)),
            jnp.sqrt(jnp.abs(x)) / (1.0 + y**2) + x**3 - x**-1,
            jnp.where(x > y, jnp.maximum(x, 0.0), jnp.minimum(-y, 1.0)),
            jnp.clip(x, -0.5, 0.5) * jnp.sign(y),
            jnp.arctan2(x, y) + jnp.arccos(inside) + jax.nn.sigmoid(y),
            jnp.tan(x) + jnp.sinh(y) - jnp.cosh(x) + jnp.arcsinh(y) + jnp.arctanh(inside),
            jnp.abs(x) ** y + jnp.log(jnp.abs(y)) + jnp.expm1(x) + jnp.exp2(y) + lax.erf(x),
            (x > 0) & ~(y > 0),
        )

    tolerance = 1e-13 if dtype == "float64" else 4e-6
    x, y = sample((2, 9), 1, dtype), sample((2, 9), 2, dtype)
    assert_agrees(every, x, y, rtol=tolerance, atol=tolerance)
