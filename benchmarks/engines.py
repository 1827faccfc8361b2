"""Speed of every shipped config on native code, relative to plain JAX, which works without LLVM.

Trials run the whole stack, but few steps, because plain JAX compiles long and runs slowly.
"""

import dataclasses
import functools
import statistics
from collections.abc import Iterator

from benchmarks.moving import UNIT
from benchmarks.plan import CONFIGS, SMALL_SWIMMER, Plan, experiment_of, random_genes
from benchmarks.rows import Row
from benchmarks.timing import Contender, race, ratio_quartiles, seconds
from evo_cpg.native.engine import Engine
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials

_SIZE = 64
_STEPS = 60


def measure(plan: Plan) -> Iterator[Row]:
    """Yield a row per config and size, with the speed relative to plain JAX."""
    names, overrides = sorted(path.stem for path in CONFIGS.glob("*.yaml")), ()
    if plan.quick:
        names, overrides = ["iwadate2010_swimmer"], SMALL_SWIMMER
    for name in names:
        for size in plan.sizes_or(_SIZE):
            yield _measure(name, overrides, size, plan)


def _measure(name: str, overrides: tuple[str, ...], size: int, plan: Plan) -> Row:
    simulation = dataclasses.replace(experiment_of(name, *overrides).simulation, steps=_STEPS)
    genes = random_genes(simulation, size)
    contenders, compiling = [], {}
    for engine in ("native", "jax"):
        plan.say(f"engines: compiling {name} for {engine}")
        own = dataclasses.replace(simulation, engine=Engine(engine))
        live = functools.partial(compile_trials(own, population_mesh()), genes)
        first = seconds(live)
        compiling[engine] = max(first - seconds(live), 0.0)
        contenders.append(Contender(engine, size * _STEPS * simulation.substeps, live))
    plan.say(f"engines: {name}")
    rates = race(contenders, plan.repeats)
    low, ratio, high = ratio_quartiles(rates, "native", "jax")
    return Row(
        "engines",
        name,
        size,
        statistics.median(rates["native"]),
        UNIT,
        f"trials of {_STEPS} control steps on {plan.cores} cores, median of {plan.repeats} rounds "
        f"in turn. Plain JAX compiles in {compiling['jax']:.0f} s",
        compiling["native"],
        peer=f"plain JAX, compiled in {compiling['jax']:.0f} s",
        peer_rate=statistics.median(rates["jax"]),
        ratio=ratio,
        ratio_spread=(low, high),
    )
