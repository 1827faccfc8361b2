"""While a process writes to a run folder, other commands do not change the folder."""

import os
import shutil

import pytest

from evo_cpg.api.sweep import claim, new_plan
from evo_cpg.io.settings import Setting
from evo_cpg.locks import locked
from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, PAIR, TINY, contents


@pytest.fixture
def run(finished_run, tmp_path):
    return shutil.copytree(finished_run, tmp_path / "run")


@pytest.mark.parametrize(
    "command",
    [
        ("resume", "--generations", 90),
        ("refine", "--rounds", 1),
        *((name,) for name in ("render", "plot", "analyse", "probe", "sensitivity", "audit")),
    ],
)
def test_a_command_that_writes_is_refused(cli, run, command):
    with RunFolder(run).locked():
        before = contents(run)
        code, out, err = cli(command[0], run, *command[1:])
        assert contents(run) == before
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"evo-cpg: {run} is in use by process {os.getpid()} on ")


def test_no_option_opens_a_locked_run(cli, run):
    with RunFolder(run).locked():
        code, _, err = cli("render", run, "-o", f"{run}/videos/x.mp4")
    assert code == 2 and f"{run} is in use by process" in err


def test_a_command_that_only_reads_is_allowed(cli, run, tmp_path):
    with RunFolder(run).locked():
        before = contents(run)
        assert cli("watch", run, "--once")[0] == 0
        assert cli("export", run, tmp_path / "model.xml")[0] == 0
        elsewhere = "--out", tmp_path / "x.html", "--trial", 7
        assert "has 1 trial(s)" in cli("analyse", run, *elsewhere)[2]
        assert contents(run) == before


@pytest.mark.parametrize(
    ("command", "rest"),
    [
        ("train", (CONFIG, *PAIR)),
        ("sweep", (CONFIG, *PAIR, "--grid", "seed=1,2")),
        ("reproduce", ("starfish", "--quick")),
    ],
)
def test_two_commands_cannot_make_one_folder(cli, tmp_path, command, rest):
    folder = tmp_path / "made"
    with locked(folder, make=True):
        err = cli.refuses(command, *rest, "--out", folder)
        assert f"{folder} is in use by process {os.getpid()} on " in err
        assert [path.name for path in folder.iterdir()] == [".lock"]


def test_the_holder_of_the_lock_finishes_an_interrupted_write(run):
    decided = run / ".decided"
    decided.mkdir()
    (decided / "config.yaml").write_text("name: new\n")
    with locked(run):
        RunFolder(run).require()
        assert not decided.exists() and (run / "config.yaml").read_text() == "name: new\n"


def test_an_interrupted_write_of_another_process_is_left_alone(run, monkeypatch):
    (run / ".decided").mkdir()
    (run / ".decided" / "config.yaml").write_text("name: new\n")
    monkeypatch.setattr("evo_cpg.locks.holds", lambda folder: False)
    with locked(run):
        before = contents(run)
        RunFolder(run).require()
        assert contents(run) == before
    RunFolder(run).require()
    assert not (run / ".decided").exists()


def test_a_sweep_is_refused_while_one_of_its_runs_is_in_use(cli, tmp_path):
    folder = tmp_path / "sweep"
    settings = [Setting(f"seed={seed}", {"seed": seed}) for seed in (1, 2)]
    claim(folder, new_plan(CONFIG, PAIR, settings))
    with RunFolder(folder / "seed=1").locked(new=True):
        assert f"{folder / 'seed=1'} is in use by process" in cli.refuses("sweep", folder)
        assert {path.name for path in folder.rglob("*")} == {"sweep.json", "seed=1", ".lock"}


@pytest.mark.slow
def test_commands_with_only_share_a_sweep(cli, tmp_path):
    """The lock stands for another command that evolves seed 1."""
    folder = tmp_path / "sweep"
    settings = [Setting(f"seed={seed}", {"seed": seed}) for seed in (1, 2)]
    claim(folder, new_plan(CONFIG, TINY, settings))
    with RunFolder(folder / "seed=1").locked(new=True):
        assert cli("sweep", folder, "--only", "seed=1")[0] == 2
        assert cli("sweep", folder, "--only", "seed=2")[0] == 0
    assert "seed=1" not in (folder / "runs.csv").read_text()
    assert cli("sweep", folder)[0] == 0
    assert "seed=1" in (folder / "runs.csv").read_text()
