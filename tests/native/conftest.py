"""Verification of every native program of a test after each pass, and its code."""

import pytest

from evo_cpg.native import native


@pytest.fixture(autouse=True, scope="session")
def verified():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EVO_CPG_VERIFY_PASSES", "1")
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
