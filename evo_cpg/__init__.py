"""Evolve the motion of virtual creatures: ``import evo_cpg as evo``.

The names in `__all__` are stable (see docs/api.md). Each is imported at its first use, so importing
the package takes little time and starts nothing.
"""

import contextlib
import importlib
import os
from importlib import metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evo_cpg.analysis.laboratory.ask import Answer
    from evo_cpg.api.analyse import analyse, gait_numbers
    from evo_cpg.api.environment import Environment, EnvironmentState
    from evo_cpg.api.experiment import Experiment, Trials
    from evo_cpg.api.lab import lab
    from evo_cpg.api.load import load
    from evo_cpg.api.progress import show_progress
    from evo_cpg.api.record import Record
    from evo_cpg.api.training import Trained, train
    from evo_cpg.control.controller import Command, Controller, Observation
    from evo_cpg.evolution.strategy import Evaluation, Strategy
    from evo_cpg.io.errors import ConfigError
    from evo_cpg.physics.water.force_law import Bodies, ForceLaw
    from evo_cpg.simulation.sensors import Sensor
    from evo_cpg.simulation.snapshot import Forces, Snapshot
    from evo_cpg.simulation.task import Task, Transition

_HOMES = {
    "Answer": "analysis.laboratory.ask",
    "Bodies": "physics.water.force_law",
    "Command": "control.controller",
    "ConfigError": "io.errors",
    "Controller": "control.controller",
    "Environment": "api.environment",
    "EnvironmentState": "api.environment",
    "Evaluation": "evolution.strategy",
    "Experiment": "api.experiment",
    "ForceLaw": "physics.water.force_law",
    "Forces": "simulation.snapshot",
    "Observation": "control.controller",
    "Record": "api.record",
    "Sensor": "simulation.sensors",
    "Snapshot": "simulation.snapshot",
    "Strategy": "evolution.strategy",
    "Task": "simulation.task",
    "Trained": "api.training",
    "Transition": "simulation.task",
    "Trials": "api.experiment",
    "analyse": "api.analyse",
    "lab": "api.lab",
    "gait_numbers": "api.analyse",
    "load": "api.load",
    "show_progress": "api.progress",
    "train": "api.training",
}

__all__ = [  # noqa: RUF022 - in the order of the reference in docs/api.md
    "load",
    "Experiment",
    "Evaluation",
    "Trials",
    "Record",
    "Environment",
    "EnvironmentState",
    "train",
    "Trained",
    "analyse",
    "lab",
    "Answer",
    "gait_numbers",
    "show_progress",
    "Task",
    "Transition",
    "Snapshot",
    "Forces",
    "Sensor",
    "ForceLaw",
    "Bodies",
    "Controller",
    "Observation",
    "Command",
    "Strategy",
    "ConfigError",
]


# On CPUs, jaxlib 0.10.2 computes some sums of products wrongly and without an error, for instance
# sums of 3000 matrix products. Versions 0.10.1 and 0.11 are correct. XLA reads this flag at the
# first computation of JAX.
_WRONG, _WITHOUT = "0.10.2", "--xla_cpu_experimental_ynn_fusion_type="
with contextlib.suppress(metadata.PackageNotFoundError):
    if metadata.version("jaxlib") == _WRONG and _WITHOUT not in os.environ.get("XLA_FLAGS", ""):
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_WITHOUT}".lstrip()


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
