"""Several noisy runs side by side: training, verification, plots and films."""

import csv
import shutil

import pytest

import evo_cpg as evo
from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, PAIR

NOISY = (
    "runs=2",
    "seed=3",
    "simulation.trials=2",
    "noise.joint_angle_deg=3",
    "noise.tilt_deg=2",
    "noise.push=0.05",
)


@pytest.fixture(scope="module")
def noisy_run(cli, tmp_path_factory):
    folder = tmp_path_factory.mktemp("several") / "run"
    overrides = (*PAIR, *NOISY, "evolution.generations=2")
    _, err = cli.passes("train", CONFIG, *overrides, "--out", folder, "--cores", 2)
    assert "   2/2 generations  best of 2 runs" in err and "  median" in err
    assert " (the first is 0) of run " in err
    assert " in training, mean " in err and " new draws (" in err
    return folder


@pytest.mark.slow
def test_noisy_runs_have_rows_and_an_exact_replay(noisy_run, cli):
    with (noisy_run / "metrics.csv").open() as file:
        rows = [(row["generation"], row["run"]) for row in csv.DictReader(file)]
    assert rows == [("0", "0"), ("0", "1"), ("1", "0"), ("1", "1")]
    out, err = cli.passes("verify", noisy_run)
    assert err == "" and out.endswith("is as recorded (exactly)\n")


@pytest.mark.slow
def test_resume_chooses_a_champion_that_is_not_yet_chosen(noisy_run, cli, tmp_path):
    code, _, err = cli("resume", noisy_run)
    assert code == 0 and f"{noisy_run} is finished: all 2 generations are done" in err
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(noisy_run, folder.path)
    done = folder.load()
    assert done is not None
    folder.save(done._replace(chosen=()))
    assert evo.resume(folder.path).expected is not None
    again = folder.load()
    assert again is not None
    assert [one and one.expected for one in again.chosen] == [
        one and one.expected for one in done.chosen
    ]


@pytest.mark.slow
def test_the_champion_of_any_run_is_plotted(noisy_run, cli, tmp_path):
    kept, _, _ = RunFolder(noisy_run).load_champion()
    other = 1 - kept.run
    code, out, err = cli("plot", noisy_run, "--run", other, "-o", tmp_path)
    drawn = [f"joint_signals_run{other}.png", f"path_run{other}.png"]
    assert code == 0, err
    assert out.splitlines() == [str(tmp_path / name) for name in ("fitness.png", *drawn)]


@pytest.mark.slow
def test_resume_refuses_another_number_of_runs(noisy_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(noisy_run, folder)
    config = folder / "config.yaml"
    written = config.read_text()
    # The total number of individuals is unchanged, but they are in one run.
    changed = written.replace("runs: 2", "runs: 1").replace("population: 8", "population: 16")
    config.write_text(changed)
    err = cli.refuses("resume", folder)
    assert "16 individuals in 1 run(s), but the checkpoint has" in err
    assert ", 16 and 2. Start" in err
