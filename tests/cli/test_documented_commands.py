"""Commands in README, docs and configs: all of them parse, and the README's session runs."""

import re
import shlex
import shutil
from pathlib import Path

import pytest
import typer

from evo_cpg.cli import options
from evo_cpg.cli.main import app
from evo_cpg.studies import find_study
from tiny_run import PAIR

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *(p for p in (ROOT / "docs").rglob("*.md") if "_build" not in p.parts)]
# Commands in a ```console block, and at the top of a configuration.
PROMPTS = (r"^\$ (.+)$", r"^# {3}((?:evo-cpg|make) .+)$")

# Settings that shorten the README's session.
SMALL = (*PAIR, "evolution.generations=2")


def commands() -> list[tuple[str, list[str]]]:
    """Return the page and the words of each command."""
    found = []
    for page in (*PAGES, *(ROOT / "configs").glob("*.yaml")):
        for pattern in PROMPTS:
            for line in re.findall(pattern, page.read_text(), re.MULTILINE):
                words = shlex.split(line, comments=True)
                found.append((str(page.relative_to(ROOT)), words))
    return found


OURS = [(page, words) for page, words in commands() if words[0] == "evo-cpg"]


def test_commands_are_found_in_the_pages():
    pages = {page for page, _ in OURS}
    assert {"README.md", "docs/getting-started.md", "configs/iwadate2010_swimmer.yaml"} <= pages
    assert len(OURS) > 30


@pytest.mark.parametrize(("page", "words"), OURS, ids=lambda x: x if isinstance(x, str) else x[1])
def test_the_program_accepts_every_command(monkeypatch, page, words):
    # The runs of the pages do not exist.
    monkeypatch.setattr(options, "_is_run", lambda folder: True)
    _, name, *arguments = words
    program = typer.main.get_command(app)
    assert name in program.commands, page
    # This raises for unknown options, missing arguments and values out of range.
    program.commands[name].make_context(name, list(arguments))
    for word in arguments:
        if word.startswith("configs/") and name != "import":
            assert (ROOT / word).is_file(), page


def test_every_make_target_exists():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    made = [words[1] for _, words in commands() if words[0] == "make"]
    assert made and set(made) <= set(targets)


def test_every_named_study_and_part_exists():
    names = r"evo-cpg reproduce ([a-z0-9_]+(?: [a-z0-9_][a-z0-9_-]*)*)"
    named = [words.split() for page in PAGES for words in re.findall(names, page.read_text())]
    assert len(named) > 5
    for name, *parts in named:
        assert set(parts) <= set(find_study(name).parts), name


def test_every_picture_exists():
    for page in PAGES:
        for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.read_text()):
            assert (page.parent / picture).is_file(), (page, picture)


@pytest.mark.slow
def test_the_session_of_the_readme_runs(cli, tmp_path):
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    block = re.search(
        r"## What you can do\n.+?```console\n(.+?)```", (ROOT / "README.md").read_text(), re.S
    )
    assert block is not None
    ran = []
    for line in block[1].splitlines():
        _, name, *arguments = shlex.split(line.removeprefix("$ "))
        if name == "train" and "configs/iwadate2010_swimmer.yaml" not in arguments:
            # Other animals run the same code but take long to compile.
            name, arguments = "validate", arguments[:1]
        extra = {"train": SMALL, "render": ("--size", "64x36", "--seconds", "0.1")}.get(name, ())
        code, _, complaint = cli(name, *arguments, *extra, folder=tmp_path)
        assert code == 0, (line, complaint)
        ran.append(name)
    assert {"train", "resume", "render", "plot", "probe", "verify", "preview", "export"} <= set(ran)
