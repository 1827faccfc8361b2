"""The controller's two halves alone: the oscillators of the spinal cord, and the brain.

Errors are relative to the size of the outputs. The root mean square of the difference from a
float64 reference is divided by the root mean square of the reference. Both are over all outputs of
16 individuals. The reference of the oscillators has a sixteenth of the step, over 1 s. The
reference of the brain differs only in precision.
"""

import functools
import statistics
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh

from benchmarks.accuracy import FINER, LANES, SECONDS
from benchmarks.ours import Program, compile_for_all, full_lanes
from benchmarks.plan import Plan, experiment_of
from benchmarks.rows import Row, finite
from benchmarks.timing import Contender, count_lasting, race
from evo_cpg.control import matsuoka
from evo_cpg.control.brain import decode_weights, think
from evo_cpg.control.brain_cpg import BrainCpg
from evo_cpg.training.devices import population_mesh

_FEWEST, _MOST = 10, 1_000_000
_SEED = 0
# The factor 0.5 gives half of the largest tonic input and the middle of the adaptation gains. The
# other number is the largest relative difference of individuals from these values.
_MIDDLE, _SPREAD = 0.5, 0.2


def measure_cpg(plan: Plan, peak: float) -> Iterator[Row]:
    """Yield a row per size for control steps of the swimmer's oscillators with constant inputs."""
    controller, mesh = _controller(), population_mesh()
    error = None
    for size in plan.sizes_or(200):
        plan.say(f"cpg, {size} individuals")
        program = _compile_rhythm(controller, _tempers(full_lanes(size, mesh)), mesh)
        if error is None:
            steps = round(SECONDS / controller.control_step)
            tempers = _tempers(full_lanes(LANES, mesh)).astype(float)
            with jax.enable_x64(True):
                reference = _compile_rhythm(controller, tempers, mesh, FINER).run(steps * FINER)
            error = _relative(program.run(steps), reference)
        yield _row("cpg", "oscillators", size, program, error, plan, None, peak)


def measure_brain(plan: Plan, peak: float) -> Iterator[Row]:
    """Yield a row per size for the swimmer's network, each evaluation after the previous one."""
    controller, mesh = _controller(), population_mesh()
    # A product and a sum for every weight and bias.
    flops = 2 * controller.gene_count
    error = None
    for size in plan.sizes_or(200):
        plan.say(f"brain, {size} individuals")
        program = _compile_thought(controller, _genes(controller, full_lanes(size, mesh)), mesh)
        if error is None:
            genes = _genes(controller, full_lanes(LANES, mesh)).astype(float)
            with jax.enable_x64(True):
                reference = _compile_thought(controller, genes, mesh).run(1)
            error = _relative(program.run(1), reference)
        yield _row("brain", "network", size, program, error, plan, flops, peak)


def _controller() -> BrainCpg:
    controller = experiment_of("iwadate2010_swimmer").simulation.controller
    assert isinstance(controller, BrainCpg)
    return controller


def _tempers(count: int) -> np.ndarray:
    """Return factors ``(1, n)`` on the oscillators' tonic inputs and adaptation gains."""
    generator = np.random.default_rng(_SEED)
    return (1 + _SPREAD * generator.uniform(-1, 1, (1, count))).astype(np.float32)


def _genes(controller: BrainCpg, count: int) -> np.ndarray:
    bound = controller.origin.settings.brain.init_range
    generator = np.random.default_rng(_SEED)
    return generator.uniform(-bound, bound, (count, controller.gene_count)).T.astype(np.float32)


def _compile_rhythm(
    controller: BrainCpg, tempers: np.ndarray, mesh: Mesh, finer: int = 1
) -> Program:
    network, cpg = controller.network, controller.origin.settings.cpg
    middle = _MIDDLE * (cpg.min_adaptation_gain + cpg.max_adaptation_gain)

    def beat(count: Array, tempers: Array) -> Array:
        oscillators = jnp.ones((network.oscillator_count, 1), tempers.dtype)
        gain = middle * oscillators * tempers
        drive = _MIDDLE * cpg.max_tonic_input * oscillators * tempers

        def advance(index, state):
            step = controller.control_step / finer
            return matsuoka.advance(network, state, jnp.stack([drive, drive]), gain, step)

        start = matsuoka.initial_state(network, tempers.shape[1:], tempers.dtype)
        return matsuoka.output(jax.lax.fori_loop(np.int32(0), count, advance, start))

    return compile_for_all(beat, tempers, mesh)


def _compile_thought(controller: BrainCpg, genes: np.ndarray, mesh: Mesh) -> Program:
    brain = controller.brain

    def live(count: Array, genes: Array) -> Array:
        senses = jnp.cos(jnp.arange(brain.sizes[0], dtype=genes.dtype))[:, None]
        senses = jnp.broadcast_to(senses, (brain.sizes[0], genes.shape[1]))
        nothing = jnp.zeros((brain.sizes[-1], genes.shape[1]), genes.dtype)
        weights = decode_weights(brain, genes)

        def again(index, mind):
            senses, _ = mind
            outputs = think(brain, weights, senses)
            # One input becomes an output, so that the next evaluation depends on this one.
            return senses.at[0].set(outputs[0]), outputs

        return jax.lax.fori_loop(np.int32(0), count, again, (senses, nothing))[1]

    return compile_for_all(live, genes, mesh)


def _relative(found: np.ndarray, exact: np.ndarray) -> float | None:
    found, exact = found[:, :LANES], exact[:, :LANES]
    return finite(np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2)))


def _row(
    case: str,
    part: str,
    size: int,
    program: Program,
    error: float | None,
    plan: Plan,
    flops: int | None,
    peak: float,
) -> Row:
    steps = count_lasting(
        lambda count: functools.partial(program.run, count), plan.call_seconds, _FEWEST, _MOST
    )
    contender = Contender(part, size * steps, functools.partial(program.run, steps))
    rate = statistics.median(race([contender], plan.repeats)[part])
    return Row(
        case,
        part,
        size,
        rate,
        "control steps/s",
        f"individual control steps/s, {plan.cores} cores, median of {plan.repeats} calls of "
        f"{steps} steps, float32",
        program.compile_seconds,
        program.temporary,
        error=error,
        flops=rate * flops if flops else None,
        peak_share=rate * flops / peak if flops else None,
    )
