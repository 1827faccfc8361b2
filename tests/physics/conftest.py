"""Double precision in every test of the physics: the oracles are better than float32."""

import jax
import pytest


@pytest.fixture(autouse=True)
def double_precision():
    """Every test of the physics runs in float64 unless it makes float32 arrays itself."""
    with jax.enable_x64(True):
        yield
