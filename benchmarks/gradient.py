"""Cost of derivatives of the fitness, relative to a run without derivatives.

| kind | what | derivative |
|---|---|---|
| ``gradient`` | the swimmer's whole trial | by all genes, backwards, as in `evo-cpg refine` |
| ``numbers`` | the swimmer's whole trial | by eight numbers of its configuration, forwards |
| ``walker`` | half a second of a quadruped | by all genes, backwards |

Everything runs on one core, in a process for each kind and size, because derivatives may need much
time and memory to compile. Run as a program, this module is the worker:
`python -m benchmarks.gradient KIND SIZE SECONDS [KEY=VALUE ...]`, where 0 s is the whole trial.
"""

import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from benchmarks.moving import UNIT
from benchmarks.plan import CONFIGS, Plan, swimmer_settings
from benchmarks.rows import Row
from benchmarks.timing import Contender, race, ratio_quartiles
from benchmarks.worker import WorkerError, serve, started


class _Kind(NamedTuple):
    """A kind of derivative.

    Attributes:
        name: name of the rows.
        config: name of the configuration.
        sizes: numbers of individuals.
        seconds: length of a trial, s, or 0 for the whole trial.
        settings: overrides of the configuration.
    """

    name: str
    config: str
    sizes: tuple[int, ...]
    seconds: float = 0.0
    settings: tuple[str, ...] = ()


_KINDS = {
    "gradient": _Kind("value and gradient", "iwadate2010_swimmer", (16, 112)),
    "numbers": _Kind("value and 8 derivatives", "iwadate2010_swimmer", (1, 16)),
    "walker": _Kind(
        "value and gradient, walker", "fukui2003_model1", (16,), 0.5, ("controller.graded=true",)
    ),
}
# Numbers of the configuration whose derivatives are computed forwards.
_NUMBERS = (
    "creature.materials.body.density",
    "world.water.density",
    "world.water.form_drag",
    "world.water.skin_drag",
    "creature.bodies.1.joint.actuator.gain",
    "controller.cpg.time_scale",
    "controller.cpg.pair_weight",
    "controller.cpg.parent_weight",
)
_DERIVATIVE, _FORWARD = "derivative", "forward run"
# Length of a trial of a quick measurement, s.
_SHORT = 1.0
# Calls in one timing, because a single call of a short trial takes only some milliseconds.
_CALLS = {True: {_DERIVATIVE: 5, _FORWARD: 30}, False: {_DERIVATIVE: 1, _FORWARD: 2}}
# Factor on a peer's time limit, because a backward pass compiles longer.
_PATIENCE = 5


def measure(plan: Plan) -> Iterator[Row]:
    """Yield a row per kind and size: the speed with derivatives relative to that without."""
    for name, kind in _KINDS.items():
        seconds = kind.seconds or (_SHORT if plan.quick else 0.0)
        for size in plan.sizes_or(*kind.sizes):
            yield _measure(plan, name, size, seconds)


def _measure(plan: Plan, name: str, size: int, seconds: float) -> Row:
    plan.say(f"gradient: compiling ({name})")
    limit, kind = _PATIENCE * plan.limit, _KINDS[name]
    settings = kind.settings or swimmer_settings(plan)
    with started("gradient", name, str(size), str(seconds), *settings) as worker:
        try:
            ready = worker.answer(limit)
        except WorkerError as error:
            return _row(kind, size, seconds, 0.0, "", note=str(error))

        def contender(which: str) -> Contender:
            work = size * ready["steps"] * _CALLS[bool(seconds)][which]
            return Contender(which, work, lambda: worker.ask(which, limit))

        plan.say("gradient")
        rates = race([contender(_DERIVATIVE), contender(_FORWARD)], plan.repeats)
    low, ratio, high = ratio_quartiles(rates, _DERIVATIVE, _FORWARD)
    forward = ready["forward_seconds"]
    return _row(
        kind,
        size,
        seconds,
        statistics.median(rates[_DERIVATIVE]),
        f", {ready['bodies']} bodies. Median of {plan.repeats} rounds. Each round times the "
        f"derivative, then the forward run. The forward run compiles in {forward:.0f} s",
        compile_seconds=ready["derivative_seconds"],
        temporary=ready["temporary"],
        memory=ready["peak"],
        peer_rate=statistics.median(rates[_FORWARD]),
        ratio=ratio,
        ratio_spread=(low, high),
    )


