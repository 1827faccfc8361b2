"""A run that was stopped and resumed equals an uninterrupted run, bit for bit.

The stopped run and the uninterrupted run are processes. The tests resume in this process, which
compiles once for all of them.
"""

import csv
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

import evo_cpg as evo
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.train import TIMING_COLUMNS
from tiny_run import CONFIG, GENERATIONS, LONG


def rows(folder: Path) -> list[dict[str, str]]:
    """Return the rows of metrics.csv as text, without the columns of durations."""
    with (folder / "metrics.csv").open() as file:
        return [
            {k: v for k, v in row.items() if k not in TIMING_COLUMNS}
            for row in csv.DictReader(file)
        ]


def assert_same_run(folder: Path, other: Path) -> None:
    """Compare history, last population and champion of two runs, bit for bit."""
    assert len(rows(folder)) == GENERATIONS
    assert rows(folder) == rows(other)
    last, other_last = RunFolder(folder).load(), RunFolder(other).load()
    assert last is not None and other_last is not None
    assert last.generation == other_last.generation == GENERATIONS
    assert last.scales == other_last.scales
    np.testing.assert_array_equal(last.genes, other_last.genes)
    assert (folder / "lineage.npz").read_bytes() == (other / "lineage.npz").read_bytes()
    champion, motion, digests = RunFolder(folder).load_champion()
    other_champion, other_motion, other_digests = RunFolder(other).load_champion()
    np.testing.assert_array_equal(champion.genes, other_champion.genes)
    assert champion[1:] == other_champion[1:]
    assert digests == other_digests
    assert motion is not None and other_motion is not None
    np.testing.assert_array_equal(motion.position, other_motion.position)


def stop(start, folder: Path, how: signal.Signals) -> tuple[int, str]:
    """Start the run, and send a signal after two generations."""
    with start(
        "train",
        CONFIG,
        *LONG,
        "--out",
        folder,
        "--cores",
        2,
    ) as process:
        metrics = folder / "metrics.csv"
        while process.poll() is None and not (metrics.exists() and len(rows(folder)) >= 2):
            time.sleep(0.002)
        process.send_signal(how)
        _, err = process.communicate()
    done = RunFolder(folder).load()
    assert done is not None and 2 <= done.generation < GENERATIONS
    return process.returncode, err


@pytest.mark.slow
def test_an_interrupted_run_continues_to_the_same_bits(finished_run, start, cli, tmp_path):
    folder = tmp_path / "run"
    code, err = stop(start, folder, signal.SIGINT)
    assert code == 130
    assert err.endswith(f"interrupted. Continue with `evo-cpg resume {folder}`\n")
    assert "Traceback" not in err
    code, out, err = cli("resume", folder)
    assert (code, out) == (0, f"{folder}\n"), err
    # The warning was printed at the start of the run, and is not repeated.
    assert "oscillator" not in err
    assert_same_run(folder, finished_run)


def test_a_killed_run_continues_to_the_same_bits(finished_run, start, cli, tmp_path):
    folder = tmp_path / "run"
    code, _ = stop(start, folder, signal.SIGKILL)
    assert code == -signal.SIGKILL
    # A crash of the machine may damage the newest checkpoint and leave half-written files.
    newest = max((folder / "checkpoints").iterdir())
    newest.write_bytes(newest.read_bytes()[:100])
    (folder / ".metrics.csv.x").write_text("generation,")
    code, _, err = cli("resume", folder)
    assert code == 0, err
    assert_same_run(folder, finished_run)


