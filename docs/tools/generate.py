"""Write the generated parts of the pages, so that they can be read as files.

    python docs/tools/generate.py            writes them
    python docs/tools/generate.py --check    lists stale pages, and returns 1 if there are any

A generated part stands between `<!-- begin KIND ARGUMENTS -->` and `<!-- end -->`:

- `begin table FILE`: a table that `evo-cpg reproduce` made. FILE is relative to the page.
- `begin configuration`: all keys of a configuration file.
- `begin import`: what an import of a MuJoCo model maps, refuses and leaves out.
- `begin animal NAME`: the page of a shipped animal (see `animal_pages.page`).
- `begin gallery NAME ...`: cards of animals, of all without a name.
- `begin api NAME ...`: public names with their docstrings (see `api_pages.reference`).
"""

import re
import sys
from pathlib import Path

import animal_pages
import api_pages
import configuration_tables
import import_tables

DOCS = Path(__file__).parents[1]
_PART = re.compile(r"(<!-- begin (\w+) ?(.*?) -->\n)(.*?)(<!-- end -->)", re.S)


def filled(page: Path) -> str:
    """Return the text of a page with fresh generated parts.

    Raises:
        ValueError: a part has an unknown kind.
        OSError: a table does not exist.
    """

    def part(match: re.Match[str]) -> str:
        begin, kind, arguments, _, end = match.groups()
        return f"{begin}\n{_made(page, kind, arguments.split()).strip()}\n\n{end}"

    return _PART.sub(part, page.read_text(encoding="utf-8"))


def _made(page: Path, kind: str, arguments: list[str]) -> str:
    if kind == "table":
        table = (page.parent / arguments[0]).read_text(encoding="utf-8")
        # The commit is in provenance.json in the table's folder.
        return re.sub(r" at commit \w+|, of runs evolved at [0-9a-f, ]+\b", "", table)
    if kind == "configuration":
        return configuration_tables.every_key()
    if kind == "import":
        return import_tables.tables()
    if kind == "api":
        return api_pages.reference(arguments)
    if kind == "animal":
        return animal_pages.page(arguments[0])
    if kind == "gallery":
        return animal_pages.cards(arguments)
    allowed = "table, configuration, import, api, animal, gallery"
    raise ValueError(f"{page}: unknown kind {kind!r}. Allowed: {allowed}")


def main(check: bool) -> int:
    """Write all stale pages, or with `check` only list them and return 1 if there are any."""
    stale = 0
    for page in animal_pages.new_pages():
        stale += 1
        print(f"{page.relative_to(DOCS)}: {'missing. Run `make format`' if check else 'written'}")
        if not check:
            page.write_text(animal_pages.empty_page(page.stem), encoding="utf-8")
    for page in sorted(DOCS.rglob("*.md")):
        text = filled(page)
        if text != page.read_text(encoding="utf-8"):
            stale += 1
            advice = "out of date. Run `make format`" if check else "written"
            print(f"{page.relative_to(DOCS)}: {advice}")
            if not check:
                page.write_text(text, encoding="utf-8")
    return int(check and stale > 0)


if __name__ == "__main__":
    sys.exit(main("--check" in sys.argv[1:]))
