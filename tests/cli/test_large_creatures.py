"""Walkers with many legs train in native code, with an empty cache and a usual stack."""

import os
import subprocess
import sys

import pytest

from benchmarks.large_bodies import walker
from evo_cpg.io.yaml_text import to_yaml
from tiny_run import REPOSITORY

# Default size of a program's stack on Linux, KiB.
STACK = 8192
# Variables that the test session sets.
OWN = ("JAX_COMPILATION_CACHE_DIR", "JAX_ENABLE_COMPILATION_CACHE", "NPROC", "XLA_FLAGS")


@pytest.mark.slow
@pytest.mark.parametrize("legs", [6, 8, 10])
def test_walker_with_many_legs_trains_as_native_code(legs, tmp_path):
    config, cache, run = tmp_path / "walker.yaml", tmp_path / "cache", tmp_path / "run"
    config.write_text(to_yaml(walker(legs, "capsule")))
    command = [sys.executable, "-m", "evo_cpg", "train", config, "--out", run]
    found = subprocess.run(
        ["sh", "-c", f'ulimit -S -s {STACK} && exec "$@"', "sh", *map(str, command)],
        env={key: value for key, value in os.environ.items() if key not in OWN}
        | {"PYTHONPATH": str(REPOSITORY), "XDG_CACHE_HOME": str(cache)},
        capture_output=True,
        text=True,
    )
    assert found.returncode == 0, found.stderr
    assert "plain JAX" not in found.stderr
    assert len((run / "metrics.csv").read_text().splitlines()) == 3
    kept = {path.name for path in cache.rglob("native-*")}
    assert any(not name.startswith("native-tried-") for name in kept)
