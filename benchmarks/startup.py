"""From the shell's prompt to the end of the first generation, and the same again.

A process of its own for each, with a home and cache folder that begin empty and that both share:
if anything compiled is kept, the second start shows it. Python's own bytecode is there already.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.plan import CONFIGS, ROOT, Plan, experiment_of, swimmer_settings
from benchmarks.rows import SECONDS, Row
from benchmarks.timing import seconds

# Where a user may have told JAX to keep what it compiles; the folder here must begin empty.
_CACHE = "JAX_COMPILATION_CACHE_DIR"


class StartError(Exception):
    """The program that was started failed."""


def measure(plan: Plan) -> list[Row]:
    """The first start ever, and the second one."""
    overrides = ("evolution.generations=1", *swimmer_settings(plan))
    population = experiment_of("iwadate2010_swimmer", *overrides).genetics.population
    how = (
        "evo-cpg train configs/iwadate2010_swimmer.yaml "
        f"{' '.join(overrides)}, a process of its own, wall clock"
    )
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for part in ("first ever", "again"):
            plan.say(f"startup: {part}")
            taken = seconds(lambda part=part: _start(Path(folder), part, overrides))
            rows.append(Row("startup", part, population, taken, SECONDS, how))
    return rows


def _start(folder: Path, part: str, overrides: tuple[str, ...]) -> None:
    home, out = folder / "home", folder / part.replace(" ", "-")
    home.mkdir(exist_ok=True)
    environment = {key: value for key, value in os.environ.items() if key != _CACHE}
    environment |= {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    environment["PYTHONPATH"] = os.pathsep.join(
        filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])
    )
    config = CONFIGS / "iwadate2010_swimmer.yaml"
    command = [sys.executable, "-m", "evo_cpg.cli.main", "train", str(config), *overrides]
    done = subprocess.run(
        [*command, "--out", str(out)], env=environment, capture_output=True, text=True
    )
    if done.returncode:
        raise StartError(f"{' '.join(command)}: code {done.returncode}: {done.stderr.strip()}")
