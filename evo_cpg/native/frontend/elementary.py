"""Elementary functions of float32 as basic arithmetic without branches.

Each is a pure elementwise function of one or two arrays of float32. It traces to operations that a
vector unit performs for all lanes at once. These are arithmetic, roots, roundings, comparisons,
selections, conversions and integer operations on the bits.

The argument is first reduced to a short interval, where a polynomial approximates the result. The
table writes k for an integer. The constants that k multiplies are sums of parts. All parts but the
last are so short that the products are exact (Cody and Waite).

| function | reduced argument | result |
|---|---|---|
| exp | r = x - k ln 2 in [-ln 2 / 2, ln 2 / 2] | 2^k P(r) |
| expm1 | r as for exp | 2^k (r + r^2 P(r)) + (2^k - 1) |
| log, log1p | x = 2^k (1 + f), abs(f) <= 1/3 | k ln 2 + (f - f^2 / 2 + f^3 P(f)) |
| sin, cos | r = x - k pi in [-pi/2, pi/2] | (-1)^k (r + r^3 P(r^2)), (-1)^k (1 + r^2 Q(r^2)) |
| asin, acos | s = abs(x) or sqrt((1 - abs(x)) / 2) <= 1/2 | s + s^3 P(s^2) |
| atan, atan2 | z = the lesser side over the greater | z + z^3 P(z^2) |
| erf_inv | w = -log(1 - x^2) | x P(w) / Q(w) |

The other functions follow from these. Functions that are not here, such as ``erf`` and ``sinh``,
are computed in float64 by the C library (`evo_cpg.native.frontend.lower`), because only a user's
own class may need them.

The coefficients minimise the maximum relative error of the result (Remez exchange on a grid of
Chebyshev points, values by mpmath). Each coefficient was rounded to float32, the constant term
first, and the remaining coefficients were fitted again.

`tests/native/test_elementary.py` lists the maximum errors, most of them below two units in the last
place. Products may or may not be fused with sums. Subnormal numbers may or may not count as zero.
"""

import functools
import math
from collections.abc import Callable, Sequence

import numpy as np
from jax import Array, lax

# Smallest normal number, and the limit below which some functions equal their tangent.
_SMALLEST = 2.0**-126
_TINY = 2.0**-30

# Bits of a float32: sign, exponent plus 127, mantissa.
_SIGN, _MANTISSA = -(2**31), 0x007FFFFF
_MANTISSA_BITS = 23
_TWO_THIRDS, _FOUR = 0x3F2AAAAB, 0x40800000
# The bits of this constant plus an integer k end in the bits of k + 127.
_INTEGER_IN_BITS = 1.5 * 2**23 + 127

_bits = functools.partial(lax.bitcast_convert_type, new_dtype=np.int32)
_float = functools.partial(lax.bitcast_convert_type, new_dtype=np.float32)
_nearest = functools.partial(lax.round, rounding_method=lax.RoundingMethod.TO_NEAREST_EVEN)

_LOG2_E = math.log2(math.e)
_LOG2_E_PARTS = (1.4423828125, 3.1222838838e-4)
# One part is enough for a small k: the error of ln 2 in float32 is 2e-9.
_LN_2 = math.log(2.0)
_LN_2_PARTS = (0.693145751953125, 1.428606765330187e-6)
_PI_PARTS = (3.140625, 9.67502593994140625e-04, 1.509957990978376432e-07)
# Error of pi / 2 in float32, which is too large.
_HALF_PI_EXCESS = 4.371139e-8