def _row(kind: _Kind, size: int, seconds: float, rate: float, how: str, **fields: Any) -> Row:
    length = f"{seconds:g} s" if seconds else "the whole trial"
    what = f"mean fitness of {size} individuals after {length}, float32, one core{how}"
    return Row("gradient", kind.name, size, rate, UNIT, what, peer=_FORWARD, **fields)


def _prepare(
    name: str, size: int, seconds: float, settings: Sequence[str]
) -> tuple[dict[str, Any], Any]:
    import dataclasses

    import jax
    import jax.numpy as jnp
    import numpy as np

    from benchmarks.machine import peak_memory
    from benchmarks.plan import experiment_of, random_genes
    from evo_cpg.io.load import load_config
    from evo_cpg.io.parameters import parametrise
    from evo_cpg.simulation.backward import Backward
    from evo_cpg.simulation.judge import Scored
    from evo_cpg.simulation.rollout import rollout
    from evo_cpg.training.devices import use_cores

    use_cores()
    config = _KINDS[name].config
    simulation = experiment_of(config, *settings).simulation
    steps = round(seconds * simulation.control_rate) or simulation.steps
    genes = jnp.asarray(random_genes(simulation, size))
    scored = Scored({"energy": jnp.float32(1)})

    def fitness(genes: Any, simulation: Any = simulation) -> Any:
        trial = dataclasses.replace(simulation, steps=steps)
        return rollout(trial, genes, observers=scored, backward=Backward()).mean()

    if name == "numbers":
        path = CONFIGS / f"{config}.yaml"
        numbers = parametrise(load_config(path, list(settings)), path, _NUMBERS)

        def several(values: Any) -> Any:
            # Two results, so that the derivative is computed forwards.
            trial = dataclasses.replace(numbers.simulation(values), steps=steps)
            terms = rollout(trial, genes).terms
            return jnp.stack([terms["distance"].mean(), terms["energy"].mean()])

        at = jnp.asarray(numbers.values, jnp.float32)
        derive = jax.jacfwd(lambda values: (several(values),) * 2, has_aux=True)
    else:
        at, derive = genes, jax.value_and_grad(fitness)

    def compiled(function: Any, at: Any) -> tuple[Any, float]:
        start = time.perf_counter()
        program = jax.jit(function).lower(at).compile()
        return program, time.perf_counter() - start

    forward, forward_seconds = compiled(fitness, genes)
    derivative, derivative_seconds = compiled(derive, at)
    programs = {_FORWARD: (forward, genes), _DERIVATIVE: (derivative, at)}

    def work(which: str) -> dict[str, Any]:
        program, at = programs[which]
        for _ in range(_CALLS[bool(seconds)][which]):
            jax.block_until_ready(program(at))
        return {}

    found = np.concatenate([np.ravel(x) for x in jax.tree.leaves(derivative(at))])
    if not np.isfinite(found).all():
        raise FloatingPointError(f"{(~np.isfinite(found)).sum()} derivatives are not finite")
    ready = {
        "bodies": simulation.world.tree.body_count,
        "steps": steps * simulation.substeps,
        "forward_seconds": forward_seconds,
        "derivative_seconds": derivative_seconds,
        "temporary": int(derivative.memory_analysis().temp_size_in_bytes),
        "peak": peak_memory(),
    }
    return ready, work


if __name__ == "__main__":
    serve(lambda: _prepare(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), sys.argv[4:]))
