"""Stable-Baselines3 accepts our environments and learns, as the page shows.

It stands outside of the extras, because PyTorch takes gigabytes.
"""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "gymnasium.md"


@pytest.mark.slow
def test_documented_program_learns_to_run():
    pytest.importorskip("stable_baselines3")
    block = re.search(r"```python\n(import evo_cpg as evo.+?)```", PAGE.read_text(), re.S)
    assert block
    names: dict = {}
    exec(block[1].replace("300_000", "100_000"), names)
    # Untrained policies stay within 0.1 m, and three seeds learned 27 to 40 m.
    assert names["distance"] > 10


@pytest.mark.slow
def test_environment_passes_the_check_of_the_library():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    from evo_cpg.gymnasium import AnimalEnv

    checker.check_env(AnimalEnv("half_cheetah", {"simulation.seconds": 1}))
