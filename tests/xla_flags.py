"""Flags for quick compilation by XLA, because most programs of a test run for a moment."""

import os
from importlib.metadata import version


def quick() -> list[str]:
    """Return flags for little optimisation, unless EVO_CPG_TESTS_OPTIMISED sets the users' (3)."""
    level = os.environ.get("EVO_CPG_TESTS_OPTIMISED", "0")
    flags = [f"--xla_backend_optimization_level={level}"]
    # The first flag halves the compilation time, and the second reduces it by a tenth. Later
    # releases may reject unknown flags.
    if level == "0" and version("jaxlib").startswith("0.10."):
        flags.append("--xla_cpu_use_fusion_emitters=false")
        flags.append("--xla_cpu_parallel_codegen_split_count=1")
    return flags
