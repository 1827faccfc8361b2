"""Check the mechanical part of the language rules in CONTRIBUTING: `python docs/tools/language.py`.

- Lines of Markdown have at most 100 columns. Tables, code, generated parts and lines of one long
  link may be longer.
- Links have text.
- Identifiers avoid words that once had a private meaning in this project. Names of tests are
  sentences, in which ordinary English is free.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
WIDTH = 100

# The field's word for each is in CONTRIBUTING.
PRIVATE_WORDS = re.compile(
    "asked|begun|coasting|departures?|doubts?|footing|gangs?|grip|lives|looks|noting|"
    "partly|people|plausible|repeating|seats?|shares?|spokes?|strays|surroundings|told|wanted|"
    "ways?|who|yardsticks?"
)
# Keys, columns and other names in files, and "share" for a shared lock.
EXCEPTIONS = frozenset({"airborne_way", "limp_way", "lives", "peak_share", "share", "told"})


def main() -> int:
    """Print every finding, and return 1 if there are any."""
    found = [*_markdown(), *_identifiers()]
    print(*found, sep="\n" if found else "")
    return int(bool(found))


def _files(*patterns: str) -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return [ROOT / name for name in listed.stdout.splitlines()]


def _markdown() -> Iterator[str]:
    for page in _files("*.md", ":!docs/reproduction/*/*"):  # tables that `reproduce` made
        free = False
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            place = f"{page.relative_to(ROOT)}:{number}"
            if "[](" in line:
                yield f"{place}: a link without text. Put a text between the brackets"
            if re.match(r"\s*(```|:::|<!-- (begin|end))", line):
                free = "begin" in line or ("end -->" not in line and not free)
            long = len(line) > WIDTH and not re.match(r"\s*(\||\S+$|[-*] \S+$)", line)
            if long and not free:
                yield f"{place}: {len(line)} columns. Wrap the line at {WIDTH}"


def _identifiers() -> Iterator[str]:
    for path in _files("evo_cpg/*.py", "benchmarks/*.py", "tests/*.py"):
        names = {path.stem: 1}
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for name in _names(node):
                names.setdefault(name, getattr(node, "lineno", 1))
        for name, line in names.items():
            words = {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}
            free = name.startswith("test_") or name in EXCEPTIONS
            if any(map(PRIVATE_WORDS.fullmatch, words)) and not free:
                yield f"{path.relative_to(ROOT)}:{line}: {name}: a private word, see CONTRIBUTING"


def _names(node: ast.AST) -> Iterator[str]:
    """Yield the names that a node defines."""
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.arg(arg=name):
            yield name
        case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
            yield name


if __name__ == "__main__":
    sys.exit(main())
