"""Peak memory of a motion, in a process of its own.

Run as a program, this module is the worker: `python -m benchmarks.memory CASE SIZE`.
"""

import sys
from typing import Any

from benchmarks.plan import Plan
from benchmarks.worker import WorkerError, serve, started

# Physics steps of the motion.
_STEPS = 10


def peak_of_motion(case: str, size: int, plan: Plan) -> int | None:
    """Return the peak memory to compile and run an animal's physics, bytes, or None if it fails.

    Args:
        case: name of the animal's case.
        size: number of individuals.
        plan: time limit and settings.
    """
    plan.say(f"{case}, {size} individuals: memory")
    with started("memory", case, str(size)) as worker:
        try:
            return int(worker.answer(plan.limit)["peak"])
        except WorkerError:
            return None


def _prepare(case: str, size: int) -> tuple[dict[str, Any], Any]:
    from benchmarks.animals import ANIMALS
    from benchmarks.machine import peak_memory
    from benchmarks.ours import compile_motion, full_lanes
    from evo_cpg.training.devices import population_mesh, use_cores

    use_cores()
    mesh, exercise = population_mesh(), ANIMALS[case]().exercise
    compile_motion(exercise, exercise.lanes(full_lanes(size, mesh)), mesh).run(_STEPS)
    return {"peak": peak_memory()}, lambda question: {}


if __name__ == "__main__":
    _case, _size = sys.argv[1:]
    serve(lambda: _prepare(_case, int(_size)))
