"""Entrainment of an isolated spinal cord by a motor that bends it.

The cord has no brain, no muscles and no water. The angle of the bent joints is

    q(t) = A sin(2 pi f_b t),

and the other joints stay straight. The cord rests for some cycles of its own frequency f_0. Then
the motor bends it for 20 cycles, of which the last 10 are measured. The oscillator of the first
bent joint has phase 0 when its output crosses 0 upwards. Its phase behind the bending is

    p_k = f_b (t_k - t_0)  modulo 1,    bending crosses 0 upwards at t_0.

A cord is entrained 1:1 if the mean frequency of every oscillator is within 1 % of f_b, and if the
phases scatter by less than 0.05 cycle (circular standard deviation).
"""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis.cycles import cycle_starts, frequency_of, mean_phase
from evo_cpg.analysis.laboratory.bodies import Variants
from evo_cpg.control import matsuoka
from evo_cpg.control.controller import Observation
from evo_cpg.native.fuse import fuse
from evo_cpg.simulation.batched import BatchedSimulation

# Cycles of bending, and how many of the last are measured.
CYCLES, MEASURED = 20, 10
# Time before the bending, s, and time in which the frequency without bending is measured.
REST, _MEASURED_REST = 15.0, 10.0
# Largest relative error of the frequency, and largest scatter of the phase, cycles.
SAME_FREQUENCY, LARGEST_SCATTER = 0.01, 0.05
# Largest scatter of a phase that has a mean, cycles.
LARGEST_PHASE_SCATTER = 0.2


class Locking(NamedTuple):
    """Rhythm of a cord during bending.

    Attributes:
        frequency: frequency of the first bent oscillator, Hz, or NaN without a rhythm.
        followed: frequency of the oscillator that is farthest from the bending, over the bending's.
        phase: phase of the first bent oscillator behind the bending, cycles, -0.5 to 0.5, or NaN
            if it scatters by more than `LARGEST_PHASE_SCATTER`.
        scatter: circular standard deviation of the phase, cycles.
        entrained: whether the cord is entrained 1:1.
    """

    frequency: float
    followed: float
    phase: float
    scatter: float
    entrained: bool


def bend(
    bodies: Variants,
    genes: Float[np.ndarray, "g n"],
    bent: Float[np.ndarray, "d n"],
    frequency: Float[np.ndarray, " n"],
    steps: int,
) -> Float[np.ndarray, "t d n"]:
    """Return the outputs of the oscillators of bent cords, one sample for each control step.

    Args:
        bodies: the animal of each cord, with its nervous system.
        genes: genes of each cord.
        bent: amplitude of each joint, rad.
        frequency: frequency of the bending, Hz.
        steps: number of control steps.
    """
    h = 1 / bodies.common.control_rate
    rest = round(REST / h)

    def run(values: Sequence[Array], genes: Array, bent: Array, frequency: Array) -> Array:
        simulation = bodies.simulation
        if isinstance(simulation, BatchedSimulation):
            simulation = simulation.inputs.put(simulation.common, values)
        controller, body_count = simulation.controller, simulation.world.tree.body_count
        decoded = controller.decode(genes)
        start = controller.initial_state(genes.shape[1:], genes.dtype)

        def advance(state: Any, index: Array) -> tuple[Any, Array]:
            turn = 2 * jnp.pi * frequency
            time = jnp.maximum(index - rest, 0) * h
            moves = (index >= rest).astype(genes.dtype)
            angle = bent * jnp.sin(turn * time)[None]
            rate = moves * bent * (turn * jnp.cos(turn * time))[None]

            def step(decoded: Any, state: Any, angle: Array, rate: Array) -> Any:
                none = angle[:0]  # No senses of the brain, and bodies without a load.
                load = jnp.zeros((body_count, *angle.shape[1:]), angle.dtype)
                observation = Observation(none, none, none, none, angle, rate, none, load=load)
                return controller.act(decoded, state, observation)[0]

            given, ndim = (decoded, state, angle, rate), genes.ndim - 1
            state = fuse(step, *given, batch_ndim=ndim, name="a bent cord")
            return state, matsuoka.output(state)

        return jax.lax.scan(advance, start, jnp.arange(steps))[1]

    given = [jnp.asarray(x, jnp.float32) for x in (genes, bent, frequency)]
    if not isinstance(bodies.simulation, BatchedSimulation):
        return np.asarray(jax.jit(functools.partial(run, ()))(*given), float)
    own = [jnp.asarray(value, jnp.float32) for value in bodies.simulation.values]
    each = jax.jit(jax.vmap(run, in_axes=-1, out_axes=-1))
    return np.asarray(each(own, *given), float)


def rest_frequency(outputs: Float[np.ndarray, " t"], h: float) -> float:
    """Return the frequency of an oscillator before the bending, Hz, NaN without a rhythm."""
    first, last = round((REST - _MEASURED_REST) / h), round(REST / h)
    return frequency_of(cycle_starts(outputs[first:last], h))


def locking(
    outputs: Float[np.ndarray, "t d"], frequency: float, h: float, first: int = 0
) -> Locking:
    """Return how a cord follows its bending (Hz), from outputs that are h (s) apart."""
    # The output after a step belongs to the end of the step.
    begin = REST + (CYCLES - MEASURED) / frequency
    window = slice(math.floor(begin / h), math.ceil((REST + CYCLES / frequency) / h) + 1)
    start = (window.start + 1) * h - REST
    times = [cycle_starts(one, h) + start for one in outputs[window].T]
    own = frequency_of(times[first])
    ratios = np.array([frequency_of(each) for each in times]) / frequency
    if not np.isfinite(ratios).all():
        return Locking(own, math.nan, math.nan, math.nan, False)
    followed = float(ratios[np.abs(ratios - 1).argmax()])
    mean, scatter = mean_phase(frequency * times[first])
    phase = mean if scatter <= LARGEST_PHASE_SCATTER else math.nan
    entrained = abs(followed - 1) < SAME_FREQUENCY and scatter < LARGEST_SCATTER
    return Locking(own, followed, phase, scatter, bool(entrained))


def entrained_range(
    ratios: Sequence[float], entrained: Sequence[bool]
) -> tuple[float, float] | None:
    """Return the lowest and highest ratio f_b/f_0 around 1 that entrain, or None.

    The range holds the ratio nearest to 1, and all its neighbours without a gap.
    """
    order = np.argsort(ratios)
    given, locked = np.asarray(ratios, float)[order], np.asarray(entrained, bool)[order]
    middle = int(np.abs(np.log(given)).argmin())
    if not locked[middle]:
        return None
    low = high = middle
    while low > 0 and locked[low - 1]:
        low -= 1
    while high < len(given) - 1 and locked[high + 1]:
        high += 1
    return float(given[low]), float(given[high])
