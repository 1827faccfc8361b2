"""The swimmer's physics on all cores and on one."""

import functools
import statistics

from benchmarks.animals import swimmer
from benchmarks.moving import UNIT
from benchmarks.ours import compile_motion, full_lanes
from benchmarks.plan import Plan
from benchmarks.rows import Row
from benchmarks.timing import Contender, count_lasting, race, ratio_quartiles
from evo_cpg.training.devices import population_mesh

_FEWEST, _MOST = 10, 20_000


def measure(plan: Plan) -> list[Row]:
    """A row per size; the ratio is how many times as fast all cores are."""
    exercise = swimmer().exercise
    return [_at_size(exercise, size, plan) for size in plan.sizes_or(200)]


def _at_size(exercise, size: int, plan: Plan) -> Row:
    names = f"{plan.cores} cores", "1 core"
    contenders, seconds = [], []
    for name, count in zip(names, (plan.cores, 1), strict=True):
        plan.say(f"scaling: compiling for {name}")
        mesh = population_mesh(count)
        program = compile_motion(exercise, exercise.lanes(full_lanes(size, mesh)), mesh)
        steps = count_lasting(
            lambda n, run=program.run: functools.partial(run, n),
            plan.call_seconds,
            _FEWEST,
            _MOST,
        )
        call = functools.partial(program.run, steps)
        contenders.append(Contender(name if name == names[1] else "all", size * steps, call))
        seconds.append(program.compile_seconds)
    rates = race(contenders, plan.repeats)
    low, ratio, high = ratio_quartiles(rates, "all", names[1])
    return Row(
        "scaling",
        names[0],
        size,
        statistics.median(rates["all"]),
        UNIT,
        f"physics of the swimmer, median of {plan.repeats} rounds in turn",
        seconds[0],
        peer=names[1],
        peer_rate=statistics.median(rates[names[1]]),
        ratio=ratio,
        ratio_spread=(low, high),
    )
