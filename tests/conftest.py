"""Settings of all tests: two host devices, strict broadcasting, shape checks on request."""

import contextlib
import ctypes
import gc
import os
import sys
import tempfile
from pathlib import Path

import rounding
import xla_flags

# JAX reads these at its start, so they are set before any import of JAX. Each device has one
# thread, because pytest-xdist already keeps the cores busy. XLA optimises little, because most
# programs compile for seconds and run for a moment. `make test-slow` compiles as for users.
os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["NPROC"] = "1"
# Most tests write their own configurations with the repository's creatures.
os.environ["EVO_CPG_TRUST"] = "1"
os.environ["XLA_FLAGS"] = " ".join((*rounding.prepare(), *xla_flags.quick()))

import hypothesis
import jax
import jaxtyping
import pytest

# `make test-shapes` takes a tenth longer. It checks all layers but two. `fusion` handles scalars
# without shapes, in half a million calls for one gradient. Typer makes the arguments of `cli`.
if os.environ.get("EVO_CPG_TESTS_SHAPES"):
    # What the checker imports is not checked: checking it would need the checker.
    import runtime_checks  # noqa: F401

    _PACKAGE = Path(__file__).parents[1] / "evo_cpg"
    _CHECKED = [f"evo_cpg.{path.parent.name}" for path in _PACKAGE.glob("*/__init__.py")]
    _CHECKED = sorted(set(_CHECKED) - {"evo_cpg.native", "evo_cpg.cli"})
    jaxtyping.install_import_hook(_CHECKED, "runtime_checks.typechecker")

from costs import Costs
from evo_cpg.native import engine
from evo_cpg.native.backend.machine import keep_code_in
from first_cases import mark_others

# Tests import the rest of the package later.
rounding.nudge()

# Equal programs are compiled once by all processes of a session, such as an experiment in several
# tests, or a run that is started and resumed. The first process makes the folder for the others.
if "EVO_CPG_TESTS_COMPILED" not in os.environ:
    _COMPILED = tempfile.TemporaryDirectory(prefix="evo_cpg_compiled_")
    os.environ["EVO_CPG_TESTS_COMPILED"] = _COMPILED.name
jax.config.update("jax_compilation_cache_dir", os.environ["EVO_CPG_TESTS_COMPILED"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
keep_code_in(Path(os.environ["EVO_CPG_TESTS_COMPILED"]))

# JAX and the traced programs keep millions of objects, with hardly any cycles. Collecting the tests
# makes another million without garbage, and takes a third longer with Python's thresholds.
gc.set_threshold(50_000, 20, 20)

# (3,) must not broadcast against (3, n) by accident. `expand_dims_like` names the axis.
jax.config.update("jax_numpy_rank_promotion", "raise")

# Every run has the same examples. There is no deadline, because the first example compiles.
hypothesis.settings.register_profile(
    "evo_cpg", deadline=None, derandomize=True, max_examples=25, print_blob=True
)
hypothesis.settings.load_profile("evo_cpg")


def pytest_addoption(parser):
    """Add the options for `make test-jax` (plain JAX) and for a file of each test's costs."""
    parser.addoption("--engine", choices=("auto", "jax"), default="auto")
    parser.addoption(
        "--compilations", metavar="FILE", help="write the costs of each test as a line of JSON"
    )


def pytest_configure(config):
    """Count the costs, and switch off native code for `--engine jax`."""
    config.pluginmanager.register(Costs(config), "costs")
    if config.getoption("--engine") == "jax":
        engine.is_native = lambda: False


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Leave later cases of dear tests to the slow tests.

    Skip tests of runs from other processes, which `rounding` does not change.
    """
    mark_others(items)
    if rounding.of_this_process_alone():
        skip = pytest.mark.skip(reason="compares with a process that rounds as usual")
        exact = "test_resume.py", "test_verify.py"
        for item in items:
            if item.path.name in exact and "finished_run" in item.fixturenames:
                item.add_marker(skip)


def pytest_collection_finish(session):
    """Exclude imported and collected objects, which stay, from garbage collection."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item, nextitem):
    """Drop compiled programs after a file if memory is short. Later files compile again."""
    result = yield
    if (nextitem is None or nextitem.path != item.path) and is_short_of_memory():
        jax.clear_caches()
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)  # glibc's
    return result


def is_short_of_memory() -> bool:
    """Return whether this process has an eighth of the machine's memory, and more than 1.2 GiB.

    The session has two such processes, and they start others.
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
