"""Versions of packages, the command that adds an extra, and the documented installations."""

import re
import shlex
import sys
from importlib import metadata
from pathlib import Path

from evo_cpg.system import command_for, version_of


def test_a_missing_package_has_no_version():
    assert version_of("numpy") == metadata.version("numpy")
    assert version_of("evo-cpg-of-nobody") == "unknown"


def test_the_command_adds_an_extra(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/my venv/bin/python")
    words = shlex.split(command_for("mujoco"))
    assert words == ["/my venv/bin/python", "-m", "pip", "install", "evo-cpg[mujoco]"]


def test_every_documented_install_is_editable():
    root = Path(__file__).parents[2]
    pages = [root / "README.md", *(root / "docs").rglob("*.md")]
    lines = [line for page in pages for line in page.read_text(encoding="utf-8").splitlines()]
    named = [line for line in lines if re.search(r"pip install [^`]*\[\w+\]'", line)]
    assert named
    for line in named:
        assert " -e '." in line or "wheel" in line, line
