"""Pages of studies show unchanged results of `evo-cpg reproduce`."""

import json
import re
import shutil
from hashlib import sha256
from pathlib import Path

import pytest

from evo_cpg.io.load import dump_config
from evo_cpg.studies import NAMES, find_study, provenance
from evo_cpg.studies.workshop import configuration
from evo_cpg.system import version_of
from evo_cpg.training.run_folder import RunFolderError

DOCS = Path(__file__).parents[2] / "docs"
FOLDER = DOCS / "reproduction"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
STUDIES = sorted(path.parent for path in FOLDER.glob("*/" + provenance.FILE))
# Tables and figures that a page takes from a study's folder.
TAKEN = r"(?:```\{figure\}|<!-- begin table) (\S+)"
GENERATED = re.compile(r"<!-- begin table .*?<!-- end -->", re.S)


def own_tables(text: str) -> list[str]:
    """Return the heads of tables in a text."""
    return re.findall(r"^\|.*\|\n\|(?:\s*:?-+:?\s*\|)+$", text, re.MULTILINE)


def faults(page: Path) -> list[str]:
    """Return the problems of tables and figures that a page takes from studies."""
    found = []
    for taken in re.findall(TAKEN, page.read_text()):
        path = (page.parent / taken).resolve()
        if not path.is_relative_to(FOLDER):
            continue
        parts = provenance.read(path.parent).values()
        part = next((part for part in parts if path.name in part["files"]), None)
        if part is None:
            found.append(f"{taken}: no part made it")
        elif part["quick"]:
            found.append(f"{taken}: is a quick result")
        elif not path.is_file() or provenance.digest(path) != part["files"][path.name]:
            found.append(f"{taken}: is not as it was made")
    return found


def test_study_pages_have_no_tables_of_their_own():
    pages = [*sorted(FOLDER.glob("*.md")), DOCS / "benchmarks.md"]
    assert len(pages) > 4
    for page in pages:
        assert not own_tables(GENERATED.sub("", page.read_text())), page


def test_pages_take_unchanged_results():
    taken = [name for page in PAGES for name in re.findall(TAKEN, page.read_text())]
    assert len(taken) > 15
    for page in PAGES:
        assert not faults(page), page


@pytest.mark.parametrize("folder", STUDIES, ids=lambda folder: folder.name)
def test_every_file_of_a_study_has_a_provenance_and_a_caption(folder):
    assert not provenance.problems(folder)
    known = find_study(folder.name).parts
    for name, told in provenance.read(folder).items():
        assert name in known, f"{folder.name} has no part {name}"
        line = provenance.caption(folder.name, name, told)
        text = (folder / f"{name}.md").read_text()
        assert text.count(line) == len(own_tables(text)) > 0, name


@pytest.mark.slow
@pytest.mark.parametrize("folder", STUDIES, ids=lambda folder: folder.name)
def test_runs_of_this_version_have_the_declared_configurations(folder):
    declared = find_study(folder.name)
    told = {
        name: run["config_sha256"]
        for part in provenance.read(folder).values()
        if part["versions"]["evo-cpg"] == version_of("evo-cpg")
        for name, run in part["runs"].items()
    }
    now = {name: dump_config(configuration(declared, name)) for name in told}
    assert told == {name: sha256(text.encode()).hexdigest() for name, text in now.items()}


def test_changed_quick_and_unknown_tables_are_found(tmp_path, monkeypatch):
    shutil.copytree(FOLDER / "starfish", tmp_path / "starfish", ignore=lambda *_: ["runs"])
    monkeypatch.setattr("test_study_pages.FOLDER", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("<!-- begin table starfish/lags.md -->")
    folder = tmp_path / "starfish"
    assert faults(page) == []
    told = provenance.read(folder)["lags"]
    provenance.note(folder, "lags", told | {"quick": True})
    assert faults(page) == ["starfish/lags.md: is a quick result"]
    provenance.note(folder, "lags", told)
    (folder / "lags.md").write_text("| better |\n|---|\n| 1 |\n")
    assert faults(page) == ["starfish/lags.md: is not as it was made"]
    assert "was changed after part lags was made" in provenance.problems(folder)[0]
    (folder / "lags.md").rename(folder / "other.md")
    missing, unknown = provenance.problems(folder)
    assert "lags.md of part lags is missing" in missing
    assert "other.md belongs to no part" in unknown
    page.write_text("<!-- begin table starfish/other.md -->")
    assert faults(page) == ["starfish/other.md: no part made it"]
    assert own_tables("| a | b |\n|---|:-:|\n") == ["| a | b |\n|---|:-:|"]


def test_a_damaged_provenance_is_named(tmp_path):
    for text in ("{", "[]", json.dumps({"parts": {"a": {"files": []}}})):
        (tmp_path / provenance.FILE).write_text(text)
        with pytest.raises(RunFolderError, match=r"provenance\.json is damaged"):
            provenance.read(tmp_path)


@pytest.mark.parametrize("name", NAMES)
def test_parts_name_runs_that_are_declared(name):
    found = find_study(name)
    assert found.name == name
    assert {run for part in found.parts.values() for run in part.runs} == set(found.runs)
