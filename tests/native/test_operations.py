"""Every operation on scalars, at ordinary and extreme numbers, and every move against JAX."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import assert_agrees, assert_equal, every, fused, sample
from jax import lax

from evo_cpg.native.fuse import fuse

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


def test_operations_on_two_floats_agree_with_jax():
    assert_agrees(every(OF_TWO_FLOATS), *PAIRS)


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


def test_operations_on_one_float_agree_with_jax():
    assert_agrees(every(OF_ONE_FLOAT), FLOATS)


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
    assert_agrees(every(OF_TWO_WHOLE), *pairs(dtype))


@pytest.mark.parametrize("dtype", ["int64", "uint64"])
def test_operations_on_two_long_integers_agree_with_jax(dtype, x64):
    test_operations_on_two_integers_agree_with_jax(dtype)


def test_constant_divisors_and_dividends_agree_with_jax():
    def divided(constant, x):
        pairs = (x, constant), (constant, x)
        return [operate(*pair) for operate in (lax.div, lax.rem) for pair in pairs]

    divisors = [np.int32(number) for number in (0, -1, 1, 3, -8, -(2**31))]
    assert_agrees(every({k: functools.partial(divided, k) for k in divisors}), pairs("int32")[0])


def test_quotients_of_constants_agree_with_numpy():
    """XLA would end the process if it compiled the last two quotients."""
    least = -(2**31)
    cases = [(7, 2, 3, 1), (-7, 2, -3, -1), (7, -2, -3, 1), (5, 0, -1, 5), (least, -1, least, 0)]
    divided = [(np.int32(a), np.int32(b)) for a, b, _, _ in cases]

    def all_of(x):
        return jnp.stack([x + operate(a, b) for operate in (lax.div, lax.rem) for a, b in divided])

    got = fused(all_of, jnp.zeros(3, jnp.int32))[0][:, 0]
    assert got.tolist() == [case[2] for case in cases] + [case[3] for case in cases]


def test_constant_shifts_agree_with_jax():
    shifts = lax.shift_left, lax.shift_right_logical, lax.shift_right_arithmetic

    def shifted(by, x):
        return [
            shift(x.astype(dtype), jnp.asarray(by, "int32").astype(dtype))
            for shift in shifts
            for dtype in ("int32", "uint32")
        ]

    by = 0, 1, 31, 32, 77, -1
    assert_agrees(every({k: functools.partial(shifted, k) for k in by}), pairs("int32")[0])


def test_bit_operations_on_conditions_agree_with_jax():
    x = sample((3, 8)) > 0
    x = x.at[0].set(x[1])
    assert_agrees(lambda x: (x[0] & x[1], x[0] | x[2], x[0] ^ x[1], ~x[0], x[0] == x[2]), x)
    assert_agrees(
        lambda x: (x[0] & True, x[0] | False, x.any(), x.all(), jnp.where(x[0], x[1], False)), x
    )
    assert_agrees(lambda x: (x.sum(), x.astype(float).sum(), jnp.argmax(x), x[0] < x[1]), x)


def test_conversions_agree_with_jax():
    """A float that is too large becomes the largest integer, and NaN becomes 0."""
    sources = [FLOATS, *(jnp.resize(pairs(source)[0], FLOATS.shape) for source in WHOLE)]
    assert_agrees(converted_to([*WHOLE, "bool", "float32"]), *sources)


def converted_to(types):
    return lambda *values: {to: [x.astype(to) for x in values] for to in types}


def test_long_conversions_agree_with_jax(x64):
    sources = [jnp.resize(pairs(source)[0], FLOATS.shape) for source in ("int64", "uint64")]
    sources.append(FLOATS.astype("float64"))
    assert_agrees(converted_to(["int64", "uint64", "float64", "int32"]), *sources)


def test_constants_are_converted_like_numbers():
    constants = jnp.array([np.nan, 1e20, -1e20, 2.0**31, 5.7, -5.7])
    for to in ("int32", "uint32"):
        expected = constants.astype(to)
        (got,) = fused(lambda x, to=to: constants.astype(to) + x, jnp.zeros((1, 3), to))
        np.testing.assert_array_equal(got, np.repeat(expected[:, None], 3, 1))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_elementary_functions_in_both_precisions(dtype, x64):
    def elementary(x, y):
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
    assert_agrees(elementary, x, y, rtol=tolerance, atol=tolerance)


# Every kind of operation at constant places.
MOVES = {
    "slice": lambda x: x[1:, :2],
    "steps": lambda x: x[::2, ::-1],
    "pick": lambda x: x[np.array([2, 0])],
    "pick pairs": lambda x: x[np.array([2, 0, 2]), np.array([1, 1, 0])],
    "pick beyond the end": lambda x: x.at[np.array([1, 7, -1])].get(mode="fill", fill_value=5.0),
    "pick the nearest": lambda x: x.at[np.array([1, 7])].get(mode="clip"),
    "transpose": lambda x: jnp.swapaxes(x, 0, 1),
    "stack": lambda x: jnp.stack([x[0], x[1]], 1),
    "concatenate": lambda x: jnp.concatenate([x, 2 * x], 1),
    "repeat": lambda x: jnp.broadcast_to(x[:1], x.shape) + x,
    "roll": lambda x: jnp.roll(x, 1, 0) - jnp.flip(x, 1),
    "reshape": lambda x: x.reshape(9)[4:],
    "reshape in another order": lambda x: lax.reshape(x, (9,), (1, 0)),
    "pad": lambda x: jnp.pad(x, ((1, 0), (0, 2))),
    "pad between": lambda x: lax.pad(x, x[0, 0], ((1, -1, 2), (-1, 2, 0))),
    "split": lambda x: jnp.split(x, 3)[1],
    "set": lambda x: x.at[1].set(3 * x[0]),
    "set some": lambda x: x.at[np.array([2, 0]), 1].set(7.0),
    "set beyond the end": lambda x: x.at[np.array([2, 9])].set(7.0, mode="drop"),
    "add at": lambda x: x.at[np.array([0, 0, 2])].add(x),
    "sum": lambda x: x.sum(0),
    "largest": lambda x: x.max(1),
    "smallest": lambda x: x.min((0, 1)),
    "product": lambda x: x.prod(1),
    "running sum": lambda x: jnp.cumsum(x, 1),
    "running sum from behind": lambda x: lax.cumsum(x, 0, reverse=True),
    "running product": lambda x: jnp.cumprod(x, 0),
    "running sum of a vector": lambda x: jnp.cumsum(x[0]),
    "running extremes": lambda x: lax.cummax(x, 0) - lax.cummin(x, 1, reverse=True),
    "place of the largest": lambda x: (jnp.argmax(x, 0), jnp.argmin(x, 1), jnp.argmax(x)),
    "any": lambda x: (x > 0.5).any(0),
    "all": lambda x: jnp.where((x > -1.5).all(1), x[0], 0.0),
    "product with a matrix": lambda x: np.arange(6, dtype="f").reshape(2, 3) @ x,
    "products of matrices": lambda x: jnp.einsum("ij,jk,kl->il", x, x, x),
    "many products": lambda x: jnp.einsum("bi,bij->bj", x, jnp.stack([x, 2 * x, x.T])),
    "grid": lambda x: np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0.5]], "f") @ x,
}


def test_moves_and_sums_agree_with_jax():
    assert_agrees(every(MOVES), sample((3, 3, 5)))


SMOOTH = {
    "sines": lambda x: jnp.sin(x) * jnp.cos(x * x),
    "roots": lambda x: jnp.sqrt(1 + x**2) / (2 + jnp.abs(x)),
    "choice": lambda x: jnp.where(x > 0.3, jnp.tanh(x), x**3),
    "bounds": lambda x: jnp.clip(x, -0.5, 0.5) + jnp.maximum(x, 0) * jnp.exp(x),
    "parts": lambda x: fuse(lambda x: (jnp.sin(x).sum(0), x * x), x[:2] * x[1:], batch_ndim=0)[1],
}


def test_forward_and_reverse_derivatives_equal_those_of_jax(x64):
    functions = {
        k: v for k, v in (MOVES | SMOOTH).items() if k not in ("any", "place of the largest")
    }
    x, along = (
        {name: sample((3, 3, 5), seed, np.float64) for name in functions} for seed in (0, 1)
    )

    def each_on_its_own(x):
        return {name: function(x[name]) for name, function in functions.items()}

    def weighed(result):
        weight = jnp.cos(jnp.arange(result.size)).reshape(result.shape)
        return (weight * result**2).sum()

    @functools.partial(jax.jit, static_argnums=0)
    def both(run, x):
        backward = jax.grad(lambda x: sum(map(weighed, jax.tree.leaves(run(x)))))
        return {"reverse": backward(x), "forward": jax.jvp(run, (x,), (along,))[1]}

    found = both(functools.partial(fuse, each_on_its_own, batch_ndim=1), x)
    expected = both(jax.vmap(each_on_its_own, -1, -1), x)
    assert all(np.abs(each).max() > 0.1 for each in expected["reverse"].values())
    assert_equal(found, expected, rtol=1e-10, atol=1e-12)


# Places that differ between individuals, inside and outside the array.
PLACES = jnp.array(
    [[0, 1, 2, 3, -1, -4, 7, 2**31 - 1], [1, 0, -3, 2, 5, 1, -(2**31), 0]], jnp.int32
)

# Operations at these places of an array ``(4, 3)``.
COMPUTED = {
    "slice": lambda x, i: lax.dynamic_slice(x, (i[0], i[1]), (2, 2)),
    "slice of all rows": lambda x, i: lax.dynamic_slice_in_dim(x, i[0], 2, 1),
    "whole": lambda x, i: lax.dynamic_slice(x, (i[0], i[1]), (4, 3)),
    "update": lambda x, i: lax.dynamic_update_slice(x, 10 * x[:2, :2], (i[0], i[1])),
    "update a row": lambda x, i: lax.dynamic_update_index_in_dim(x, x[3], i[1], 0),
    "row": lambda x, i: x[i[0]],
    "row of none": lambda x, i: jnp.append(x[:, :0][i[0]], x[i[1]]),
    "element": lambda x, i: x[i[0], i[1]],
    "column, clipped": lambda x, i: x.at[:, i[1]].get(mode="clip"),
    "column, filled": lambda x, i: x.at[:, i[1]].get(mode="fill"),
    "column, filled with 3": lambda x, i: x.at[:, i[1]].get(mode="fill", fill_value=3.0),
    "several rows": lambda x, i: x.at[i].get(mode="fill"),
    "several elements": lambda x, i: x.at[i, i[::-1]].get(mode="clip"),
    "from constants": lambda x, i: jnp.arange(5.0).at[i].get(mode="fill") + x[0, 0],
    "of whole numbers": lambda x, i: (x > 0).astype(int).at[i].get(mode="fill"),
    "of unsigned ones": lambda x, i: (x > 0).astype(jnp.uint32).at[i].get(mode="fill"),
    "of truths": lambda x, i: (x > 0).at[i[0]].get(mode="fill"),
    "unsigned places": lambda x, i: x.at[i.astype(jnp.uint32)].get(mode="fill"),
    "one of a row": lambda x, i: x[1].at[i[0]].get(mode="fill") + x[:, 0].at[i[1]].get(mode="clip"),
    "one of one": lambda x, i: x[0, :1].at[i[0]].get(mode="fill"),
    "where it is largest": lambda x, i: x[jnp.argmax(x[:, 0])] + x[i[0]],
    "axes in the middle": lambda x, i: x.reshape(2, 2, 3).at[:, i % 2].get(mode="clip"),
}


def test_moves_at_computed_places_agree_with_jax():
    assert_agrees(every(COMPUTED), sample((4, 3, 8)), PLACES)


def test_places_of_64_bits_agree_with_jax(x64):
    """Choose places far outside the array whose last 32 bits would be inside."""
    places = jnp.array([[0, 1, 2**32, 2**32 + 1, -(2**32), 2**62]])
    for length in (1, 3):
        x = sample((length, 6))
        assert_agrees(lambda x, i: x.at[i].get(mode="fill"), x, places)
        assert_agrees(lambda x, i: x.at[i].get(mode="clip"), x, places)


def test_the_first_nan_is_the_largest_and_the_smallest():
    x = np.array(sample((5, 6)))
    x[2, 1] = x[0, 2] = x[4, 3] = x[2:4, 4] = np.nan
    x[1:4, 5] = np.inf
    assert_agrees(lambda x: (jnp.argmax(x), jnp.argmin(x), x.max(), x.min()), jnp.asarray(x))


def test_shared_and_individual_tables_agree_with_jax():
    table = sample((7,), 4)
    places = jnp.arange(20).reshape(2, 10) % 7

    def look(run):
        return jax.jit(lambda table, own, places: run(table, own, places))(
            table, sample((7, 10)), places
        )

    got = look(lambda table, own, i: fuse(lambda own, i: table[i] * own[i], own, i, batch_ndim=1))
    expected = look(
        lambda table, own, i: jax.vmap(lambda own, i: table[i] * own[i], -1, -1)(own, i)
    )
    np.testing.assert_array_equal(got, expected)
