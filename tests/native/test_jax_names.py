"""Private names of JAX are used in one file only.

A deprecated name warns at its use, and the warning fails a test.
"""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
# Modules that JAX does not promise to keep. `jax.core` has a few public names, and those move.
PRIVATE = "jax.core", "jax.interpreters", "jax.lib", "jaxlib"


def dotted(node):
    """Return the path of an attribute, such as ``jax.lax.scan``, or "" if no name begins it."""
    if isinstance(node, ast.Name):
        return node.id
    before = dotted(node.value) if isinstance(node, ast.Attribute) else ""
    return f"{before}.{node.attr}" if before else ""


def paths(tree):
    """Yield all imports of a module, and all paths of attributes in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{each.name}" for each in node.names)
        elif isinstance(node, ast.Attribute):
            yield dotted(node)
        # Programs that tests run in a separate process.
        elif isinstance(node, ast.Constant) and "jax._src" in str(node.value):
            yield "jax._src"


def private_names(source):
    def is_private(path):
        inside = any(path == name or path.startswith(f"{name}.") for name in PRIVATE)
        hidden = path.startswith("jax.") and any(
            re.match("_[^_]", part) for part in path.split(".")
        )
        return inside or hidden

    return sorted({path for path in paths(ast.parse(source)) if is_private(path)})


def test_one_file_alone_uses_private_names():
    found = {}
    for folder in ("evo_cpg", "benchmarks", "tests"):
        for path in (ROOT / folder).rglob("*.py"):
            if names := private_names(path.read_text(encoding="utf-8")):
                found[str(path.relative_to(ROOT))] = names
    del found["tests/native/test_jax_names.py"]
    assert list(found) == ["evo_cpg/native/jax_internals.py"], found
    (names,) = found.values()
    # Each way to write a private name is found in this file.
    assert {"jax.core", "jax.core.Tracer", "jax.interpreters.ad", "jax._src.core.ShapedArray"} <= {
        *names
    }
