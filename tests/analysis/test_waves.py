"""Synthetic travelling and standing waves, with noise."""

import math

import numpy as np
import pytest

from evo_cpg.analysis.body_wave import body_wave
from evo_cpg.analysis.gait import phase_lags

STEP = 1 / 60
TIME = np.arange(1200)[:, None] * STEP


def running(frequency: float, waves: float, noise: float = 0.0, joints: int = 9) -> np.ndarray:
    """Return a travelling wave of a body of 2 m with joints 0.2 m apart."""
    place = 0.2 * np.arange(1, joints + 1)
    made = 0.3 * np.sin(2 * np.pi * (frequency * TIME - waves * place / 2.0))
    return made + noise * np.random.default_rng(5).normal(size=made.shape)


PLACE = 0.2 * np.arange(1, 10)


@pytest.mark.parametrize("waves", [0.8, 1.0, 1.7, -1.2])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_numbers_of_a_travelling_wave(waves, noise):
    """The wave length is 2 m / waves at 1.3 Hz. The noise is a third of the amplitude."""
    found = body_wave(running(1.3, waves, noise), PLACE, 2.0, STEP, 1.3)
    assert found.count == pytest.approx(waves, rel=0.03)
    assert found.length == pytest.approx(2.0 / abs(waves), rel=0.03)
    assert found.speed == pytest.approx(1.3 * 2.0 / waves, rel=0.03)
    assert found.lag == pytest.approx(36.0 * waves, rel=0.03)
    assert found.straightness > 0.99
    np.testing.assert_allclose(found.amplitude, 0.3, rtol=0.1)


@pytest.mark.parametrize(
    ("bending", "frequency"),
    [
        (np.zeros((1200, 9)), 1.0),
        (running(1.0, 1.0), math.nan),
        (running(1.0, 1.0)[:50], 1.0),
        (running(1.0, 1.0, joints=2), 1.0),
    ],
    ids=["still", "no stride", "less than a period", "two joints"],
)
def test_a_body_without_a_wave_has_nan(bending, frequency):
    found = body_wave(bending, PLACE[: bending.shape[1]], 2.0, STEP, frequency)
    numbers = found.count, found.length, found.speed, found.lag, found.travelling
    assert all(math.isnan(number) for number in numbers)


def test_lags_and_coherence_of_signals_with_noise():
    expected = np.array([0.0, 40.0, -75.0, 170.0])
    made = np.sin(2 * np.pi * 0.9 * TIME - np.radians(expected))
    noise = np.random.default_rng(2).normal(size=made.shape)
    found = phase_lags(made + 0.3 * noise, STEP, 0.9)
    np.testing.assert_allclose(found.lag[0], expected, atol=3.0)
    assert found.lag[1, 0] == pytest.approx(-found.lag[0, 1])
    assert found.lag[1, 2] == pytest.approx(-115.0, abs=3.0)
    assert (found.coherence[0] > 0.98).all()


def test_noise_has_a_low_coherence():
    made = np.sin(2 * np.pi * 0.9 * TIME)
    noise = np.random.default_rng(4).normal(size=(len(TIME), 1))
    assert phase_lags(np.hstack([made, noise]), STEP, 0.9).coherence[0, 1] < 0.5


def test_silent_or_short_signals_have_no_lag():
    made = np.sin(2 * np.pi * 0.9 * TIME - np.array([0.0, 1.0, 0.0])) * [1, 1, 0]
    found = phase_lags(made, STEP, 0.9)
    assert np.isnan(found.lag[2]).all() and np.isfinite(found.lag[0, 1])
    assert np.isnan(phase_lags(made[:60], STEP, 0.9).lag).all()
    assert np.isnan(phase_lags(made, STEP, math.nan).lag).all()
    # A single segment has no coherence.
    short = phase_lags(made[:100], STEP, 0.9)
    assert np.isfinite(short.lag[0, 1]) and np.isnan(short.coherence).all()
