"""Cycles of sinusoids with known crossings, and phases with a known mean and scatter."""

import numpy as np
import pytest

from evo_cpg.analysis.cycles import cycle_starts, frequency_of, mean_phase, upward_crossings


def test_crossings_are_interpolated_between_samples():
    np.testing.assert_allclose(upward_crossings(np.array([-1.0, 3.0, 1.0, -2.0, 0.0])), [0.25, 4.0])


def test_cycles_start_at_the_mid_range():
    time = np.arange(600) / 60
    starts = cycle_starts(5.0 + np.sin(2 * np.pi * (1.3 * time - 0.2)), 1 / 60)
    np.testing.assert_allclose(starts, (np.arange(13) + 0.2) / 1.3, atol=1e-3)
    assert frequency_of(starts) == pytest.approx(1.3, rel=1e-3)


def test_still_signal_has_no_cycles():
    starts = cycle_starts(np.full(100, 0.3), 1 / 60)
    assert len(starts) == 0 and np.isnan(frequency_of(starts))


def test_phases_around_the_start_of_a_cycle_have_their_mean_there():
    mean, scatter = mean_phase(np.array([0.95, 0.05, 1.0]))
    assert mean == pytest.approx(0.0, abs=1e-12) and 0 < scatter < 0.05


def test_scatter_is_the_standard_deviation_of_a_wrapped_normal():
    """|m| = exp(-(2 pi sigma)^2 / 2)."""
    phase = np.random.default_rng(0).normal(0.3, 0.1, 100_000)
    mean, scatter = mean_phase(phase % 1)
    assert (mean, scatter) == pytest.approx((0.3, 0.1), rel=0.01)
    assert mean_phase(np.array([0.0, 0.5]))[1] > 1
