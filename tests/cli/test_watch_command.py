"""`evo-cpg watch`: its display of a run, which it does not change."""

import io
import math
import shutil
import signal
import time

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from evo_cpg.cli import watch
from evo_cpg.cli.watched import _over_generations, curve, panel
from evo_cpg.live.standing import standing
from evo_cpg.training import devices
from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, LONG, PAIR


@pytest.fixture(scope="module")
def run(cli, tmp_path_factory):
    folder = tmp_path_factory.mktemp("watched") / "run"
    code, _, complaint = cli("train", CONFIG, *PAIR, "evolution.generations=3", "--out", folder)
    assert code == 0, complaint
    return folder


@pytest.fixture(autouse=True)
def polite(monkeypatch):
    """Keep the priority and the devices of this process."""
    monkeypatch.setattr(watch, "lower_priority", lambda: None)
    monkeypatch.setattr(devices, "use_cores", lambda count=None: 2)


def contents(folder) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.slow
def test_a_finished_run_is_printed_and_drawn(cli, run, tmp_path):
    """The command ends, and writes only its own picture to the folder."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    before = contents(folder)
    code, out, complaint = cli("watch", folder)
    assert code == 0, complaint
    lines = out.splitlines()
    assert [line.partition("  champion")[0] for line in lines[:3]] == [
        f"   {i}/3 generations" for i in (1, 2, 3)
    ]
    assert lines[3] == str(folder / "watch.png")
    fitness = RunFolder(folder).load_champion()[0].fitness
    assert f"champion {fitness:8.4f}" in lines[2]
    after = contents(folder)
    drawn = after.pop("watch.png")
    assert after == before
    with Image.open(io.BytesIO(drawn)) as picture:
        assert picture.width == 1280
        assert len(np.unique(np.array(picture.convert("RGB")).reshape(-1, 3), axis=0)) > 1000


def test_once_prints_all_generations_without_a_picture(cli, run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    code, out, _ = cli("watch", folder, "--once", "--no-picture")
    assert code == 0 and len(out.splitlines()) == 3
    assert not (folder / "watch.png").exists()


def test_a_run_without_a_finished_generation_is_reported(cli, run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    shutil.rmtree(folder / "checkpoints")
    code, out, _ = cli("watch", folder, "--once")
    assert code == 0 and out == f"{folder}: no generation is finished yet\n"


def test_a_folder_without_a_run_is_refused(cli, tmp_path):
    code, _, complaint = cli("watch", tmp_path)
    assert code == 2 and "is not a run folder (it has no config.yaml)" in complaint


def test_watch_leaves_an_interrupted_write_to_the_trainer(run, tmp_path):
    """`require`, which other commands call, would finish the write."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / ".decided").mkdir()
    (folder / ".decided" / "config.yaml").write_text((run / "config.yaml").read_text())
    watch.watch(folder, once=True, picture=False)
    assert (folder / ".decided" / "config.yaml").is_file()


def test_a_terminal_shows_numbers_and_curves(run):
    folder = RunFolder(run)
    seen = standing(folder)
    assert seen.finished and standing(folder, seen) is seen
    screen = Console(file=io.StringIO(), width=100, force_terminal=False)
    screen.print(panel(folder, seen, 100))
    shown = screen.file.getvalue()
    champion = RunFolder(run).load_champion()[0]
    for words in ("3/3 generations", "finished", f"champion {champion.fitness:.4f}", "diverged"):
        assert words in shown
    # Braille dots.
    assert any(0x2800 < ord(letter) < 0x2900 for letter in shown)
    waiting = seen._replace(generations=100, changed=time.time() - 7200)
    screen.print(panel(folder, waiting, 100))
    shown = screen.file.getvalue()
    assert "no new generation for 2.0 h" in shown or "120 min" in shown


def test_curves_show_the_best_champion_of_several_runs():
    history = [
        {"generation": g, "run": r, "champion": c, "mean": m}
        for g, r, c, m in ((0, 0, 1.0, 0.0), (0, 1, 3.0, 2.0), (1, 0, math.nan, 1.0),
                           (1, 1, 4.0, 3.0))
    ]  # fmt: skip
    found = _over_generations(history)
    assert found["champion"].tolist() == [3.0, 4.0] and found["mean"].tolist() == [1.0, 2.0]


@pytest.mark.slow
def test_watch_follows_a_run_until_control_c(start, tmp_path):
    """Each new generation prints a line. The trainer has more generations than the test needs."""
    folder = tmp_path / "run"
    with start("train", CONFIG, *LONG, "evolution.generations=50000", "--out", folder) as trainer:
        until = time.monotonic() + 120
        while not (folder / "metrics.csv").exists() and time.monotonic() < until:
            time.sleep(0.1)
        with start("watch", folder, "--no-picture") as watcher:
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


def dots(lines: list[str]) -> list[tuple[int, int]]:
    """Return row and column of every dot."""
    bits = {0x01: (0, 0), 0x02: (1, 0), 0x04: (2, 0), 0x40: (3, 0), 0x08: (0, 1), 0x10: (1, 1),
            0x20: (2, 1), 0x80: (3, 1)}  # fmt: skip
    return sorted(
        (4 * r + row, 2 * c + column)
        for r, line in enumerate(lines)
        for c, letter in enumerate(line)
        for bit, (row, column) in bits.items()
        if (ord(letter) - 0x2800) & bit
    )


def test_a_curve_spans_its_lowest_and_highest_value():
    assert dots(curve([0.0, 1.0, 2.0, 3.0], 2, 1)) == [
        (0, 3), (1, 2), (1, 3), (2, 1), (2, 2), (3, 0), (3, 1)
    ]  # fmt: skip
    # These are a level curve, a single value, no value, and a gap.
    assert dots(curve([2.0, 2.0], 1, 1)) == [(3, 0), (3, 1)]
    assert dots(curve([5.0], 2, 1)) == [(3, 0), (3, 1), (3, 2), (3, 3)]
    assert dots(curve([math.nan], 2, 1)) == [] == dots(curve([], 2, 1))
    assert {c for _, c in dots(curve([1.0, math.inf, 1.0, 1.0], 2, 1))} == {0, 2, 3}
