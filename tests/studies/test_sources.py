"""Digests of the code that made a result."""

import importlib

import pytest

from evo_cpg.studies.sources import changed, digest, loaded, older, packed, unpacked

CODE = '''
"""Module."""
import math  # for pi

def area(radius: float) -> float:
    """Return an area."""
    return math.pi * radius**2
'''


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""Module."""', '"""Another text."""'),
        ("# for pi", ""),
        ('    """Return an area."""\n', ""),
        ("math.pi * radius**2", "(math.pi\n        * radius ** 2)"),
    ],
)
def test_words_and_layout_leave_the_digest(old, new):
    assert old in CODE
    assert digest(CODE.replace(old, new)) == digest(CODE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("radius**2", "radius**3"),
        ("math.pi * radius", "radius * math.pi"),
        ("area(", "volume("),
        ("float:", "int:"),
    ],
)
def test_any_change_of_the_code_changes_the_digest(old, new):
    assert old in CODE
    assert digest(CODE.replace(old, new)) != digest(CODE)


def test_the_digest_is_the_same_in_all_versions_of_python():
    # Recorded with 3.11. Type parameters and lists that are empty came with later versions.
    assert digest(CODE) == "5db7c51cf6"
    assert digest("f'{1!r:>{2}} {3}'\nclass A(B): pass\n") == "518f43e96a"


def test_code_that_computes_counts_and_code_that_draws_does_not():
    for name in ("evo_cpg.physics.step", "evo_cpg.view.skin"):
        importlib.import_module(name)
    names = loaded()
    assert "evo_cpg.physics.step" in names
    assert not any(name.startswith(("evo_cpg.view", "evo_cpg.cli")) for name in names)


def test_changed_and_missing_modules_are_named():
    now = loaded()
    assert changed(now) == []
    name = "evo_cpg.studies.sources"
    other = "0000000000"
    assert set(changed(now | {name: other, "evo_cpg.gone": other})) == {name, "evo_cpg.gone"}


def test_sources_return_from_their_short_form():
    now = loaded()
    assert unpacked(packed(now)) == now
    assert len(packed(now)) < len(now) / 4


def test_the_first_digest_of_a_module_stays():
    assert older({"a": "1"}, {"a": "2", "b": "3"}) == {"a": "1", "b": "3"}
    assert older({}, {"a": "2"}) == {"a": "2"}
