"""Digests of the source code that a part of a study ran through.

A result is up to date while the code that made it is the same. The digest of a module leaves out
comments, docstrings and layout. It also leaves out what annotations say of functions and of the
shapes of arrays. Only packages that compute count. Drawing and messages change how a result looks,
but not what it says. The code that reads configurations is left out, too: a run records the
configuration that it produced.
"""

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

# Packages whose loaded modules count, and modules within them that only keep records.
_COUNTED = (
    "benchmarks.",
    *(
        f"evo_cpg.{package}."
        for package in (
            *("spatial", "fusion", "creature", "physics", "control", "evolution", "simulation"),
            *("analysis", "training", "exchange", "laboratory", "studies"),
        )
    ),
)
_RECORDS = tuple(f"evo_cpg.studies.{name}" for name in ("catalogue", "provenance", "sources"))
_DIGITS = 10

# Kinds of arrays in annotations, whose shapes do not count.
_ARRAYS = ("Bool", "Complex", "Float", "Int", "Shaped", "UInt8", "UInt32")

Sources = dict[str, str]


def loaded() -> Sources:
    """Return the digest of each module that this process has loaded and that counts, by name."""
    names = sorted(filter(_counts, sys.modules))
    return {name: found for name in names if (found := _digest_of(name)) is not None}


def older(one: Mapping[str, str], other: Mapping[str, str]) -> Sources:
    """Join two sets of sources. A module in both keeps a digest that differs from today's code."""
    joined = {**one, **other}
    joined |= {name: known for name, known in one.items() if known != _digest_of(name)}
    return dict(sorted(joined.items()))


def changed(sources: Mapping[str, str]) -> list[str]:
    """Return the names of modules whose code differs from recorded sources, or that are gone."""
    return [name for name, known in sources.items() if _counts(name) and _digest_of(name) != known]


def packed(sources: Mapping[str, str]) -> Sources:
    """Return sources with a text of all modules for each package, which is short to store."""
    groups: dict[str, list[str]] = {}
    for name, digest in sources.items():
        package, _, module = name.rpartition(".")
        groups.setdefault(package, []).append(f"{module}={digest}")
    return {package: " ".join(modules) for package, modules in groups.items()}


def unpacked(packages: Mapping[str, str]) -> Sources:
    """Return the sources that `packed` made a text of."""
    pairs = [
        (package, *module.split("="))
        for package, modules in packages.items()
        for module in modules.split()
    ]
    return {f"{package}.{name}" if package else name: digest for package, name, digest in pairs}


def _counts(name: str) -> bool:
    return name.startswith(_COUNTED) and name not in _RECORDS


@cache
def _digest_of(name: str) -> str | None:
    """Return the digest of a module's code, or None if there is no such file."""
    try:
        found = importlib.util.find_spec(name)
    except (ModuleNotFoundError, ValueError):
        return None
    if found is None or found.origin is None or not found.origin.endswith(".py"):
        return None
    return digest(Path(found.origin).read_text("utf-8"))


def digest(code: str) -> str:
    """Return the digest of a module's code, without the parts that compute nothing."""
    plain = repr(_plain(ast.parse(code)))
    return hashlib.sha256(plain.encode()).hexdigest()[:_DIGITS]


def _plain(node: Any) -> Any:
    """Return a syntax tree as nested tuples that are the same in all versions of Python."""
    if isinstance(node, ast.AST):
        return type(node).__name__, *_fields(node)
    if isinstance(node, list):
        return tuple(map(_plain, node))
    return node


def _fields(node: ast.AST) -> Iterator[tuple[str, Any]]:
    described = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
    for name, value in ast.iter_fields(node):
        if _only_describes(node, name):
            continue
        if described and name == "body" and ast.get_docstring(node, clean=False) is not None:
            value = value[1:]
        if isinstance(node, ast.JoinedStr):
            # Python 3.12 has empty texts in f-strings.
            value = [part for part in value if getattr(part, "value", None) != ""]
        # Later versions of Python have more fields, which are empty in old code.
        if value is not None and value != []:
            yield name, _plain(value)


def _only_describes(node: ast.AST, field: str) -> bool:
    """Return whether a field of a syntax tree is an annotation that computes nothing."""
    if isinstance(node, ast.Subscript):
        return field == "slice" and getattr(node.value, "id", None) in _ARRAYS
    return field == "returns" or (isinstance(node, ast.arg) and field == "annotation")