# fmt: off
# e^r on [-ln 2 / 2, ln 2] and 2^r on [-1/2, 1]. Errors in the last third have half the weight: only
# the largest results need it, because k is at most 127.
_EXP = (1.0, 1.0, 0.50000197, 0.16666782, 0.04162442, 0.008341856, 0.0016019798)
_EXP2 = (1.0, 0.6931472, 0.24022745, 0.05550448, 0.0096084075, 0.0013347428, 0.00017762973)
# (e^r - 1 - r) / r^2 on [-ln 2 / 2, ln 2 / 2].
_EXPM1 = (0.49999997, 0.16666546, 0.041667435, 0.008366272, 0.0013870688)
# (ln(1 + f) - f + f^2 / 2) / f^3 on [-1/3, 1/3].
_LOG1P = (
    0.33333215, -0.24999796, 0.20010479, -0.16680591,
    0.14004397, -0.12182546, 0.13992809, -0.12900318,
)
# (sin r - r) / r^3 and (cos r - 1) / r^2 on [0, pi / 2], in r^2, fitted to the absolute error.
_SIN = (-1.66666571e-01, 8.33301729e-03, -1.98066152e-04, 2.60005477e-06)
_COS = (-4.99999995e-01, 4.16666407e-02, -1.38884035e-03, 2.47618862e-05, -2.60771053e-07)
# (asin s - s) / s^3 on [0, 1/2] and (atan z - z) / z^3 on [0, 1], in the square of the argument.
_ASIN = (0.16666752, 0.074953094, 0.04546915, 0.02418478, 0.0421583)
_ATAN = (
    -0.33333153, 0.19993767, -0.14211002, 0.106657684,
    -0.07551656, 0.043204635, -0.016363103, 0.0029193931,
)
# erf_inv(x) / x up to w = 15.95, for the largest x below 1. The coefficients were not fitted again.
_ERF_INV = (0.88622695, 0.3064674, 0.059570104, 0.0077630226, 0.00064372784, 2.434903e-5)
_ERF_INV_BELOW = (1.0, 0.084012434, 0.03218962, 0.0018750958, 0.0001796728, 1.2935906e-6)
# fmt: on


def exp(x: Array) -> Array:
    """Return ``e^x`` as ``2^k p``, with k = -127 for ``e^x = 0``."""
    x = _clip(x, -88.0)
    k = _clip(_nearest(x * _LOG2_E), greatest=127)
    r = _less_multiple(x, k, _LN_2_PARTS)
    return _polynomial(_EXP, r) * _power_of_two(k)


def expm1(x: Array) -> Array:
    """Return ``e^x - 1``."""
    half = _half_expm1(_clip(x, -18.0, 89.0))
    return _where(abs(x) < _TINY, x, half + half)


def log(x: Array) -> Array:
    """Return ``ln x``."""
    inside = _where(
        x < _SMALLEST, _where(x < 0.0, math.nan, -math.inf), _log_of_parts(*_parts_of_log(x))
    )
    return _where(x < math.inf, inside, x)


def log1p(x: Array) -> Array:
    """Return ``ln(1 + x)``."""
    above = _bits(1.0 + x) - _TWO_THIRDS
    # f = 2^-k (1 + x) - 1. k may be 128, so the scale is 2^(2 - k), which is not subnormal.
    scale = _float(_FOUR - (above & ~_MANTISSA))
    f = 0.25 * x * scale + (0.25 * scale - 1.0)
    inside = _where(x > -1.0, _log_of_parts(_exponent(above), f), -math.inf)
    inside = _where(x < -1.0, math.nan, inside)
    return _where((abs(x) > _TINY) & (x < math.inf), inside, x)


def tanh(x: Array) -> Array:
    """Return ``tanh x`` as ``t / (1 + t)`` with ``t = (e^(2 x) - 1) / 2``."""
    a = _clip(abs(x), greatest=10.0)
    t = _half_expm1(a + a, (_LN_2,))
    return _with_sign(t / (1.0 + t), x)


def _sin_or_cos(x: Array, cosine: bool) -> Array:
    """Return ``sin x`` or ``cos x``, within 1.5e-7 for ``abs(x)`` up to 1e4.

    Larger arguments lose digits. Up to 1e4, k times each of the first two parts of pi is exact.
    """
    k = _nearest(x * (1 / math.pi))
    r = _less_multiple(x, k, _PI_PARTS)
    half = k * 0.5
    fraction = half - lax.floor(half)
    square, sign = r * r, 1.0 - 4.0 * fraction
    if cosine:
        return sign * (_polynomial(_COS, square) * square + 1.0)
    return sign * (_polynomial(_SIN, square) * square * r + r)


