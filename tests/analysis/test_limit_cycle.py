"""Periodic orbits of the oscillators against time-stepping simulation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import box_chain
from evo_cpg.analysis.gait import dominant_frequency, fourier_component
from evo_cpg.analysis.limit_cycle import STEPS, limit_cycle
from evo_cpg.control.matsuoka import (
    CpgSettings,
    MatsuokaNetwork,
    MatsuokaState,
    advance,
    build_network,
    initial_state,
    output,
    parts,
)
from evo_cpg.creature.tree import build_tree

H = 1 / 240


def chain(joints: int, axes: str = "z", **settings) -> MatsuokaNetwork:
    return build_network(build_tree(box_chain(joints + 1, axes)), CpgSettings(**settings))


def drive(network: MatsuokaNetwork, gain: float) -> tuple[np.ndarray, np.ndarray]:
    count = network.oscillator_count
    return np.ones((2, count)), np.full(count, gain)


def simulate(network, tonic, gain, seconds, start=None, h=H):
    """Return outputs at every step and the final state, float64."""
    state = initial_state(network, dtype=jnp.float64) if start is None else start
    steps = round(seconds / h)

    @jax.jit
    def run(state):
        def onward(state, _):
            return advance(network, state, jnp.asarray(tonic), jnp.asarray(gain), h), output(state)

        return jax.lax.scan(onward, state, length=steps)

    state, signals = run(state)
    return np.asarray(signals), state


@pytest.mark.parametrize("gain", [pytest.param(1.5, marks=pytest.mark.slow), 4.0, 10.0])
@pytest.mark.slow
def test_frequency_and_lag_equal_simulation(gain, x64):
    network = chain(9)
    tonic, gains = drive(network, gain)
    cycle = limit_cycle(network, tonic, gains)
    signals, _ = simulate(network, tonic, gains, 400.0)
    tail = signals[len(signals) // 2 :]
    frequency = float(np.median(dominant_frequency(tail, H)))
    assert cycle.frequency == pytest.approx(frequency, rel=1e-3)
    component = fourier_component(tail, H, cycle.frequency)
    lag = np.rad2deg(np.angle(component[:-1] / component[1:]))
    np.testing.assert_allclose(cycle.lag, lag, rtol=1e-3, atol=0.02)
    np.testing.assert_allclose(cycle.amplitude, np.ptp(tail, axis=0) / 2, rtol=2e-3)
    assert cycle.stable


@pytest.mark.parametrize(
    ("joints", "gain", "weight"),
    [
        (1, 5.0, 2.0),
        (4, 3.0, 1.07),
        (9, 4.0, 1.07),
        pytest.param(9, 9.0, 1.07, marks=pytest.mark.slow),
    ],
)
def test_multipliers_predict_the_decay_of_a_perturbation(joints, gain, weight, x64):
    """Compare the slowest perturbation after one period and after two, within 5 %.

    A finite perturbation also shifts the phase. That part never decays, and is left out.
    """
    network = chain(joints, pair_weight=weight)
    tonic, gains = drive(network, gain)
    cycle = limit_cycle(network, tonic, gains)
    values, vectors = np.linalg.eig(cycle.monodromy)
    slowest = int(np.abs(values - cycle.multipliers[0]).argmin())
    assert 1e-3 < np.abs(values[slowest]) < 1
    flat, along = cycle.states[..., 0].ravel(), np.linalg.inv(vectors)[slowest]
    push = 1e-4 * np.real(vectors[:, slowest])
    # One individual is pushed, and one is not, because the orbit closes to 1e-6 only.
    state = MatsuokaState(*jnp.asarray(np.stack([flat + push, flat], -1).reshape(2, 2, joints, 2)))
    left = [abs(along @ push)]
    drives = [np.repeat(each[..., None], 2, -1) for each in (tonic, gains)]
    for _ in range(2 if abs(values[slowest]) > 0.1 else 1):
        _, state = simulate(network, *drives, cycle.period, state, cycle.period / (8 * STEPS))
        pushed, free = np.stack([state.potential, state.adaptation]).reshape(-1, 2).T
        left.append(abs(along @ (pushed - free)))
    shrinks = np.array(left[1:]) / left[:-1]
    if values[slowest].imag == 0:
        np.testing.assert_allclose(shrinks, np.abs(cycle.multipliers[0]), rtol=0.05)
        return
    # The push has equal parts along two conjugate eigenvectors. `along` measures one of them.
    expected = abs(along @ (cycle.monodromy @ push)) / left[0]
    np.testing.assert_allclose(shrinks[0], expected, rtol=0.05)


def test_uncoupled_axes_are_separate_parts(x64):
    network = chain(4, "yz")
    assert parts(network) == [(0, 2, 4, 6), (1, 3, 5, 7)]
    alone = limit_cycle(chain(4), *drive(chain(4), 4.0))
    for part in parts(network):
        cycle = limit_cycle(network, *drive(network, 4.0), oscillators=part)
        assert cycle.period == pytest.approx(alone.period, rel=1e-6)
    assert parts(chain(4, "yz", cross_weight=0.3)) == [tuple(range(8))]
