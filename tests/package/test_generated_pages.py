"""Generated parts of the docs are up to date."""

import sys

import pytest

from tiny_run import REPOSITORY

sys.path.insert(0, str(REPOSITORY / "docs" / "tools"))
import generate

PAGES = [page for page in generate.DOCS.rglob("*.md") if "<!-- begin " in page.read_text("utf-8")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_generated_parts_are_fresh(page):
    """Run `python docs/tools/generate.py` if this fails."""
    assert generate.filled(page) == page.read_text(encoding="utf-8")


def test_every_shipped_animal_has_a_page():
    assert generate.animal_pages.new_pages() == []
