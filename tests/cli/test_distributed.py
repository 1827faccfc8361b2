"""`--distributed`: several processes evolve one run, and a lost process costs one generation."""

import csv
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from evo_cpg.cli import distributed, local
from evo_cpg.cli.errors import ExitCode
from evo_cpg.training.loop import TIMING_COLUMNS
from evo_cpg.training.run_folder import RunFolder
from loopback import free_port, loopback
from tiny_run import CONFIG, PAIR, environment

# The population fills three vectors. Two processes have parts of different sizes, and one of four
# processes has no part.
MANY = (*PAIR, "evolution.population=40")

# Long enough to lose a process during the run.
ENDLESS = (*MANY, "simulation.seconds=50", "evolution.generations=5000")


def rows(folder: Path) -> list[dict[str, str]]:
    """Return the rows of metrics.csv as text, without the columns of durations."""
    with (folder / "metrics.csv").open() as file:
        return [
            {name: value for name, value in row.items() if name not in TIMING_COLUMNS}
            for row in csv.DictReader(file)
        ]


def assert_same_run(folder: Path, other: Path) -> None:
    """Compare history, last population, champion and motion of two runs, bit for bit."""
    assert rows(folder) == rows(other)
    last, other_last = RunFolder(folder).load(), RunFolder(other).load()
    assert last is not None and other_last is not None
    assert last.generation == other_last.generation == 4
    assert last.genes.tobytes() == other_last.genes.tobytes()
    assert last.scales == other_last.scales
    champion, motion, _ = RunFolder(folder).load_champion()
    other_champion, other_motion, _ = RunFolder(other).load_champion()
    assert champion.genes.tobytes() == other_champion.genes.tobytes()
    assert champion[1:] == other_champion[1:]
    assert motion is not None and other_motion is not None
    np.testing.assert_array_equal(motion.position, other_motion.position)


