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
    named = set(re.findall(r"`([a-z_/]+\.(?:py|js))`", text))
    assert len(named) > 50
    roots = [PACKAGE.parent / name for name in ("evo_cpg", "tests", "benchmarks", "docs/tools")]
    files = [
        path.as_posix() for root in roots for end in ("py", "js") for path in root.rglob(f"*.{end}")
    ]
    assert {name for name in named if not any(x.endswith(f"/{name}") for x in files)} == set()
