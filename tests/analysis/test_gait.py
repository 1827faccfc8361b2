"""Rhythms of synthetic joint angles."""

import numpy as np
import pytest

from evo_cpg.analysis.gait import bending_axis, dominant_frequency, gait, ring_lags
from evo_cpg.simulation.recording import Recording

STEP = 1 / 60


def recording(angles: np.ndarray, names: tuple[str, ...]) -> Recording:
    """Return a recording of joint angles. No rhythm depends on the other fields."""
    fields = dict.fromkeys(Recording._fields, np.zeros(0))
    time = np.arange(len(angles)) * STEP
    return Recording(**fields | {"time": time, "joint_angle": angles, "dof_names": names})


def wave(frequency: float, lag_deg: float, joints: int = 6, count: int = 2000) -> np.ndarray:
    phase = 2 * np.pi * frequency * STEP * np.arange(count)[:, None]
    return 0.3 + np.cos(phase - np.deg2rad(lag_deg) * np.arange(joints))


@pytest.mark.parametrize(("frequency", "lag"), [(0.317, 36.0), (1.043, -20.0), (2.71, 100.0)])
def test_frequency_amplitude_and_lag_of_a_travelling_wave(frequency, lag):
    """A Hann window preserves the phase. Leakage of the mean sets the tolerances."""
    names = tuple(f"segment{i}.z" for i in range(6))
    found = gait(recording(0.2 * wave(frequency, lag), names))
    assert found.axis == "z"
    np.testing.assert_allclose(found.frequency, frequency, rtol=2e-3)
    np.testing.assert_allclose(found.amplitude, 0.2, rtol=1e-2)
    np.testing.assert_allclose(found.lag, lag, atol=0.5)
    assert found.has_wave() == (10 <= lag <= 70)


def test_a_wave_needs_one_frequency_and_lags_everywhere():
    names = tuple(f"segment{i}.z" for i in range(6))
    angles = wave(1.0, 30.0)
    angles[:, 3] = wave(1.1, 30.0)[:, 3]
    assert not gait(recording(angles, names)).has_wave()
    angles = wave(1.0, 30.0)
    angles[:, 5] = angles[:, 4]
    assert not gait(recording(angles, names)).has_wave()


def test_bending_axis_moves_most_except_twist():
    count = np.arange(600)
    swing = np.sin(count / 7.0)
    names = ("a.x", "a.y", "a.z")
    angles = np.stack([3 * swing, swing, 2 * swing], -1)
    assert bending_axis(recording(angles, names)) == "z"
    assert bending_axis(recording(angles[:, :1], ("a.x",))) == "x"


def test_drift_is_no_rhythm():
    time = np.arange(1000) * STEP
    drifting = 5 * time + 0.1 * np.sin(2 * np.pi * 1.5 * time)
    assert dominant_frequency(drifting[:, None], STEP)[0] == pytest.approx(1.5, rel=0.01)
    # A quadratic drift has its peak between one period and two.
    fraction = time / time[-1]
    bent = 16 * fraction**2 + np.sin(2 * np.pi * 1.5 * time)
    assert dominant_frequency(bent[:, None], STEP)[0] == pytest.approx(1.5, rel=0.01)


def test_ring_lags_equal_those_of_the_signals():
    names = tuple(f"arm{j}.y" for j in (3, 1, 5, 2, 4))
    phases = np.deg2rad([130.0, 0.0, 300.0, 50.0, 200.0])
    time = 2 * np.pi * 1.3 * STEP * np.arange(1200)[:, None]
    found = ring_lags(recording(np.cos(time - phases), names), [f"arm{j}.y" for j in range(1, 6)])
    np.testing.assert_allclose(found, [60, 50, 80, 70, 100], atol=0.5)