@pytest.fixture(scope="module")
def alone(finish, tmp_path_factory) -> Path:
    """Make the run with one process."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    code, _, err = finish("train", CONFIG, *MANY, "--out", folder, "--cores", 1)
    assert code == 0, err
    return folder


def train(finish, folder: Path, processes: int, *settings: str) -> None:
    code, out, err = finish(
        "train", CONFIG, *MANY, *settings, "--out", folder, "--cores", processes,
        "--distributed", "--local", processes,
    )  # fmt: skip
    assert (code, out) == (0, f"{folder}\n"), err
    assert RunFolder(folder).read_meta()["processes"] == processes


def resume(finish, folder: Path, processes: int) -> None:
    several = ("--distributed", "--local", processes) if processes > 1 else ()
    code, out, err = finish("resume", folder, "--generations", 4, "--cores", processes, *several)
    assert (code, out) == (0, f"{folder}\n"), err
    assert RunFolder(folder).read_meta()["processes"] == processes


def generations_done(folder: Path) -> int:
    """Return the number of generations so far, or -1 before the run starts."""
    if not (folder / "meta.json").exists():
        return -1
    return len(rows(folder)) if (folder / "metrics.csv").exists() else 0


# Progress lines, and the warning that the oscillators of this short animal rest.
_NO_ERROR = re.compile(r" *\d+/\d+ generations|evo-cpg: warning: .* at rest ")


class Hosts:
    """Processes that are started separately, as on several hosts."""

    def __init__(self, compiled: Path, logs: Path, *arguments: object, count: int = 2):
        hosts = loopback(count)
        self._logs = logs
        self.processes: list[subprocess.Popen] = []
        for index in range(count):
            command = [
                *arguments, "--cores", 1, "--distributed", "--hosts", hosts, "--process", index
            ]  # fmt: skip
            with (logs / f"{index}.err").open("w") as errors:
                self.processes.append(
                    subprocess.Popen(
                        [sys.executable, "-m", "evo_cpg", *map(str, command)],
                        env=environment(compiled),
                        stdout=subprocess.DEVNULL,
                        stderr=errors,
                    )
                )

    def __enter__(self) -> "Hosts":
        return self

    def __exit__(self, *error: object) -> None:
        for process in self.processes:
            process.kill()
            process.wait()

    def errors(self, index: int) -> str:
        """Return the errors of a process, without the progress of the lead."""
        lines = (self._logs / f"{index}.err").read_text().splitlines(True)
        return "".join(line for line in lines if not _NO_ERROR.match(line))

    def ends(self, *which: int, within: float = 30.0) -> list[tuple[int, str]]:
        """Wait for processes to end in time, and return their exit codes and errors."""
        end = time.monotonic() + within
        for index in which:
            self.processes[index].wait(max(0.0, end - time.monotonic()))
        return [(self.processes[index].returncode, self.errors(index)) for index in which]


def lose(
    compiled: Path,
    folder: Path,
    which: int,
    how: signal.Signals,
    *options: object,
    generations: int = 3,
    count: int = 3,
) -> list[tuple[int, str]]:
    """Lose a process after some generations, and return how the other processes end."""
    run = folder / "run"
    command = ("train", CONFIG, *ENDLESS, "--out", run, *options)
    with Hosts(compiled, folder, *command, count=count) as hosts:
        while generations_done(run) < generations:
            assert all(process.poll() is None for process in hosts.processes), hosts.errors(0)
            time.sleep(0.01)
        hosts.processes[which].send_signal(how)
        return hosts.ends(*(index for index in range(count) if index != which))


def assert_lost(ends: list[tuple[int, str]], run: Path, words: str) -> None:
    """Check that each process printed one line about the loss."""
    for code, err in ends:
        assert code == ExitCode.LOST, err
        assert err.startswith("evo-cpg: process "), err
        assert words in err
        advice = f". Continue with `evo-cpg resume {run}`, on any number of processes\n"
        assert err.endswith(advice) and err.count("\n") == 1, err


@pytest.mark.slow
def test_two_processes_equal_one_process(alone, finish, tmp_path):
    train(finish, tmp_path / "run", 2)
    assert_same_run(tmp_path / "run", alone)


@pytest.mark.slow
def test_four_processes_equal_one_process(alone, finish, tmp_path):
    train(finish, tmp_path / "run", 4)
    assert_same_run(tmp_path / "run", alone)


@pytest.mark.slow
@pytest.mark.parametrize(("first", "then"), [(1, 2), (2, 1), (4, 1), (1, 4), (2, 4), (4, 2)])
def test_a_run_may_continue_on_another_number_of_processes(first, then, alone, finish, tmp_path):
    folder = tmp_path / "run"
    if first == 1:
        code, _, err = finish(
            "train", CONFIG, *MANY, "evolution.generations=2", "--out", folder, "--cores", 1
        )
        assert code == 0, err
    else:
        train(finish, folder, first, "evolution.generations=2")
    resume(finish, folder, then)
    assert_same_run(folder, alone)


@pytest.mark.slow
def test_three_processes_equal_one_with_noise_and_learning(finish, tmp_path):
    settings = (
        "runs=2",
        "evolution.population=17",
        "simulation.trials=3",
        "noise.joint_angle_deg=3",
        "evolution.learning={every: 2, elites: 1, steps: 1}",
    )
    code, _, err = finish(
        "train", CONFIG, *MANY, *settings, "--out", tmp_path / "one", "--cores", 1
    )
    assert code == 0, err
    train(finish, tmp_path / "three", 3, *settings)
    assert_same_run(tmp_path / "three", tmp_path / "one")


@pytest.mark.slow
def test_a_killed_worker_ends_the_job(compiled, tmp_path):
    ends = lose(compiled, tmp_path, 1, signal.SIGKILL, count=2)
    assert_lost(ends, tmp_path / "run", "process 0 of 2: process 1 (localhost) is gone")
    done = RunFolder(tmp_path / "run").load()
    assert done is not None and done.generation >= 1


@pytest.mark.slow
def test_a_stopped_worker_ends_the_job_after_the_patience(compiled, tmp_path):
    ends = lose(compiled, tmp_path, 1, signal.SIGSTOP, "--patience", 1, count=2)
    assert_lost(ends, tmp_path / "run", "has waited 1 s for the others' results of generation ")


@pytest.mark.slow
def test_a_run_that_lost_a_process_continues_with_fewer(compiled, cli, tmp_path):
    run = tmp_path / "run"
    assert_lost(
        lose(compiled, tmp_path, 1, signal.SIGKILL), run, ": process 1 (localhost) is gone."
    )
    done = RunFolder(run).load()
    assert done is not None
    code, _, err = cli("resume", run, "--generations", done.generation + 1)
    assert code == 0, err
    after = RunFolder(run).load()
    assert after is not None and after.generation == done.generation + 1


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
def test_a_stopped_process_ends_the_job_within_30_s(which, compiled, tmp_path):
    ends = lose(compiled, tmp_path, which, signal.SIGSTOP)
    words = f"process {which} (localhost) is dead or stopped: no heartbeat for 18 s"
    assert_lost(ends, tmp_path / "run", words)


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
def test_a_process_stopped_during_compilation_ends_the_job_within_30_s(which, tmp_path):
    # The cache is empty, so the compilation takes long.
    (tmp_path / "logs").mkdir()
    ends = lose(tmp_path / "compiled", tmp_path, which, signal.SIGSTOP, generations=0)
    assert_lost(ends, tmp_path / "run", f"process {which} (localhost) is dead or stopped")


@pytest.mark.slow
def test_a_killed_lead_ends_the_job(compiled, tmp_path):
    ends = lose(compiled, tmp_path, 0, signal.SIGKILL)
    assert_lost(ends, tmp_path / "run", ": process 0 (localhost) is gone.")


@pytest.mark.slow
def test_an_interrupted_lead_prints_how_to_continue(compiled, tmp_path, interruptible):
    run = tmp_path / "run"
    with Hosts(compiled, tmp_path, "train", CONFIG, *ENDLESS, "--out", run) as hosts:
        while generations_done(run) < 1:
            time.sleep(0.01)
        hosts.processes[0].send_signal(signal.SIGINT)
        lead, worker = hosts.ends(0, 1)
    assert lead == (130, f"interrupted. Continue with `evo-cpg resume {run}`\n")
    assert_lost([worker], run, "process 1 of 2: process 0 (localhost) is gone")


@pytest.mark.slow
def test_local_processes_are_interrupted_and_ended_together(start, tmp_path):
    run = tmp_path / "run"
    command = ("train", CONFIG, *ENDLESS, "--out", run, "--distributed", "--local", 2)
    with start(*command) as process:
        while generations_done(run) < 3:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert f"interrupted. Continue with `evo-cpg resume {run}`\n" in err
    assert "Traceback" not in err


@pytest.mark.slow
def test_a_stopped_local_process_is_ended_with_the_others(start, tmp_path):
    run = tmp_path / "run"
    command = ("train", CONFIG, *ENDLESS, "--out", run, "--distributed", "--local", 2)
    with start(*command, "--patience", 1) as process:
        while generations_done(run) < 3:
            assert process.poll() is None
            time.sleep(0.01)
        listed = subprocess.run(
            ["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True
        )
        worker = max(map(int, listed.stdout.split()))
        os.kill(worker, signal.SIGSTOP)
        _, err = process.communicate(timeout=30)
    assert process.returncode == ExitCode.LOST
    assert "process 0 of 2: process 0 has waited" in err
    with pytest.raises(ProcessLookupError):
        os.kill(worker, 0)


@pytest.mark.slow
def test_processes_with_different_configurations_are_refused(compiled, tmp_path):
    hosts = loopback(2)
    started = []
    for index in range(2):
        command = [
            "train", CONFIG, *MANY, f"evolution.elites={2 + index}", "--out", tmp_path / "run",
            "--cores", 1, "--distributed", "--hosts", hosts, "--process", index,
        ]  # fmt: skip
        started.append(
            subprocess.Popen(
                [sys.executable, "-m", "evo_cpg", *map(str, command)],
                env=environment(compiled),
                stderr=subprocess.PIPE,
                text=True,
            )
        )
    message = "evo-cpg: the configuration differs between the processes: process 0 unlike 1"
    lead, other = [process.communicate(timeout=60)[1] for process in started]
    assert [process.returncode for process in started] == [2, 2], (lead, other)
    assert lead == f"{message}\n"
    assert other == f"{message}. Process 1 differs from process 0 in evolution.elites\n"
    # No run was started.
    assert not (tmp_path / "run").exists()


def test_a_process_that_never_joins_is_an_error(cli, tmp_path):
    command = ("train", CONFIG, *MANY, "--out", tmp_path / "run", "--distributed")
    several = ("--hosts", loopback(2), "--process", 0, "--join-timeout", 0.5)
    code, _, err = cli(*command, *several)
    assert code == 2
    assert "1 of 2 processes did not connect to localhost:" in err
    assert "within 0.5 s: process 1 (localhost). Allow more time with --join-timeout" in err
    assert not (tmp_path / "run").exists()


def test_contradictory_options_are_refused(cli, tmp_path, monkeypatch):
    for name in list(os.environ):
        if name.startswith(("SLURM_", "OMPI_", "JAX_COORDINATOR")):
            monkeypatch.delenv(name)
    for options, words in (
        (("--hosts", "a,b"), "--hosts needs --distributed"),
        (("--local", 2), "--local needs --distributed"),
        (("--process", 1), "--process needs --distributed"),
        (("--distributed", "--process", 1), "--process needs --hosts, because it is a place in"),
        (("--distributed", "--local", 2, "--hosts", "a,b"), "--local and --hosts exclude each"),
        (("--distributed",), "--distributed: no scheduler that JAX knows (SLURM, Open MPI) has"),
    ):
        for command in (("train", CONFIG, *MANY, "--out", tmp_path / "x"), ("resume", tmp_path)):
            code, _, err = cli(*command, *options)
            assert code == 2
            assert err.splitlines()[-1].startswith(f"evo-cpg: {words}"), err


@pytest.mark.parametrize(
    ("environment", "address"),
    [
        (
            {
                "SLURM_JOB_ID": "4097",
                "SLURM_STEP_NODELIST": "node[003-006],other",
                "SLURM_NTASKS": "5",
                "SLURM_PROCID": "2",
                "SLURM_LOCALID": "0",
            },
            "node003:61441",
        ),
        (
            {
                "OMPI_MCA_orte_hnp_uri": "8192.0;tcp://10.96.0.1,10.148.0.1:34911",
                "OMPI_COMM_WORLD_SIZE": "5",
                "OMPI_COMM_WORLD_RANK": "2",
                "OMPI_COMM_WORLD_LOCAL_RANK": "0",
            },
            "10.96.0.1:61442",
        ),
    ],
    ids=["SLURM", "Open MPI"],
)
def test_schedulers_determine_the_place_of_a_process(environment, address, monkeypatch):
    for name in list(os.environ):
        if name.startswith(("SLURM_", "OMPI_", "JAX_COORDINATOR")):
            monkeypatch.delenv(name)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    place = distributed._place(distributed.Distribution(distributed=True))
    assert (place.index, place.count, place.address) == (2, 5, address)


def test_a_wrong_configuration_is_reported_once(cli, tmp_path):
    several = ("--distributed", "--local", 4)
    code, _, err = cli("train", CONFIG, "evolution.elites=x", *several)
    assert code == 2
    assert err.count("evolution.elites") == 1, err
    code, _, err = cli("resume", tmp_path, *several)
    assert code == 2
    assert err == f"evo-cpg: {tmp_path} is not a run folder (it has no config.yaml)\n"


def test_a_failed_process_ends_the_lead(tmp_path, monkeypatch):
    """Otherwise the lead would wait for the failed process until its patience ends."""
    program = tmp_path / "process"
    lines = "#!/bin/sh", "for last; do :; done", '[ "$last" = 1 ] && exit 2', "exec sleep 60", ""
    program.write_text("\n".join(lines))
    program.chmod(0o755)
    monkeypatch.setattr(local.sys, "executable", str(program))
    monkeypatch.setattr(local, "_GRACE", 0.2)
    began = time.monotonic()
    assert local.run_local(2, ["train", "x.yaml"], 2) == 2
    assert time.monotonic() - began < 20


def test_local_processes_get_the_arguments_without_local_and_cores():
    words = ["--trust", "train", "a.yaml", "--local", "4", "--cores=8", "x=1", "--distributed"]
    assert local._without_local(words) == ["--trust", "train", "a.yaml", "x=1", "--distributed"]
    assert local._without_local(["--local=4", "--cores", "8", "x"]) == ["x"]


@pytest.mark.parametrize(
    ("codes", "code"),
    [([0, 0], 0), ([2, 4], 2), ([-9, 4], 4), ([4, -9], 4), ([0, -9], 137), ([-15, 0], 143)],
)
def test_the_exit_code_comes_from_the_process_that_failed(codes, code):
    assert local._code(codes) == code


@pytest.mark.slow
def test_meta_records_one_process(finished_run):
    assert json.loads((finished_run / "meta.json").read_text())["processes"] == 1


def test_a_port_in_use_is_refused(cli, tmp_path):
    with socket.create_server(("", free_port())) as server:
        port = server.getsockname()[1]
        several = ("--distributed", "--hosts", f"localhost:{port},localhost", "--process", 0)
        code, _, err = cli("train", CONFIG, *MANY, "--out", tmp_path / "run", *several)
    assert code == 2
    assert err.splitlines()[-1].startswith(
        f"evo-cpg: port {port} of this machine cannot be used (Address already"
    )
