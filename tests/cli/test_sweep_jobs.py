"""`evo-cpg sweep --jobs`: settings that share no program as local jobs and as jobs of SLURM."""

import json
import os
import signal
import stat
import sys
import time

import jax
import numpy as np
import pytest
import typer

from evo_cpg.api.sweep import claim, new_plan
from evo_cpg.cli import jobs as sweep_jobs
from evo_cpg.cli.errors import ExitCode, UsageError
from evo_cpg.cli.sweep import sweep as run_sweep
from evo_cpg.config.settings import Setting
from evo_cpg.locks import LockedError
from evo_cpg.training.devices import available_cores
from evo_cpg.training.loop import TIMING_COLUMNS
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from tiny_run import CONFIG, PAIR, environment, program

pytest.importorskip("submitit")

SHORT = (*PAIR, "simulation.seconds=0.3333", "evolution.generations=3")
# Enough for a job to start before another job has ended.
GENERATIONS = 600
LONG = (*PAIR, f"evolution.generations={GENERATIONS}")
GRID = ("world.water.density=1000,1200",)
NAMES = ("density=1000", "density=1200")


@pytest.fixture(autouse=True)
def devices(monkeypatch):
    """Use the two devices that JAX already has."""
    monkeypatch.setattr("evo_cpg.training.devices.use_cores", lambda count=None: 2)


@pytest.fixture
def quick(monkeypatch, compiled):
    """Set the environment of quick programs, which jobs inherit."""
    # JAX reads its flags at its start. It starts here, so that this process keeps its devices.
    assert jax.local_device_count() == 2
    for name, value in environment(compiled).items():
        monkeypatch.setenv(name, value)


def sweep(folder, jobs=None, options=(), *, given=SHORT, grid=GRID):
    return succeeded(CONFIG, given, grid, out=folder, jobs=jobs, job_option=options)


def resume(folder, jobs=None):
    return succeeded(folder, jobs=jobs)


def succeeded(*arguments, **options):
    try:
        run_sweep(*arguments, **options)
    except typer.Exit as stop:
        assert stop.exit_code == ExitCode.FAULT
        return False
    return True


def sweep_of(folder):
    """Make the folder of a sweep without any run."""
    settings = [Setting(name, {"world.water.density": int(name[8:])}) for name in NAMES]
    claim(folder, new_plan(CONFIG, SHORT, settings))


def until(reached, process=None):
    """Wait until a condition holds. Fail if the process ends before."""
    end = time.monotonic() + 240
    while not reached():
        assert time.monotonic() < end
        assert process is None or process.poll() is None, process.communicate()
        time.sleep(0.05)


def untimed(rows):
    return [{k: v for k, v in row.items() if k not in TIMING_COLUMNS} for row in rows]


@pytest.mark.slow
def test_jobs_have_the_results_of_a_sweep_without_jobs(tmp_path, quick, capfd):
    assert sweep(tmp_path / "jobs", "2")
    err = capfd.readouterr().err
    assert sweep(tmp_path / "turn")
    for name in NAMES:
        job, turn = (RunFolder(tmp_path / which / name).load() for which in ("jobs", "turn"))
        np.testing.assert_array_equal(job.genes, turn.genes)
        assert untimed(job.history) == untimed(turn.history)
        meta = json.loads((tmp_path / "jobs" / name / "meta.json").read_text())
        assert meta["devices"] == max(1, available_cores() // 2)
        assert f": {name}\n" in err
    assert (tmp_path / "jobs" / "settings.csv").is_file()
    # The logs of successful jobs are deleted.
    assert not list((tmp_path / "jobs" / ".jobs").iterdir())
    assert not (tmp_path / "jobs" / ".lock").exists()


@pytest.mark.slow
def test_a_failed_job_is_reported_and_the_others_continue(tmp_path, quick, capfd):
    folder = tmp_path / "sweep"
    sweep_of(folder)
    obstacle = folder / NAMES[1] / "notes.txt"
    obstacle.parent.mkdir()
    obstacle.write_text("mine")
    assert not resume(folder, "1")
    err = capfd.readouterr().err
    assert f"failed ({NAMES[1]}). {folder.resolve() / '.jobs'}" in err
    assert "RunFolderError: " in err and "is not empty" in err
    assert f"1 of 2 settings did not finish: {NAMES[1]}. Continue with" in err
    assert RunFolder(folder / NAMES[0]).newest == 3
    # Only the failed setting is continued.
    obstacle.unlink()
    assert resume(folder, "1")
    assert NAMES[0] not in capfd.readouterr().err
    assert RunFolder(folder / NAMES[1]).newest == 3


def test_two_commands_cannot_run_one_sweep(tmp_path):
    folder = tmp_path / "sweep"
    sweep_of(folder)
    with (
        sweep_jobs.claimed(folder, None),
        pytest.raises(LockedError, match=rf"is in use by process {os.getpid()} on .*\. A job that"),
    ):
        resume(folder)
    # The lock is free again.
    with sweep_jobs.claimed(folder, None):
        pass


@pytest.mark.slow
def test_a_host_without_slurm_is_an_error(tmp_path, compiled):
    path = os.environ["PATH"]
    os.environ["PATH"] = str(tmp_path)
    try:
        started = program("sweep", CONFIG, "--grid", GRID[0], "--jobs", "slurm", compiled=compiled)
    finally:
        os.environ["PATH"] = path
    _, err = started.communicate(timeout=120)
    assert started.returncode == 2
    assert err.startswith("evo-cpg: --jobs slurm: this host has no sbatch")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("jobs", "options", "words"),
    [
        ("0", (), "'0' is neither a number of processes nor slurm"),
        ("SLURM", (), "'SLURM' is neither a number"),
        ("2", ("mem_gb=4",), "--job-option: needs --jobs slurm"),
        (None, ("mem_gb=4",), "--job-option: needs --jobs slurm"),
        ("slurm", ("mem_gb",), "'mem_gb' is not KEY=VALUE"),
    ],
)
def test_wrong_options_are_refused(jobs, options, words):
    with pytest.raises(UsageError, match=words):
        sweep_jobs.read_jobs(jobs, options)


