"""Programs of ours, compiled for all cores: every timed call of ours goes through here."""

import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from benchmarks.exercise import Exercise
from evo_cpg.physics.step import step
from evo_cpg.simulation.situation import starting_state
from evo_cpg.training.devices import POPULATION_AXIS, fast_jit
from evo_cpg.training.experiment import padding


class Program(NamedTuple):
    """Something compiled.

    Attributes:
        run: does so many steps and waits for the result ``(k, lanes)``.
        compile_seconds: that tracing and compiling took, s.
        temporary: bytes that XLA sets aside for intermediate results on all devices.
    """

    run: Callable[[int], np.ndarray]
    compile_seconds: float
    temporary: int


def compile_for_all(
    function: Callable[[Array, Array], Array], lanes: np.ndarray, mesh: Mesh
) -> Program:
    """Compile a function, sharded over the individuals.

    Args:
        function: of the number of steps and of ``(k, n)``, one column per individual.
        lanes: all columns; as many as fill the devices' vectors (see `full_lanes`).
        mesh: the devices.
    """
    columns = PartitionSpec(None, POPULATION_AXIS)
    sharded = fast_jit(
        jax.shard_map(
            function,
            mesh=mesh,
            in_specs=(PartitionSpec(), columns),
            out_specs=columns,
            check_vma=False,
        )
    )
    placed = jax.device_put(lanes, NamedSharding(mesh, columns))
    start = time.perf_counter()
    compiled = sharded.lower(np.int32(0), placed).compile()
    seconds = time.perf_counter() - start
    usage = compiled.memory_analysis()
    temporary = mesh.size * int(usage.temp_size_in_bytes) if usage is not None else 0
    return Program(lambda count: np.asarray(compiled(np.int32(count), placed)), seconds, temporary)


def full_lanes(count: int, mesh: Mesh) -> int:
    """As many individuals, rounded up to full vectors on every device, as in training."""
    return count + padding(count, mesh)


def compile_motion(exercise: Exercise, lanes: np.ndarray, mesh: Mesh, finer: int = 1) -> Program:
    """Our population at its exercise: physics alone, without a brain.

    Its result is the place ``(3, lanes)`` of every root at the end, m.

    Args:
        exercise: what the animals do.
        lanes: what each of them does differently (see `Exercise.lanes`); of its type is the motion.
        mesh: the devices.
        finer: in how many steps each step is divided, with the commands as before.
    """
    simulation = exercise.experiment.simulation
    world, h = simulation.world, simulation.step_length / finer

    def move(count: Array, lanes: Array) -> Array:
        told = exercise.prepare(lanes)

        def advance(index, state):
            rate, angle = exercise.command(told, index // finer)
            return step(world, state, rate, h, angle)[0]

        start = starting_state(
            simulation.situations, None, world.tree, lanes.shape[1:], lanes.dtype
        )
        # The number of steps is an argument: one program for calls of every length.
        return jax.lax.fori_loop(np.int32(0), count, advance, start).position

    return compile_for_all(move, lanes, mesh)
