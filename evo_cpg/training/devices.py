"""CPU cores as JAX devices, the population in chunks on them, and the disk cache of programs.

Each core becomes a device, the population is sharded over the devices, and XLA keeps to one thread
per device. These settings are process-wide. So the program (the command line, a benchmark) makes
them, never the import of the package.

A device computes a *chunk* of the population at a time, for a whole trial. The chunks of all
devices are a *block*. The host feeds one block after the other to a program that is compiled for
one block. So compile time and memory of the physics do not depend on the number of individuals.
If individuals have several trials, each trial counts as an individual here.

Every later command that needs an already compiled program loads it from the cache: `train` with
another seed, `resume`, `render` or `verify`. JAX keeps XLA's programs under a key of program,
options and version. Native code is kept next to them (`evo_cpg.native.backend.machine`). Machine
code for one processor may not run on another. A cluster may share the home folder, so each kind of
processor has a folder of its own. `JAX_COMPILATION_CACHE_DIR` names another folder.
`JAX_ENABLE_COMPILATION_CACHE=false` switches the cache off.
"""

import contextlib
import functools
import hashlib
import os
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Int

from evo_cpg.native import machine_constants
from evo_cpg.native.backend.machine import keep_code_in
from evo_cpg.native.machine_constants import LANES
from evo_cpg.system import described_by, home_folder, is_writable

Tree = TypeVar("Tree")

# Name of the mesh axis of the population.
POPULATION_AXIS = "population"


def available_cores() -> int:
    """Return the number of cores that this process may run on."""
    # Windows and macOS lack `sched_getaffinity`, and a sandbox may refuse the call.
    with contextlib.suppress(AttributeError, OSError):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def use_cores(count: int | None = None) -> int:
    """Make every core a JAX device, and keep compiled programs.

    After JAX has run something, the devices can no longer change.

    Args:
        count: number of cores to use, or None for all that this process may run on.

    Returns:
        The number of devices.
    """
    count = count or available_cores()
    # Size of the thread pool of each device, read when the CPU backend starts.
    os.environ["NPROC"] = "1"
    try:
        jax.config.update("jax_num_cpu_devices", count)
    except RuntimeError:
        return jax.local_device_count()
    keep_compiled_programs()
    return count


def population_mesh(count: int | None = None) -> Mesh:
    """Return the mesh of the first devices, or of all, over which the population is sharded."""
    devices = jax.local_devices()[:count]
    return Mesh(np.array(devices), (POPULATION_AXIS,))


class Layout(NamedTuple):
    """Layout of a population: the devices, and the width of the chunks that they compute in turn.

    Attributes:
        mesh: devices that are used.
        width: number of individuals in a chunk.
    """

    mesh: Mesh
    width: int

    @property
    def block(self) -> int:
        """Number of individuals that all devices together compute at a time."""
        return self.mesh.size * self.width


