"""Our physics, oscillators and brain, compiled for all cores and run in chunks, as in training."""

import functools
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jax import Array
from jax.sharding import Mesh

from benchmarks.exercise import Exercise
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.simulation.situation import starting_state
from evo_cpg.training.devices import layout, run_in_blocks, sharded


class Program(NamedTuple):
    """A compiled program.

    Attributes:
        run: function that runs some steps and waits for the result ``(k, lanes)``.
        compile_seconds: time to trace and compile, s.
        temporary: bytes that XLA sets aside for intermediate results on all devices.
    """

    run: Callable[[int], np.ndarray]
    compile_seconds: float
    temporary: int


def compile_for_all(
    function: Callable[[Array, Array], Array], lanes: np.ndarray, mesh: Mesh
) -> Program:
    """Compile a function that runs over the individuals in chunks, as in training.

    Args:
        function: function of the number of steps and of ``(k, n)``, one column per individual.
        lanes: all columns. They fill whole chunks (see `full_lanes`).
        mesh: the devices.
    """
    count = lanes.shape[1]
    spread = layout(count, mesh)

    def arguments(steps: int, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array(steps, np.int32), lanes[:, numbers]

    start = time.perf_counter()
    first = arguments(0, np.arange(spread.block))
    compiled = sharded(function, spread.mesh, (0, 2)).lower(*first).compile()
    seconds = time.perf_counter() - start
    usage = compiled.memory_analysis()
    temporary = spread.mesh.size * int(usage.temp_size_in_bytes) if usage is not None else 0

    def run(steps: int) -> np.ndarray:
        return run_in_blocks(compiled, spread, count, functools.partial(arguments, steps))

    return Program(run, seconds, temporary)


def full_lanes(count: int, mesh: Mesh) -> int:
    """Return the number of individuals, rounded up to full chunks on every busy device."""
    block = layout(count, mesh).block
    return -(-count // block) * block


def compile_motion(exercise: Exercise, lanes: np.ndarray, mesh: Mesh, finer: int = 1) -> Program:
    """Compile the motion of a population by the commands of an exercise: physics without a brain.

    The result is the final place ``(3, lanes)`` of every root, m.

    Args:
        exercise: exercise of the animals.
        lanes: differing inputs of individuals (see `Exercise.lanes`). The motion is computed in
            their type (float32 or float64).
        mesh: the devices.
        finer: number of equal parts into which each step is divided, with unchanged commands.
    """
    simulation = exercise.experiment.simulation
    world, h = simulation.world, simulation.step_length / finer

    def move(count: Array, lanes: Array) -> Array:
        commands = exercise.prepare(lanes)

        def advance(index, carry):
            state, warmstart = carry
            command = exercise.command(commands, index // finer)
            state, effort = step(world, state, command, h, warmstart)
            return state, effort.warmstart

        start = starting_state(
            simulation.situations, None, world.tree, lanes.shape[1:], lanes.dtype
        )
        begin = start, first_warmstart(world, lanes.shape[1:], lanes.dtype)
        # The number of steps is an argument, so that one program serves calls of every length.
        return jax.lax.fori_loop(np.int32(0), count, advance, begin)[0].position

    return compile_for_all(move, lanes, mesh)
