"""The measures of entrainment, on a phase oscillator with a closed form."""

import numpy as np
import pytest

from evo_cpg.analysis.laboratory.entrain import (
    CYCLES,
    REST,
    entrained_range,
    locking,
    rest_frequency,
)

H, W0, K = 1 / 60, 2 * np.pi * 1.3, 1.5


def phase_oscillator(bending: float, seed: int = 0) -> np.ndarray:
    """Return sin(theta) of theta' = w_0 + K sin(w_b t - theta), free before the bending."""
    substeps = 20
    steps = int((REST + (CYCLES + 1) * 2 * np.pi / bending) / H)
    theta, found, h = 0.3 + seed, [], H / substeps

    def slope(theta, t):
        return W0 + (K * np.sin(bending * t - theta) if t >= 0 else 0.0)

    for i in range(steps):
        for k in range(substeps):
            t = i * H + k * h - REST
            middle = theta + 0.5 * h * slope(theta, t)
            theta += h * slope(middle, t + 0.5 * h)
        found.append(np.sin(theta))
    return np.array(found)[:, None]


@pytest.mark.parametrize("off", [-0.9, -0.5, 0.0, 0.5, 0.9])
def test_phase_oscillator_lags_by_the_closed_form(off):
    """It locks if |w_b - w_0| <= K, and lags by asin((w_b - w_0) / K)."""
    bending = W0 + off * K
    outputs = phase_oscillator(bending)
    found = locking(outputs, bending / (2 * np.pi), H)
    assert found.entrained and found.followed == pytest.approx(1, abs=2e-3)
    assert found.phase == pytest.approx(np.arcsin(off) / (2 * np.pi), abs=0.01)
    assert rest_frequency(outputs[:, 0], H) == pytest.approx(1.3, rel=1e-3)


def test_phase_that_wanders_has_no_mean():
    time = np.arange(4000) * H
    found = locking(np.sin(2 * np.pi * 1.3 * time)[:, None], 1.1, H)
    assert found.scatter > 0.2 and np.isnan(found.phase)


def test_range_is_the_range_of_the_phase_oscillator():
    """The last locked frequencies lie within one step of w_0 - K and w_0 + K."""
    ratios = np.linspace(0.75, 1.25, 21)
    locked = [locking(phase_oscillator(r * W0), r * W0 / (2 * np.pi), H).entrained for r in ratios]
    low, high = entrained_range(ratios, locked)
    assert low == pytest.approx(1 - K / W0, abs=0.03)
    assert high == pytest.approx(1 + K / W0, abs=0.03)


def test_range_stops_at_a_gap():
    assert entrained_range([0.8, 0.9, 1.0, 1.1], [True, False, True, True]) == (1.0, 1.1)
    assert entrained_range([0.9, 1.0, 1.1], [True, False, True]) is None


def test_silent_cord_is_not_entrained():
    found = locking(np.zeros((3000, 2)), 1.0, H)
    assert not found.entrained and np.isnan(found.frequency)
