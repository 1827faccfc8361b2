"""Time from the shell's prompt to the end of the first generation, for two starts.

Each start has a process of its own. Both share a home and a cache folder that are initially empty,
so that a cache of compiled code shows in the second start. Python's own bytecode exists already.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.plan import CONFIGS, ROOT, Plan, experiment_of, swimmer_settings
from benchmarks.rows import SECONDS, Row

# Variable for JAX's cache folder, which the user may have set. The benchmark needs an empty folder.
_CACHE = "JAX_COMPILATION_CACHE_DIR"

# Interval between checks of the run folder, s.
_LOOK_AGAIN = 0.02


class StartError(Exception):
    """The `evo-cpg train` process that was timed failed."""


def measure(plan: Plan) -> Iterator[Row]:
    """Yield a row of the first start, then a row of the second."""
    overrides = ("evolution.generations=1", *swimmer_settings(plan))
    population = experiment_of("iwadate2010_swimmer", *overrides).strategy.population
    how = (
        "evo-cpg train configs/iwadate2010_swimmer.yaml "
        f"{' '.join(overrides)}, a process of its own, wall clock"
    )
    with tempfile.TemporaryDirectory() as folder:
        for part in ("first ever", "again"):
            plan.say(f"startup: {part}")
            taken = _start(Path(folder), part, overrides)
            yield Row("startup", part, population, taken, SECONDS, how)


def _start(folder: Path, part: str, overrides: tuple[str, ...]) -> float:
    """Return the time until the run folder holds the first generation, s.

    Raises:
        StartError: the program failed.
    """
    home, out = folder / "home", folder / part.replace(" ", "-")
    home.mkdir(exist_ok=True)
    environment = {key: value for key, value in os.environ.items() if key != _CACHE}
    environment |= {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    environment["PYTHONPATH"] = os.pathsep.join(
        filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])
    )
    config = CONFIGS / "iwadate2010_swimmer.yaml"
    command = [sys.executable, "-m", "evo_cpg", "train", str(config), *overrides]
    start, taken = time.perf_counter(), None
    with subprocess.Popen(
        [*command, "--out", str(out)], env=environment, stderr=subprocess.PIPE, text=True
    ) as process:
        while taken is None and process.poll() is None:
            if (out / "metrics.csv").exists():
                taken = time.perf_counter() - start
            time.sleep(_LOOK_AGAIN)
        complaint = process.communicate()[1]
    if process.returncode or taken is None:
        raise StartError(f"{' '.join(command)}: code {process.returncode}: {complaint.strip()}")
    return taken
