"""Elementary functions of float32 against SciPy in float64, and against JAX at their limits."""

import functools

import jax
import numpy as np
import pytest
from jax import lax
from scipy import special

from evo_cpg.native.frontend.elementary import FLOAT32

SMALLEST = 2.0**-126

# The function in float64, and its largest error in units in the last place: the measured maximum
# over one in seventeen of all arguments, fused and not, plus a small margin.
EXACT = {
    "exp": (np.exp, 1.9),
    "expm1": (np.expm1, 1.8),
    "log": (np.log, 0.9),
    "log1p": (np.log1p, 1.7),
    "tanh": (np.tanh, 2.6),
    "logistic": (special.expit, 2.6),
    "asin": (np.arcsin, 2.1),
    "acos": (np.arccos, 1.4),
    "atan": (np.arctan, 1.8),
    "erf_inv": (special.erfinv, 4.0),
}
OF_TWO = ("atan2", "pow")

# XLA:CPU fuses products with sums only if it optimises.
LEVELS = pytest.mark.parametrize("level", [0, 3], ids=["plain", "fused"])

# Limits, extrema and changes of method. Subnormal numbers are absent, because JAX may or may not
# take them as zero.
ENDS = [0, 1e-37, 1e-30, 0.25, 0.5, 1, 1.5, 2, 3, 89, 100, 150, 2**24, 2**25, 1e30, 3e38, np.inf]
ENDS = np.array([*ENDS, *(-end for end in ENDS), -0.0, np.nan], np.float32)


@functools.cache
def compiled(name, level):
    return jax.jit(FLOAT32[name], compiler_options={"xla_backend_optimization_level": level})


def traced(name):
    return jax.make_jaxpr(FLOAT32[name])(*[np.float32(1)] * (1 + (name in OF_TWO)))


@functools.cache
def samples():
    """Return numbers of every magnitude, dense around 1 and 10, none subnormal."""
    x = np.arange(0, 2**32, 16411, dtype=np.uint32).view(np.float32)
    x = np.concatenate([x, *(np.linspace(-s, s, 100_001, dtype=np.float32) for s in (1, 20))])
    return x[~(np.abs(x) < SMALLEST)]


def units_off(got, exact):
    """Return the maximum error in units in the last place. Subnormal numbers may be zero."""
    with np.errstate(all="ignore"):
        rounded = exact.astype(np.float32)
    finite = np.isfinite(rounded)
    np.testing.assert_array_equal(got[~finite], rounded[~finite])
    got, exact, rounded = got[finite].astype(float), exact[finite], rounded[finite]
    subnormal = np.abs(exact) < SMALLEST
    assert (np.abs(got[subnormal]) <= SMALLEST).all()
    unit = np.spacing(np.abs(rounded)).astype(float)
    return (np.abs(got - exact) / unit)[~subnormal].max()


@LEVELS
@pytest.mark.parametrize("name", EXACT)
def test_errors_stay_within_their_units(name, level):
    exact, allowed = EXACT[name]
    # SciPy takes 15 us for one value of erfinv.
    x = samples()[:: 8 if name == "erf_inv" else 1]
    with np.errstate(all="ignore"):
        exact = exact(x.astype(float))
    assert units_off(np.asarray(compiled(name, level)(x)), exact) < allowed


@LEVELS
@pytest.mark.parametrize("largest", [1e-3, np.pi / 2, 3.3, 100.0, 1e4])
def test_sine_and_cosine_are_accurate(largest, level):
    x = np.random.default_rng(0).uniform(-largest, largest, 100_000).astype(np.float32)
    for name in ("sin", "cos"):
        exact = getattr(np, name)(x.astype(float))
        # Without fused multiply-add, which SSE lacks, the last bit is less exact.
        assert np.abs(compiled(name, level)(x) - exact).max() < 1.8e-7


