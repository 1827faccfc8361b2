"""What every test runs under: two host devices, shapes checked, broadcasting strict."""

import os
import tempfile
from pathlib import Path

import xla_flags

# JAX reads these when it starts, so they are set before anything imports it. One thread a
# device: pytest-xdist keeps the cores busy already. XLA optimises little, for most programs run
# for a moment and compile for seconds; `make test-slow` has them compiled as users do.
os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["NPROC"] = "1"
os.environ["XLA_FLAGS"] = " ".join(("--xla_force_host_platform_device_count=2", *xla_flags.quick()))

import hypothesis
import jax
import jaxtyping
import pytest

# All layers but one: `fusion` handles scalars, half a million calls of it in a single gradient, and
# no shapes.
_PACKAGE = Path(__file__).parents[1] / "evo_cpg"
_CHECKED = [f"evo_cpg.{path.parent.name}" for path in _PACKAGE.glob("*/__init__.py")]
_CHECKED.remove("evo_cpg.fusion")
jaxtyping.install_import_hook(_CHECKED, "runtime_checks.typechecker")

from evo_cpg.fusion import engine  # noqa: E402
from evo_cpg.fusion.machine import keep_code_in  # noqa: E402

# Two functions that come to the same program are compiled once: an experiment that several tests
# build, a run that is started and resumed. Each process has a folder of its own, for the duration.
_COMPILED = tempfile.TemporaryDirectory(prefix="evo_cpg_compiled_")
jax.config.update("jax_compilation_cache_dir", _COMPILED.name)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
keep_code_in(Path(_COMPILED.name))

# (3,) against (3, n) must not broadcast by accident: `expand_dims_like` says which axis is meant.
jax.config.update("jax_numpy_rank_promotion", "raise")

# The same examples in every run. No deadline: the first example pays for the compiling.
hypothesis.settings.register_profile(
    "evo_cpg", deadline=None, derandomize=True, max_examples=25, print_blob=True
)
hypothesis.settings.load_profile("evo_cpg")


def pytest_addoption(parser):
    """`make test-jax` computes everything on plain JAX."""
    parser.addoption("--engine", choices=("auto", "jax"), default="auto")


def pytest_configure(config):
    """Without native code, whatever a test's config says."""
    if config.getoption("--engine") == "jax":
        engine.is_native = lambda: False


@pytest.fixture
def x64():
    """Compute in float64 inside one test."""
    with jax.enable_x64(True):
        yield
