"""Count the code of every package, and compare it with its budget: `python docs/tools/budget.py`.

The ceilings are in `[tool.budget]` of pyproject.toml. Code is what is left of a Python file without
docstrings, comments and blank lines. CONTRIBUTING says how to raise a ceiling.
"""

import ast
import io
import sys
import tokenize
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
COLUMNS = ("code", "docstrings", "files")


def main() -> int:
    """Print the counts of all packages, and return 1 if one is above its ceiling."""
    budget = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["budget"]
    above = 0
    print(f"{'':32}" + "".join(f"{column:>20}" for column in COLUMNS))
    for package, counts in _packages().items():
        ceilings = budget.get(package, {})
        cells = [_cell(counts[column], ceilings.get(column)) for column in COLUMNS]
        above += sum(cell.endswith("!") for cell in cells)
        print(f"{package:32}" + "".join(f"{cell:>20}" for cell in cells))
    if above:
        print("! is above the ceiling: replace something, or raise it in a commit that says why")
    return int(above > 0)


def _packages() -> dict[str, Counter[str]]:
    """Return the counts of the whole product, of the tests, of the pages and of each package."""
    found: dict[str, Counter[str]] = {"evo_cpg": Counter(), "tests": Counter(), "pages": Counter()}
    for path in sorted((ROOT / "evo_cpg").rglob("*.py")):
        folder = path.relative_to(ROOT).parts[:2]
        package = "/".join(folder) if len(folder) == 2 and not folder[1].endswith(".py") else "top"
        counts = _count(path)
        found["evo_cpg"] += counts
        found[package] = found.get(package, Counter()) + counts
    for path in (ROOT / "tests").rglob("*.py"):
        found["tests"] += _count(path)
    for path in (ROOT / "evo_cpg").rglob("*"):
        if path.suffix in {".js", ".css", ".html"} and ".min." not in path.name:
            lines = path.read_text(encoding="utf-8").splitlines()
            found["pages"] += Counter(code=sum(map(bool, map(str.strip, lines))), files=1)
    return found


def _count(path: Path) -> Counter[str]:
    """Return the lines of code and of docstrings of a Python file."""
    text = path.read_text(encoding="utf-8")
    docstrings = set()
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                docstrings.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    code = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in SILENT:
            code.update(range(token.start[0], token.end[0] + 1))
    return Counter(code=len(code - docstrings), docstrings=len(docstrings), files=1)


def _cell(count: int, ceiling: int | None) -> str:
    if ceiling is None:
        return str(count)
    return f"{count} of {ceiling}" + ("!" if count > ceiling else "")


if __name__ == "__main__":
    sys.exit(main())
