"""Flags with which XLA compiles quickly: most programs of a test run for a moment."""

import os
from importlib.metadata import version


def quick() -> list[str]:
    """Little optimisation, unless EVO_CPG_TESTS_OPTIMISED asks for as much as users have (3)."""
    level = os.environ.get("EVO_CPG_TESTS_OPTIMISED", "0")
    flags = [f"--xla_backend_optimization_level={level}"]
    # Half the time to compile. Later releases have but the one way, and refuse unknown flags.
    if level == "0" and version("jaxlib").startswith("0.10."):
        flags.append("--xla_cpu_use_fusion_emitters=false")
    return flags