def test_the_error_without_submitit_has_the_command_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(UsageError, match=r"'submitit' is not installed here.*\[jobs\]"):
        sweep_jobs.read_jobs("2", ())


def test_values_of_options_are_json_or_words(tmp_path, monkeypatch):
    fake_slurm(tmp_path, monkeypatch)
    given = ("timeout_min=600", "mem_gb=0.5", "slurm_time=1:00:00", 'slurm_setup=["a", "b"]')
    assert sweep_jobs.read_jobs("slurm", given).options == {
        "timeout_min": 600,
        "mem_gb": 0.5,
        "slurm_time": "1:00:00",
        "slurm_setup": ["a", "b"],
    }


@pytest.mark.slow
def test_interrupted_local_jobs_continue_to_the_same_bits(tmp_path, compiled):
    folder = tmp_path / "sweep"
    words = ("sweep", CONFIG, *LONG, "--grid", GRID[0], "--out", folder, "--cores", 2)
    started = program(*words, "--jobs", 2, compiled=compiled)
    until(lambda: all(RunFolder(folder / name).newest >= 3 for name in NAMES), started)
    started.send_signal(signal.SIGINT)
    _, err = started.communicate(timeout=60)
    assert started.returncode == 130
    assert f"interrupted. Continue with `evo-cpg sweep {folder}" in err
    stopped = [RunFolder(folder / name).newest for name in NAMES]
    time.sleep(2)
    assert (
        stopped == [RunFolder(folder / name).newest for name in NAMES]
        and max(stopped) < GENERATIONS
    )
    again = program("sweep", folder, "--jobs", 2, "--cores", 2, compiled=compiled)
    _, err = again.communicate(timeout=200)
    assert again.returncode == 0, err
    whole = program(*words[:-4], "--out", tmp_path / "whole", "--cores", 1, compiled=compiled)
    _, err = whole.communicate(timeout=200)
    assert whole.returncode == 0, err
    for name in NAMES:
        one, other = (RunFolder(tmp_path / which / name).load() for which in ("sweep", "whole"))
        np.testing.assert_array_equal(one.genes, other.genes)
        assert untimed(one.history) == untimed(other.history)


@pytest.mark.slow
def test_a_job_keeps_the_lock_after_its_command_was_killed(tmp_path, compiled):
    folder = tmp_path / "sweep"
    words = ("sweep", CONFIG, *LONG, "--grid", GRID[0], "--out", folder, "--cores", 1)
    started = program(*words, "--jobs", 1, compiled=compiled)
    until(lambda: RunFolder(folder / NAMES[0]).newest >= 1, started)
    started.kill()
    started.wait()
    with (
        pytest.raises(LockedError, match="A job that it has started may be running, too"),
        sweep_jobs.claimed(folder, None),
    ):
        pass
    # The job inherits the output streams of the command, so they close when the job ends.
    started.communicate(timeout=200)
    assert RunFolder(folder / NAMES[0]).newest == GENERATIONS
    assert RunFolder(folder / NAMES[1]).newest == 0


SBATCH = """#!{python}
import os, subprocess, sys
home, script = {home!r}, open(sys.argv[1]).read()
number = str(101 + len([name for name in os.listdir(home) if name.endswith(".sh")]))
with open(f"{{home}}/{{number}}.sh", "w") as file:
    file.write(script)
started = subprocess.Popen(
    ["/bin/sh", f"{{home}}/{{number}}.sh"],
    env=os.environ | {{"SLURM_JOB_ID": number, "SLURM_NTASKS": "1"}},
    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    start_new_session=True,
)
with open(f"{{home}}/{{number}}.pid", "w") as file:
    file.write(str(started.pid))
print("Submitted batch job", number)
"""

SRUN = """#!{python}
import os, sys
words = sys.argv[1:]
for option, number in (("--output", 1), ("--error", 2)):
    path = words[words.index(option) + 1].replace("%j", os.environ["SLURM_JOB_ID"])
    os.dup2(os.open(path.replace("%t", "0"), os.O_WRONLY | os.O_CREAT | os.O_APPEND), number)
first = words.index({python!r})
os.execv(words[first], words[first:])
"""

