"""Unlikely values in a configuration: a warning, or an error with --strict. And --version."""

import platform
import subprocess
from importlib import metadata

import pytest

from evo_cpg.api.machine import commit_of, version
from evo_cpg.native import engine as engines
from evo_cpg.native.backend.machine import llvm_version
from evo_cpg.native.engine import is_native
from evo_cpg.native.ir import Unsupported
from tiny_run import CONFIG, PAIR, REPOSITORY

GRAMS = "creature.materials.body.density=1"
RADIANS = "task.light.bearing_deg=0.524"
SAID = (
    f"{CONFIG}: creature.materials.body.density: 1: plausible: 20 to 23000 kg/m^3. "
    "If it is in g/cm^3, write 1000\n"
)


def test_validate_takes_settings_and_warns(cli):
    out, err = cli.passes("validate", CONFIG, GRAMS, "creature.bodies.1.repeat=2")
    assert out == f"{CONFIG}: 3 bodies, 6 joint axes, 0.006 kg, 519 genes\n"
    assert err == f"evo-cpg: warning: {SAID}"


def test_validate_takes_settings_for_every_file(cli):
    walker = REPOSITORY / "configs" / "hexapod.yaml"
    code, out, _ = cli("validate", "seed=3", CONFIG, walker)
    assert (code, out.count("\n")) == (0, 2)
    err = cli.refuses("validate", CONFIG, "seed=-1")
    assert f"{CONFIG}: seed: -1: must be greater than or equal to 0" in err
    err = cli.refuses("validate", "seed=3")
    assert "seed=3 is a setting. Name a configuration file, too" in err


@pytest.mark.parametrize(
    "command", [["validate"], ["train", "--out", "run"], ["preview", "-o", "body.png"]]
)
def test_strict_refuses_before_anything_is_written(cli, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    name, *rest = command
    err = cli.refuses(name, CONFIG, GRAMS, RADIANS, "--strict", *rest)
    second, first = err.splitlines()
    assert f"{first}\n" == SAID
    assert second.startswith(f"evo-cpg: {CONFIG}: task.light.bearing_deg: 0.524: ")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_train_and_preview_warn_and_continue(cli, tmp_path):
    heavy = "creature.materials.body.density=2"
    _, err = cli.passes("preview", CONFIG, heavy, "-o", tmp_path / "body.png", "--size", "64x36")
    assert "evo-cpg: warning: " in err and "plausible: 20 to" in err
    assert (tmp_path / "body.png").is_file()
    run = tmp_path / "run"
    _, err = cli.passes("train", CONFIG, *PAIR, "evolution.generations=1", RADIANS, "--out", run)
    assert "task.light.bearing_deg: 0.524: in degrees this is hardly a turn. If it is in" in err
    # This animal has one hinge, so there is one warning about oscillators.
    assert err.count("coupled to no other oscillator, and at rest under a") == 1
    assert (run / "champion.npz").is_file()


def test_version_names_the_program_and_its_packages(cli):
    code, out, err = cli("--version")
    assert (code, err) == (0, "")
    words = out.split()
    assert words[:2] == ["evo-cpg", metadata.version("evo-cpg")]
    _, python, jax, engine = out.splitlines()
    assert python.startswith(f"Python {platform.python_version()} on ")
    assert jax == f"JAX {metadata.version('jax')}"
    native = is_native()
    assert engine.startswith("engine: native code, " if native else "engine: plain JAX")
    if native:
        assert llvm_version() in engine


def test_version_says_why_there_is_no_native_code(monkeypatch):
    reason = "llvmlite is not installed"

    def no_target():
        raise Unsupported(reason)

    monkeypatch.setattr(engines, "target", no_target)
    engines.warn_once.cache_clear()
    last = version().splitlines()[-1]
    assert last.startswith("engine: plain JAX; ") and last.endswith(reason)


def test_version_names_the_commit_of_a_checkout(tmp_path):
    def git(*words: object) -> str:
        author = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
        command = ["git", "-C", tmp_path, *author, *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    assert commit_of(tmp_path) is None
    (tmp_path / ".git").mkdir()
    assert commit_of(tmp_path) is None
    (tmp_path / ".git").rmdir()
    git("init", "-q")
    (tmp_path / "file").write_text("one")
    git("add", "file")
    git("commit", "-qm", "x")
    commit = commit_of(tmp_path)
    assert commit and git("rev-parse", "HEAD").startswith(commit) and len(commit) >= 4
    (tmp_path / "file").write_text("two")
    assert commit_of(tmp_path) == f"{commit}-dirty"
    # If only other files count, nothing has changed.
    assert commit_of(tmp_path, ("other",)) == commit
