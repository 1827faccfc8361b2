"""All built pages of the docs in headless Chromium: nothing is cut, and nothing is requested."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import chromium

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "tools"))
import animal_pages

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium.found() is None, reason="needs Chromium"),
]
DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    pytest.importorskip("sphinx")
    made = tmp_path_factory.mktemp("docs")
    command = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "-b", "html"]
    done = subprocess.run(
        [*command, "-d", str(made / "trees"), str(DOCS), str(made / "html")],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return made / "html"


@pytest.fixture(scope="module")
def tab(tmp_path_factory) -> Iterator[chromium.Page]:
    with chromium.browser(tmp_path_factory.mktemp("profile")) as page:
        yield page


def faults(tab: chromium.Page, page: Path) -> list[str]:
    """Return what is cut on a page at two widths, light and dark, and what it requests."""
    tab.events.clear()
    tab.open(page)
    found = [f"{page.name}: {complaint}" for complaint in tab.complaints]
    for width in (390, 1280):
        for scheme in ("light", "dark"):
            tab.resize((width, 900))
            features = [{"name": "prefers-color-scheme", "value": scheme}]
            tab.call("Emulation.setEmulatedMedia", features=features)
            found += [f"{page.name}, {width} px, {scheme}: {each}" for each in tab.cut()]
    local = ("file:", "data:", "blob:")
    found += [f"{page.name} requests {each}" for each in tab.requests if not each.startswith(local)]
    return found


def test_no_page_is_cut_or_requests_anything(built, tab):
    pages = sorted(built.rglob("*.html"))
    assert len(pages) > 60
    wrong = [each for page in pages for each in faults(tab, page)]
    assert wrong == []


def test_a_page_that_is_cut_is_noticed(tab, tmp_path):
    page = tmp_path / "wide.html"
    page.write_text(
        '<div class="content" style="overflow: auto"><p style="width: 500px">wide</p></div>'
        '<pre style="overflow: auto"><a style="display: block; width: 600px">long</a></pre>'
        '<img src="https://example.org/a.png">'
    )
    wrong = " ".join(faults(tab, page))
    assert "390 px, light: P wide" in wrong and "1280 px, light: P" not in wrong
    assert "A long" not in wrong
    assert "requests https://example.org/a.png" in wrong


def test_every_champion_of_the_gallery_has_the_shipped_configuration():
    """Train the animal again, and collect it with `docs/tools/animal_pages.py`, if this fails."""
    assert animal_pages.outdated() == []


def test_search_works_from_files(built, tab):
    tab.events.clear()
    tab.open(built / "search.html")
    tab.run("void (location.search = '?q=salamander')")
    tab.wait("document.querySelectorAll('#search-results li').length > 3")
    assert not tab.complaints


def test_every_animal_of_the_gallery_lives(built, tab):
    """The viewer starts, and the canvas is not blank."""
    animals = sorted((built / "animals").glob("*.animal.html"))
    assert len(animals) > 10
    for animal in animals:
        tab.open(animal, (800, 600))
        tab.wait("document.querySelector('#animal.ready') !== null")


def test_formulas_need_no_script(built, tab):
    tab.open(built / "models" / "controller.html")
    assert tab.run("document.querySelectorAll('math').length") > 50
    assert tab.run("document.querySelector('.formula math').getBoundingClientRect().height") > 15


def test_a_button_copies_commands_without_prompt_and_output(built, tab):
    tab.open(built / "getting-started.html")
    tab.wait("document.querySelectorAll('button.copybtn').length > 3")
    tab.run(
        "void document.addEventListener('copy',"
        " () => { window.copied = document.activeElement.value; })"
    )
    tab.click("button.copybtn")
    tab.wait("window.copied !== undefined")
    lines = tab.run("window.copied").splitlines()
    assert lines[1] == "python3 -m venv .venv" and len(lines) == 3
