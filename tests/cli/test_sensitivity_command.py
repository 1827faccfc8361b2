"""`evo-cpg sensitivity` on a tiny run: its table, its picture, and its errors."""

import csv
import dataclasses

import pytest

from evo_cpg.analysis.sensitivity import Sensitivity
from evo_cpg.cli import champions, sensitivity
from evo_cpg.io.schema.controller import PosturesConfig
from pictures import ink

KEYS = ("world.water.form_drag", "world.water.current.0", "genes")


@pytest.mark.slow
def test_the_table_ranks_the_requested_keys(finished_run, cli, tmp_path):
    folder = tmp_path / "made"
    arguments = ("--seconds", 1, "--out", folder)
    code, out, err = cli("sensitivity", finished_run, *KEYS, *arguments)
    assert code == 0, err
    *_, table, picture = out.splitlines()
    assert (table, picture) == (str(folder / "sensitivity.csv"), str(folder / "sensitivity.png"))
    assert 0.01 < ink(folder / "sensitivity.png") < 0.5
    with (folder / "sensitivity.csv").open() as file:
        rows = {row["key"]: row for row in csv.DictReader(file)}
    assert set(rows) == set(KEYS)
    # A value of 0 has no relative change, so its row is the last.
    assert list(rows)[-1] == "world.water.current.0"
    assert rows["world.water.current.0"]["relative"] == "0"
    drag = rows["world.water.form_drag"]
    assert drag["speed_confirmed"] == "1"
    # The curvature causes a difference of 1 %.
    assert float(drag["speed_elasticity"]) == pytest.approx(float(drag["speed_found"]), rel=0.05)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["world.water.form_darg"], "did you mean world.water.form_drag"),
        (["simulation.substeps"], "is a whole number"),
        (["--seconds", 99], "--seconds: 99 s is not allowed"),
        (["--seconds", 0.02], "Allowed: 0.0333 to "),
        (["--seconds", "nan"], "--seconds"),
        (["--seconds", "inf"], "--seconds: inf s is not allowed"),
    ],
)
def test_wrong_keys_and_times_are_refused(finished_run, cli, arguments, words):
    code, _, complaint = cli("sensitivity", finished_run, *arguments)
    assert code == 2 and words in complaint


def test_bits_have_no_sensitivity(finished_run, cli, monkeypatch):
    """A bit cannot change by 1 %, so a table with 0 would call the genes unimportant."""
    open_champion = champions.open_champion

    def with_postures(run, which):
        opened = open_champion(run, which)
        postures = {"controller": PosturesConfig(type="postures")}
        return dataclasses.replace(opened, config=opened.config.model_copy(update=postures))

    monkeypatch.setattr(champions, "open_champion", with_postures)
    code, _, complaint = cli("sensitivity", finished_run, "genes")
    assert code == 2
    assert "genes: bits are 0 or 1" in complaint and "controller.graded: true" in complaint


def test_an_infinite_change_is_a_dash_in_the_table():
    speed = Sensitivity("p", 2.0, 3.0, 0.12, 0.04, 6.0)
    nothing = Sensitivity("p", 2.0, 1e-17, 0.0, 0.04, 1e-17)
    cells = sensitivity._cells(sensitivity._row(speed, nothing))
    assert cells[2:] == ("+1 %/%", "? \N{EN DASH}")
