"""The command that measures: bench. The suite itself lies in the checkout's benchmarks/."""

import importlib.util
from pathlib import Path

import evo_cpg
from evo_cpg.cli.errors import UsageError


def run_suite(json: Path | None, quick: bool) -> None:
    """`evo-cpg bench`."""
    suite = Path(evo_cpg.__file__).parents[1] / "benchmarks" / "suite.py"
    if not suite.is_file():
        raise UsageError(f"the benchmark suite is part of a checkout; there is none at {suite}")
    spec = importlib.util.spec_from_file_location("suite", suite)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(json, quick)
