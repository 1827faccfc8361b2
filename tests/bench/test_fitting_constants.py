"""Candidates of a constant are timed in turn, each with its own value set."""

import time

import pytest

from benchmarks.fit_constants import CONSTANTS, Constant, compare
from evo_cpg.native import machine_constants


def test_twice_the_time_is_measured(monkeypatch):
    monkeypatch.setattr(machine_constants, "LANES", 20)
    seen = []

    def work():
        compiled = machine_constants.LANES

        def call():
            assert compiled == machine_constants.LANES
            seen.append(compiled)
            time.sleep(1e-3 * compiled)

        return call

    present, other = compare("LANES", Constant((20, 40), {"sleep": work}), "sleep", 3)
    assert (present.value, other.value) == (20, 40)
    assert present.time == (1.0, 1.0, 1.0)
    assert other.time[1] == pytest.approx(2.0, rel=0.25)
    assert seen.count(20) == seen.count(40) >= 3
    assert machine_constants.LANES == 20


def test_fitted_constants_exist():
    assert all(hasattr(machine_constants, name) for name in CONSTANTS)
