"""Digests of the code that made a result."""

import importlib

import pytest

from evo_cpg.studies.sources import changed, digest, loaded, older, packed, unpacked

CODE = '''
"""Module."""
import math  # for pi

class Circle:
    centre: Float[Array, "3"] | None

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
        ("radius: float", "radius: int"),
        (" -> float", ""),
        ('[Array, "3"]', '[Array, "2"]'),
    ],
)
def test_words_layout_and_annotations_leave_the_digest(old, new):
    assert old in CODE
    assert digest(CODE.replace(old, new)) == digest(CODE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("radius**2", "radius**3"),
        ("math.pi * radius", "radius * math.pi"),
        ("area(", "volume("),
        ("radius:", "diameter:"),
        ("Float[", "Int["),
    ],
)
def test_any_change_of_the_code_changes_the_digest(old, new):
    assert old in CODE
    assert digest(CODE.replace(old, new)) != digest(CODE)


def test_the_digest_is_the_same_in_all_versions_of_python():
    # Recorded with 3.11. Type parameters and lists that are empty came with later versions.
    assert digest(CODE) == "e06c7362a1"
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
    name = "evo_cpg.studies.study"
    importlib.import_module(name)
    other = "0000000000"
    gone = "evo_cpg.physics.gone"
    assert set(changed(now | {name: other, gone: other})) == {name, gone}


def test_sources_return_from_their_short_form():
    now = loaded()
    assert unpacked(packed(now)) == now
    assert len(packed(now)) < len(now) / 4


def test_a_digest_that_differs_from_the_present_code_stays():
    now = loaded()
    name = next(iter(now))
    stale = {name: "0000000000"}
    for joined in (older(stale, now), older(now, stale), older(older(now, stale), now)):
        assert joined == now | stale
        assert changed(joined) == [name]
    assert older({}, now) == now


def test_modules_that_only_keep_records_do_not_count():
    assert "evo_cpg.studies.sources" not in loaded()
    assert changed({"evo_cpg.studies.sources": "0000000000"}) == []
