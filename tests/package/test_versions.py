"""Versions of the program and of its dependencies agree in all files."""

import datetime
import re
import tomllib

import yaml

from tiny_run import REPOSITORY

PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
SUPPORT = (REPOSITORY / "docs" / "support.md").read_text()
CHANGELOG = (REPOSITORY / "CHANGELOG.md").read_text()


def test_the_newest_release_is_this_version():
    heads = re.findall(r"^## \[(.+?)\](?: - (\S+))?$", CHANGELOG, re.MULTILINE)
    assert len(heads) == len(re.findall(r"^## ", CHANGELOG, re.MULTILINE))
    # Unreleased changes may stand above the release.
    if heads[0] == ("Unreleased", ""):
        heads = heads[1:]
    version, date = heads[0]
    # A version in development (2.0.0.dev0) follows the newest release.
    if "dev" not in PROJECT["version"]:
        assert version == PROJECT["version"]
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())
    assert citation["version"] == version
    assert citation["date-released"] == datetime.date.fromisoformat(date)
    dates = [each[1] for each in heads]
    assert dates == sorted(dates, reverse=True)


def test_stability_starts_with_this_major_version():
    major = PROJECT["version"].split(".")[0]
    assert set(re.findall(r"[Ss]ince (\d+\.\d+)", SUPPORT)) == {f"{major}.0"}


def test_supported_versions_are_the_required_versions():
    oldest, tested = {}, {}
    for line in SUPPORT.splitlines():
        if match := re.match(r"\| (Python|JAX|llvmlite) \| ([\d.]+) \| ([\d.]+)", line):
            oldest[match[1].lower()], tested[match[1].lower()] = match[2], match[3]
    required = {"python": PROJECT["requires-python"].removeprefix(">=")}
    for words in PROJECT["dependencies"]:
        if match := re.match(r"(jax|llvmlite)>=([\d.]+)", words):
            required[match[1]] = match[2]
    assert oldest == required and set(required) == {"python", "jax", "llvmlite"}
    pins = dict(re.findall(r"^(\S+)==(\S+)", (REPOSITORY / "constraints.txt").read_text(), re.M))
    for name in ("jax", "llvmlite"):
        assert pins[name] == tested[name] or pins[name] == f"{tested[name]}.0"
    assert tested["python"] == oldest["python"]
