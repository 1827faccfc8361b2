"""Run the fast tests with other roundings: `make test-rounding`.

The verdict of a test must not depend on the last digits, because they differ between processors.
Each run changes one thing: masses and places by one unit in the last place, the number of cores, or
the instruction set (`tests/rounding.py`).
"""

import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]

CHANGES = ("nudged", "cores=1", "cores=2", "cores=4", "sse", "avx2", "avx512")


def main(arguments: list[str]) -> int:
    """Run the tests with every change, print a table, and return the number of failed runs.

    Args:
        arguments: arguments of pytest.
    """
    results = {}
    for change in CHANGES:
        if change == "avx512" and not _has_avx512():
            results[change] = "left out: this processor has no AVX-512"
            continue
        print(f"\n=== {change}", flush=True)
        start = time.monotonic()
        settings = os.environ | {"EVO_CPG_TESTS_ROUNDING": change}
        command = [sys.executable, "-m", "pytest", "-q", *arguments]
        code = subprocess.run(command, cwd=ROOT, env=settings, check=False).returncode
        verdict = "FAILED" if code else "passed"
        results[change] = f"{verdict} in {(time.monotonic() - start) / 60:.1f} min"
    print(*(f"{change:8} {result}" for change, result in results.items()), sep="\n")
    return sum(result.startswith("FAILED") for result in results.values())


def _has_avx512() -> bool:
    """Return whether native code can use AVX-512 here."""
    from evo_cpg.native.backend import machine
    from evo_cpg.native.ir import Unsupported

    try:
        return machine.host("avx512").name == "avx512"
    except Unsupported:
        return False


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
