"""The spinal cord against closed forms, another integrator and another program.

The numbers of `CHAIN` are from an independent program (classical RK4 at 1/120 s, plain NumPy). Its
printed digits set the tolerances. T_rT_a s^2 + (T_r + T_a(1 - a)) s + 1 - a + b = 0 gives the rates
of a pair whose neurons are both active. The pair decays unless a > 1 + T_r/T_a.
"""

import math
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evo_cpg.analysis.cycles import upward_crossings
from evo_cpg.control.matsuoka import (
    TIME_CONSTANTS,
    CpgSettings,
    MatsuokaState,
    advance,
    build_network,
    inhibition_matrix,
    initial_state,
    output,
)

A = 1.070772
RISE, ADAPTATION = TIME_CONSTANTS["swapped"]

# b: frequency (Hz), amplitude of joint 5, lag per joint (degrees) of nine oscillators at u = 1.
CHAIN = {
    0.5: (0.158, 0.859, 12.7),
    1.0: (0.285, 0.744, 17.0),
    2.0: (0.440, 0.584, 20.6),
    3.0: (0.554, 0.481, 23.1),
    5.0: (0.731, 0.357, 27.3),
    8.0: (0.938, 0.258, 32.5),
    10.0: (1.054, 0.218, 35.5),
    15.0: (1.305, 0.157, 41.7),
    20.0: (1.519, 0.123, 46.4),
}


class Rhythm(NamedTuple):
    """Frequency (Hz), amplitudes (half peak to peak) and lags of neighbours (degrees)."""

    frequency: float
    amplitude: np.ndarray
    lags: np.ndarray


@eqx.filter_jit
def simulate(network, state, tonic_input, gain, h, steps):
    """Return outputs ``(steps, oscillators, *n)`` with constant inputs."""

    def step(state, _):
        state = advance(network, state, tonic_input, gain, h)
        return state, output(state)

    return jax.lax.scan(step, state, length=steps)[1]


def run(tree, settings, gains, seconds, h=1 / 60, tonic=1.0):
    """Return outputs ``(steps, oscillators, gains)`` from the standard start, at one u and b."""
    network = build_network(tree, settings)
    batch = (len(gains),)
    count = network.oscillator_count
    gain = jnp.broadcast_to(jnp.asarray(gains, float)[None], (count, *batch))
    drive = jnp.full((2, count, *batch), tonic)
    state = initial_state(network, batch, float)
    return np.asarray(simulate(network, state, drive, gain, h, round(seconds / h)))


def rhythm(signals, h):
    """Return the rhythm of signals ``(steps, o)``, with lags from phases of the fundamental."""
    frequency = 1 / np.mean([np.diff(h * upward_crossings(signal)).mean() for signal in signals.T])
    steps = int(int(len(signals) * h * frequency) / frequency / h)  # whole periods
    time = h * np.arange(steps)[:, None]
    window = np.hanning(steps)[:, None] * np.exp(-2j * np.pi * frequency * time)
    phases = np.angle((window * signals[:steps]).sum(axis=0), deg=True)
    lags = (phases[:-1] - phases[1:] + 180) % 360 - 180
    return Rhythm(frequency, np.ptp(signals, axis=0) / 2, lags)


@pytest.fixture(scope="module")
def chain_rhythms(chain):
    """Rhythm of the default chain for each b of `CHAIN`."""
    h = 1 / 120
    with jax.enable_x64(True):
        signals = run(chain(10, "z"), CpgSettings(), list(CHAIN), 120.0, h)
    return {b: rhythm(signals[60 * 120 :, :, k], h) for k, b in enumerate(CHAIN)}


@pytest.mark.parametrize("gain", CHAIN)
def test_chain_has_the_expected_frequency_amplitude_and_lag(chain_rhythms, gain):
    frequency, amplitude, lag = CHAIN[gain]
    found = chain_rhythms[gain]
    assert found.frequency == pytest.approx(frequency, abs=6e-4)
    # Samples every 1/120 s miss up to (pi f h)^2 / 2 of a peak, here 0.1 %.
    assert found.amplitude[4] == pytest.approx(amplitude, abs=6e-4, rel=1e-3)
    assert found.lags.mean() == pytest.approx(lag, abs=0.06)
    assert np.all(found.lags > 0)


