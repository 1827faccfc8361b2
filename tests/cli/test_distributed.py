"""`--distributed`: several processes are one run; a lost one costs no more than a generation."""

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

# Three vectors: two processes have parts of different sizes, and of four one has none.
MANY = (*PAIR, "evolution.population=40")

# Long enough to lose a process in the middle of.
ENDLESS = (*MANY, "simulation.steps=3000", "evolution.generations=5000")


def rows(folder: Path) -> list[dict[str, str]]:
    """metrics.csv as text, without the columns that tell the time."""
    with (folder / "metrics.csv").open() as file:
        return [
            {name: value for name, value in row.items() if name not in TIMING_COLUMNS}
            for row in csv.DictReader(file)
        ]


def assert_same_run(folder: Path, other: Path) -> None:
    """Same history, last population, champion and motion, to the last bit."""
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
    """The run of one process."""
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
    """So far; -1 before the run begins."""
    if not (folder / "meta.json").exists():
        return -1
    return len(rows(folder)) if (folder / "metrics.csv").exists() else 0


# Generations, and that the oscillators of so short an animal rest.
_TOLD = re.compile(r" *\d+/\d+ generations|evo-cpg: warning: .* at rest ")


class Hosts:
    """Processes that were started one by one, as on hosts."""

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

    def said(self, index: int) -> str:
        """What a process complained of; what the lead says of the run is left out."""
        lines = (self._logs / f"{index}.err").read_text().splitlines(True)
        return "".join(line for line in lines if not _TOLD.match(line))

    def ends(self, *which: int, within: float = 30.0) -> list[tuple[int, str]]:
        """Exit codes of processes, and what they complained of, where they end in time."""
        end = time.monotonic() + within
        for index in which:
            self.processes[index].wait(max(0.0, end - time.monotonic()))
        return [(self.processes[index].returncode, self.said(index)) for index in which]


def lose(
    compiled: Path,
    folder: Path,
    which: int,
    how: signal.Signals,
    *options: object,
    generations: int = 3,
    count: int = 3,
) -> list[tuple[int, str]]:
    """Lose one of some processes once so many generations are done: how the others end."""
    run = folder / "run"
    command = ("train", CONFIG, *ENDLESS, "--out", run, *options)
    with Hosts(compiled, folder, *command, count=count) as hosts:
        while generations_done(run) < generations:
            assert all(process.poll() is None for process in hosts.processes), hosts.said(0)
            time.sleep(0.01)
        hosts.processes[which].send_signal(how)
        return hosts.ends(*(index for index in range(count) if index != which))


def assert_lost(ends: list[tuple[int, str]], run: Path, words: str) -> None:
    """Each said it in one line."""
    for code, said in ends:
        assert code == ExitCode.LOST, said
        assert said.startswith("evo-cpg: process "), said
        assert words in said
        advice = f"; go on with `evo-cpg resume {run}`, on any number of processes\n"
        assert said.endswith(advice) and said.count("\n") == 1, said


def test_two_processes_are_one_run(alone, finish, tmp_path):
    train(finish, tmp_path / "run", 2)
    assert_same_run(tmp_path / "run", alone)


@pytest.mark.slow
def test_four_processes_are_one_run(alone, finish, tmp_path):
    train(finish, tmp_path / "run", 4)
    assert_same_run(tmp_path / "run", alone)


@pytest.mark.slow
@pytest.mark.parametrize(("first", "then"), [(1, 2), (2, 1), (4, 1), (1, 4), (2, 4), (4, 2)])
def test_checkpoints_move_between_numbers_of_processes(first, then, alone, finish, tmp_path):
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
def test_several_runs_with_noise_trials_and_learning_by_three_processes(finish, tmp_path):
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


def test_a_killed_worker_ends_the_job(compiled, tmp_path):
    ends = lose(compiled, tmp_path, 1, signal.SIGKILL, count=2)
    assert_lost(ends, tmp_path / "run", "process 0 of 2: process 1 (localhost) is gone")
    done = RunFolder(tmp_path / "run").load()
    assert done is not None and done.generation >= 1


@pytest.mark.slow
def test_a_stopped_worker_is_not_waited_for_longer_than_allowed(compiled, tmp_path):
    ends = lose(compiled, tmp_path, 1, signal.SIGSTOP, "--patience", 1, count=2)
    assert_lost(ends, tmp_path / "run", "has waited 1 s for the others' results of generation ")


@pytest.mark.slow
def test_a_run_that_lost_a_process_goes_on_with_fewer(compiled, cli, tmp_path):
    run = tmp_path / "run"
    assert_lost(
        lose(compiled, tmp_path, 1, signal.SIGKILL), run, ": process 1 (localhost) is gone;"
    )
    done = RunFolder(run).load()
    assert done is not None
    code, _, err = cli("resume", run, "--generations", done.generation + 1)
    assert code == 0, err
    after = RunFolder(run).load()
    assert after is not None and after.generation == done.generation + 1


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
def test_who_is_stopped_ends_the_job_within_half_a_minute(which, compiled, tmp_path):
    ends = lose(compiled, tmp_path, which, signal.SIGSTOP)
    words = f"process {which} (localhost) is dead or stopped: no heartbeat for 18 s"
    assert_lost(ends, tmp_path / "run", words)


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
def test_who_is_stopped_while_all_compile_ends_the_job_within_half_a_minute(which, tmp_path):
    # Nothing is compiled before, so it takes a while.
    (tmp_path / "logs").mkdir()
    ends = lose(tmp_path / "compiled", tmp_path, which, signal.SIGSTOP, generations=0)
    assert_lost(ends, tmp_path / "run", f"process {which} (localhost) is dead or stopped")


