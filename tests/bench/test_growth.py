"""Costs of creatures of many bodies: tables, exponents, and the memory of compilers."""

import dataclasses
import subprocess
import sys

import pytest

from benchmarks import growth, large_creatures
from benchmarks.machine import children_watched
from benchmarks.plan import Plan
from benchmarks.report import line, notes, page_tables, tables
from benchmarks.rows import Build, Row
from benchmarks.worker import WorkerError

MACHINE = {"processor": "abacus", "cores": 2, "float32_peak": 1e11, "versions": {}}
REASON = "a trial runs on plain JAX, not as native code: it has more than 600000 operations"


def row(bodies, compile_seconds, native=True, **fields):
    build = Build("chains", bodies, bodies * 1000, 0.1, 2.0, 3.0, 2**20, 2**22, 2**28, native)
    part = f"chain, {bodies} bodies"
    made = Row("large-creatures", part, 64, 5e5, "steps/s", "a test", compile_seconds, build=build)
    return dataclasses.replace(made, memory=2**29, **fields)


# A power of 1.5 up to 40 bodies. The creature on plain JAX would increase the exponent.
ROWS = [row(10, 1.0), row(20, 2**1.5), row(40, 8.0), row(60, 1000.0, False, note=REASON)]


def test_the_exponent_of_a_power_is_found():
    assert growth.exponent([1, 10, 100], [3.0, 3 * 10**0.7, 3 * 10**1.4]) == pytest.approx(0.7)


def test_tables_have_costs_and_exponents():
    costs, exponents = page_tables(ROWS, MACHINE)
    cells = [dict(zip(costs.head, each, strict=True)) for each in costs.rows]
    units = {"memory, MiB": "512", "compiler, MiB": "256", "scratch, MiB": "4.0", "us/step": "2"}
    assert cells[0].items() >= units.items() and cells[0]["compile, s"] == "1.0"
    assert [each["engine"] for each in cells] == ["native"] * 3 + ["plain JAX"]
    assert exponents.rows == [["chains", "64", "10 to 40", "1.00", "1.50", "0.00"]]
    assert notes(ROWS) == [f"large-creatures, 64, chain, 60 bodies: {REASON}"]


def test_other_rows_have_no_tables_of_growth():
    other = Row("brain", "network", 64, 5e5, "steps/s", "a test")
    assert growth.tables([other]) == []
    assert len(tables([other], MACHINE)) == 2
    assert len(tables([other, *ROWS], MACHINE)) == 4
    assert growth.tables(ROWS[:1])[1].rows == []


def test_a_process_that_dies_leaves_a_row(monkeypatch):
    def dies(worker, limit):
        raise WorkerError("ended with code -11: no message")

    monkeypatch.setattr("benchmarks.worker.Worker.answer", dies)
    monkeypatch.setattr("benchmarks.worker.Worker.__init__", lambda *_: None)
    monkeypatch.setattr("benchmarks.worker.Worker.stop", lambda _: None)
    rows = list(large_creatures.measure(Plan(2, quick=True)))
    assert [each.build.bodies for each in rows] == [5, 9]
    assert all(each.rate == 0 and each.note == "ended with code -11: no message" for each in rows)
    assert line(rows[0]) == "large-creatures, capsules, 2 legs, 64: none"
    costs, exponents = growth.tables(rows)
    assert costs.rows[0][-2:] == ["", "none"] and exponents.rows == []


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not report it")
def test_the_memory_of_children_is_measured():
    program = "held = bytearray(b'1') * 2**27; import time; time.sleep(0.3)"
    with children_watched() as peak:
        assert peak() is None
        subprocess.run([sys.executable, "-c", program], check=True)
        found = peak()
    assert 2**27 < found < 2**28
