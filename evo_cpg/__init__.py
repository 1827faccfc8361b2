"""Evolve the motion of virtual creatures: ``import evo_cpg as evo``.

The names in `__all__` are stable (see docs/api.md). Each is imported at its first use, so importing
the package takes little time and starts nothing.
"""

# ruff: noqa: F401 - the imports for type checkers

import contextlib
import importlib
import os
from importlib import metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evo_cpg.analysis.laboratory.ask import Answer
    from evo_cpg.api.analyse import Analysis, analyse, gait_numbers
    from evo_cpg.api.audit import Audit, audit
    from evo_cpg.api.cluster import cluster
    from evo_cpg.api.environment import Environment, EnvironmentState, Session
    from evo_cpg.api.experiment import Experiment, Trials, load
    from evo_cpg.api.lab import lab
    from evo_cpg.api.probe import Probed, probe
    from evo_cpg.api.progress import show_progress
    from evo_cpg.api.record import Record
    from evo_cpg.api.refine import Refined, refine
    from evo_cpg.api.rhythm import rhythm
    from evo_cpg.api.runs import Verification, verify
    from evo_cpg.api.sensitivity import Sensitivities, sensitivity
    from evo_cpg.api.story import story
    from evo_cpg.api.sweep import Summary, sweep
    from evo_cpg.api.training import Trained, resume, train
    from evo_cpg.control.controller import Command, Controller, Observation
    from evo_cpg.evolution.strategy import Evaluation, Strategy
    from evo_cpg.io.errors import ConfigError
    from evo_cpg.physics.water.force_law import Bodies, ForceLaw
    from evo_cpg.simulation.sensors import Sensor
    from evo_cpg.simulation.snapshot import Forces, Snapshot
    from evo_cpg.simulation.task import Task, Transition

# Public names by module, in the order of the reference in docs/api.md.
_NAMES = {
    "api.experiment": ("load", "Experiment", "Trials"),
    "evolution.strategy": ("Evaluation", "Strategy"),
    "api.record": ("Record",),
    "api.environment": ("Environment", "EnvironmentState", "Session"),
    "api.training": ("train", "resume", "Trained"),
    "api.cluster": ("cluster",),
    "api.refine": ("refine", "Refined"),
    "api.sweep": ("sweep", "Summary"),
    "api.runs": ("verify", "Verification"),
    "api.audit": ("audit", "Audit"),
    "api.analyse": ("analyse", "Analysis", "gait_numbers"),
    "api.probe": ("probe", "Probed"),
    "api.sensitivity": ("sensitivity", "Sensitivities"),
    "api.story": ("story",),
    "api.rhythm": ("rhythm",),
    "api.lab": ("lab",),
    "analysis.laboratory.ask": ("Answer",),
    "api.progress": ("show_progress",),
    "simulation.task": ("Task", "Transition"),
    "simulation.snapshot": ("Snapshot", "Forces"),
    "simulation.sensors": ("Sensor",),
    "physics.water.force_law": ("ForceLaw", "Bodies"),
    "control.controller": ("Controller", "Observation", "Command"),
    "io.errors": ("ConfigError",),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}

__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


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
