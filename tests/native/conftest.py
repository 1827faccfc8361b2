"""Verification of every native program of a test after each pass, and its code."""

import pytest

from benchmarks.graphs import verifying
from evo_cpg.native import compile, native


@pytest.fixture(autouse=True, scope="session")
def verified():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compile, "stages", verifying(compile.stages))
        # Code that is known by its program would not be verified.
        patch.setattr(native, "note_of", lambda *_: None)
        yield


@pytest.fixture
def texts(monkeypatch):
    """Collect the code of all compiled programs."""
    found, load = [], native.load

    def note(text, target):
        found.append(text)
        return load(text, target)

    monkeypatch.setattr(native, "load", note)
    return found
