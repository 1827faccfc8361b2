"""Commands read and continue run folders that version 1.0.0 wrote.

The folders in `compatibility/version_1_0/trained` hold two generations of trials of 1 s: a swimmer
of four bodies with three searches, two runs of Fukui's first model, and the salamander on land.
The folder `resumed` holds checkpoints of version 1.0.0, which resumed the same runs.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.api.machine import machine_changes, machine_fingerprint
from evo_cpg.cli.errors import ExitCode
from evo_cpg.config.fingerprint import changes_since
from evo_cpg.fusion.engine import Engine
from evo_cpg.training.loop import TIMING_COLUMNS
from evo_cpg.training.run_folder import RunFolder
from tiny_run import REPOSITORY

FORMER = Path(__file__).parents[1] / "compatibility" / "version_1_0"
RUNS, RESUMED = FORMER / "trained", FORMER / "resumed"
SWIMMERS = "swimmer", "swimmer_open_es", "swimmer_map"
# Motors at their torque limits obey another law since 1.1, so these animals move differently.
WALKERS = "walkers", "salamander"
NAMES = SWIMMERS + WALKERS

# Generations of a resumed run.
GENERATIONS = 4
# Largest relative change of the walkers' fitness by the new law of motors.
_CHANGED_LAW = 0.01
_TIMES = {f"history.{name}" for name in TIMING_COLUMNS}


@pytest.fixture
def copied(tmp_path):
    """Return a function that copies a run folder."""
    return lambda name: RunFolder(shutil.copytree(RUNS / name, tmp_path / name))


def on_the_same_machine(folder: RunFolder) -> bool:
    """Return whether this machine rounds as the one of the run, apart from our version."""
    here = machine_fingerprint(Engine(), 2)
    found = machine_changes(folder.read_meta(), here)
    return all(change.startswith("evo-cpg:") for change in found)


def assert_same(found: Path, expected: Path) -> None:
    """Compare the arrays of a checkpoint of 1.0, without times. Version 1.1 adds arrays."""
    with np.load(found) as ours, np.load(expected) as theirs:
        names = set(theirs.files) - _TIMES
        assert names <= set(ours.files)
        wrong = [name for name in names if ours[name].tobytes() != theirs[name].tobytes()]
    assert wrong == []


@pytest.mark.parametrize("name", NAMES)
def test_run_of_1_0_loads(name):
    folder = RunFolder(RUNS / name)
    assert folder.read_meta()["versions"]["evo-cpg"] == "1.0.0"
    champion, recording, _ = folder.load_champion()
    experiment = evo.load(folder.path)
    assert champion.genes.shape == (experiment.gene_count,)
    assert recording is not None and len(recording.time) == 60
    assert recording.position.shape[1] == len(experiment.creature.bodies)
    newest = folder.load()
    assert newest is not None and newest.generation == 2
    assert changes_since(folder.read_meta()["fingerprint"], experiment.config) == []


@pytest.mark.slow
def test_a_resumed_swimmer_has_the_fitness_of_1_0(cli, copied):
    """The next generation is compared. Selection amplifies other rounding afterwards."""
    folder = resumed("swimmer", cli, copied)
    with np.load(checkpoint(folder, GENERATIONS)) as ours, np.load(RESUMED / "swimmer.npz") as then:
        for name in ("history.best", "history.mean", "history.worst"):
            np.testing.assert_allclose(ours[name][:3], then[name][:3], rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["swimmer", "swimmer_open_es"])
def test_a_resumed_search_has_the_bits_of_1_0(name, copied):
    """The tests compile with other flags, so the program runs as for users."""
    folder = copied(name)
    if not on_the_same_machine(folder):
        pytest.skip("another machine rounds differently")
    command = "resume", folder.path, "--generations", GENERATIONS, "--cores", 2
    environment = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "NPROC")}
    subprocess.run(
        [sys.executable, "-m", "evo_cpg", *map(str, command)],
        env=environment | {"PYTHONPATH": str(REPOSITORY)},
        check=True,
        capture_output=True,
    )
    assert_same(checkpoint(folder, GENERATIONS), RESUMED / f"{name}.npz")


def checkpoint(folder: RunFolder, generation: int) -> Path:
    return folder.path / "checkpoints" / f"generation_{generation:06d}.npz"


@pytest.mark.slow
def test_a_map_of_1_0_is_filled_on(cli, copied):
    """The next generation is as in 1.0. Later parents come from occupied cells only, since 1.1."""
    folder = resumed("swimmer_map", cli, copied)
    now = checkpoint(folder, GENERATIONS - 1)
    with np.load(now) as ours, np.load(RESUMED / "swimmer_map.npz") as theirs:
        for key in ("fitness", "genes", "descriptors", "generation", "index"):
            found, expected = ours[f"state.{key}"], theirs[f"state.{key}"]
            assert found.shape == expected.shape and np.isfinite(expected).any()
            np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", WALKERS)
def test_a_walker_of_1_0_evolves_on(name, cli, copied):
    folder = resumed(name, cli, copied)
    rows = folder.metrics.read_text().splitlines()
    generations = [int(row.split(",")[0]) for row in rows[1:]]
    count = 2 if name == "walkers" else 1
    assert generations == sorted([*range(GENERATIONS)] * count)


def resumed(name, cli, copied) -> RunFolder:
    """Resume a run. Its history stays, and nothing counts as changed."""
    folder = copied(name)
    code, out, err = cli("resume", folder.path, "--generations", GENERATIONS)
    assert code == 0, (out, err)
    assert "changed since" not in err
    newest = folder.load()
    assert newest is not None and newest.generation == GENERATIONS
    before = (RUNS / name / "metrics.csv").read_text()
    assert folder.metrics.read_text().startswith(before)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_champion_of_1_0_is_replayed(name, cli, copied):
    """Swimmers score as recorded. Walkers score nearly so, and `verify` says what differs."""
    folder = copied(name)
    code, out, err = cli("verify", folder.path)
    if name in SWIMMERS:
        assert code == 0, (out, err)
        assert "is as recorded" in out
        return
    assert code in (0, ExitCode.NOT_PASSED), (out, err)
    lines = [line for line in err.splitlines() if line.startswith("evo-cpg:")]
    assert all(": recorded " in line for line in lines), err
    for text in re.findall(r": fitness: recorded (.*)", err):
        then, now = (float(each) for each in text.split(", replayed "))
        assert now == pytest.approx(then, rel=_CHANGED_LAW)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["swimmer", "walkers"])
def test_commands_read_a_run_of_1_0(name, cli, copied, tmp_path):
    folder = copied(name)
    outputs = {suffix: tmp_path / f"motion.{suffix}" for suffix in ("xml", "glb", "csv", "npz")}
    for command in (
        ("plot", folder.path),
        ("render", folder.path, "--sheet", "2x1", "-o", tmp_path / "sheet.png"),
        ("render", folder.path, "--size", "320x180", "--seconds", "0.2"),
        ("analyse", folder.path),
        ("audit", folder.path),
        *(("export", folder.path, path) for path in outputs.values()),
    ):
        code, out, err = cli(*command)
        # Only `audit` gives a verdict, which may be negative.
        assert code == 0 or (command[0] == "audit" and code == ExitCode.NOT_PASSED), (
            command,
            out,
            err,
        )
        assert "Traceback" not in err
    for path in (tmp_path / "sheet.png", *outputs.values()):
        assert path.stat().st_size > 1000
    for made in ("analysis.html", "audit.json", "plots/fitness.png", "plots/path.png"):
        assert (folder.path / made).stat().st_size > 100
    assert json.loads((folder.path / "audit.json").read_text())["checks"]
    assert len(list((folder.path / "videos").glob("*.mp4"))) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["swimmer", "salamander"])
def test_a_champion_of_1_0_is_probed(name, cli, copied):
    folder = copied(name)
    code, out, err = cli("probe", folder.path, "--bearings", "-30,30")
    assert code == 0, (out, err)
    assert len((folder.path / "probe.csv").read_text().splitlines()) == 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["swimmer", "walkers"])
def test_a_run_of_1_0_has_a_story(name, cli, copied, tmp_path):
    folder = copied(name)
    film = tmp_path / "story.mp4"
    code, out, err = cli("render", folder.path, "--story", "--size", "320x180", "-o", film)
    assert code == 0, (out, err)
    assert out.splitlines() == [str(film)]
    assert film.stat().st_size > 10_000