@LEVELS
def test_small_angles_keep_all_their_digits(level):
    x = np.logspace(-30, -2, 200, dtype=np.float32)
    for name in ("sin", "cos"):
        exact = getattr(np, name)(x.astype(float))
        np.testing.assert_allclose(compiled(name, level)(x), exact, rtol=1.3e-7)


@LEVELS
def test_atan2_is_accurate(level):
    draws = np.random.default_rng(0)
    anywhere = draws.integers(0, 2**32, (2, 100_000), dtype=np.uint32).view(np.float32)
    anywhere = np.where(np.abs(anywhere) < SMALLEST, 0, anywhere)
    anywhere = anywhere[:, ~np.isnan(anywhere).any(0)]
    y, x = np.hstack([anywhere, draws.normal(size=(2, 100_000))]).astype(np.float32)
    exact = np.arctan2(y.astype(float), x.astype(float))
    assert units_off(np.asarray(compiled("atan2", level)(y, x)), exact) < 1.9


@LEVELS
@pytest.mark.parametrize(("octaves", "allowed"), [(20, 3.8), (130, 19.0)])
@pytest.mark.parametrize("spread", [0.01, 0.3, 10])
def test_powers_are_accurate(spread, octaves, allowed, level):
    """Choose exponents that put the results within the given octaves around 1."""
    draws = np.random.default_rng(0)
    x = np.exp(spread * draws.normal(size=100_000)).astype(np.float32)
    y = draws.uniform(-octaves, octaves, x.shape) / np.log2(x, dtype=float)
    y = y.astype(np.float32)
    exact = x.astype(float) ** y
    assert units_off(np.asarray(compiled("pow", level)(x, y)), exact) < allowed


@pytest.mark.parametrize("name", FLOAT32)
def test_limits_equal_those_of_jax(name):
    """Check zeros with their signs, infinities and NaN."""
    ends = ENDS
    if name in ("sin", "cos"):
        # Large angles have no accurate digits, nor the sign of a zero.
        ends = np.abs(ends[~(np.abs(ends) > 1e3) | np.isinf(ends)])
    arguments = np.meshgrid(ends, ends) if name in OF_TWO else [ends]
    got = np.asarray(compiled(name, 0)(*arguments))
    expected = np.asarray(jax.jit(getattr(lax, name))(*arguments))
    np.testing.assert_allclose(got, expected, rtol=4e-6, atol=SMALLEST)
    zero = (expected == 0) & (got == 0)
    np.testing.assert_array_equal(np.signbit(got[zero]), np.signbit(expected[zero]))


@pytest.mark.parametrize("name", FLOAT32)
def test_names_equal_those_of_the_primitives(name):
    assert getattr(lax, f"{name}_p").name == name


@pytest.mark.parametrize("name", FLOAT32)
def test_only_basic_arithmetic_is_left(name, x64):
    """All operations are scalar, and in float32 even if float64 is the default."""
    allowed = {"add", "sub", "mul", "div", "neg", "abs", "sqrt", "floor", "round", "select_n"}
    allowed |= {"eq", "ne", "lt", "gt", "and", "or", "not", "shift_left", "shift_right_arithmetic"}
    allowed |= {"convert_element_type", "bitcast_convert_type"}
    jaxpr = traced(name)
    assert {equation.primitive.name for equation in jaxpr.eqns} <= allowed
    values = [value.aval for each in jaxpr.eqns for value in (*each.invars, *each.outvars)]
    assert {(value.shape, value.dtype.name) for value in values} <= {
        ((), dtype) for dtype in ("float32", "int32", "bool")
    }


@pytest.mark.parametrize("name", FLOAT32)
def test_only_bits_are_converted_to_integers(name):
    """The conversion of NaN or of a number out of range would be undefined."""
    to_integers = [
        equation
        for equation in traced(name).eqns
        if equation.primitive is lax.convert_element_type_p
        and equation.outvars[0].aval.dtype == np.int32
    ]
    assert not to_integers
