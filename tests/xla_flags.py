"""Flags with which XLA compiles quickly: most programs of a test run for a moment."""

import os
from importlib.metadata import version


def quick() -> list[str]:
    """Little optimisation, unless EVO_CPG_TESTS_OPTIMISED asks for as much as users have (3)."""
    level = os.environ.get("EVO_CPG_TESTS_OPTIMISED", "0")
    flags = [f"--xla_backend_optimization_level={level}"]
    # The first halves the time to compile, the second takes a tenth off it. Later releases may
    # refuse flags that they do not know.
    if level == "0" and version("jaxlib").startswith("0.10."):
        flags.append("--xla_cpu_use_fusion_emitters=false")
        flags.append("--xla_cpu_parallel_codegen_split_count=1")
    return flags
