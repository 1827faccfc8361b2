"""A word names one thing."""

import ast
import re
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "evo_cpg"


def test_no_two_public_classes_share_a_name():
    places = defaultdict(list)
    for path in PACKAGE.rglob("*.py"):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(path.relative_to(PACKAGE).as_posix())
    assert len(places) > 300
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_files_named_on_the_page_of_the_architecture_exist():
    text = (PACKAGE.parent / "docs" / "architecture.md").read_text("utf-8")
    rooms = "|".join(path.name for path in PACKAGE.iterdir() if path.is_dir())
    named = set(re.findall(rf"`((?:{rooms})/[a-z_/]+\.(?:py|js))`", text))
    assert len(named) > 50
    places = PACKAGE, PACKAGE.parent / "tests"
    assert {
        name for name in named if not any((place / name).is_file() for place in places)
    } == set()
