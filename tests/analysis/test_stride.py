"""Strides, speeds and excursions of synthetic motions."""

import math

import numpy as np
import pytest

from evo_cpg.analysis import stride
from evo_cpg.analysis.midline import sway
from evo_cpg.analysis.stride import strouhal_number

STEP = 1 / 60
TIME = np.arange(1200) * STEP


def test_a_joint_at_twice_the_frequency_does_not_count():
    beat = 2 * np.pi * 0.8 * TIME
    signals = np.stack([0.4 * np.sin(beat), np.sin(2 * beat), np.sin(2 * beat + 1)], -1)
    assert stride.stride_frequency(signals, STEP) == pytest.approx(0.8, rel=0.01)


@pytest.mark.parametrize("frequency", [0.31, 1.0, 2.7, 5.3, 8.0, 9.5, 11.0, 17.3, 20.0])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_slow_and_fast_beats_have_accurate_frequency_and_speed(frequency, noise):
    """Errors are at most 1 %. A fast beat has only a few samples, which may miss its extremes."""
    beat = 2 * np.pi * frequency * TIME
    signals = np.sin(beat[:, None] - np.arange(6))
    signals += noise * np.random.default_rng(1).normal(size=signals.shape)
    assert stride.stride_frequency(signals, STEP) == pytest.approx(frequency, rel=0.01)
    if frequency > 12:
        return
    path = np.stack([TIME, 0 * TIME, 0 * TIME], -1)
    tip = path + np.stack([0 * TIME, 0.1 * np.sin(beat), 0 * TIME], -1)
    nose = path + np.array([1.0, 0.0, 0.0])
    found = sway(np.stack([nose, tip], 1), STEP, frequency)
    assert found.cycles.peak_to_peak[1] == pytest.approx(0.2, rel=0.01)
    assert stride.path_speed(tip, STEP, frequency) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(
    "signals",
    [
        np.zeros((600, 3)),
        np.ones((600, 3)) * [1, 2, 3],
        np.zeros((600, 0)),
        np.sin(2 * np.pi * np.arange(600)[:, None] / 900),
        np.linspace(0, 1, 600)[:, None],
        np.random.default_rng(3).normal(size=(600, 1)),
        np.zeros((4, 1)),
    ],
    ids=["nothing", "still", "no joint", "too slow", "drift", "noise", "too short"],
)
def test_signals_without_repetition_have_no_stride(signals):
    assert math.isnan(stride.stride_frequency(signals, STEP))


def test_path_speed_leaves_out_the_sway():
    """The path advances at 0.2 m/s and sways by 5 cm at 2 Hz, at up to 0.63 m/s."""
    path = np.stack([0.2 * TIME, 0.05 * np.sin(4 * np.pi * TIME), 0 * TIME], -1)
    assert stride.path_speed(path, STEP, 2.0) == pytest.approx(0.2, rel=1e-3)
    circle = np.stack([np.cos(0.3 * TIME), np.sin(0.3 * TIME), 0 * TIME], -1)
    assert stride.path_speed(circle, STEP, 2.0) == pytest.approx(0.3, rel=0.01)
    # Without a stride, the path is the straight line from start to end.
    chord = np.linalg.norm(circle[-1] - circle[0]) / (TIME[-1] - TIME[0])
    assert stride.path_speed(circle, STEP, math.nan) == pytest.approx(chord, rel=1e-3)
    assert stride.path_speed(0 * path, STEP, 2.0) == 0.0
    assert math.isnan(stride.path_speed(path[:1], STEP, math.nan))


@pytest.mark.parametrize("course", [0.0, 1.1])
@pytest.mark.parametrize("upright", [False, True], ids=["sideways", "up and down"])
def test_the_sway_of_a_tail_and_its_strouhal_number(course, upright):
    """The tail swings by 0.07 m to each side, while the animal moves at 0.5 m/s."""
    along = np.array([math.cos(course), math.sin(course), 0.0])
    across = np.array([0.0, 0.0, 1.0]) if upright else np.cross([0.0, 0.0, 1.0], along)
    beat = 2 * np.pi * 1.5 * TIME
    path = 0.5 * TIME[:, None] * along
    # The swing along the body does not count.
    tip = path - along + 0.07 * np.sin(beat)[:, None] * across
    tip = tip + 0.2 * np.cos(2 * beat)[:, None] * along
    found = float(sway(np.stack([path, tip], 1), STEP, 1.5).cycles.peak_to_peak[1])
    assert found == pytest.approx(0.14, rel=0.01)
    speed = stride.path_speed(path, STEP, 1.5)
    assert strouhal_number(1.5, found, speed) == pytest.approx(0.42, rel=0.02)


def test_a_standing_animal_has_no_gait_numbers():
    still = np.zeros((600, 2, 3))
    assert sway(still, STEP, 1.0).cycles.peak_to_peak[1] == 0.0
    assert sway(still, STEP, math.nan) is None
    assert sway(still, STEP, 0.01) is None
    assert math.isnan(strouhal_number(1.0, 0.1, 0.0))
    assert math.isnan(stride.stride_length(0.3, math.nan))
    assert math.isnan(stride.cost_of_transport(5.0, 2.0, 9.81, 0.0))
    assert math.isnan(stride.cost_of_transport(5.0, 2.0, 0.0, 1.0))


def test_stride_length_and_cost_of_transport():
    assert stride.stride_length(0.6, 1.5) == pytest.approx(0.4)
    assert stride.cost_of_transport(98.1, 2.0, 9.81, 10.0) == pytest.approx(0.5)
