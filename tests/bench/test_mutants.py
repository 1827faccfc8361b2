"""Every mutant of `make test-mutants` still fits the code."""

import ast
from pathlib import Path

import pytest

from benchmarks.mutants import MUTANTS, ROOT, Mutant, mutated


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda one: f"{one.file}: {one.right.strip()}")
def test_a_mutant_applies_and_its_tests_exist(mutant):
    text = (ROOT / "evo_cpg" / mutant.file).read_text()
    changed = mutated(mutant, text)
    assert changed != text
    compile(changed, mutant.file, "exec")
    files = [(ROOT / "tests" / name).read_text() for name in mutant.tests.split()]
    # `make test-mutants` runs only the fast tests.
    assert any(has_fast_test(text) for text in files)


def has_fast_test(text: str) -> bool:
    """Return whether a file of tests has a test without the mark of the slow ones."""
    return any(
        isinstance(node, ast.FunctionDef)
        and node.name.startswith("test_")
        and "pytest.mark.slow" not in map(ast.unparse, node.decorator_list)
        for node in ast.parse(text).body
    )


def test_a_mutant_of_missing_code_is_refused():
    gone = Mutant("physics/step/step.py", "right", "wrong", "physics/test_water.py")
    words = r"physics/step/step.py contains 'right' 0 times, not once. Correct the mutant"
    with pytest.raises(ValueError, match=words):
        mutated(gone, "")


def test_every_layer_with_mathematics_has_mutants():
    layers = {Path(mutant.file).parts[0] for mutant in MUTANTS}
    expected = "analysis creature physics control evolution simulation native view"
    assert layers == set(expected.split())
    assert len(MUTANTS) >= 60
