"""The command that adds an extra suits the installation: editable or from a wheel."""

import json
import os
import re
import shlex
import sys
from importlib import metadata
from pathlib import Path

import pytest

from evo_cpg import system
from evo_cpg.system import command_for, version_of


class Installed:
    """Stand-in for pip's record of an installation."""

    def __init__(self, record):
        self._record = record

    def read_text(self, name):
        assert name == "direct_url.json"
        return self._record


@pytest.fixture
def installed(monkeypatch):
    """Function that replaces pip's record."""

    def replace(record):
        monkeypatch.setattr(metadata, "distribution", lambda name: Installed(record))

    return replace


def noted(folder, **about):
    return json.dumps({"url": folder.as_uri(), "dir_info": about})


def test_a_clone_stays_editable(installed, tmp_path, monkeypatch):
    folder = tmp_path / "a clone"
    folder.mkdir()
    (folder / "constraints.txt").touch()
    installed(noted(folder, editable=True))
    words = shlex.split(command_for("mujoco"))
    assert words[1:] == [
        *("-m", "pip", "install", "-c", str(folder / "constraints.txt")),
        *("-e", f"{folder}[mujoco]"),
    ]
    # If the working folder is the clone, the command has paths relative to the clone.
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "executable", str(folder / ".venv" / "bin" / "python"))
    assert command_for("mujoco") == (
        f"{Path('.venv/bin/python')} -m pip install -c constraints.txt -e '.[mujoco]'"
    )
    (folder / "constraints.txt").unlink()
    assert command_for("mujoco").endswith(" -m pip install -e '.[mujoco]'")


@pytest.mark.parametrize(
    "record",
    [
        None,
        "",
        "no JSON",
        "[]",
        '{"url": "https://x/evo_cpg-1.0.0.whl", "archive_info": {}}',
        '{"url": "file:///clone", "dir_info": {}}',
    ],
)
def test_a_wheel_is_installed_by_name(installed, record):
    installed(record)
    assert command_for("mujoco").endswith(" -m pip install 'evo-cpg[mujoco]'")
    assert shlex.split(command_for("mujoco"))[0] == system._shown(sys.executable)


def test_a_missing_package_has_no_version(monkeypatch):
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