def test_printed_constants_never_oscillate(chain):
    gains = [0.5, 2.0, 3.0, 5.0, 8.0, 10.0, 15.0, 20.0]
    settings = CpgSettings(constants="as_printed")
    late = run(chain(10, "z"), settings, gains, 120.0)[-600:]
    assert np.ptp(late, axis=0).max() < 1e-6
    # Both sides end equal if 1 + b exceeds the chain's effective a of 1.98. Otherwise one side
    # keeps firing.
    assert np.abs(late[..., 1:]).max() < 1e-6
    assert np.abs(late[..., 0]).max() > 0.1


@pytest.mark.parametrize("gain", [2.0, 5.0, 10.0])
@pytest.mark.parametrize("weight", [A, 1.12, 1.1297, 1.14])
def test_small_oscillation_of_a_pair_has_the_closed_form_rate_and_frequency(chain, gain, weight):
    # Both neurons are active and nearly in balance, so eqs. 4-6 are linear.
    network = build_network(chain(2, "z"), CpgSettings(pair_weight=weight))
    rest = 1 / (1 + weight + gain)
    swing = 1e-3 * rest
    state = MatsuokaState(jnp.array([[rest + swing], [rest - swing]]), jnp.array([[rest], [rest]]))
    drive, gains = jnp.ones((2, 1)), jnp.array([gain])
    h, seconds = 1 / 120, 8
    signal = simulate(network, state, drive, gains, h, round(seconds / h))
    damping = -(RISE + ADAPTATION * (1 - weight)) / (2 * RISE * ADAPTATION)
    angular = math.sqrt((1 - weight + gain) / (RISE * ADAPTATION) - damping**2)
    times = h * upward_crossings(np.asarray(signal[:, 0]))
    assert 2 * np.pi / np.diff(times).mean() == pytest.approx(angular, rel=1e-4)
    # The initial displacement and rate follow from x_e - x_f = 2 swing and z_e = z_f.
    rate = (weight - 1) / RISE
    time = h * np.arange(1, len(signal) + 1)
    expected = 2 * swing * np.exp(damping * time)
    expected *= np.cos(angular * time) + (rate - damping) / angular * np.sin(angular * time)
    np.testing.assert_allclose(signal[:, 0], expected, atol=2e-4 * swing)


@pytest.mark.parametrize(("weight", "oscillates"), [(A, False), (1.11, False), (1.15, True)])
def test_pair_alone_oscillates_only_above_the_critical_weight(chain, weight, oscillates):
    signals = run(chain(2, "z"), CpgSettings(pair_weight=weight), [5.0], 200.0)
    late = np.abs(signals[-600:]).max()
    assert (late > 0.1) if oscillates else (late < 1e-3)


def test_doubling_the_tonic_input_doubles_the_output_bit_for_bit(chain):
    tree = chain(10, "z")
    single = run(tree, CpgSettings(), [5.0], 20.0)
    double = run(tree, CpgSettings(max_tonic_input=2.0), [5.0], 20.0, tonic=2.0)
    np.testing.assert_array_equal(double, 2 * single)


@pytest.mark.parametrize("scale", [0.1, 0.5, 4.0])
def test_time_scale_only_stretches_time(chain, scale):
    tree, h = chain(10, "z"), 1 / 60
    plain = run(tree, CpgSettings(), [2.0, 5.0], 10.0, h)
    scaled = run(tree, CpgSettings(time_scale=scale), [2.0, 5.0], 10.0 * scale, h * scale)
    np.testing.assert_allclose(scaled, plain, atol=1e-9)


def reference(gains, times, count):
    """Return outputs ``(times, o, gains)`` of the default chain, integrated by diffrax."""

    def derivative(_, state, __):
        x, z = state
        y = jnp.maximum(x, 0.0)[::-1]
        inhibition = A * y
        inhibition = inhibition.at[:, 1:].add(1.0 * A * y[:, :-1])
        inhibition = inhibition.at[:, :-1].add(0.2 * A * y[:, 1:])
        return (1.0 - x - inhibition - gains[None, None] * z) / RISE, (y[::-1] - z) / ADAPTATION

    rest = jnp.zeros((2, count, len(gains)))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(derivative),
        diffrax.Tsit5(),
        t0=0.0,
        t1=times[-1],
        dt0=1e-3,
        y0=(rest.at[0].set(0.1), rest),
        saveat=diffrax.SaveAt(ts=jnp.asarray(times)),
        stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-11),
        max_steps=200_000,
    )
    firing = np.maximum(solution.ys[0], 0.0)
    return firing[:, 0] - firing[:, 1]


