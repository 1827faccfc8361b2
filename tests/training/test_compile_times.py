"""Compile times are estimated from measured times."""

import pytest

from evo_cpg.fusion.backend import machine
from evo_cpg.fusion.stopwatch import Spent
from evo_cpg.training.compile_times import expected_seconds, note_seconds


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "_folder", tmp_path)
    return tmp_path


def test_there_is_no_estimate_before_the_first_measurement(folder):
    assert expected_seconds(1000.0, "swimmer") is None
    note_seconds(1000.0, "swimmer", Spent())
    assert not list(folder.iterdir())


def test_a_known_animal_takes_its_time_without_the_compiler(folder):
    note_seconds(1000.0, "swimmer", Spent(8.0, 5.0))
    assert expected_seconds(1000.0, "swimmer") == 3.0
    note_seconds(1000.0, "swimmer", Spent(4.0, 0.0))
    assert expected_seconds(1000.0, "swimmer") == 4.0


def test_another_animal_takes_equal_time_per_operation(folder):
    note_seconds(1000.0, "swimmer", Spent(8.0, 5.0))
    assert expected_seconds(2000.0, "walker") == expected_seconds(2000.0) == 16.0
    # This does not measure new code, because all code was cached.
    note_seconds(1000.0, "swimmer", Spent(3.0, 0.0))
    assert expected_seconds(2000.0, "walker") == 16.0
    note_seconds(500.0, "walker", Spent(12.0, 5.0))
    assert expected_seconds(1000.0, "crawler") == pytest.approx(1000 * (4 + 12) / (500 + 500))


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"rate": [1], "animals": {}}', '{"rate": [1, NaN], "animals": {}}']
)
def test_a_broken_file_counts_as_missing(folder, content):
    (folder / "compile-times.json").write_text(content, encoding="utf-8")
    assert expected_seconds(1000.0, "swimmer") is None
    note_seconds(1000.0, "swimmer", Spent(8.0, 5.0))
    assert expected_seconds(1000.0) == 8.0


def test_the_oldest_animals_are_dropped(folder, monkeypatch):
    monkeypatch.setattr("evo_cpg.training.compile_times._MOST", 2)
    for number, name in enumerate(("a", "b", "c")):
        note_seconds(1000.0, name, Spent(10.0 + number, 9.0))
    assert expected_seconds(0.0, "a") == 0.0
    assert (expected_seconds(0.0, "b"), expected_seconds(0.0, "c")) == (2.0, 3.0)


def test_an_unwritable_folder_raises_no_error(folder, monkeypatch):
    monkeypatch.setattr(machine, "_folder", folder / "gone")
    note_seconds(1000.0, "swimmer", Spent(8.0, 5.0))
    assert expected_seconds(1000.0) is None
