"""Shipped configurations as parameters of tests that hold for each of them."""

from pathlib import Path

import pytest

CONFIGS = Path(__file__).parents[1] / "configs"
PATHS = sorted(CONFIGS.glob("*.yaml"))

# The fast tests take every fourth configuration. All of them are built in `tests/io/test_load.py`.
some_configs = pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * (number % 4 > 0))
        for number, path in enumerate(PATHS)
    ],
)
