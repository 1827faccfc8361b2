"""The command that shows the rhythm of a config's oscillators: cpg."""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evo_cpg.analysis.limit_cycle import (
    LimitCycle,
    NoRhythmError,
    RhythmSearchError,
    limit_cycle,
    parts,
)
from evo_cpg.cli.building import build
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.exit_codes import ExitCode
from evo_cpg.cli.oscillators import warn_of_oscillators
from evo_cpg.cli.tables import show_table
from evo_cpg.config.load import load_config
from evo_cpg.control.couplings import ring_members
from evo_cpg.control.matsuoka import Oscillators
from evo_cpg.simulation.simulation import Simulation

_COLUMNS = ("joints", "Hz", "lag, deg", "amplitude", "multiplier", "recovery")


def read_oscillators(path: Path, overrides: Sequence[str]) -> tuple[Simulation, Oscillators]:
    """Return a config's simulation and its oscillators.

    Raises:
        UsageError: the controller has no oscillators.
    """
    simulation = build(load_config(path, overrides), path).simulation
    oscillators = simulation.controller.rhythm_generator
    if oscillators is None:
        raise UsageError(
            f"{path}: its controller has no oscillators; `controller.type: brain_cpg` has"
        )
    return simulation, oscillators


def show_rhythm(
    path: Path, overrides: Sequence[str], gain: float | None, tonic_input: float | None
) -> None:
    """`evo-cpg cpg`.

    Raises:
        SystemExit: with `ExitCode.FAULT`, where the search failed for some oscillators.
    """
    simulation, (cpg, network, _) = read_oscillators(path, overrides)
    tree = simulation.world.tree
    middle = (cpg.min_adaptation_gain + cpg.max_adaptation_gain) / 2
    gains = np.full(network.oscillator_count, middle if gain is None else gain)
    tonic = cpg.max_tonic_input if tonic_input is None else tonic_input
    drive = np.full((2, network.oscillator_count), tonic)
    rows: list[tuple[str, ...]] = []
    rests: dict[str, list[str]] = {}
    failures: dict[str, list[str]] = {}
    cycles: dict[int, LimitCycle] = {}
    for part in parts(network):
        first, *others = part
        names = tree.dof_names[first] + (f" + {len(others)}" if others else "")
        try:
            cycle = limit_cycle(network, drive, gains, part)
            rows.append((names, *_words(cycle)))
            cycles |= dict.fromkeys(part, cycle)
        except NoRhythmError as error:
            rows.append((names, "rest"))
            rests.setdefault(str(error), []).append(names)
        except RhythmSearchError as error:
            rows.append((names, "not found"))
            failures.setdefault(str(error), []).append(names)
    show_table(_COLUMNS, rows, title=f"b = {gains[0]:g}, u = {tonic:g}")
    for i, ring in enumerate(cpg.rings):
        members = ring_members(tree, ring, i)
        if members[0] in cycles:
            lags = ", ".join(f"{lag:.1f}" for lag in cycles[members[0]].lags(members))
            names = ", ".join(tree.dof_names[member] for member in members)
            print(f"ring of {names}: {lags} deg behind the one before")
    for reason, who in rests.items():
        print(f"{', '.join(who)}: {reason}")
    warn_of_oscillators(path, simulation)
    if failures:
        for reason, who in failures.items():
            print(f"evo-cpg: {path}: {', '.join(who)}: {reason}", file=sys.stderr)
        raise SystemExit(ExitCode.FAULT)


def _words(cycle: LimitCycle) -> tuple[str, ...]:
    """A row of the table."""
    # Beside an oscillator that rests there is no lag.
    lags = cycle.lag[np.isfinite(cycle.lag)]
    lag = f"{lags.min():.1f} to {lags.max():.1f}" if len(lags) else ""
    return (
        hertz(cycle),
        lag,
        f"{cycle.amplitude.min():.2g} to {cycle.amplitude.max():.2g}",
        *stability(cycle, " s"),
    )


def hertz(cycle: LimitCycle) -> str:
    """The frequency, with four digits after those of a whole number, however slow it is."""
    return f"{cycle.frequency:#.5g}" if cycle.frequency >= 1 else f"{cycle.frequency:#.4g}"


def stability(cycle: LimitCycle, unit: str) -> tuple[str, str]:
    """The largest multiplier, and the time of recovery with its unit."""
    size = np.abs(cycle.multipliers[0])
    if np.isnan(size):
        return "unknown", "unknown"
    recovery = f"{cycle.recovery_time:.3g}{unit}" if cycle.stable else "unstable"
    return f"{size:.3g}", recovery