def _asin_or_acos(x: Array, cosine: bool) -> Array:
    """Return the angle in [-pi/2, pi/2] with sine x, or the angle in [0, pi] with cosine x."""
    a = abs(x)
    far = a > 0.5
    square = _where(far, 0.5 - 0.5 * a, a * a)
    s = _where(far, lax.sqrt(square), a)
    rest = s * square * _polynomial(_ASIN, square)
    if cosine:
        signed = _with_sign(s + rest, x)
        beyond = _where(x < 0.0, math.pi, 0.0) + 2.0 * signed
        return _where(far, beyond, math.pi / 2 - (signed + _HALF_PI_EXCESS))
    # pi / 2 - 2 asin s
    beyond = (math.pi / 2 - 2.0 * s) - (2.0 * rest + _HALF_PI_EXCESS)
    return _with_sign(_where(far, beyond, s + rest), x)


def atan(x: Array) -> Array:
    """Return the angle in [-pi/2, pi/2] with tangent x."""
    a = abs(x)
    far = a > 1.0
    return _with_sign(_atan_of_ratio(_where(far, 1.0, a) / _where(far, a, 1.0), far), x)


def atan2(y: Array, x: Array) -> Array:
    """Return the angle in [-pi, pi] from the x-axis to ``(x, y)``."""
    a, b = abs(y), abs(x)
    steep = a > b
    lesser, greater = _where(steep, b, a), _where(steep, a, b)
    # 0 / 0 must be 0, and infinity / infinity must be 1.
    greater = _where(greater < _SMALLEST, _SMALLEST, greater)
    ratio = _where(lesser == greater, 1.0, lesser / greater)
    angle = _atan_of_ratio(ratio, steep)
    angle = _where(_bits(x) < 0, math.pi - (angle + 2 * _HALF_PI_EXCESS), angle)
    return _with_sign(angle, y)


def pow_(x: Array, y: Array) -> Array:
    """Return ``x^y`` as ``2^(y log2 x)``. Logarithm and product are sums of two numbers.

    The main part of each product has factors of 12 binary digits, so it is exact.
    """
    k, f = _parts_of_log(abs(x))
    # ln(1 + f) = high + low
    head = _head(f)
    half_square = 0.5 * head * head
    high = f - half_square
    low = (f - high) - half_square - 0.5 * (f - head) * (f + head)
    low = low + f * f * f * _polynomial(_LOG1P, f)
    # log2 x = high_2 + low_2
    head = _head(high)
    exact = head * _LOG2_E_PARTS[0]
    high_2 = k + exact
    low_2 = (exact - (high_2 - k)) + (high - head) * _LOG2_E_PARTS[0]
    low_2 = low_2 + high * _LOG2_E_PARTS[1] + low * _LOG2_E
    # y log2 x = exact + rest. The value of y beyond 2^40 has no effect, unless x = 1.
    factor = _clip(y, -(2.0**40), 2.0**40)
    head, head_2 = _head(factor), _head(high_2)
    exact = head * head_2
    rest = (factor - head) * head_2 + factor * (low_2 + (high_2 - head_2))
    n = _nearest(_clip(exact + rest, -127.0, 127.0))
    size = _polynomial(_EXP2, _clip((exact - n) + rest, -1.0, 2.0)) * _power_of_two(n)
    # The sign, zeros, infinities and NaN.
    a = abs(x)
    zero = a < _SMALLEST
    grows = _where(zero, -y, y) > 0.0
    size = _where(zero | (a == math.inf), _where(grows, math.inf, 0.0), size)
    half = 0.5 * y
    whole = lax.floor(y) == y
    odd = whole & (lax.floor(half) != half)
    power = _where(odd & (_bits(x) < 0), -size, size)
    undefined = ~whole & (x < 0.0) & (x > -math.inf) | (x != x) | (y != y)
    power = _where(undefined, math.nan, power)
    return _where((x == 1.0) | (y == 0.0), 1.0, power)


def erf_inv(x: Array) -> Array:
    """Return the number whose error function is x."""
    a = abs(x)
    w = -_log_of_parts(*_parts_of_log((1.0 - a) * (1.0 + a)))
    inside = x * _polynomial(_ERF_INV, w) / _polynomial(_ERF_INV_BELOW, w)
    end = _where(a == 1.0, math.inf, math.nan)
    return _where(a < 1.0, inside, _with_sign(end, x))


