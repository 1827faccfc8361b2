"""Other roundings for the same tests, one change at a time (`make test-rounding`).

`EVO_CPG_TESTS_ROUNDING` names the change. Threads and instruction sets act through the environment,
so `prepare` runs before the first import of JAX and NumPy. `nudge` runs before tests import the
package.
"""

import dataclasses
import functools
import os

CHANGE = os.environ.get("EVO_CPG_TESTS_ROUNDING", "")

# OpenBLAS' kernels and XLA's names of the instruction sets.
_SETS = {
    "sse": ("Nehalem", "SSE4_2"),
    "avx2": ("Haswell", "AVX2"),
    "avx512": ("SkylakeX", "AVX512"),
}


def prepare() -> list[str]:
    """Set the instruction set or the cores of the change, and return flags for XLA."""
    cores = CHANGE.partition("cores=")[2]
    flags = [f"--xla_force_host_platform_device_count={cores or 2}"]
    if cores:
        os.environ["OPENBLAS_NUM_THREADS"] = cores
    if CHANGE in _SETS:
        kernel, instructions = _SETS[CHANGE]
        os.environ["OPENBLAS_CORETYPE"] = kernel
        flags.append(f"--xla_cpu_max_isa={instructions}")
    return flags


def of_this_process_alone() -> bool:
    """Return whether processes that tests start do not have the change."""
    return CHANGE == "nudged" or CHANGE in _SETS


def nudge() -> None:
    """Apply the change to the package: its instruction set, or its masses and places."""
    if CHANGE in _SETS:
        from evo_cpg.native import engine

        engine._AUTO = engine.Engine(instructions=CHANGE)
    if CHANGE == "nudged":
        _nudge_masses_and_places()


def _nudge_masses_and_places() -> None:
    """Move masses and joints of all trees, and all starts, by one unit in the last place."""
    import jax
    import numpy as np

    from evo_cpg.creature import tree
    from evo_cpg.physics.tree import state

    built, resting = tree.build_tree, state.resting_state

    def nudged(numbers):
        known = isinstance(numbers, np.ndarray) and numbers.dtype == np.float64
        return numbers * (1 + np.finfo(np.float64).eps) if known else numbers

    @functools.wraps(built)
    def build_tree(*given, **options):
        found = built(*given, **options)
        fields = {name: nudged(getattr(found, name)) for name in ("mass", "joint_offset", "com")}
        return dataclasses.replace(found, **fields)

    @functools.wraps(resting)
    def resting_state(*given, **options):
        found = resting(*given, **options)
        if found.base is not None:
            return found
        unit = np.finfo(found.position.dtype).eps * jax.lax.stop_gradient(found.position)
        return dataclasses.replace(found, position=found.position + unit)

    tree.build_tree, state.resting_state = build_tree, resting_state
