"""Swimmers that are small enough to evolve in a test, and a function that starts the program."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import yaml

import xla_flags

REPOSITORY = Path(__file__).parents[1]
CONFIG = REPOSITORY / "configs" / "iwadate2010_swimmer.yaml"

# Changes that make the published swimmer tiny: three bodies.
TINY = (
    "creature.bodies.1.repeat=2",
    "world.water.form_resolution=1",
    "controller.brain.hidden=[4]",
    "simulation.seconds=1",
    "evolution.population=8",
    "evolution.elites=2",
    "evolution.generations=4",
    "audit.after_training=false",
)

# Two bodies on a hinge, for tests of commands. Programs and compilation times are half as large.
PAIR = (*TINY, "creature.bodies.1.repeat=1", "creature.bodies.1.joint.axes=[z]")

# The same two bodies as overrides by key.
SMALL = {
    "creature.bodies.1.repeat": 1,
    "creature.bodies.1.joint.axes": ["z"],
    "world.water.form_resolution": 1,
    "controller.brain.hidden": [4],
    "simulation.seconds": 0.5,
}

# A viscosity has a drag law of its own. The swimmer names another law, and a coefficient.
VISCOUS = ("world.water.viscosity=0.001", "world.water.law=null", "world.water.skin_drag=null")

# Enough generations of enough length to stop a run in the middle, on a busy machine too.
GENERATIONS = 30
LONG = (*PAIR, "simulation.seconds=5", f"evolution.generations={GENERATIONS}")


def program(
    *arguments: object, compiled: Path, folder: Path | None = None
) -> subprocess.Popen[str]:
    """Start `evo-cpg` as a separate process.

    Args:
        arguments: arguments of the command line.
        compiled: folder for compiled programs, which the next process can use.
        folder: working folder.
    """
    # A background shell makes the tests and their child processes ignore SIGINT. The parent changes
    # that, because a change in the child needs a fork, and JAX warns about forks.
    interrupt = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "evo_cpg", *map(str, arguments)],
            env=environment(compiled),
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
    finally:
        signal.signal(signal.SIGINT, interrupt)


def contents(folder: Path) -> dict[Path, bytes | None]:
    """Return the bytes of every file below a folder, and None for its folders."""
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def own_config() -> dict:
    """Return the contents of the configuration, which find its creature from any folder."""
    config = yaml.safe_load(CONFIG.read_text())
    return config | {"creature": str(REPOSITORY / "configs" / config["creature"])}


def environment(compiled: Path) -> dict[str, str]:
    """Return the environment of a process that compiles quickly and only once."""
    return os.environ | {
        "PYTHONPATH": str(REPOSITORY),
        "XLA_FLAGS": " ".join(xla_flags.quick()),
        "JAX_COMPILATION_CACHE_DIR": str(compiled),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
