"""Trials on all cores, on one core, and on all cores with one process per core.

The trials run the whole stack, as in training, with random genes. Independent processes share only
the machine. So the speed of one process on all cores, relative to theirs, shows the cost of its
threads. Run as a program, this module is one of these processes:
`python -m benchmarks.scaling CONFIG STEPS SIZE FIRST LAST`.
"""

import contextlib
import dataclasses
import functools
import itertools
import statistics
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks.moving import UNIT
from benchmarks.plan import Plan, experiment_of, random_genes
from benchmarks.rows import Row
from benchmarks.timing import Contender, race, ratio_quartiles
from benchmarks.worker import Worker, serve, started
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials

# Control steps of a trial, by config. One core computes a population's trials in about a second.
_CASES = {"iwadate2010_swimmer": 4000, "fukui2003_model1": 2400, "iwadate2010_salamander_land": 600}
_QUICK = 60
# Number of individuals, which gives each core whole vectors of individuals.
_SIZE = 256
# Factor on a peer's time limit for our processes, because all of them compile.
_PATIENCE = 10
_ALL, _ONE, _APART = "all", "1 core", "processes"


def measure(plan: Plan) -> Iterator[Row]:
    """Yield two rows per config and size: all cores against one core, and against processes."""
    cases = [("iwadate2010_swimmer", _QUICK)] if plan.quick else list(_CASES.items())
    for config, steps in cases:
        for size in plan.sizes_or(_SIZE):
            yield from _measure(config, steps, size, plan)


def _measure(config: str, steps: int, size: int, plan: Plan) -> list[Row]:
    simulation = _simulation(config, steps)
    work, contenders = size * steps * simulation.substeps, []
    for name, count in ((_ONE, 1), (_ALL, plan.cores)):
        plan.say(f"scaling: compiling {config} for {name}")
        contenders.append(Contender(name, work, _trials(simulation, size, count, 0, size)))
    with _processes(config, steps, size, plan) as workers:

        def apart() -> None:
            for worker in workers:
                worker.send(None)
            for worker in workers:
                worker.answer(_PATIENCE * plan.limit)

        contenders.append(Contender(_APART, work, apart))
        plan.say(f"scaling: {config}")
        rates = race(contenders, plan.repeats)
    return [
        Row(
            "scaling",
            config,
            size,
            statistics.median(rates[_ALL]),
            UNIT,
            f"trials of {steps} control steps on {plan.cores} cores, median of {plan.repeats} "
            "rounds in turn",
            peer=_ONE if peer == _ONE else f"{plan.cores} processes",
            peer_rate=statistics.median(rates[peer]),
            ratio=ratio,
            ratio_spread=(low, high),
        )
        for peer in (_ONE, _APART)
        for low, ratio, high in (ratio_quartiles(rates, _ALL, peer),)
    ]


def _simulation(config: str, steps: int) -> Simulation:
    return dataclasses.replace(experiment_of(config).simulation, steps=steps)


def _trials(
    simulation: Simulation, size: int, cores: int, first: int, last: int
) -> Callable[[], object]:
    """Return a function that runs trials of a slice, first to last, of a population."""
    genes = random_genes(simulation, size)[:, first:last]
    return functools.partial(compile_trials(simulation, population_mesh(cores)), genes)


@contextlib.contextmanager
def _processes(config: str, steps: int, size: int, plan: Plan) -> Iterator[list[Worker]]:
    """Yield one worker per core, each with its part of the individuals, ready to run."""
    ends = np.linspace(0, size, plan.cores + 1).astype(int)
    with contextlib.ExitStack() as stack:
        workers = [
            stack.enter_context(started("scaling", config, *map(str, (steps, size, first, last))))
            for first, last in itertools.pairwise(ends)
        ]
        for worker in workers:
            worker.answer(_PATIENCE * plan.limit)
        yield workers


def _prepare(
    config: str, steps: int, size: int, first: int, last: int
) -> tuple[dict[str, Any], Callable[[Any], dict[str, Any]]]:
    from evo_cpg.training.devices import use_cores

    use_cores()
    run = _trials(_simulation(config, steps), size, 1, first, last)

    def work(_: Any) -> dict[str, Any]:
        run()
        return {}

    return {}, work


if __name__ == "__main__":
    serve(lambda: _prepare(sys.argv[1], *map(int, sys.argv[2:6])))
