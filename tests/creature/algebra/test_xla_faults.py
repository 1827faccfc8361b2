"""Known faults of XLA do not occur after an import of the package."""

import os
import subprocess
import sys

import pytest

PRODUCTS = """
import jax, jax.numpy as jnp, numpy as np
import evo_cpg
from evo_cpg.creature.algebra.linear import matmul

a, b = np.random.default_rng(0).normal(size=(2, 3, 3, 4, 3000)).astype(np.float32)
wrong = np.abs(jax.jit(matmul)(a, b) - np.einsum("ij...,jk...->ik...", a, b)).max()
assert wrong < 1e-5, wrong
"""


@pytest.mark.slow
@pytest.mark.parametrize("flags", [None, "--xla_cpu_enable_fast_math=false"])
def test_thousands_of_products_of_matrices_are_right(flags):
    """Run in a separate process, with the optimisation that users have."""
    environment = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"}
    if flags is not None:
        environment["XLA_FLAGS"] = flags
    done = subprocess.run(
        [sys.executable, "-c", PRODUCTS], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
