"""Time the swimmer's physics step once for every input line (see `benchmarks.matrix`)."""

import platform
from typing import Any

import jax

from benchmarks.exercise import Wave
from benchmarks.ours import compile_motion, full_lanes
from benchmarks.plan import experiment_of
from benchmarks.timing import seconds
from benchmarks.worker import serve
from evo_cpg.native.engine import Engine, described
from evo_cpg.training.devices import population_mesh, use_cores

_INDIVIDUALS = 200
_STEPS = 5000


def _prepare() -> tuple[dict[str, Any], Any]:
    """Compile swimmers with a travelling wave, on one core.

    Returns:
        A description of the environment, and a function that measures the time of a step, s.
    """
    use_cores(1)
    mesh, exercise = population_mesh(), Wave(experiment_of("iwadate2010_swimmer"))
    program = compile_motion(exercise, exercise.lanes(full_lanes(_INDIVIDUALS, mesh)), mesh)
    program.run(_STEPS)
    about = {
        "python": f"Python {platform.python_version()}",
        "jax": jax.__version__,
        "engine": ", ".join(f"{key} {value}" for key, value in described(Engine()).items()),
    }
    return about, lambda _: {"seconds": seconds(lambda: program.run(_STEPS)) / _STEPS}


if __name__ == "__main__":
    serve(_prepare)
