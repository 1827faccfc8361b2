"""Rows are stored without loss, and slower rows are found."""

import dataclasses

import pytest

from benchmarks import rows
from benchmarks.compare import compare
from benchmarks.report import comparison, notes, tables
from benchmarks.rows import Row, RowsError

MACHINE = {"processor": "abacus", "cores": 2, "float32_peak": 1e11, "quick": False}
BESIDE = Row("swimmer", "physics", 200, 2.5e6, "steps/s", "in turn", 9.5, 100_000, 2**28,
             0.004, 3e10, 0.3, "MuJoCo", 5e4, 0.012, 50.0, (49.0, 51.0))  # fmt: skip
ALONE = Row("cpg", "oscillators", 200, 1e7, "control steps/s", "alone")
TIMED = Row("startup", "again", 200, 20.0, "s", "a process of its own")
ABSENT = Row("ga", "bits", 200, 6.0, "generations/s", "alone", peer="evosax", note="not installed")
ROWS = [BESIDE, ALONE, TIMED, ABSENT]


def changed(row, **fields):
    return dataclasses.replace(row, **fields)


def slower(*now, then=ROWS, tolerance=0.1):
    verdict = compare((MACHINE, list(then)), (MACHINE, list(now)), tolerance)
    return [change.row for change in verdict.slower]


def test_loaded_rows_equal_the_saved_rows(tmp_path):
    path = tmp_path / "bench.json"
    rows.save(path, MACHINE, ROWS)
    assert rows.load(path) == (MACHINE, ROWS)


def test_equal_rows_are_not_slower():
    assert slower(*ROWS) == []


def test_a_row_with_a_peer_is_compared_by_its_ratio():
    """A machine at half its speed is no regression. A lower ratio is one."""
    assert slower(changed(BESIDE, rate=1.25e6, peer_rate=2.5e4)) == []
    worse = changed(BESIDE, ratio=44.0)
    assert slower(worse) == [worse]
    assert slower(worse, tolerance=0.15) == []


def test_a_row_without_a_ratio_is_compared_by_its_rate():
    worse = [changed(ALONE, rate=8.9e6), changed(TIMED, rate=22.5), changed(ABSENT, rate=5.0)]
    assert slower(*worse) == worse
    assert slower(changed(ALONE, rate=9.1e6), changed(TIMED, rate=10.0)) == []


def test_differences_between_the_runs_are_remarked():
    other = {**MACHINE, "processor": "slide rule", "quick": True}
    new = changed(ALONE, size=15)
    verdict = compare((other, ROWS), (MACHINE, [BESIDE, new]), 0.1)
    assert [change.row for change in verdict.changes] == [BESIDE]
    text = "\n".join(verdict.remarks)
    assert "1 of 2 rows have no counterpart" in text
    assert "another processor: slide rule" in text
    assert "one run was quick" in text


def test_the_tables_hold_every_row():
    assert [table.row_count for table in tables(ROWS, MACHINE)] == [4, 2]
    assert notes([*ROWS, ABSENT]) == ["ga, 200, evosax: not installed"]
    verdict = compare((MACHINE, ROWS), (MACHINE, ROWS), 0.1)
    assert comparison(verdict, 0.1).row_count == len(ROWS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "cannot be read"),
        ("nonsense", "is no JSON file"),
        ("[]", "has the format None, not 2"),
        ('{"format": 1}', "has the format 1, not 2"),
        ('{"format": 2, "machine": {}, "rows": [{}]}', "holds no rows of"),
        ('{"format": 2, "machine": {}}', "holds no rows of"),
        ('{"format": 2, "machine": {}, "rows": [{"x": 1}]}', "holds no rows of"),
    ],
)
def test_other_files_are_refused(tmp_path, text, words):
    path = tmp_path / "bench.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(RowsError, match=words):
        rows.load(path)


def test_numbers_that_json_lacks_are_not_written(tmp_path):
    assert rows.finite(float("nan")) is None
    with pytest.raises(ValueError, match="JSON"):
        rows.save(tmp_path / "bench.json", MACHINE, [changed(ALONE, rate=float("nan"))])
