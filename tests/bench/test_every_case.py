"""Every case yields valid rows, which the picture and the tables accept."""

import math
import subprocess
import sys

import matplotlib.image
import numpy as np
import pytest

from benchmarks import breeding, jax_peers, machine, picture, suite
from benchmarks.plan import Plan
from benchmarks.report import tables
from benchmarks.rows import SECONDS, load, save
from tiny_run import REPOSITORY

PEAK = 1e11
MACHINE = {"processor": "abacus", "cores": 2, "float32_peak": PEAK}
# The other cases compile for long.
FAST = {"cpg", "brain", "ga"}
TIMES = {"time", "first ever", "again"}
PLAN = Plan(2, call_seconds=0.01, repeats=2, quick=True)
CASES = [
    name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in suite.CASES
]


def test_fast_cases_are_cases():
    assert set(suite.CASES) > FAST


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_case_yields_valid_rows(name, monkeypatch, tmp_path):
    # Warnings of the peers' packages would fail the test, so the peers are left out.
    monkeypatch.setattr(jax_peers, "_MODULES", {"mjx": "no_such_mjx", "brax": "no_such_brax"})
    monkeypatch.setattr(breeding, "_MODULE", "no_such_evosax")
    sizes = (2,) if suite.CASES[name].sized else None
    rows = list(suite.CASES[name].measure(PLAN._replace(sizes=sizes), PEAK))
    assert rows
    for row in rows:
        assert row.case == name
        assert row.rate > 0
        if sizes:
            assert row.size == 2
        for error in (row.error, row.peer_error):
            assert error is None or (math.isfinite(error) and error > 0)
        assert (row.ratio is None) == (row.peer_rate is None)
        assert row.peer is None or (row.peer_rate is None) == (row.note == "not installed")
        if row.ratio is not None and row.ratio_spread is not None:
            assert row.ratio_spread[0] <= row.ratio <= row.ratio_spread[1]
        if row.peak_share is not None:
            assert row.flops == pytest.approx(row.peak_share * PEAK)
    measured = [row for row in rows if row.error is not None]
    assert bool(measured) == (name in {"cpg", "brain", *suite.ANIMALS})
    # The brain's error is rounding. The other errors come from the step, and are larger.
    assert all(row.error < (1e-5 if name == "brain" else 1) for row in measured)
    assert len({row.key for row in rows}) == len(rows)
    assert all((row.unit == SECONDS) == (row.part in TIMES) for row in rows)
    save(tmp_path / "bench.json", MACHINE, rows)
    assert load(tmp_path / "bench.json")[1] == rows
    assert tables(rows, MACHINE)[0].row_count == len({row.key[:3] for row in rows})
    drawn = matplotlib.image.imread(picture.draw(rows, MACHINE, tmp_path / "bench.png"))
    assert drawn.shape[1] == 900
    blue = np.array([0x00, 0x72, 0xB2]) / 255
    bars = (np.abs(drawn[..., :3] - blue).max(-1) < 0.02).any()
    assert bars == (name in suite.ANIMALS)


def test_the_peak_of_a_matrix_product_is_plausible():
    """The bounds, 1/s, hold for every processor that runs JAX."""
    assert 1e9 < machine.matrix_product_rate() < 2e12


@pytest.mark.slow
def test_the_peak_memory_grows_with_allocations():
    # This process may have had a higher peak before, so a new process measures.
    program = (
        "import numpy as np; from benchmarks.machine import peak_memory; before = peak_memory(); "
        "held = np.ones(2**26 // 8); print(before, peak_memory())"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=True
    )
    before, after = map(int, done.stdout.split())
    assert before < after < before + 2**28
