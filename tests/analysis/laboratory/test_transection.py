"""Measures of the two sides of a cut, on sinusoids with known lags."""

import numpy as np
import pytest

from evo_cpg.analysis.laboratory.measures import cut_of, sides
from evo_cpg.analysis.laboratory.settings import NOTHING

STEP = 1 / 60
TIME = np.arange(600) * STEP


@pytest.mark.parametrize("lag", [-120.0, 0.0, 40.0, 170.0])
def test_lag_of_two_sinusoids_is_their_phase_difference(lag):
    front = np.sin(2 * np.pi * 1.3 * TIME)
    behind = 0.2 + 0.5 * np.sin(2 * np.pi * 1.3 * TIME - np.deg2rad(lag))
    found = sides(front, behind, STEP)
    assert found.front == pytest.approx(1.3, rel=1e-3) == found.behind
    assert found.lag == pytest.approx(lag, abs=1.0)
    assert found.scatter < 0.005


def test_rhythms_of_their_own_have_a_scattered_lag():
    found = sides(np.sin(2 * np.pi * TIME), np.sin(2 * np.pi * 1.31 * TIME), STEP)
    assert found.behind == pytest.approx(1.31, rel=1e-3)
    assert found.scatter > 0.25


def test_still_side_has_no_rhythm():
    found = sides(np.sin(2 * np.pi * TIME), 0 * TIME, STEP)
    assert found.front == pytest.approx(1.0, rel=1e-3)
    assert np.isnan([found.behind, found.lag, found.scatter]).all()


def test_intact_animals_are_measured_at_the_only_cut():
    assert cut_of([{"cut": "none"}, {"cut": "tail2"}]) == "tail2"
    assert cut_of([{"cut": "tail1"}, {"cut": "tail2"}]) == NOTHING == cut_of([{"u": 1.0}])
