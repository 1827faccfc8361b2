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
from tiny_run import CONFIG, GENERATIONS, LONG, contents


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
    with start("train", CONFIG, *LONG, "--out", folder, "--cores", 2) as process:
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
    cli.passes("resume", folder)
    assert_same_run(folder, finished_run)


def test_a_run_killed_before_its_first_checkpoint_restarts(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    shutil.copy(finished_run / "config.yaml", folder)
    cli.passes("resume", folder, "--cores", 2)
    assert_same_run(folder, finished_run)


def test_resume_restores_files_lost_at_the_end(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    for lost in ("champion.npz", "metrics.csv", "meta.json"):
        (folder / lost).unlink()
    cli.passes("resume", folder, "--cores", 2)
    assert_same_run(folder, finished_run)


def test_resume_of_a_finished_run_prints_how_to_continue(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    before = contents(folder)
    assert evo.resume(folder, cores=2).was_finished
    code, out, err = cli("resume", folder)
    assert (code, out) == (0, f"{folder}\n")
    assert err.endswith(f"`evo-cpg resume {folder} --generations {2 * GENERATIONS}`\n")
    assert contents(folder) == before
    err = cli.refuses("train", CONFIG, *LONG, "--out", folder)
    assert f"`evo-cpg resume {folder}` ({GENERATIONS} generations are done)" in err
    code, _, err = cli("resume", folder, "--generations", MORE)
    assert code == 0 and len(rows(folder)) == MORE


MORE = GENERATIONS + 1


@pytest.mark.parametrize(
    ("change", "generations", "words"),
    [
        ({}, 3, ["Give at least"]),
        # No command could read a configuration with so many generations.
        ({}, 10**14, ["evolution.generations: 100000000000000: must be less than or equal to"]),
        ({"evolution.population": 12}, None, ["config.yaml was changed", "12 individuals"]),
        ({"measures": ["speed", "power"]}, MORE, ["add best_speed, best_power"]),
        ({"task": {"type": "distance"}}, MORE, ["add best_forward and drop best_energy"]),
        # The champion would keep the fitness of other conditions, so better individuals were lost.
        ({"world.water.density": 1200.0}, None, ["last started: world.water.", "--start pop"]),
        ({"world.water.density": 1200.0}, MORE, ["last started: world.water.", "--start pop"]),
    ],
)
def test_resume_refuses_other_configurations(
    finished_run, cli, tmp_path, change, generations, words
):
    folder = shutil.copytree(finished_run, tmp_path / "run")
    config = yaml.safe_load((folder / "config.yaml").read_text())
    for key, value in change.items():
        *sections, last = key.split(".")
        place = config
        for section in sections:
            place = place[section]
        place[last] = value
    if change:
        (folder / "config.yaml").write_text(yaml.safe_dump(config))
    before = contents(folder)
    given = () if generations is None else ("--generations", generations)
    err = cli.refuses("resume", folder, *given)
    assert "Traceback" not in err and all(word in err for word in words), err
    assert contents(folder) == before


def test_resume_refuses_to_drop_a_metric_of_a_strategy(finished_run, cli, tmp_path):
    folder = RunFolder(shutil.copytree(finished_run, tmp_path / "run"))
    done = folder.load()
    assert done is not None
    folder.save(done._replace(history=[row | {"spread": 0.5} for row in done.history]))
    err = cli.refuses("resume", folder.path, "--generations", MORE)
    assert "metrics.csv would drop spread, but all its rows must have" in err


def test_resume_continues_with_changes_of_the_search(finished_run, cli, tmp_path):
    folder = RunFolder(shutil.copytree(finished_run, tmp_path / "run"))
    text = folder.config.read_text()
    folder.config.write_text(text.replace("mutation_rate: 0.05", "mutation_rate: 0.3"))
    code, _, err = cli("resume", folder.path, "--generations", MORE)
    assert code == 0 and "evolution.mutation_rate. The run continues with the changes" in err
    assert rows(folder.path)[:GENERATIONS] == rows(finished_run)
