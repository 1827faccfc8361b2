"""The wheel holds all files that the program needs, and works without a clone."""

import os
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from evo_cpg.io.shipped import shipped_names
from tiny_run import PAIR, REPOSITORY

# It runs in an empty folder. The path has the wheel, then the dependencies.
_LOADS_ALL = """
import evo_cpg
from evo_cpg.io.load import load_config
from evo_cpg.io.shipped import find_config, shipped_names

print(evo_cpg.__file__)
for name in shipped_names():
    assert load_config(find_config(name)).name == name
    print(name)
"""


def build(source: Path, kind: str, into: Path) -> Path:
    """Build a wheel or an sdist of a source tree."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(into)]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    (made,) = into.iterdir()
    return made


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    return build(REPOSITORY, "wheel", tmp_path_factory.mktemp("wheel"))


def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if not name.endswith("/")}


def tracked(folder: str) -> set[str]:
    """Return the files in a folder of the repository, without compiled Python."""
    root = REPOSITORY / folder
    files = (path for path in root.rglob("*") if path.is_file())
    return {str(p.relative_to(REPOSITORY)) for p in files if "__pycache__" not in p.parts}


def test_the_wheel_holds_only_package_and_configurations(wheel):
    ours = {name for name in names(wheel) if ".dist-info/" not in name}
    configs = {f"evo_cpg/{name}" for name in tracked("configs")}
    assert ours == tracked("evo_cpg") | configs
    assert "evo_cpg/py.typed" in ours


@pytest.mark.slow
def test_every_configuration_loads_from_the_wheel_alone(wheel, tmp_path):
    """Small counterpart of the slow test below."""
    (tmp_path / "empty").mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "wheel")
    done = subprocess.run(
        [sys.executable, "-c", _LOADS_ALL],
        cwd=tmp_path / "empty",
        env=os.environ | {"PYTHONPATH": str(tmp_path / "wheel"), "EVO_CPG_TRUST": "0"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        str(tmp_path / "wheel" / "evo_cpg" / "__init__.py"),
        *shipped_names(),
    ]


@pytest.mark.slow
def test_commands_work_in_an_empty_environment(wheel, tmp_path):
    """Install the wheel with `constraints.txt`, and run the commands from `configs` to `reproduce`.

    The installed wheel is built from the sdist. It has the same files as the clone's wheel.
    """
    sdist = build(REPOSITORY, "sdist", tmp_path / "sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "source", filter="data")
    (source,) = (tmp_path / "source").iterdir()
    second = build(source, "wheel", tmp_path / "second")
    assert names(second) == names(wheel)

    venv.create(tmp_path / "env", with_pip=True)
    own = {k: v for k, v in os.environ.items() if not k.startswith(("EVO_CPG_", "PYTHON", "XLA_"))}
    own["COLUMNS"] = "200"
    empty = tmp_path / "empty"
    empty.mkdir()

    def call(*words: object) -> subprocess.CompletedProcess[str]:
        program = tmp_path / "env" / "bin" / str(words[0])
        command = [program, *map(str, words[1:])]
        return subprocess.run(command, cwd=empty, env=own, capture_output=True, text=True)

    def run(*words: object) -> str:
        done = call(*words)
        assert done.returncode == 0, (words, done.stdout, done.stderr)
        return done.stdout

    run("python", "-m", "pip", "install", "-q", "-c", REPOSITORY / "constraints.txt", second)
    run("python", "-c", f"import evo_cpg; assert {str(tmp_path)!r} in evo_cpg.__file__")
    listed = run("evo-cpg", "configs")
    assert all(f" {name} " in listed for name in shipped_names())
    settings = (*PAIR, "evolution.generations=2")
    swimmer = "iwadate2010_swimmer"
    run_folder = run("evo-cpg", "train", swimmer, *settings).strip()
    assert run_folder == f"runs/{swimmer}"
    films = run("evo-cpg", "render", run_folder, "--size", "64x36", "--seconds", "0.2")
    assert (empty / films.strip()).stat().st_size > 500
    assert len(run("evo-cpg", "plot", run_folder).split()) == 3
    assert "lights reached" in run("evo-cpg", "probe", run_folder, "--bearings", "-30,30")
    # Two bodies on a hinge pass these limits: the test is that the command works.
    loose = ("half_step=0", "quarter_step=0", "friction=0", "drag=0", "pose=0")
    loose += ("surface_points=0", "precision=0", "other_engine=0", "limp_way=10")
    assert "passes its audit" in run("evo-cpg", "audit", run_folder, *loose)
    run("evo-cpg", "export", run_folder, "run.xml")
    run("evo-cpg", "export", "hexapod", "hexapod.xml")
    assert (empty / "run.xml").is_file() and (empty / "hexapod.xml").is_file()
    assert "is as recorded (exactly)" in run("evo-cpg", "verify", run_folder)
    run("evo-cpg", "resume", run_folder, "--generations", 3)
    rows = (empty / run_folder / "metrics.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows[1:]] == ["0", "1", "2"]
    copied = run("evo-cpg", "configs", "copy", "salamander_amphibious").strip()
    assert copied == "salamander_amphibious.yaml"
    assert "16 bodies" in run("evo-cpg", "validate", copied)
    # Only a clone has the benchmarks.
    bench = call("evo-cpg", "reproduce", "benchmarks", "brain")
    assert bench.returncode == 2 and bench.stderr.startswith(
        "evo-cpg: the benchmark suite is part of a checkout of evo_cpg, but "
    )