FLOAT32: dict[str, Callable[..., Array]] = {
    **{
        function.__name__.rstrip("_"): function
        for function in (
            exp, expm1, log, log1p, tanh, atan, atan2, pow_, erf_inv,
        )
    },
    "logistic": lambda x: 1.0 / (1.0 + exp(-x)),
    "sin": functools.partial(_sin_or_cos, cosine=False),
    "cos": functools.partial(_sin_or_cos, cosine=True),
    "asin": functools.partial(_asin_or_acos, cosine=False),
    "acos": functools.partial(_asin_or_acos, cosine=True),
}  # fmt: skip
"""Elementary functions by the names of JAX's primitives."""


def _half_expm1(x: Array, ln_2: Sequence[float] = _LN_2_PARTS) -> Array:
    """Return ``(e^x - 1) / 2``, with ``e^x - 1 = 2^k r + (2^k - 1)``."""
    k = _nearest(x * _LOG2_E)
    r = _less_multiple(x, k, ln_2)
    r = r + r * r * _polynomial(_EXPM1, r)
    half = _power_of_two(k, -1.0)
    return half * r + (half - 0.5)


def _power_of_two(k: Array, more: float = 0.0) -> Array:
    """Return ``2^(k + more)`` for an integer exponent: 0 for -127 and infinity for 128."""
    return _float(lax.shift_left(_bits(k + (_INTEGER_IN_BITS + more)), np.int32(_MANTISSA_BITS)))


def _parts_of_log(x: Array) -> tuple[Array, Array]:
    """Return an integer k and f in [-1/3, 1/3] with ``x = 2^k (1 + f)``."""
    above = _bits(x) - _TWO_THIRDS
    return _exponent(above), _float((above & _MANTISSA) + _TWO_THIRDS) - 1.0


def _exponent(above: Array) -> Array:
    """Return the exponent of a number from its bits minus the bits of 2/3."""
    k = lax.shift_right_arithmetic(above, np.int32(_MANTISSA_BITS))
    return lax.convert_element_type(k, np.float32)


def _log_of_parts(k: Array, f: Array) -> Array:
    square = f * f
    rest = f * square * _polynomial(_LOG1P, f) + k * _LN_2_PARTS[1]
    return (f + (rest - 0.5 * square)) + k * _LN_2_PARTS[0]


def _atan_of_ratio(z: Array, inverted: Array) -> Array:
    """Return ``atan z`` for z in [0, 1], or ``pi / 2 - atan z`` if inverted."""
    square = z * z
    angle = z + z * square * _polynomial(_ATAN, square)
    return _where(inverted, math.pi / 2 - (angle + _HALF_PI_EXCESS), angle)


def _polynomial(coefficients: Sequence[float], x: Array) -> Array:
    """Evaluate a polynomial by Horner's rule. Coefficients begin with the constant term."""
    value = x * coefficients[-1] + coefficients[-2]
    for coefficient in coefficients[-3::-1]:
        value = value * x + coefficient
    return value


def _less_multiple(x: Array, k: Array, parts: Sequence[float]) -> Array:
    """Return x minus k times the sum of the parts."""
    for part in parts:
        x = x - k * part
    return x


def _clip(x: Array, least: float | None = None, greatest: float | None = None) -> Array:
    """Return x within bounds. NaN stays NaN.

    A bound takes one instruction. `lax.min` checks both operands for NaN and takes more.
    """
    if greatest is not None:
        x = _where(x > greatest, greatest, x)
    return x if least is None else _where(x < least, least, x)


def _with_sign(size: Array, of: Array) -> Array:
    """Return a nonnegative number with the sign of ``of``."""
    return _float(_bits(size) | (_bits(of) & _SIGN))


def _head(x: Array) -> Array:
    """Return a number rounded towards zero to its first 12 binary digits."""
    return _float(_bits(x) & ~0xFFF)


def _where(condition: Array, x: Array | float, y: Array | float) -> Array:
    """Select as `jax.numpy.where` for float32, in a single operation."""
    full = [
        each if isinstance(each, Array) else lax.full_like(condition, each, np.float32)
        for each in (x, y)
    ]
    return lax.select(condition, *full)
