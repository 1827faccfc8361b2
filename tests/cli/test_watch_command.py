"""`evo-cpg watch`: its display of a run, which it does not change."""

import shutil
import signal
import time

import pytest

from evo_cpg.cli.evolve import watch
from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, LONG, PAIR, contents


@pytest.fixture(scope="module")
def run(cli, tmp_path_factory):
    folder = tmp_path_factory.mktemp("watched") / "run"
    cli.passes("train", CONFIG, *PAIR, "evolution.generations=3", "--out", folder)
    return folder


def test_a_finished_run_is_printed_and_unchanged(cli, run):
    before = contents(run)
    out, _ = cli.passes("watch", run)
    lines = out.splitlines()
    assert [line.partition("  champion")[0] for line in lines] == [
        f"   {i}/3 generations" for i in (1, 2, 3)
    ]
    fitness = RunFolder(run).load_champion()[0].fitness
    assert f"champion {fitness:8.4f}" in lines[2]
    assert contents(run) == before
    assert cli("watch", run, "--once")[1] == out


def test_a_run_without_a_finished_generation_is_reported(cli, run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    shutil.rmtree(folder / "checkpoints")
    code, out, _ = cli("watch", folder, "--once")
    assert code == 0 and out == f"{folder}: no generation is finished yet\n"


def test_watch_leaves_an_interrupted_write_to_the_trainer(run, tmp_path):
    """`require`, which other commands call, would finish the write."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / ".decided").mkdir()
    (folder / ".decided" / "config.yaml").write_text((run / "config.yaml").read_text())
    watch(folder, once=True)
    assert (folder / ".decided" / "config.yaml").is_file()


@pytest.mark.slow
def test_watch_follows_a_run_until_control_c(start, tmp_path):
    """Each new generation prints a line. The trainer has more generations than the test needs."""
    folder = tmp_path / "run"
    with start("train", CONFIG, *LONG, "evolution.generations=50000", "--out", folder) as trainer:
        until = time.monotonic() + 120
        while not (folder / "metrics.csv").exists() and time.monotonic() < until:
            time.sleep(0.1)
        with start("watch", folder) as watcher:
            first = watcher.stdout.readline()
            later = watcher.stdout.readline()
            assert first.split()[:2] == ["1/50000", "generations"]
            assert later.split()[:2] == ["2/50000", "generations"]
            assert trainer.poll() is None
            watcher.send_signal(signal.SIGINT)
            _, complaint = watcher.communicate(timeout=60)
            assert watcher.returncode == 130 and "Traceback" not in complaint
        assert trainer.poll() is None
        trainer.send_signal(signal.SIGINT)
        trainer.communicate(timeout=60)
