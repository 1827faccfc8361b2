"""A run with three situations: training, verification, plots and films of any of them."""

import pytest
import yaml

from evo_cpg.cli.options import View
from evo_cpg.view.camera import CAMERAS
from pictures import ink
from tiny_run import CONFIG, PAIR

TRIALS = (
    "[{light: {bearing_deg: -60}}, {light: {bearing_deg: 60, distance: 5}}, "
    "{start: [3, 0], start_heading_deg: 180, light: {at: [0, 1, 0.5]}}]"
)


@pytest.fixture(scope="module")
def situated_run(cli, tmp_path_factory):
    folder = tmp_path_factory.mktemp("situated") / "run"
    overrides = (*PAIR, f"simulation.trials={TRIALS}", "evolution.generations=2")
    cli.passes("train", CONFIG, *overrides, "--out", folder, "--cores", 2)
    return folder


@pytest.mark.slow
def test_the_champion_is_verified_exactly(situated_run, cli):
    code, out, err = cli("verify", situated_run)
    assert (code, err) == (0, "")
    assert out.endswith("is as recorded (exactly)\n")
    written = yaml.safe_load((situated_run / "config.yaml").read_text())
    assert written["simulation"]["trials"] == yaml.safe_load(TRIALS)


@pytest.mark.slow
def test_any_trial_can_be_plotted_and_filmed(situated_run, cli, tmp_path):
    out, _ = cli.passes("plot", situated_run, "--trial", 2, "-o", tmp_path)
    names = ["fitness.png", "joint_signals_trial2.png", "path_trial2.png"]
    assert out.splitlines() == [str(tmp_path / name) for name in names]
    assert all(0.005 < ink(tmp_path / name) < 0.5 for name in names)
    picture = tmp_path / "film.png"
    code, out, err = cli("render", situated_run, "--trial", 1, "--size", "64x48", "-o", picture)
    assert (code, out) == (0, f"{picture}\n"), err


@pytest.mark.slow
def test_each_camera_has_its_own_file(situated_run, cli):
    assert tuple(View) == CAMERAS
    small = ("--size", "64x48", "--seconds", "0.1")
    code, out, err = cli("render", situated_run, "--camera", "top", "--trial", 1, *small)
    assert (code, out) == (0, f"{situated_run / 'videos' / 'champion_trial1_top.mp4'}\n"), err


@pytest.mark.parametrize("command", ["render", "plot"])
def test_a_missing_trial_is_refused(situated_run, cli, command):
    assert "has 3 trial(s)" in cli.refuses(command, situated_run, "--trial", 3)
    assert "--trial" in cli.refuses(command, situated_run, "--trial", -1)


@pytest.mark.slow
def test_a_run_over_uneven_ground_trains_and_verifies(cli, finish, tmp_path):
    """Checks of the start and the light precede training, and must not fix the number of cores."""
    folder, floor = tmp_path / "run", "{type: plane, slope_deg: 5, height: -3}"
    overrides = (*PAIR, "evolution.generations=1", f"world.ground.floor={floor}")
    code, _, err = finish("train", CONFIG, *overrides, "--out", folder, "--cores", 2)
    assert code == 0, err
    code, out, err = cli("verify", folder)
    assert code == 0 and out.endswith("is as recorded (exactly)\n"), err
