"""Cores as devices, and the population in chunks on them.

Each core becomes a device of its own, the population is sharded over them, and XLA keeps to one
thread per device. These are process-wide settings, which is why they are made by the program (the
command line, a benchmark) and never by importing the package.

A device computes a *chunk* of the population at a time, for as long as a trial lasts. The chunks of
all devices are a *block*. The host feeds one block after the other to a program that knows one
block only, so neither the time to compile nor the memory of the physics depends on how many
individuals there are.
"""

import contextlib
import os
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Int

from evo_cpg.fusion import machine_constants
from evo_cpg.fusion.machine_constants import LANES
from evo_cpg.training.compile_cache import keep_compiled_programs

Tree = TypeVar("Tree")

# The name of the mesh axis that carries the population.
POPULATION_AXIS = "population"


def available_cores() -> int:
    """How many cores this process may run on."""
    # Windows and macOS have no such list, and a sandbox may not tell it.
    with contextlib.suppress(AttributeError, OSError):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def use_cores(count: int | None = None) -> int:
    """Make every core a JAX device, and keep what is compiled.

    Once JAX has run something it is too late, and the devices stay as they are.

    Args:
        count: cores to use; None for all that this process may run on.

    Returns:
        The number of devices that there are, or will be.
    """
    count = count or available_cores()
    # Read when the CPU backend starts: the size of the thread pool behind each device.
    os.environ["NPROC"] = "1"
    try:
        jax.config.update("jax_num_cpu_devices", count)
    except RuntimeError:
        return jax.local_device_count()
    keep_compiled_programs()
    return count


def population_mesh(count: int | None = None) -> Mesh:
    """The devices over which the population is sharded.

    Args:
        count: how many; None for all of this process.
    """
    devices = jax.local_devices()[:count]
    return Mesh(np.array(devices), (POPULATION_AXIS,))


class Layout(NamedTuple):
    """How a population is spread over devices and time.

    Attributes:
        mesh: the devices that are busy.
        width: individuals in the chunk of each.
    """

    mesh: Mesh
    width: int

    @property
    def block(self) -> int:
        """Individuals that all devices compute at a time."""
        return self.mesh.size * self.width


def layout(count: int, mesh: Mesh) -> Layout:
    """The layout of a population.

    Args:
        count: individuals.
        mesh: the devices. Of more than there are vectors the others stay idle: half a vector takes
            as long as a full one.
    """
    busy = Mesh(mesh.devices[: -(-count // LANES)], mesh.axis_names)
    return Layout(busy, chunk_width(count, mesh.size))


def chunk_width(count: int, devices: int) -> int:
    """How many individuals a device computes at a time: chunks of full vectors, equally wide.

    On other devices than CPUs a chunk is all of a device's share.

    Args:
        count: individuals, on all devices.
        devices: that share them; those that stay idle make no difference.
    """
    vectors = -(-count // (devices * LANES))
    chunks = -(-vectors // machine_constants.WIDEST_CHUNK) if jax.default_backend() == "cpu" else 1
    return LANES * -(-vectors // chunks)


def sharded(
    function: Callable[..., Tree], mesh: Mesh, ranks: tuple[Any, ...], result_rank: int
) -> jax.stages.Wrapped:
    """A function of one block, compiled at its first call; the devices never talk to each other.

    Args:
        function: of one chunk: of arrays with the population on the last axis, of numbers, and of
            None; gives arrays with the population on the last axis.
        mesh: the devices.
        ranks: number of axes of each argument; where its arrays differ in that, of each of them.
        result_rank: number of axes of each array that it gives.
    """
    return jax.jit(
        jax.shard_map(
            function,
            mesh=mesh,
            in_specs=jax.tree.map(_spec, ranks),
            out_specs=_spec(result_rank),
            check_vma=False,
        )
    )


def run_in_blocks(
    program: Callable[..., Tree],
    spread: Layout,
    count: int,
    pick: Callable[[Int[np.ndarray, " block"]], tuple],
) -> Tree:
    """What a program makes of a population, one block after the other.

    Args:
        program: from `sharded`.
        spread: layout of the population.
        count: individuals; places of the last block beyond them repeat the last individual.
        pick: the program's arguments, on the host, for the individuals with these numbers.

    Returns:
        Host arrays of all individuals.
    """

    def placed(x: np.ndarray) -> jax.Array:
        return jax.device_put(x, NamedSharding(spread.mesh, _spec(x.ndim)))

    results: list = []
    for first in range(0, count, spread.block):
        numbers = np.minimum(np.arange(first, first + spread.block), count - 1)
        results.append(program(*jax.tree.map(placed, pick(numbers))))
        # While one block is computed the next one waits, and no more: each takes memory.
        if len(results) > 1:
            jax.block_until_ready(results[-2])

    def join(*parts: jax.Array) -> np.ndarray:
        return np.concatenate([np.asarray(part) for part in parts], axis=-1)[..., :count]

    return jax.tree.map(join, *results)


def _spec(rank: int) -> PartitionSpec:
    """The last axis of an array is the population; a number is the same on all devices."""
    return PartitionSpec(*(None,) * (rank - 1), POPULATION_AXIS) if rank else PartitionSpec()
