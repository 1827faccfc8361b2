"""Cores as devices, and the compiler options that make the physics fast on them.

XLA's own threading slows this program down: its many small kernels are handed between threads at
a cost above their own (0.28 M instead of 0.41 M steps/s on one core). So each core becomes a
device of its own, the population is sharded over them, and XLA keeps to one thread per device.
These are process-wide settings, which is why they are made by the program (the command line, a
benchmark) and never by importing the package.
"""

import functools
import os
import warnings
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from evo_cpg.training.compile_cache import keep_compiled_programs

# Lets XLA:CPU compile small reductions and products itself instead of handing them to a library
# that is several times slower at this size; and uses the widest vectors that the processor has.
COMPILER_OPTIONS = {
    "xla_cpu_experimental_ynn_fusion_type": "",
    "xla_cpu_prefer_vector_width": 512,
}

# The name of the mesh axis that carries the population.
POPULATION_AXIS = "population"

# Individuals per device are rounded up to this many, so that no vector loop ends in a slow,
# scalar remainder. 16 float32 values fill an AVX-512 register.
LANES = 16


def use_cores(count: int | None = None) -> int:
    """Make every core a JAX device, and keep what is compiled. Call it before JAX runs anything.

    Args:
        count: cores to use; None for all that this process may run on.

    Returns:
        The number of devices there will be.
    """
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    count = count or available or 1
    # Read when the CPU backend starts: the size of the thread pool behind each device.
    os.environ["NPROC"] = "1"
    jax.config.update("jax_num_cpu_devices", count)
    keep_compiled_programs()
    return count


def population_mesh(count: int | None = None) -> Mesh:
    """The devices over which the population is sharded.

    Args:
        count: how many; None for all.
    """
    devices = jax.devices()[:count]
    return Mesh(np.array(devices), (POPULATION_AXIS,))


def fast_jit(function: Callable, **options) -> Callable:
    """`jax.jit` with this program's compiler options, or without them where JAX lacks them."""
    return jax.jit(function, compiler_options=_supported_options(), **options)


@functools.cache
def _supported_options() -> dict[str, str | int] | None:
    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(jnp.negative, compiler_options=COMPILER_OPTIONS).lower(1.0).compile()
    except Exception as error:
        if "No such compile option" not in str(error):
            raise
        warnings.warn(
            f"this version of JAX ({jax.__version__}) does not know {list(COMPILER_OPTIONS)}; "
            "training works but is several times slower",
            stacklevel=3,
        )
        return None
    return COMPILER_OPTIONS
