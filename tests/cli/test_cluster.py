"""`--cluster`: who takes part, who is refused, and what faults cost."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

import evo_cpg as evo
from evo_cpg.api import cluster
from evo_cpg.errors import Advice, ClusterError, UsageError
from tiny_run import CONFIG, PAIR, environment
from trials import untimed

distributed = pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")

ROUNDS = ("simulation.seconds=20", "evolution.population=64", "evolution.generations=400")


@pytest.fixture(scope="module")
def threads():
    """Return a cluster of one worker, which is a thread of this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(distributed, "Nanny", distributed.Worker)
        with evo.cluster(1) as found:
            yield found


def history(run: Path) -> str:
    from evo_cpg.training.run_folder import RunFolder

    found = RunFolder(run).load()
    assert found is not None
    return str((untimed(found.history), found.genes.tolist()))


@pytest.mark.parametrize("given", ["0", "1000", "nowhere.json", "-1", "tls:/host"])
def test_a_wrong_cluster_is_refused(given, cli, tmp_path):
    words = cli.refuses("train", CONFIG, "--out", tmp_path / "run", f"--cluster={given}")
    assert "llowed" in words and given in words and not (tmp_path / "run").exists()


@pytest.mark.parametrize("given", [CONFIG, "http://localhost:1", "tcp://localhost:x"])
def test_a_cluster_that_cannot_be_joined_is_refused(given, cli, tmp_path):
    words = cli.refuses("train", CONFIG, "--out", tmp_path / "run", f"--cluster={given}")
    assert "cannot be joined" in words and str(given) in words


@pytest.mark.slow
def test_workers_give_the_bits_of_one_process(threads, tmp_path):
    experiment = evo.load(CONFIG, PAIR)
    together = evo.train(experiment, tmp_path / "together")
    with cluster.using(None):
        alone = evo.train(experiment, tmp_path / "alone")
    assert history(tmp_path / "alone") == history(tmp_path / "together")
    assert (alone.genome == together.genome).all() and not evo.verify(together.folder).machine


def test_parts_that_no_configuration_names_are_refused(threads, tmp_path):
    experiment = evo.load(CONFIG, PAIR)
    own = experiment.with_task(experiment.parts.simulation.task)
    with pytest.raises(UsageError, match="task"):
        evo.train(own, tmp_path / "run")


def test_asking_for_workers_loses_no_result(threads, tmp_path):
    evo.train(evo.load(CONFIG, [*PAIR, "evolution.generations=1"]), tmp_path / "run")
    (worker,) = threads.workers()
    threads.send(worker, [])
    while threads._events.empty():
        time.sleep(0.01)
    threads.workers()
    assert not threads._events.empty()
    # There was nothing to evaluate.
    with pytest.raises(ClusterError, match=worker):
        threads.receive()


def test_only_the_holder_of_the_certificate_can_join(threads):
    address = threads._client.scheduler.address
    assert address.startswith("tls://127.0.0.1")
    for security in (distributed.Security.temporary(), distributed.Security()):
        with pytest.raises((OSError, TypeError)):
            distributed.Client(address, security=security, timeout=1, set_as_default=False)
    with pytest.raises(OSError, match=r"."):
        distributed.Client(address.replace("tls", "tcp"), timeout=1, set_as_default=False)


def changed(job, section: str, value):
    config = yaml.safe_load(job.configs[0]) | {section: value}
    return job._replace(configs=(json.dumps(config),))


FOREIGN = {
    "has jax": lambda job: job._replace(versions=(("jax", "0.1"),)),
    "the run has 0123abc": lambda job: job._replace(commit="0123abc"),
    "seed": lambda job: changed(job, "seed", 7),
    "mine": lambda job: changed(job, "task", {"type": "mine:Own"}),
}


@pytest.mark.parametrize("words", FOREIGN)
def test_a_foreign_worker_takes_no_part(words, threads, tmp_path):
    evo.train(evo.load(CONFIG, [*PAIR, "evolution.generations=1"]), tmp_path / "run")
    job = FOREIGN[words](threads._job)
    with pytest.warns(Advice, match=words), pytest.raises(ClusterError, match="no worker"):
        threads._start(job)


def workers_of(process) -> list:
    """Return the worker processes that `--cluster` started."""
    found = psutil.Process(process.pid).children(recursive=True)
    return [each for each in found if "spawn_main" in " ".join(each.cmdline())]


def generations(run: Path) -> int:
    try:
        return len((run / "metrics.csv").read_text().splitlines()) - 1
    except FileNotFoundError:
        return 0


def until(condition, process, seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.fixture(scope="module")
def alone(finish, tmp_path_factory):
    """Return the history of a run in one process."""
    run = tmp_path_factory.mktemp("alone") / "run"
    assert finish("train", CONFIG, *PAIR, *ROUNDS, "--out", run)[0] == 0
    return history(run)


def disturb(fault: str, process, run: Path) -> None:
    for _ in range(20 if fault == "twenty kills" else 1):
        until(lambda: workers_of(process), process)
        victim, done = workers_of(process)[-1], generations(run)
        if fault == "stop":
            victim.suspend()
            started = time.monotonic()
            until(lambda done=done: generations(run) > done + 2, process)
            assert time.monotonic() - started < 30
            victim.resume()
        elif fault == "full disk":
            for each in workers_of(process):
                each.rlimit(psutil.RLIMIT_FSIZE, (0, 0))
        else:
            victim.kill()
            until(lambda done=done: generations(run) > done + 1, process)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["kill", "twenty kills", "stop", "full disk"])