@pytest.mark.slow
@pytest.mark.parametrize("steps", [500, 2000])
def test_whole_trial_agrees_with_diffrax(chain, steps):
    h, gains = 1 / 60, [5.0, 20.0]
    exact = reference(np.array(gains), h * np.arange(1, steps + 1), 9)
    found = run(chain(10, "z"), CpgSettings(), gains, steps * h)
    errors = np.sqrt(np.mean((found - exact) ** 2, axis=(0, 1)) / np.mean(exact**2, axis=(0, 1)))
    assert errors.max() < 2e-3


def test_integration_is_of_fourth_order_without_kinks(chain):
    # All neurons stay active near the balanced state, so no kink of eq. 6 is crossed.
    tree = chain(4, "z")
    network, gain = build_network(tree, CpgSettings()), jnp.full(3, 5.0)
    rest = 1 / (6 + inhibition_matrix(tree, CpgSettings()).sum(axis=1))
    x, z = rest * np.random.default_rng(0).uniform(0.95, 1.05, (2, 2, 3))
    start = MatsuokaState(jnp.asarray(x), jnp.asarray(z))
    steps = [32, 64, 128]

    def end(count):
        return simulate(network, start, jnp.ones((2, 3)), gain, 0.25 / count, count)[-1]

    exact = end(1024)
    errors = [np.abs(end(count) - exact).max() for count in steps]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(-4.0, abs=0.2)


@pytest.mark.parametrize(("scale", "substeps"), [(1.0, 1), (0.5, 1), (0.25, 2), (0.05, 9)])
def test_substeps_stay_below_a_quarter_of_the_shorter_time(chain, scale, substeps):
    network = build_network(chain(2, "z"), CpgSettings(time_scale=scale))
    assert network.substeps(1 / 60) == substeps


def test_substeps_equal_shorter_steps(chain):
    network = build_network(chain(4, "z"), CpgSettings(time_scale=0.25))
    state, drive = initial_state(network, (), float), jnp.ones((2, 3))
    gain = jnp.full(3, 5.0)
    long = simulate(network, state, drive, gain, 1 / 60, 100)
    short = simulate(network, state, drive, gain, 1 / 120, 200)[1::2]
    np.testing.assert_allclose(long, short, rtol=0, atol=1e-13)


def test_branches_couple_to_the_nearest_ancestor_with_the_same_axis(grow):
    tree = grow(
        {
            "trunk": (None, ""),
            "chest": ("trunk", "yz"),
            "arm": ("chest", "xz"),
            "hand": ("arm", "yz"),
            "leg": ("trunk", "z"),
            "neck": ("chest", "y"),
        }
    )
    settings = CpgSettings(parent_weight=0.7, child_weight=0.3)
    matrix = inhibition_matrix(tree, settings)
    expected = A * np.eye(tree.dof_count)
    for child, parent in {
        "arm.z": "chest.z",
        "hand.z": "arm.z",
        "hand.y": "chest.y",  # the arm has no y axis
        "neck.y": "chest.y",
    }.items():
        i, j = tree.dof_names.index(child), tree.dof_names.index(parent)
        expected[i, j], expected[j, i] = 0.7 * A, 0.3 * A
    np.testing.assert_allclose(matrix, expected)
    np.testing.assert_array_equal(build_network(tree, settings).matrix, matrix)


def test_mirrored_axes_and_opposite_bodies_are_inhibited_by_the_same_side(grow):
    tree = grow(
        {
            "head": (None, ""),
            "chest": ("head", "z"),
            "left": ("chest", "Zy"),
            "right": ("chest", "zy"),
            "paw": ("left", "Z"),
            "hip": ("chest", "z"),
        }
    )
    settings = CpgSettings(
        parent_weight=0.7, child_weight=0.3, cross_weight=0.4, opposite=("rig*", "hip")
    )
    matrix = inhibition_matrix(tree, settings) / A
    expected = np.eye(tree.dof_count)
    for child, parent, side in (
        ("left.z", "chest.z", -1),  # the axis is turned
        ("right.z", "chest.z", -1),  # named as opposite
        ("hip.z", "chest.z", -1),
        ("paw.z", "left.z", 1),  # both are turned
    ):
        i, j = tree.dof_names.index(child), tree.dof_names.index(parent)
        expected[i, j], expected[j, i] = 0.7 * side, 0.3 * side
    for leg in ("left", "right"):
        i, j = (tree.dof_names.index(f"{leg}.{axis}") for axis in "zy")
        expected[i, j] = expected[j, i] = 0.4
    np.testing.assert_allclose(matrix, expected, rtol=0, atol=1e-15)