def test_a_run_killed_before_its_first_checkpoint_restarts(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    shutil.copy(finished_run / "config.yaml", folder)
    code, _, err = cli("resume", folder, "--cores", 2)
    assert code == 0, err
    assert_same_run(folder, finished_run)


def test_resume_restores_files_lost_at_the_end(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    for lost in ("champion.npz", "metrics.csv", "meta.json"):
        (folder / lost).unlink()
    code, _, err = cli("resume", folder, "--cores", 2)
    assert code == 0, err
    assert_same_run(folder, finished_run)


def test_resume_of_a_finished_run_prints_how_to_continue(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert evo.resume(folder, cores=2).was_finished
    code, out, err = cli("resume", folder)
    assert (code, out) == (0, f"{folder}\n")
    assert err.endswith(f"`evo-cpg resume {folder} --generations {2 * GENERATIONS}`\n")
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    code, _, err = cli("train", CONFIG, *LONG, "--out", folder)
    assert code == 2
    assert f"`evo-cpg resume {folder}` ({GENERATIONS} generations are done)" in err
    code, _, err = cli("resume", folder, "--generations", GENERATIONS + 1)
    assert code == 0 and len(rows(folder)) == GENERATIONS + 1


def test_resume_refuses_fewer_generations_and_another_population(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    code, _, err = cli("resume", folder, "--generations", 3)
    assert code == 2
    assert f"Give at least {GENERATIONS}" in err
    config = folder / "config.yaml"
    written = config.read_text()
    config.write_text(written.replace("population: 8", "population: 12"))
    code, _, err = cli("resume", folder)
    assert code == 2 and "config.yaml was changed: it now has" in err
    assert "12 individuals" in err and "Start a new run instead" in err
    assert config.read_text() == written.replace("population: 8", "population: 12")


def test_resume_refuses_more_generations_than_a_configuration_allows(finished_run, cli):
    """The configuration does not change, because no command could read it."""
    config = finished_run / "config.yaml"
    before = config.read_text()
    code, _, err = cli("resume", finished_run, "--generations", 10**14)
    assert code == 2
    assert "evolution.generations: 100000000000000: must be less than or equal to" in err
    assert config.read_text() == before


def test_resume_refuses_changes_of_the_columns_of_metrics(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    config = folder / "config.yaml"
    written = yaml.safe_load(config.read_text())
    for change, words in (
        ({"measures": ["speed", "power"]}, "add best_speed, best_power"),
        (
            {"task": {"type": "distance"}},
            "add best_forward and drop best_energy, best_light",
        ),
    ):
        config.write_text(yaml.safe_dump(written | change))
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        code, _, err = cli("resume", folder, "--generations", GENERATIONS + 1)
        assert code == 2 and "Traceback" not in err
        assert f"metrics.csv would {words}, but all its rows must have" in err
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_resume_refuses_to_drop_a_metric_of_a_strategy(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    done = RunFolder(folder).load()
    assert done is not None
    history = [row | {"spread": 0.5} for row in done.history]
    RunFolder(folder).save(done._replace(history=history))
    code, _, err = cli("resume", folder, "--generations", GENERATIONS + 1)
    assert code == 2 and "metrics.csv would drop spread, but all its rows must have" in err


def test_resume_refuses_changes_of_the_fitness(finished_run, cli, tmp_path):
    """The champion would keep the fitness of other conditions, so better individuals were lost."""
    folder = RunFolder(shutil.copytree(finished_run, tmp_path / "run"))
    written = yaml.safe_load(folder.config.read_text())
    written["world"]["water"]["density"] = 1200.0
    folder.config.write_text(yaml.safe_dump(written))
    before = {path: path.read_bytes() for path in folder.path.rglob("*") if path.is_file()}
    for more in ((), ("--generations", GENERATIONS + 1)):
        code, _, err = cli("resume", folder.path, *more)
        assert code == 2 and "last started: world.water. Its champion was evaluated without" in err
        assert f"train {folder.config} --from {folder.path} --start population" in err
    assert {path: path.read_bytes() for path in before} == before


def test_resume_continues_with_changes_of_the_search(finished_run, cli, tmp_path):
    folder = RunFolder(shutil.copytree(finished_run, tmp_path / "run"))
    text = folder.config.read_text()
    folder.config.write_text(text.replace("mutation_rate: 0.05", "mutation_rate: 0.3"))
    code, _, err = cli("resume", folder.path, "--generations", GENERATIONS + 1)
    assert code == 0 and "evolution.mutation_rate. The run continues with the changes" in err
    assert rows(folder.path)[:GENERATIONS] == rows(finished_run)