@pytest.mark.slow
def test_a_killed_lead_ends_the_job(compiled, tmp_path):
    ends = lose(compiled, tmp_path, 0, signal.SIGKILL)
    assert_lost(ends, tmp_path / "run", ": process 0 (localhost) is gone;")


@pytest.mark.slow
def test_an_interrupted_lead_says_how_to_go_on(compiled, tmp_path):
    run = tmp_path / "run"
    with Hosts(compiled, tmp_path, "train", CONFIG, *ENDLESS, "--out", run) as hosts:
        while generations_done(run) < 1:
            time.sleep(0.01)
        hosts.processes[0].send_signal(signal.SIGINT)
        lead, worker = hosts.ends(0, 1)
    assert lead == (130, f"interrupted; go on with `evo-cpg resume {run}`\n")
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
    assert f"interrupted; go on with `evo-cpg resume {run}`\n" in err
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


def test_configurations_that_differ(compiled, tmp_path):
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
    told = "evo-cpg: the configuration differs between the processes: process 0 unlike 1"
    lead, other = [process.communicate(timeout=60)[1] for process in started]
    assert [process.returncode for process in started] == [2, 2], (lead, other)
    assert lead == f"{told}\n"
    assert other == f"{told}; process 1 differs from process 0 in evolution.elites\n"
    # Nothing was begun.
    assert not (tmp_path / "run").exists()


def test_a_process_that_never_comes(cli, tmp_path):
    command = ("train", CONFIG, *MANY, "--out", tmp_path / "run", "--distributed")
    several = ("--hosts", loopback(2), "--process", 0, "--join-timeout", 0.5)
    code, _, err = cli(*command, *several)
    assert code == 2
    assert "1 of 2 processes did not connect to localhost:" in err
    assert "within 0.5 s: process 1 (localhost). Allow more time with --join-timeout" in err
    assert not (tmp_path / "run").exists()


def test_wrong_options(cli, tmp_path, monkeypatch):
    for name in list(os.environ):
        if name.startswith(("SLURM_", "OMPI_", "JAX_COORDINATOR")):
            monkeypatch.delenv(name)
    for options, words in (
        (("--hosts", "a,b"), "--hosts goes with --distributed"),
        (("--local", 2), "--local goes with --distributed"),
        (("--process", 1), "--process goes with --distributed"),
        (("--distributed", "--process", 1), "--process goes with --hosts: it is a place in that"),
        (("--distributed", "--local", 2, "--hosts", "a,b"), "--local starts processes on this"),
        (("--distributed",), "--distributed: no scheduler that JAX knows (SLURM, Open MPI) has"),
    ):
        for command in (("train", CONFIG, *MANY, "--out", tmp_path / "x"), ("resume", tmp_path)):
            code, _, err = cli(*command, *options)
            assert code == 2
            assert err.startswith(f"evo-cpg: {words}"), err


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
def test_schedulers_that_jax_knows(environment, address, monkeypatch):
    for name in list(os.environ):
        if name.startswith(("SLURM_", "OMPI_", "JAX_COORDINATOR")):
            monkeypatch.delenv(name)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    place = distributed._place(distributed.Distribution(distributed=True))
    assert (place.index, place.count, place.address) == (2, 5, address)


def test_a_wrong_configuration_is_complained_of_once(cli, tmp_path):
    several = ("--distributed", "--local", 4)
    code, _, err = cli("train", CONFIG, "evolution.elites=x", *several)
    assert code == 2
    assert err.count("evolution.elites") == 1, err
    code, _, err = cli("resume", tmp_path, *several)
    assert code == 2
    assert err == f"evo-cpg: {tmp_path} is not a run folder (it has no config.yaml)\n"


def test_one_that_fails_ends_all_while_the_first_one_lives(tmp_path, monkeypatch):
    """The lead would wait for the others as long as they are patient."""
    program = tmp_path / "process"
    lines = "#!/bin/sh", "for last; do :; done", '[ "$last" = 1 ] && exit 2', "exec sleep 60", ""
    program.write_text("\n".join(lines))
    program.chmod(0o755)
    monkeypatch.setattr(local.sys, "executable", str(program))
    monkeypatch.setattr(local, "_GRACE", 0.2)
    began = time.monotonic()
    assert local.run_local(2, ["train", "x.yaml"], 2) == 2
    assert time.monotonic() - began < 20


def test_arguments_of_local_processes():
    words = ["--trust", "train", "a.yaml", "--local", "4", "--cores=8", "x=1", "--distributed"]
    assert local._without_local(words) == ["--trust", "train", "a.yaml", "x=1", "--distributed"]
    assert local._without_local(["--local=4", "--cores", "8", "x"]) == ["x"]


@pytest.mark.parametrize(
    ("codes", "code"),
    [([0, 0], 0), ([2, 4], 2), ([-9, 4], 4), ([4, -9], 4), ([0, -9], 137), ([-15, 0], 143)],
)
def test_exit_code_of_local_processes(codes, code):
    assert local._code(codes) == code


def test_meta_tells_of_one_process(alone):
    assert json.loads((alone / "meta.json").read_text())["processes"] == 1


def test_a_port_in_use(cli, tmp_path):
    with socket.create_server(("", free_port())) as server:
        port = server.getsockname()[1]
        several = ("--distributed", "--hosts", f"localhost:{port},localhost", "--process", 0)
        code, _, err = cli("train", CONFIG, *MANY, "--out", tmp_path / "run", *several)
    assert code == 2
    assert err.startswith(f"evo-cpg: port {port} of this machine cannot be used (Address already")