SACCT = """#!{python}
import os, sys
print("JobID|State|NodeList")
for number in sys.argv[sys.argv.index("-j") + 1 :: 2]:
    try:
        os.kill(int(open(f"{home}/{{number}}.pid").read()), 0)
        state = "RUNNING"
    except OSError:
        state = "COMPLETED"
    print(f"{{number}}|{{state}}|here")
"""


def fake_slurm(tmp_path, monkeypatch):
    """Install the programs that submitit calls, which run jobs on this machine."""
    home = tmp_path / "slurm"
    home.mkdir()
    for name, text in (("sbatch", SBATCH), ("srun", SRUN), ("sacct", SACCT)):
        path = home / name
        path.write_text(text.format(python=sys.executable, home=str(home)))
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{home}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr(sweep_jobs, "_LOOK_AT_SLURM", 0.5)
    return home


@pytest.mark.slow
def test_jobs_of_slurm_continue_without_the_command(tmp_path, monkeypatch, quick, compiled):
    home = fake_slurm(tmp_path, monkeypatch)
    folder = tmp_path / "sweep"
    options = ("--job-option", "slurm_partition=long", "--job-option", "mem_gb=2")
    started = program(
        "sweep", CONFIG, *LONG, "--grid", GRID[0], "--out", folder, "--cores", 1,
        "--jobs", "slurm", *options, compiled=compiled,
    )  # fmt: skip
    until(lambda: all(RunFolder(folder / name).newest >= 1 for name in NAMES), started)
    started.send_signal(signal.SIGINT)
    _, err = started.communicate(timeout=60)
    assert started.returncode == 130
    assert f"jobs 101, 102 continue. Follow them with `evo-cpg sweep {folder} --jobs slurm`" in err
    assert "scancel 101 102" in err and "interrupted" not in err
    script = (home / "101.sh").read_text()
    for words in ("partition=long", "mem=2GB", "cpus-per-task=1", "job-name=evo-cpg-sweep"):
        assert f"#SBATCH --{words}" in script
    with pytest.raises(RunFolderError, match=r"SLURM has jobs of this sweep \(101, 102\)"):
        resume(folder)
    assert resume(folder, "slurm")
    assert [RunFolder(folder / name).newest for name in NAMES] == [GENERATIONS] * 2
    # No setting was submitted twice, and no job is left on the list.
    assert not (home / "103.sh").exists()
    assert json.loads((folder / ".jobs" / "slurm.json").read_text()) == []
    assert resume(folder)


def test_unknown_parameters_of_submitit_are_refused(tmp_path, monkeypatch):
    fake_slurm(tmp_path, monkeypatch)
    for option, words in (
        ("partitoin=long", "--job-option: Parameter 'partitoin' need to be prefixed"),
        ("slurm_partitoin=long", "--job-option: Unknown argument 'partitoin'"),
        ("timeout_min=soon", '--job-option: Parameter "timeout_min" expected type'),
    ):
        with pytest.raises(UsageError, match=words):
            sweep(tmp_path / "sweep", "slurm", (option,))


def test_a_damaged_list_of_jobs_is_refused(tmp_path):
    sweep_of(tmp_path)
    (tmp_path / ".jobs").mkdir(exist_ok=True)
    (tmp_path / ".jobs" / "slurm.json").write_text('[{"id": 3}]')
    with pytest.raises(RunFolderError, match=r"slurm\.json is damaged"):
        resume(tmp_path)


def test_a_job_that_slurm_refuses_is_an_error(tmp_path, monkeypatch):
    home = fake_slurm(tmp_path, monkeypatch)
    (home / "sbatch").write_text("#!/bin/sh\necho sbatch: error: invalid partition >&2\nexit 1\n")
    with pytest.raises(UsageError, match=r"sbatch refuses the job: .*invalid partition"):
        sweep(tmp_path / "sweep", "slurm")
    assert not list((tmp_path / "sweep" / ".jobs").iterdir())


def test_a_setting_is_not_submitted_twice(tmp_path, monkeypatch):
    """An existing job evolves the setting together with another setting."""
    fake_slurm(tmp_path, monkeypatch)
    folder = tmp_path / "sweep"
    sweep_of(folder)
    (folder / ".jobs").mkdir(exist_ok=True)
    entry = {"id": "7", "logs": str(tmp_path), "settings": list(NAMES)}
    (folder / ".jobs" / "slurm.json").write_text(json.dumps([entry]))
    monkeypatch.setattr(sweep_jobs, "_of_slurm", lambda entry: Alive())
    with pytest.raises(
        UsageError, match=f"job 7 already evolves {NAMES[0]}, with other settings.*scancel 7"
    ):
        run_sweep(folder, only=[NAMES[0]], jobs="slurm")


class Alive:
    """Job that continues."""

    job_id = "7"

    def done(self, force_check=False):
        del force_check
        return False
