"""`evo-cpg sensitivity` on a tiny run: its table, its picture, and its errors."""

import csv
import dataclasses

import pytest

import evo_cpg as evo
from evo_cpg.analysis.sensitivity import Sensitivity
from evo_cpg.api import sensitivity
from evo_cpg.errors import UsageError
from evo_cpg.io.schema.controller import PosturesConfig
from pictures import ink

KEYS = ("world.water.form_drag", "world.water.current.0", "genes")


@pytest.mark.slow
def test_the_table_ranks_the_requested_keys(finished_run, tmp_path):
    found = evo.sensitivity(finished_run, KEYS, seconds=1)
    table, picture = found.save(tmp_path / "made")
    assert 0.01 < ink(picture) < 0.5
    with table.open() as file:
        rows = {row["key"]: row for row in csv.DictReader(file)}
    assert set(rows) == set(KEYS) == {one.key for one in found.speed}
    # A value of 0 has no relative change, so its row is the last.
    assert list(rows)[-1] == "world.water.current.0"
    assert rows["world.water.current.0"]["relative"] == "0"
    drag = rows["world.water.form_drag"]
    assert drag["speed_confirmed"] == "1"
    # The curvature causes a difference of 1 %.
    assert float(drag["speed_elasticity"]) == pytest.approx(float(drag["speed_found"]), rel=0.05)


def test_the_command_prints_the_result(cli, finished_run, monkeypatch, tmp_path):
    """An infinite change is a dash."""
    speed = Sensitivity("p", 2.0, 3.0, 0.12, 0.04, 6.0)
    nothing = Sensitivity("p", 2.0, 1e-17, 0.0, 0.04, 1e-17)
    found = evo.Sensitivities("an eel", 1.0, (speed,), (nothing,))
    monkeypatch.setattr(evo, "sensitivity", lambda *_: found)
    code, out, _ = cli("sensitivity", finished_run, "--out", tmp_path / "made")
    assert code == 0 and "+1 %/%" in out and "? \N{EN DASH}" in out
    assert str(tmp_path / "made" / "sensitivity.csv") in out


@pytest.mark.parametrize(
    ("keys", "seconds", "words"),
    [
        (["world.water.form_darg"], None, "did you mean world.water.form_drag"),
        (["simulation.substeps"], None, "is a whole number"),
        ([], 99, "seconds: 99 s is not allowed"),
        ([], 0.02, "Allowed: 0.0333 to "),
        ([], float("inf"), "inf s is not allowed"),
    ],
)
def test_wrong_keys_and_times_are_refused(finished_run, keys, seconds, words):
    with pytest.raises((evo.ConfigError, UsageError), match=words):
        evo.sensitivity(finished_run, keys, seconds)


def test_bits_have_no_sensitivity(finished_run, cli, monkeypatch):
    """A bit cannot change by 1 %, so a table with 0 would call the genes unimportant."""
    open_champion = sensitivity.open_champion

    def with_postures(run, number):
        opened = open_champion(run, number)
        postures = {"controller": PosturesConfig(type="postures")}
        return dataclasses.replace(opened, config=opened.config.model_copy(update=postures))

    monkeypatch.setattr(sensitivity, "open_champion", with_postures)
    assert "genes: bits are 0 or 1" in cli.refuses("sensitivity", finished_run, "genes")
