"""Verification of every native program of a test after each pass."""

import pytest


@pytest.fixture(autouse=True, scope="session")
def verified():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EVO_CPG_VERIFY_PASSES", "1")
        yield
