"""Costs of creatures of many bodies: compile time, memory, operations and run time per step.

Every creature has a process of its own, without any earlier compiled code. Run as a program, this
module is that process: `python -m benchmarks.large_creatures KIND COUNT SIZE`.
"""

import dataclasses
import functools
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.large_bodies import chain, walker
from benchmarks.moving import UNIT
from benchmarks.plan import Plan, random_genes
from benchmarks.rows import Build, Row
from benchmarks.timing import seconds
from benchmarks.worker import WorkerError, serve, started

_SIZE = 64
_STEPS = 30
# Factor on a peer's time limit, because our own compiler may take longer.
_PATIENCE = 10


class _Kind(NamedTuple):
    """Creatures that differ only in their size.

    Attributes:
        title: title in the table.
        word: name of the counted parts.
        counts: numbers of parts.
        bodies: function that returns the number of bodies for a number of parts.
        config: function that returns a configuration for a number of parts.
    """

    title: str
    word: str
    counts: tuple[int, ...]
    bodies: Callable[[int], int]
    config: Callable[[int], dict[str, Any]]


def _bodies_of_walker(legs: int) -> int:
    return 2 * legs + 1


_LEGS, _CHAINS = (4, 6, 8, 10, 20), (10, 20, 40, 60)
_KINDS = {
    "capsules": _Kind(
        "walkers of capsules", "legs", _LEGS, _bodies_of_walker, lambda n: walker(n, "capsule")
    ),
    "boxes": _Kind(
        "walkers of boxes", "legs", _LEGS, _bodies_of_walker, lambda n: walker(n, "box")
    ),
    "chain": _Kind("chains", "bodies", _CHAINS, lambda n: n, chain),
}
_QUICK = {"capsules": (2, 4)}


def measure(plan: Plan) -> Iterator[Row]:
    """Yield a row per creature and size of the population."""
    for kind in _QUICK if plan.quick else _KINDS:
        for count in _QUICK[kind] if plan.quick else _KINDS[kind].counts:
            for size in plan.sizes_or(_SIZE):
                yield _measure(kind, count, size, plan)


def _measure(kind: str, count: int, size: int, plan: Plan) -> Row:
    title, word, _, bodies, _ = _KINDS[kind]
    part = f"{kind}, {count} {word}"
    how = (
        f"trials of {_STEPS} control steps on one core, median of {plan.repeats}. Each creature "
        "has a process of its own, without earlier compiled code"
    )
    plan.say(f"large-creatures: {part}")
    limit = _PATIENCE * plan.limit
    row = Row("large-creatures", part, size, 0.0, UNIT, how)
    build = Build(title, bodies(count))
    with started("large_creatures", kind, str(count), str(size)) as worker:
        try:
            found = worker.answer(limit)
            taken = [worker.ask(None, limit)["seconds"] for _ in range(plan.repeats)]
        except WorkerError as error:
            return dataclasses.replace(row, note=str(error), build=build)
    again = statistics.median(taken)
    return dataclasses.replace(
        row,
        rate=size * found["steps"] / again,
        compile_seconds=max(found["first"] - again, 0.0),
        memory=found["memory"],
        note=found["fallback"],
        build=dataclasses.replace(build, **found["build"]),
    )


def _prepare(
    kind: str, count: int, size: int
) -> tuple[dict[str, Any], Callable[[Any], dict[str, Any]]]:
    from benchmarks.machine import children_watched, monitored, peak_memory
    from evo_cpg.io.build import build_experiment
    from evo_cpg.io.load import complete_config
    from evo_cpg.native import engine
    from evo_cpg.native.backend import machine
    from evo_cpg.native.native import COMPILING, WRITING
    from evo_cpg.training.devices import population_mesh, use_cores
    from evo_cpg.training.evaluate import compile_trials

    use_cores()
    # The engine tests itself first, because this is not part of a creature's compile time.
    engine.is_native()
    source = Path(f"{kind}.yaml")
    start = time.perf_counter()
    config = complete_config(_KINDS[kind].config(count), source)
    simulation = build_experiment(config, source).simulation
    building = time.perf_counter() - start
    simulation = dataclasses.replace(simulation, steps=_STEPS)
    trials = compile_trials(simulation, population_mesh(1))
    live = functools.partial(trials, random_genes(simulation, size))
    with (
        warnings.catch_warnings(record=True) as caught,
        monitored(WRITING, COMPILING) as spent,
        children_watched() as compiler,
    ):
        warnings.simplefilter("always")
        first = seconds(live)
        largest = compiler()
    fallbacks = [str(each.message) for each in caught if each.category is engine.EngineWarning]
    ready = {
        "first": first,
        "steps": _STEPS * simulation.substeps,
        "memory": peak_memory(),
        "fallback": fallbacks[0] if fallbacks else None,
        "build": {
            "operations": sum(more["operations"] for _, more in spent[WRITING]) or None,
            "building": building,
            "writing": sum(duration for duration, _ in spent[WRITING]),
            "llvm": sum(duration for duration, _ in spent[COMPILING]),
            "code": machine.code_bytes(),
            "scratch": max((more["scratch"] for _, more in spent[WRITING]), default=0),
            "compiler": largest,
            "native": not fallbacks,
        },
    }
    return ready, lambda question: {"seconds": seconds(live)}


if __name__ == "__main__":
    _kind, _count, _size = sys.argv[1:]
    serve(lambda: _prepare(_kind, int(_count), int(_size)))