def test_the_cross_weight_couples_axes_of_one_joint(chain):
    """Two oscillators with equal mutual inhibition of opposite sides synchronise."""
    network = build_network(chain(2, "yz"), CpgSettings(cross_weight=1.0))
    state = MatsuokaState(jnp.array([[0.3, 0.0], [0.0, 0.2]]), jnp.zeros((2, 2)))
    found = simulate(network, state, jnp.ones((2, 2)), jnp.full(2, 5.0), 1 / 60, 2400)[-600:]
    assert np.ptp(found[:, 0]) > 0.3
    np.testing.assert_allclose(found[:, 0], found[:, 1], rtol=0, atol=1e-6)


def test_one_step_of_a_branching_network_equals_plain_runge_kutta(grow):
    tree = grow(
        {
            "trunk": (None, ""),
            "chest": ("trunk", "xyz"),
            "left": ("chest", "yZ"),
            "right": ("chest", "yz"),
            "paw": ("left", "z"),
            "tail": ("trunk", "z"),
        }
    )
    settings = CpgSettings(constant_input=0.1, cross_weight=0.5)
    network, matrix = build_network(tree, settings), inhibition_matrix(tree, settings)
    count, h = tree.dof_count, 1 / 60
    rng = np.random.default_rng(1)
    x, z = rng.uniform(-1, 1, (2, 2, count))
    u, b = rng.uniform(0, 1, (2, count)), rng.uniform(1, 10, count)

    def derivative(state):
        x, z = state
        y = np.maximum(x, 0)
        crossed, straight = np.maximum(matrix, 0), np.maximum(-matrix, 0)
        inhibition = y[::-1] @ crossed.T + y @ straight.T
        dx = (-x - inhibition - b * z + u + 0.1) / RISE
        return np.stack([dx, (y - z) / ADAPTATION])

    start = np.stack([x, z])
    k1 = derivative(start)
    k2 = derivative(start + h / 2 * k1)
    k3 = derivative(start + h / 2 * k2)
    k4 = derivative(start + h * k3)
    expected = start + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    state = MatsuokaState(jnp.asarray(x), jnp.asarray(z))
    found = jax.jit(lambda s: advance(network, s, jnp.asarray(u), jnp.asarray(b), h))(state)
    np.testing.assert_allclose(found.potential, expected[0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.adaptation, expected[1], rtol=0, atol=1e-14)


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32 - 1),
    settings=st.sampled_from([CpgSettings(), CpgSettings(constants="as_printed", time_scale=0.03)]),
)
def test_output_never_exceeds_the_largest_tonic_input(chain, seed, settings):
    network = build_network(chain(4, "yz"), settings)
    rng = np.random.default_rng(seed)
    # Inputs that jump every 0.1 s between the extremes are the hardest case.
    u = jnp.asarray(rng.choice([0.0, 0.2, 1.0], (50, 2, 6, 8)))
    b = jnp.asarray(rng.choice([0.05, 1.0, 10.0, 20.0], (50, 6, 8)))
    signals, adaptation = storm(network, u, b)
    assert np.abs(signals).max() <= 1 + 1e-12
    assert adaptation.min() >= 0


@eqx.filter_jit
def storm(network, tonic_inputs, gains):
    """Return outputs and adaptation with inputs that change every 6 steps."""

    def hold(state, inputs):
        def step(state, _):
            state = advance(network, state, *inputs, 1 / 60)
            return state, (output(state), state.adaptation)

        return jax.lax.scan(step, state, length=6)

    start = initial_state(network, (tonic_inputs.shape[-1],), tonic_inputs.dtype)
    return jax.lax.scan(hold, start, (tonic_inputs, gains))[1]


def test_single_precision_keeps_its_type_and_agrees_with_double(chain):
    network = build_network(chain(10, "z"), CpgSettings())
    ends = {}
    for dtype in (jnp.float32, jnp.float64):
        state = initial_state(network, (), dtype)
        gain = jnp.full(9, 5.0, dtype)
        ends[dtype] = simulate(network, state, jnp.ones((2, 9), dtype), gain, 1 / 60, 600)
        assert ends[dtype].dtype == dtype
    np.testing.assert_allclose(ends[jnp.float32], ends[jnp.float64], rtol=0, atol=2e-5)
