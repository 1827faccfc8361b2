"""Double precision in every test of the physics, because the oracles are better than float32."""

import jax
import pytest


@pytest.fixture(autouse=True)
def double_precision():
    """Run every test of the physics in float64, except for arrays that it makes in float32."""
    with jax.enable_x64(True):
        yield
