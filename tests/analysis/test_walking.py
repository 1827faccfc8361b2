"""Walking numbers of motions with known answers."""

import math

import numpy as np
import pytest

from evo_cpg.analysis.animals import reynolds_of_swimmers, running_cost, swimming_cost
from evo_cpg.analysis.stride import froude_number, recovery, tripod_strength

BEAT = np.linspace(0.0, 10 * 2 * np.pi, 10 * 720 + 1)


def test_recovery_of_many_settings():
    """R = 1 - |cos(d / 2)|."""
    shifts = np.radians([0.0, 90.0, 120.0, 180.0])
    other = np.sin(BEAT[:, None] + shifts)
    found = recovery(np.broadcast_to(np.sin(BEAT)[:, None], other.shape), other)
    np.testing.assert_allclose(found, 1 - np.abs(np.cos(shifts / 2)), atol=1e-4)
    assert np.isnan(recovery(np.ones(5), np.ones(5)))


def test_froude_number_of_a_walker():
    """v 1 m/s and h 0.2039 m: 0.5. The root of it is 0.7."""
    assert froude_number(1.0, 9.81, 1 / 9.81 / 0.5) == pytest.approx(0.5)
    assert math.sqrt(froude_number(1.0, 9.81, 0.2039)) == pytest.approx(0.7, abs=0.01)
    assert math.isnan(froude_number(1.0, 0.0, 0.2))


def swings(starts: list[int], length: int = 40, stride: int = 100, count: int = 8) -> np.ndarray:
    """Return contacts of legs that swing once in a stride, from their starts on."""
    time = np.arange(stride * count)
    return np.stack([(time - start) % stride >= length for start in starts], -1)


@pytest.mark.parametrize(("late", "expected"), [(0, 1.0), (5, 30 / 50), (10, 20 / 60), (20, 0.0)])
def test_tripod_strength_of_swings_that_follow_each_other(late, expected):
    """Swings of 40 samples: (40 - 2 d) / (40 + 2 d)."""
    first, second = [0, late, 2 * late], [50, 50 + late, 50 + 2 * late]
    # L1, R2, L3 swing first.
    legs = swings([first[0], second[1], first[2], second[0], first[1], second[2]])
    assert tripod_strength(legs[..., None]) == pytest.approx(expected)


def test_legs_that_stand_have_no_tripod():
    assert np.isnan(tripod_strength(np.ones((100, 6, 1), bool)))


def test_running_costs_of_animals():
    """1 kg at high speed: 10.7 J/(kg m). 100 kg at 1 m/s: 2.50 + 1.49 J/(kg m)."""
    assert running_cost(1.0) * 9.80665 == pytest.approx(10.7)
    expected = 10.7 * 100**-0.316 + 6.03 * 100**-0.303
    assert running_cost(100.0, 1.0) * 9.80665 == pytest.approx(expected)
    np.testing.assert_allclose(
        running_cost(np.array([1.0, 1000.0]))[1] / running_cost(1.0), 0.1127, rtol=1e-3
    )


def test_swimming_costs_of_fish():
    """A fish of 0.35 kg has 1.2 J/(kg m). 20 kg have 0.03 to 0.10 J/(N m)."""
    low, _ = swimming_cost(0.35)
    assert low * 9.81 == pytest.approx(1.2, abs=0.05)
    low, high = swimming_cost(20.0)
    assert low == pytest.approx(0.026, abs=0.001)
    assert high == pytest.approx(0.104, abs=0.001)


def test_reynolds_numbers_of_swimmers():
    """Both laws of Gazzola et al. 2014 meet near Sw = 7500."""
    found = reynolds_of_swimmers(np.array([1e2, 1e6]))
    np.testing.assert_allclose(found, [0.03 * 1e2**1.31, 0.4 * 1e6**1.02])
    meet = (0.4 / 0.03) ** (1 / 0.29)
    assert meet == pytest.approx(7500, rel=0.02)
