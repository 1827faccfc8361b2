"""An extra is added by the command that suits how the program was installed."""

import json
import os
import re
import shlex
import sys
from importlib import metadata
from pathlib import Path

import pytest

from evo_cpg import installation
from evo_cpg.installation import command_for, version_of


class Installed:
    """What pip notes of an installation."""

    def __init__(self, told):
        self._told = told

    def read_text(self, name):
        assert name == "direct_url.json"
        return self._told


@pytest.fixture
def installed(monkeypatch):
    """Replace what pip has noted."""

    def replace(told):
        monkeypatch.setattr(metadata, "distribution", lambda name: Installed(told))

    return replace


def noted(folder, **about):
    return json.dumps({"url": folder.as_uri(), "dir_info": about})


def test_in_a_clone_the_program_stays_editable(installed, tmp_path, monkeypatch):
    folder = tmp_path / "a clone"
    folder.mkdir()
    (folder / "constraints.txt").touch()
    installed(noted(folder, editable=True))
    words = shlex.split(command_for("mujoco"))
    assert words[1:] == [
        *("-m", "pip", "install", "-c", str(folder / "constraints.txt")),
        *("-e", f"{folder}[mujoco]"),
    ]
    # In the clone all is named from there.
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "executable", str(folder / ".venv" / "bin" / "python"))
    assert command_for("jobs") == (
        f"{Path('.venv/bin/python')} -m pip install -c constraints.txt -e '.[jobs]'"
    )
    (folder / "constraints.txt").unlink()
    assert command_for("jobs").endswith(" -m pip install -e '.[jobs]'")


@pytest.mark.parametrize(
    "told",
    [
        None,
        "",
        "no JSON",
        "[]",
        '{"url": "https://x/evo_cpg-1.0.0.whl", "archive_info": {}}',
        '{"url": "file:///clone", "dir_info": {}}',
    ],
)
def test_a_wheel_goes_by_its_name(installed, told):
    installed(told)
    assert command_for("mujoco").endswith(" -m pip install 'evo-cpg[mujoco]'")
    assert shlex.split(command_for("mujoco"))[0] == installation._shown(sys.executable)


def test_what_was_never_installed_has_no_version(monkeypatch):
    assert version_of("numpy") == metadata.version("numpy")
    assert version_of("evo-cpg-of-nobody") == "unknown"

    def missing(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", missing)
    assert command_for("mujoco").endswith("'evo-cpg[mujoco]'")


def test_every_documented_install_is_editable():
    root = Path(__file__).parents[2]
    pages = [root / "README.md", *(root / "docs").rglob("*.md")]
    lines = [line for page in pages for line in page.read_text(encoding="utf-8").splitlines()]
    named = [line for line in lines if re.search(r"pip install [^`]*\[\w+\]'", line)]
    assert named
    for line in named:
        assert " -e '." in line or "wheel" in line, line
    assert os.linesep not in command_for("mujoco")
