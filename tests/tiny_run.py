"""Swimmers that a test can afford to evolve, and a way to call the program."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import xla_flags

REPOSITORY = Path(__file__).parents[1]
CONFIG = REPOSITORY / "configs" / "iwadate2010_swimmer.yaml"

# What makes the published swimmer tiny: three bodies.
TINY = (
    "creature.bodies.1.repeat=2",
    "world.water.form_resolution=1",
    "controller.brain.hidden=[4]",
    "simulation.steps=60",
    "evolution.population=8",
    "evolution.elites=2",
    "evolution.generations=4",
    "audit.after_training=false",
)

# Where what matters is the command and not the animal: two bodies on a hinge. Programs are half as
# large, and so is the time to compile them.
PAIR = (*TINY, "creature.bodies.1.repeat=1", "creature.bodies.1.joint.axes=[z]")

# Enough generations, each long enough, to stop a run in the middle of on a busy machine.
GENERATIONS = 30
LONG = (*PAIR, "simulation.steps=300", f"evolution.generations={GENERATIONS}")


def program(
    *arguments: object, compiled: Path, folder: Path | None = None
) -> subprocess.Popen[str]:
    """Start `evo-cpg` as a process of its own, on two cores.

    Args:
        arguments: of the command line.
        compiled: where it keeps what it compiles, for the next process to use.
        folder: working folder.
    """
    # A shell that runs the tests in the background has them ignore it, and what they start. It is
    # not changed in the child itself, for that takes a fork, against which JAX warns.
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


def environment(compiled: Path) -> dict[str, str]:
    """Environment of a process that compiles quickly and only once."""
    return os.environ | {
        "PYTHONPATH": str(REPOSITORY),
        "XLA_FLAGS": " ".join(xla_flags.quick()),
        "JAX_COMPILATION_CACHE_DIR": str(compiled),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
