"""What every test runs under: two host devices, broadcasting strict, shapes checked on request."""

import contextlib
import ctypes
import gc
import os
import sys
import tempfile
from pathlib import Path

import xla_flags

# JAX reads these when it starts, so they are set before anything imports it. One thread a
# device: pytest-xdist keeps the cores busy already. XLA optimises little, for most programs run
# for a moment and compile for seconds; `make test-slow` has them compiled as users do.
os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["NPROC"] = "1"
# Most tests write configurations of their own that name the repository's creatures.
os.environ["EVO_CPG_TRUST"] = "1"
os.environ["XLA_FLAGS"] = " ".join(("--xla_force_host_platform_device_count=2", *xla_flags.quick()))

import hypothesis
import jax
import jaxtyping
import pytest

# `make test-shapes`: it takes a tenth longer. All layers but two: `fusion` handles scalars, half a
# million calls of it in a single gradient, and no shapes; what commands get, Typer makes.
if os.environ.get("EVO_CPG_TESTS_SHAPES"):
    _PACKAGE = Path(__file__).parents[1] / "evo_cpg"
    _CHECKED = [f"evo_cpg.{path.parent.name}" for path in _PACKAGE.glob("*/__init__.py")]
    _CHECKED = sorted(set(_CHECKED) - {"evo_cpg.fusion", "evo_cpg.cli"})
    jaxtyping.install_import_hook(_CHECKED, "runtime_checks.typechecker")

from costs import Costs
from evo_cpg.fusion import engine
from evo_cpg.fusion.backend.machine import keep_code_in

# Two functions that come to the same program are compiled once: an experiment that several tests
# build, a run that is started and resumed. Each process has a folder of its own, for the duration.
_COMPILED = tempfile.TemporaryDirectory(prefix="evo_cpg_compiled_")
jax.config.update("jax_compilation_cache_dir", _COMPILED.name)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
keep_code_in(Path(_COMPILED.name))

# JAX and the traced programs keep millions of objects, hardly ever in a cycle. Collecting the tests
# makes another million, of which none is garbage: it takes a third longer with Python's thresholds.
gc.set_threshold(50_000, 20, 20)

# (3,) against (3, n) must not broadcast by accident: `expand_dims_like` says which axis is meant.
jax.config.update("jax_numpy_rank_promotion", "raise")

# The same examples in every run. No deadline: the first example pays for the compiling.
hypothesis.settings.register_profile(
    "evo_cpg", deadline=None, derandomize=True, max_examples=25, print_blob=True
)
hypothesis.settings.load_profile("evo_cpg")


def pytest_addoption(parser):
    """`make test-jax` computes everything on plain JAX; what each test costs goes to a file."""
    parser.addoption("--engine", choices=("auto", "jax"), default="auto")
    parser.addoption(
        "--compilations", metavar="FILE", help="write each test's costs there, a line of JSON each"
    )


def pytest_configure(config):
    """Without native code, whatever a test's config says; costs are always counted."""
    config.pluginmanager.register(Costs(config), "costs")
    if config.getoption("--engine") == "jax":
        engine.is_native = lambda: False


def pytest_collection_finish(session):
    """Keep the garbage collector from what was imported and collected, which stays."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item, nextitem):
    """Drop compiled programs between files where memory is short; later files compile anew."""
    result = yield
    if (nextitem is None or nextitem.path != item.path) and is_short_of_memory():
        jax.clear_caches()
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)  # glibc's
    return result


def is_short_of_memory() -> bool:
    """Return whether this process has an eighth of the machine's memory, and more than 1.2 GiB.

    The session has two processes like this one, and they start others.
    """
    if sys.platform != "linux":
        return False
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    most = max(1.2 * 2**30 / os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_PHYS_PAGES") / 8)
    return pages > most


@pytest.fixture
def x64():
    """Compute in float64 inside one test."""
    with jax.enable_x64(True):
        yield
