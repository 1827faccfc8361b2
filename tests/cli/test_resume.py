"""A run that was stopped and resumed is the run that went through, bit for bit.

What is stopped is a process. One of those who go on is another; the others are this one, which
compiles once for all.
"""

import csv
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import yaml

from evo_cpg.training.loop import TIMING_COLUMNS
from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, GENERATIONS, LONG


def rows(folder: Path) -> list[dict[str, str]]:
    """metrics.csv as text, without the columns that tell the time."""
    with (folder / "metrics.csv").open() as file:
        return [
            {k: v for k, v in row.items() if k not in TIMING_COLUMNS}
            for row in csv.DictReader(file)
        ]


def assert_same_run(folder: Path, other: Path) -> None:
    """Same history, last population and champion, to the last bit."""
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
    """Begin the run and send a signal once two generations are done."""
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


def test_an_interrupted_run_says_how_to_go_on_and_does(finished_run, start, cli, tmp_path):
    folder = tmp_path / "run"
    code, err = stop(start, folder, signal.SIGINT)
    assert code == 130
    assert err.endswith(f"interrupted; go on with `evo-cpg resume {folder}`\n")
    assert "Traceback" not in err
    code, out, err = cli("resume", folder)
    assert (code, out) == (0, f"{folder}\n"), err
    # Said when it began, and not again.
    assert "oscillator" not in err
    assert_same_run(folder, finished_run)


def test_a_killed_run_goes_on(finished_run, start, finish, tmp_path):
    folder = tmp_path / "run"
    code, _ = stop(start, folder, signal.SIGKILL)
    assert code == -signal.SIGKILL
    # A crash of the machine may have cost the newest checkpoint and left half-written files.
    newest = max((folder / "checkpoints").iterdir())
    newest.write_bytes(newest.read_bytes()[:100])
    (folder / ".metrics.csv.x").write_text("generation,")
    code, _, err = finish("resume", folder)
    assert code == 0, err
    assert_same_run(folder, finished_run)


def test_a_run_killed_before_its_first_checkpoint_begins_anew(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    shutil.copy(finished_run / "config.yaml", folder)
    code, _, err = cli("resume", folder, "--cores", 2)
    assert code == 0, err
    assert_same_run(folder, finished_run)


def test_what_a_kill_at_the_very_end_cost_is_written_anew(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    for lost in ("champion.npz", "metrics.csv", "meta.json"):
        (folder / lost).unlink()
    code, _, err = cli("resume", folder, "--cores", 2)
    assert code == 0, err
    assert_same_run(folder, finished_run)


def test_a_finished_run_says_so_and_how_to_go_on(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    code, out, err = cli("resume", folder)
    assert (code, out) == (0, f"{folder}\n")
    assert err == (
        f"{folder} is finished: all {GENERATIONS} generations are done, and the champion is in "
        f"{folder / 'champion.npz'}; to go on, ask for more than that in all, such as "
        f"`evo-cpg resume {folder} --generations {2 * GENERATIONS}`\n"
    )
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    code, _, err = cli("train", CONFIG, *LONG, "--out", folder)
    assert code == 2
    assert f"`evo-cpg resume {folder}` ({GENERATIONS} generations are done)" in err
    code, _, err = cli("resume", folder, "--generations", GENERATIONS + 1)
    assert code == 0 and len(rows(folder)) == GENERATIONS + 1


def test_resume_refuses_what_it_cannot_go_on_with(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    code, _, err = cli("resume", folder, "--generations", 3)
    assert code == 2
    assert err == (
        f"evo-cpg: {folder}: {GENERATIONS} generations are done already, "
        "--generations 3 would take some back\n"
    )
    config = folder / "config.yaml"
    written = config.read_text()
    config.write_text(written.replace("population: 8", "population: 12"))
    code, _, err = cli("resume", folder)
    warning, err = err.splitlines()
    assert code == 2 and "warning" in warning and "changed since the run" in warning
    assert "config.yaml was changed: it asks for" in err
    assert "12 individuals" in err and "start a new run instead" in err
    assert config.read_text() == written.replace("population: 8", "population: 12")


def test_resume_refuses_more_generations_than_a_file_may_ask_for(finished_run, cli):
    """And writes nothing, for no command would read such a file."""
    config = finished_run / "config.yaml"
    before = config.read_text()
    code, _, err = cli("resume", finished_run, "--generations", 10**14)
    assert code == 2
    assert "evolution.generations: 100000000000000: must be less than or equal to" in err
    assert config.read_text() == before


def test_resume_refuses_what_would_have_other_columns_and_loses_nothing(
    finished_run, cli, tmp_path
):
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
        assert f"metrics.csv would {words}, but all its rows have the same columns; put" in err
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_resume_refuses_to_drop_what_a_strategy_told_of_itself(finished_run, cli, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    done = RunFolder(folder).load()
    assert done is not None
    history = [row | {"spread": 0.5} for row in done.history]
    RunFolder(folder).save(done._replace(history=history))
    code, _, err = cli("resume", folder, "--generations", GENERATIONS + 1)
    assert code == 2 and "metrics.csv would drop spread, but all its rows have" in err