def test_a_fault_costs_only_work_in_flight(fault, alone, start, tmp_path):
    run = tmp_path / "run"
    with start("train", CONFIG, *PAIR, *ROUNDS, "--out", run, "--cluster", 4) as process:
        until(lambda: generations(run) > 3, process)
        disturb(fault, process, run)
        assert process.wait(300) == 0, process.stderr.read()
    assert history(run) == alone


@pytest.fixture
def scheduler(tmp_path, compiled):
    """Return a function that starts ``dask scheduler`` or ``dask worker`` with certificates."""
    security, own = distributed.Security.temporary(), environment(compiled)
    for name, text in (("ca", security.tls_ca_file), ("key", security.tls_client_key)):
        (tmp_path / name).write_text(text)
    own["DASK_DISTRIBUTED__COMM__TLS__CA_FILE"] = str(tmp_path / "ca")
    for role in ("SCHEDULER", "WORKER", "CLIENT"):
        own[f"DASK_DISTRIBUTED__COMM__TLS__{role}__CERT"] = str(tmp_path / "ca")
        own[f"DASK_DISTRIBUTED__COMM__TLS__{role}__KEY"] = str(tmp_path / "key")
    running = []

    def begin(*command):
        line = [sys.executable, "-m", *command, "--scheduler-file", str(tmp_path / "file.json")]
        process = subprocess.Popen(line, env=own, stderr=subprocess.PIPE, text=True)
        running.append(process)
        return process

    with pytest.MonkeyPatch.context() as patch:
        for name, value in own.items():
            patch.setenv(name, value)
        yield begin, tmp_path / "file.json"
    for process in running:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_a_worker_joins_and_a_scheduler_dies(scheduler, alone, start, finish, tmp_path):
    begin, file = scheduler
    run, worker = tmp_path / "run", ("distributed.cli.dask_worker", "--nthreads=1", "--no-nanny")
    first = begin("distributed.cli.dask_scheduler", "--protocol=tls", "--host=127.0.0.1")
    until(file.exists, first)
    begin(*worker)
    with start("train", CONFIG, *PAIR, *ROUNDS, "--out", run, "--cluster", file) as process:
        until(lambda: generations(run) > 3, process)
        begin(*worker)
        until(lambda: generations(run) > 100, process)
        first.kill()
        _, words = process.communicate(timeout=120)
    assert process.returncode == 2 and f"evo-cpg resume {run} --cluster {file}" in words
    file.unlink()
    second = begin("distributed.cli.dask_scheduler", "--protocol=tls", "--host=127.0.0.1")
    until(file.exists, second)
    begin(*worker)
    code, _, words = finish("resume", run, "--cluster", file)
    assert code == 0, words
    assert history(run) == alone


@pytest.mark.slow
def test_a_killed_sweep_resumes_on_a_cluster(start, finish, tmp_path):
    given = ("sweep", CONFIG, *PAIR, "simulation.seconds=20", "evolution.generations=60")
    axes = ("--grid", "evolution.mutation_rate=0.1,0.2,0.3,0.4", "--grid", "runs=1,8")
    done = finish(*given, *axes, "--out", tmp_path / "alone")
    assert done[0] == 0, done[2]
    folder = tmp_path / "together"
    with start(*given, *axes, "--out", folder, "--cluster", 2) as process:
        until(lambda: any(generations(each) > 8 for each in folder.glob("*/")), process)
        children = psutil.Process(process.pid).children(recursive=True)
        process.kill()
    psutil.wait_procs(children, 60)
    assert not any(each.is_running() for each in children)
    code, _, words = finish("sweep", folder, "--cluster", 2)
    assert code == 0, words
    for each in (tmp_path / "alone").glob("*/"):
        assert history(each) == history(folder / each.name)


@pytest.mark.slow
def test_the_documented_job_script_continues(compiled, tmp_path):
    page = (CONFIG.parents[1] / "docs" / "cluster.md").read_text(encoding="utf-8")
    blocks = [block.partition("```")[0] for block in page.split("```bash\n")]
    certificate, exports, job = (
        next(block for block in blocks if words in block)
        for words in ("openssl req", "export DASK_", "#SBATCH")
    )
    small = f"{CONFIG} {' '.join(PAIR)}"
    (tmp_path / "job").write_text(job.replace("train eel", f"train {small}"))
    stand_in = tmp_path / "srun"
    stand_in.write_text(
        '#!/bin/bash\n"$@" --local-directory $HOME/1 & "$@" --local-directory $HOME/2'
    )
    stand_in.chmod(0o700)
    places = f"{tmp_path}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    own = environment(compiled) | {"HOME": str(tmp_path), "PATH": places}
    own |= {"SLURM_JOB_ID": "7", "SLURM_CPUS_PER_TASK": "1"}

    def run(script: str, *given: str) -> str:
        line = ["bash", "-c", script, *given]
        process = subprocess.Popen(
            line, env=own, cwd=tmp_path, start_new_session=True, stderr=subprocess.PIPE, text=True
        )
        code = process.wait(120)
        # The end of a SLURM job ends scheduler and workers, too.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        words = process.communicate()[1]
        assert code == 0, words
        return words

    run(certificate)
    (tmp_path / "evo-cpg-tls" / "on.sh").write_text(exports)
    assert "champion of" in run((tmp_path / "job").read_text())
    (tmp_path / "scheduler-7.json").unlink(missing_ok=True)
    assert "is finished" in run((tmp_path / "job").read_text())
