"""Every program that a test makes native is verified after each pass."""

import pytest

from evo_cpg.fusion import compile
from evo_cpg.fusion.ir.verify import verify


@pytest.fixture(autouse=True, scope="session")
def verified():
    passes = [each for one in compile.PASSES for each in (verify, one)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compile, "PASSES", (*passes, verify))
        yield
