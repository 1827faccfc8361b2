"""`evo-cpg probe` on a tiny run: its table, its picture, and its errors."""

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from evo_cpg.api.probe import Probed
from evo_cpg.simulation.situation import Situation
from evo_cpg.training.conditions import Probe, around
from evo_cpg.training.run_folder import RunFolder
from pictures import ink

LIGHTS = ("--bearings=-60:60:3", "--distances", "3,5")


def rows(path: Path) -> list[dict[str, float]]:
    with path.open() as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def probed(finished_run, cli, tmp_path_factory):
    folder = tmp_path_factory.mktemp("probe") / "made"
    out, _ = cli.passes("probe", finished_run, *LIGHTS, "--out", folder, "--reach", 0.97)
    return folder, out


def test_probe_prints_a_table_a_summary_and_its_files(probed):
    folder, out = probed
    found = rows(folder / "probe.csv")
    *table, summary, file, picture = out.splitlines()
    assert (file, picture) == (str(folder / "probe.csv"), str(folder / "probe.png"))
    reached = sum(row["reached"] for row in found)
    assert summary.startswith(f"{reached:.0f} of 6 lights reached ({reached / 6:.0%}), with at")
    assert all(f"{row['distance']:.1%}" in "\n".join(table) for row in found)
    assert 0.01 < ink(folder / "probe.png") < 0.5


def test_the_table_has_the_requested_lights_and_the_results(probed):
    found = rows(probed[0] / "probe.csv")
    lights = [(row["bearing_deg"], row["start_distance"]) for row in found]
    requested = [(b, d) for d in (3, 5) for b in (-60, 0, 60)]
    np.testing.assert_allclose(lights, requested, atol=1e-9)
    for row in found:
        assert row["distance_left"] == pytest.approx(row["distance"] * row["start_distance"])
        assert row["reached"] == (row["distance"] <= 0.97)
        assert row["diverged"] == 0
    assert len({row["light"] for row in found}) == 6


def test_trials_of_the_configuration_give_the_terms_of_training(finished_run, cli, tmp_path):
    _, err = cli.passes("probe", finished_run, "--trials", "--out", tmp_path)
    missed = (
        f"evo-cpg: warning: {finished_run}: the champion: it misses most lights: it reaches 0 of 1"
    )
    assert missed in err
    (row,) = rows(tmp_path / "probe.csv")
    champion, _, _ = RunFolder(finished_run).load_champion()
    assert row["bearing_deg"] == 30 and row["start_distance"] == pytest.approx(8)
    assert row["distance"] == pytest.approx(champion.terms["distance"], rel=1e-4)
    assert row["light"] == pytest.approx(champion.terms["light"], rel=1e-4)


def test_a_blind_probe_has_its_own_files_and_sees_no_light(finished_run, cli, tmp_path):
    out, err = cli.passes("probe", finished_run, *LIGHTS, "--blind", "--out", tmp_path)
    assert f"warning: {finished_run}: the champion: it " in err or "blinded, it keeps" in out
    found = rows(tmp_path / "probe_blind.csv")
    assert out.splitlines()[-1] == str(tmp_path / "probe_blind.png")
    assert all(row["light"] == 0 for row in found)


def made_of(bearings: list[float], left: list[float]) -> Probe:
    """Return a probe of lights at 5 m, with the given fractions of the distance left."""
    start = Situation((0.0, 0.0, 0.0), 0.0, (5.0, 0.0, 0.0))
    situations = around(start, np.deg2rad(bearings))
    count = len(left)
    alive, paths = np.isfinite(left), np.zeros((count, 2, 3))
    return Probe(situations, np.full(count, 5.0), np.array(left), np.zeros(count), alive, paths)


LIGHT = (-60, -20, 20, 60)
MISSED = "it misses most lights: it reaches"
UNUSED = "it does not use its eyes: blinded, it keeps"


@pytest.mark.parametrize(
    ("bearings", "left", "blind", "words"),
    [
        (LIGHT, [0.1, 0.1, 0.1, 0.1], None, ""),
        (LIGHT, [0.9, 0.9, 0.1, 0.1], None, ""),
        (LIGHT, [0.9, 0.9, 0.9, 0.1], None, f"{MISSED} 1 of 4, all of them on the left"),
        (LIGHT, [0.1, 0.9, 0.9, 0.9], None, f"{MISSED} 1 of 4, all of them on the right"),
        (LIGHT, [0.9, 0.9, 0.9, np.nan], None, f"{MISSED} 0 of 4"),
        ([-30, 30], [0.1, 0.1], [0.25, 0.25], f"{UNUSED} 83% of its displacement"),
        ([-30, 30], [0.1, 0.1], [0.1, 0.1], f"{UNUSED} 100% of its displacement"),
        ([-30, 30], [0.1, 0.1], [0.9, 0.3], ""),
        ([-30, 30], [0.1, 0.1], [2.0, np.nan], ""),
        ([-30, 30], [1.0, 1.1], [1.0, 1.1], "nothing can be compared"),
    ],
)
def test_missed_lights_and_unused_eyes_are_warnings(bearings, left, blind, words):
    """An animal without displacement cannot be compared with a blinded one."""
    seeing = made_of(bearings, left)
    given = (seeing, None) if blind is None else (made_of(bearings, blind), seeing)
    found = Probed("", *given, 0.2, True).remark
    assert words in found and bool(found) == bool(words)


def test_a_task_without_a_light_cannot_be_probed(finished_run, cli, tmp_path):
    copy = tmp_path / "run"
    shutil.copytree(finished_run, copy)
    config = yaml.safe_load((copy / "config.yaml").read_text())
    config["task"] = {"type": "distance"}
    (copy / "config.yaml").write_text(yaml.safe_dump(config))
    assert "has no light" in cli.refuses("probe", copy)
