"""The command that shows the rhythm of a config's oscillators: cpg."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from evo_cpg.analysis.limit_cycle import LimitCycle, NoRhythmError, limit_cycle, parts
from evo_cpg.cli.errors import UsageError
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.control.brain_cpg import BrainCpg

_COLUMNS = ("joints", "frequency", "lag", "amplitude", "multiplier", "recovery")


def show_rhythm(
    path: Path, overrides: Sequence[str], gain: float | None, tonic_input: float | None
) -> None:
    """`evo-cpg cpg`."""
    simulation = build_experiment(load_config(path, overrides), path).simulation
    controller, tree = simulation.controller, simulation.world.tree
    if not isinstance(controller, BrainCpg):
        raise UsageError(
            f"{path}: its controller has no oscillators; `controller.type: brain_cpg` has"
        )
    cpg, network = controller.settings.cpg, controller.network
    middle = (cpg.min_adaptation_gain + cpg.max_adaptation_gain) / 2
    gains = np.full(network.oscillator_count, middle if gain is None else gain)
    tonic = cpg.max_tonic_input if tonic_input is None else tonic_input
    drive = np.full((2, network.oscillator_count), tonic)
    table = Table(title=f"b = {gains[0]:g}, u = {tonic:g}")
    for column in _COLUMNS:
        table.add_column(column, justify="left" if column == "joints" else "right")
    for part in parts(network):
        names = f"{tree.dof_names[part[0]]}"
        if len(part) > 1:
            names += f" to {tree.dof_names[part[-1]]} ({len(part)})"
        try:
            table.add_row(names, *_words(limit_cycle(network, drive, gains, part)))
        except NoRhythmError as error:
            table.add_row(names, f"none: {error}")
    Console().print(table)


def _words(cycle: LimitCycle) -> tuple[str, ...]:
    """A row of the table."""
    lag = f"{cycle.lag.min():.1f} to {cycle.lag.max():.1f} deg" if len(cycle.lag) else ""
    recovery = f"{cycle.recovery_time:.2f} s" if cycle.stable else "unstable"
    return (
        f"{cycle.frequency:.4f} Hz",
        lag,
        f"{cycle.amplitude.min():.3f} to {cycle.amplitude.max():.3f}",
        f"{np.abs(cycle.multipliers[0]):.3f}",
        recovery,
    )
