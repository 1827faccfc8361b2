"""The command that measures: bench. The suite itself lies in the checkout's benchmarks/."""

import importlib
import sys
from pathlib import Path

import evo_cpg
from evo_cpg.cli.errors import UsageError


def run_suite(json: Path | None, quick: bool) -> None:
    """`evo-cpg bench`."""
    checkout = Path(evo_cpg.__file__).parents[1]
    if not (checkout / "benchmarks" / "suite.py").is_file():
        raise UsageError(
            f"the benchmark suite is part of a checkout of evo_cpg; there is none in {checkout}"
        )
    if json is not None:
        # Measuring takes minutes; a path that cannot be written is better known before.
        try:
            json.parent.mkdir(parents=True, exist_ok=True)
            json.touch()
        except OSError as error:
            raise UsageError(f"--json: {json} cannot be written ({error.strerror})") from None
    sys.path.insert(0, str(checkout))
    try:
        suite = importlib.import_module("benchmarks.suite")
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the benchmark suite needs {error.name}; install it with pip install 'evo-cpg[test]'"
        ) from None
    suite.main(json, quick)
