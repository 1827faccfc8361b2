"""Speed of a run with the gradient of the fitness, relative to a run without the gradient.

The whole stack of the swimmer is differentiated over the trial, as in `evo-cpg refine`. Populations
fill one vector or seven, on one core. Each has a process of its own, because the backward pass may
need much time and memory to compile. Run as a program, this module is the worker:
`python -m benchmarks.gradient SIZE SECONDS [KEY=VALUE ...]`, where 0 s is the whole trial.
"""

import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

from benchmarks.moving import UNIT
from benchmarks.plan import Plan, swimmer_settings
from benchmarks.rows import Row
from benchmarks.timing import Contender, race, ratio_quartiles
from benchmarks.worker import WorkerError, serve, started

SIZES = (16, 112)
# Length of a trial, s, or 0 for the whole trial.
_SHORT, _WHOLE = 1.0, 0.0
_GRADIENT, _FORWARD = "value and gradient", "forward run"
# Calls in one timing, because a single call of a short trial takes only some milliseconds.
_CALLS = {_SHORT: {_GRADIENT: 5, _FORWARD: 30}, _WHOLE: {_GRADIENT: 1, _FORWARD: 2}}
# Factor on a peer's time limit, because the backward pass compiles much longer.
_PATIENCE = 5


def measure(plan: Plan) -> Iterator[Row]:
    """Yield a row per size, with the speed with the gradient relative to the speed without it."""
    seconds = _SHORT if plan.quick else _WHOLE
    for size in plan.sizes_or(*SIZES):
        yield _measure(plan, size, seconds)


def _measure(plan: Plan, size: int, seconds: float) -> Row:
    plan.say("gradient: compiling")
    limit = _PATIENCE * plan.limit
    with started("gradient", str(size), str(seconds), *swimmer_settings(plan)) as worker:
        try:
            ready = worker.answer(limit)
        except WorkerError as error:
            return _row(size, seconds, 0.0, "", note=str(error))

        def contender(name: str) -> Contender:
            work = size * ready["steps"] * _CALLS[seconds][name]
            return Contender(name, work, lambda: worker.ask(name, limit))

        plan.say("gradient")
        rates = race([contender(_GRADIENT), contender(_FORWARD)], plan.repeats)
    low, ratio, high = ratio_quartiles(rates, _GRADIENT, _FORWARD)
    forward = ready["forward_seconds"]
    return _row(
        size,
        seconds,
        statistics.median(rates[_GRADIENT]),
        f", {ready['bodies']} bodies. Median of {plan.repeats} rounds. Each round times the "
        f"gradient, then the forward run. The forward run compiles in {forward:.0f} s",
        compile_seconds=ready["gradient_seconds"],
        temporary=ready["temporary"],
        memory=ready["peak"],
        peer_rate=statistics.median(rates[_FORWARD]),
        ratio=ratio,
        ratio_spread=(low, high),
    )


def _row(size: int, seconds: float, rate: float, how: str, **fields: Any) -> Row:
    length = f"{seconds:g} s" if seconds else "the whole trial"
    what = f"mean fitness of {size} individuals after {length}, float32, one core{how}"
    return Row("gradient", _GRADIENT, size, rate, UNIT, what, peer=_FORWARD, **fields)


def _prepare(size: int, seconds: float, settings: Sequence[str]) -> tuple[dict[str, Any], Any]:
    import dataclasses

    import jax
    import jax.numpy as jnp
    import numpy as np

    from benchmarks.machine import peak_memory
    from benchmarks.plan import experiment_of, random_genes
    from evo_cpg.simulation.backward import Backward
    from evo_cpg.simulation.judge import Scored
    from evo_cpg.simulation.rollout import rollout
    from evo_cpg.training.devices import use_cores

    use_cores()
    simulation = experiment_of("iwadate2010_swimmer", *settings).simulation
    if seconds:
        control_steps = round(seconds * simulation.control_rate)
        simulation = dataclasses.replace(simulation, steps=control_steps)
    scales = {"energy": jnp.float32(1)}

    def fitness(genes):
        return rollout(simulation, genes, observers=Scored(scales), backward=Backward()).mean()

    genes = random_genes(simulation, size)

    def compiled(function: Any) -> tuple[Any, float]:
        start = time.perf_counter()
        program = jax.jit(function).lower(genes).compile()
        return program, time.perf_counter() - start

    forward, forward_seconds = compiled(fitness)
    gradient, gradient_seconds = compiled(jax.value_and_grad(fitness))
    programs = {_FORWARD: forward, _GRADIENT: gradient}

    def work(name: str) -> dict[str, Any]:
        for _ in range(_CALLS[seconds][name]):
            jax.block_until_ready(programs[name](genes))
        return {}

    usage = gradient.memory_analysis()
    slope = np.asarray(gradient(genes)[1])
    if not np.isfinite(slope).all():
        raise FloatingPointError(f"{(~np.isfinite(slope)).sum()} derivatives are not finite")
    ready = {
        "bodies": simulation.world.tree.body_count,
        "steps": simulation.steps * simulation.substeps,
        "forward_seconds": forward_seconds,
        "gradient_seconds": gradient_seconds,
        "temporary": int(usage.temp_size_in_bytes),
        "peak": peak_memory(),
    }
    return ready, work


if __name__ == "__main__":
    serve(lambda: _prepare(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3:]))