def layout(count: int, mesh: Mesh) -> Layout:
    """Return the layout of a population.

    Args:
        count: number of individuals.
        mesh: the devices. Each used device gets at least one vector of `LANES` individuals,
            because half a vector takes as long as a full vector. The other devices stay idle. A
            single individual needs no vector.
    """
    busy = Mesh(mesh.devices[: -(-count // LANES)], mesh.axis_names)
    return Layout(busy, chunk_width(count, mesh.size))


def chunk_width(count: int, devices: int) -> int:
    """Return the number of individuals in a chunk. Chunks are full vectors, equally wide.

    A single individual is a chunk, because native code computes it without vectors. On devices
    other than CPUs, a chunk is the device's whole part of the population.

    Args:
        count: number of individuals on all devices.
        devices: number of devices. Counting idle devices does not change the result.
    """
    on_cpu = jax.default_backend() == "cpu"
    if on_cpu and count == 1:
        return 1
    vectors = -(-count // (devices * LANES))
    chunks = -(-vectors // machine_constants.WIDEST_CHUNK) if on_cpu else 1
    return LANES * -(-vectors // chunks)


def sharded(
    function: Callable[..., Tree], mesh: Mesh, ranks: tuple[Any, ...]
) -> jax.stages.Wrapped:
    """Return a function of one block for `run_in_blocks`, compiled at its first call.

    Devices never communicate. The results have the population on the first axis, because then
    arrays of all ranks are split alike.

    Args:
        function: function of one chunk. Arguments are arrays with the population on the last axis,
            numbers, or None. Results are arrays with the population on the last axis.
        mesh: the devices.
        ranks: number of axes of each argument, or of each of its arrays if they differ.
    """

    @functools.wraps(function)
    def of_chunk(*arguments: Any) -> Any:
        return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), function(*arguments))

    results = PartitionSpec(POPULATION_AXIS)
    given = jax.tree.map(_spec, ranks)
    return jax.jit(
        jax.shard_map(of_chunk, mesh=mesh, in_specs=given, out_specs=results, check_vma=False)
    )


def placed(block: Tree, mesh: Mesh) -> Tree:
    """Return the host arrays of a block on the devices, split on the population axis."""
    return jax.tree.map(lambda x: jax.device_put(x, NamedSharding(mesh, _spec(np.ndim(x)))), block)


def run_in_blocks(
    program: Callable[..., Tree],
    spread: Layout,
    count: int,
    pick: Callable[[Int[np.ndarray, " block"]], tuple],
) -> Tree:
    """Run a program on a population, one block after the other.

    Args:
        program: from `sharded`.
        spread: layout of the population.
        count: number of individuals. Copies of the last individual fill the rest of the last block.
        pick: function that returns the program's host arguments, given individuals' indices.

    Returns:
        Host arrays of all individuals, with the population on the last axis.
    """
    results: list = []
    for first in range(0, count, spread.block):
        numbers = np.minimum(np.arange(first, first + spread.block), count - 1)
        results.append(program(*placed(pick(numbers), spread.mesh)))
        # Only one block waits while another is computed, to limit memory.
        if len(results) > 1:
            jax.block_until_ready(results[-2])

    return jax.tree.map(
        lambda *parts: np.moveaxis(np.concatenate([*map(np.asarray, parts)])[:count], 0, -1),
        *results,
    )


def run_on(program: Callable[..., Tree], spread: Layout, given: tuple) -> Tree:
    """Run a program on host arrays, all of which have the population on the last axis."""
    count = jax.tree.leaves(given)[0].shape[-1]
    return run_in_blocks(
        program, spread, count, lambda own: jax.tree.map(lambda x: x[..., own], given)
    )


def _spec(rank: int) -> PartitionSpec:
    """Return the sharding: arrays are split on the last axis, numbers are copied to all devices."""
    return PartitionSpec(*(None,) * (rank - 1), POPULATION_AXIS) if rank else PartitionSpec()


# Largest size of the cache, bytes. The oldest programs are deleted. A program has 1 to 4 MB.
_MOST = 1 << 30

# Programs that compile faster are not kept, s.
_LEAST_SECONDS = 0.5


def keep_compiled_programs() -> Path | None:
    """Make JAX keep compiled programs. Call this before JAX runs anything.

    Returns:
        The folder, or None if none can be made, the cache is off, or the user has chosen one.
    """
    jax.config.update("jax_persistent_cache_min_compile_time_secs", _LEAST_SECONDS)
    if not jax.config.values["jax_enable_compilation_cache"]:
        return None
    chosen = jax.config.values["jax_compilation_cache_dir"]
    if chosen:
        keep_code_in(Path(chosen))
        return None
    home = home_folder()
    cache = os.environ.get("XDG_CACHE_HOME") or (home and home / ".cache")
    if not cache:
        return None
    # The folder's name is equal for compatible processors.
    kind = [platform.system(), platform.machine(), platform.processor()]
    lines = described_by(Path("/proc/cpuinfo")).splitlines()
    kind += sorted({line for line in lines if line.startswith(("flags", "Features", "model"))})
    processor = hashlib.sha256("\n".join(kind).encode()).hexdigest()[:16]
    folder = Path(cache) / "evo_cpg" / "compiled" / processor
    found, total = [], 0
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in folder.iterdir():
            # Another process may have renamed or deleted the file.
            with contextlib.suppress(FileNotFoundError):
                found.append((file, file.stat()))
        for file, status in sorted(found, key=lambda pair: pair[1].st_mtime, reverse=True):
            total += status.st_size
            if total > _MOST:
                file.unlink(missing_ok=True)
    except OSError:
        return None
    # In a read-only folder JAX would warn about each program.
    if not is_writable(folder):
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    keep_code_in(folder)
    return folder
