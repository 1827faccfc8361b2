"""Rhythm of a configuration's oscillators, and search for settings with a requested rhythm."""

import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evo_cpg.analysis.chains import Chain, chains
from evo_cpg.analysis.lag_survey import UnreachableRhythmError
from evo_cpg.analysis.limit_cycle import (
    LimitCycle,
    NoRhythmError,
    RhythmSearchError,
    limit_cycle,
    parts,
)
from evo_cpg.analysis.reference_rhythm import Rhythm, reference_rhythm, rhythm
from evo_cpg.cli.advice import about_oscillators
from evo_cpg.cli.building import build
from evo_cpg.cli.errors import ExitCode, UsageError, tell, warn
from evo_cpg.cli.tables import show_table, show_words
from evo_cpg.control.couplings import ring_members
from evo_cpg.control.matsuoka import CpgSettings, Oscillators
from evo_cpg.creature.tree import Tree
from evo_cpg.io.errors import nearest
from evo_cpg.io.load import load_config
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.devices import keep_compiled_programs

_COLUMNS = ("joints", "Hz", "lag, deg", "amplitude", "multiplier", "recovery")


def read_oscillators(path: Path, overrides: Sequence[str]) -> tuple[Simulation, Oscillators]:
    """Return the simulation of a configuration, and its oscillators.

    Raises:
        UsageError: the controller has no oscillators.
    """
    simulation = build(load_config(path, overrides), path).simulation
    oscillators = simulation.controller.rhythm_generator
    if oscillators is None:
        raise UsageError(
            f"{path}: its controller has no oscillators. Choose controller.type: brain_cpg"
        )
    return simulation, oscillators


def show_rhythm(
    path: Path, overrides: Sequence[str], gain: float | None, tonic_input: float | None
) -> None:
    """Print the rhythm of each group of oscillators, for `evo-cpg cpg`.

    Args:
        path: path of the configuration.
        overrides: settings to change, ``key=value``.
        gain: adaptation gain b, or None for the middle of its range.
        tonic_input: tonic input u, or None for the largest.

    Raises:
        SystemExit: with `ExitCode.FAULT`, if the search failed for some oscillators.
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
    in_a_row = {tuple(sorted(chain.oscillators)) for chain in chains(tree, cpg)}
    branched = {part for part in parts(network) if len(part) > 2 and part not in in_a_row}
    for part in parts(network):
        first, *others = part
        names = tree.dof_names[first] + (f" + {len(others)}" if others else "")
        try:
            cycle = limit_cycle(network, drive, gains, part)
            rows.append((names, *_words(cycle, part in branched)))
            cycles |= dict.fromkeys(part, cycle)
        except NoRhythmError as error:
            rows.append((names, "rest"))
            rests.setdefault(str(error), []).append(names)
        except RhythmSearchError as error:
            rows.append((names, "not found"))
            failures.setdefault(str(error), []).append(names)
    show_table(_COLUMNS, rows, title=f"b = {gains[0]:g}, u = {tonic:g}")
    for part in parts(network):
        if part in branched and part[0] in cycles:
            cycle, first = cycles[part[0]], tree.dof_names[part[0]]
            behind = {tree.dof_names[i]: cycle.lags((part[0], i))[1] for i in part[1:]}
            listed = ", ".join(f"{name} {round(lag)}" for name, lag in behind.items())
            show_words(f"lag of each oscillator behind {first}, deg: {listed}")
    for i, ring in enumerate(cpg.rings):
        members = ring_members(tree, ring, i)
        if members[0] in cycles:
            lags = ", ".join(f"{lag:.1f}" for lag in cycles[members[0]].lags(members))
            names = ", ".join(tree.dof_names[member] for member in members)
            show_words(f"ring of {names}: each lags behind the one before by {lags} deg")
    for reason, joints in rests.items():
        show_words(f"{', '.join(joints)}: {reason}")
    if cpg.feedback is not None:
        show_words(
            "open loop: without the senses of controller.cpg.feedback, which change the rhythm"
        )
    for line in about_oscillators(simulation):
        warn(f"{path}: {line}")
    if failures:
        for reason, joints in failures.items():
            tell(f"evo-cpg: {path}: {', '.join(joints)}: {reason}")
        raise SystemExit(ExitCode.FAULT)


def _words(cycle: LimitCycle, branched: bool) -> tuple[str, ...]:
    """Return the cells of a rhythm in the table. Lags of branched oscillators are below it."""
    # An oscillator has no lag to an oscillator at rest.
    lags = cycle.lag[np.isfinite(cycle.lag)]
    lag = f"{lags.min():.1f} to {lags.max():.1f}" if len(lags) else ""
    return (
        hertz(cycle),
        "below" if branched else lag,
        f"{cycle.amplitude.min():.2g} to {cycle.amplitude.max():.2g}",
        *stability(cycle, " s"),
    )


def hertz(cycle: LimitCycle) -> str:
    """Return the frequency, Hz, with four or five significant digits."""
    return f"{cycle.frequency:#.5g}" if cycle.frequency >= 1 else f"{cycle.frequency:#.4g}"


def stability(cycle: LimitCycle, unit: str) -> tuple[str, str]:
    """Return the size of the largest Floquet multiplier, and the recovery time with its unit."""
    size = np.abs(cycle.multipliers[0])
    if np.isnan(size):
        return "unknown", "unknown"
    recovery = f"{cycle.recovery_time:.3g}{unit}" if cycle.stable else "unstable"
    return f"{size:.3g}", recovery


# Keys that the search may change, in addition to the range of b.
_WEIGHTS = ("time_scale", "parent_weight", "child_weight")


def find_rhythm(
    path: Path,
    overrides: Sequence[str],
    gain: float | None,
    tonic_input: float | None,
    frequency: float | None,
    lag: float | None,
    joint: str | None,
) -> None:
    """Find and print settings for a rhythm, for `evo-cpg cpg` with `--frequency` or `--lag`.

    Args:
        path: path of the configuration.
        overrides: settings to change, ``key=value``.
        gain: adaptation gain b to hold, or None to let the search change it.
        tonic_input: tonic input u, or None for the largest.
        frequency: requested frequency, Hz, if any.
        lag: requested mean lag along the chain, degrees, or None for the present lag.
        joint: oscillator that the chain must contain, or None for the longest chain.

    Raises:
        UsageError: an option is wrong, the oscillators rest, or the rhythm is out of reach.
        SystemExit: with `ExitCode.FAULT`, if the search failed.
    """
    _check(frequency, lag, gain, tonic_input)
    keep_compiled_programs()
    simulation, (settings, *_) = read_oscillators(path, overrides)
    tree = simulation.world.tree
    if frequency is not None and 2 * frequency >= simulation.control_rate:
        raise UsageError(
            f"--frequency {frequency:g}: must be less than half of the {simulation.control_rate:g} "
            "steps in which the controller acts each second (simulation.control_rate_hz)"
        )
    chain = _chain(tree, settings, joint)
    present = (settings.min_adaptation_gain + settings.max_adaptation_gain) / 2
    b = present if gain is None else gain
    try:
        before = rhythm(tree, settings, chain, b, tonic_input)
    except NoRhythmError:
        before = "rest"
    except RhythmSearchError:
        before = "not found"
    try:
        found = reference_rhythm(
            tree, settings, chain, b, frequency, lag, gain is not None, tonic_input
        )
    except UnreachableRhythmError as error:
        raise UsageError(f"{path}: {chain.name}: {error}") from None
    except NoRhythmError as error:
        hint = ". Search for a rhythm with --lag" if lag is None else ""
        raise UsageError(f"{path}: {chain.name}: {error}{hint}") from None
    except RhythmSearchError as error:
        tell(f"evo-cpg: {path}: {chain.name}: {error}")
        raise SystemExit(ExitCode.FAULT) from None
    _show_found(chain, settings, b, before, found)
    changes = _changes(settings, found)
    if not changes:
        print("The present settings already have this rhythm.")
        return
    print("controller:\n  cpg:")
    for key, value in changes.items():
        print(f"    {key}: {value:.8g}")
    words = [f"controller.cpg.{key}={value:.8g}" for key, value in changes.items()]
    held = f"{found.adaptation_gain:.8g}"
    shown = ["evo-cpg", "cpg", str(path), *overrides, *words, "--gain", held]
    shown += [] if tonic_input is None else ["--tonic-input", f"{tonic_input:.8g}"]
    if "min_adaptation_gain" in changes:
        print(
            f"\nThe brain sets b within this range, whose middle is {held}. To fix b, set both "
            f"ends to {held}."
        )
    print(f"\nTo show the rhythm with b held at this value:\n{shlex.join(shown)}")


def _check(
    frequency: float | None, lag: float | None, gain: float | None, tonic_input: float | None
) -> None:
    if frequency is None and lag is None:
        raise UsageError("--chain needs --frequency or --lag. Add one of them")
    if frequency is not None and not 0 < frequency < np.inf:
        raise UsageError(f"--frequency {frequency:g}: must be a positive number of Hz")
    if lag is not None and not -180 < lag < 180:
        raise UsageError(f"--lag {lag:g}: must lie between -180 and 180 degrees")
    if gain is not None and not 0 < gain < np.inf:
        raise UsageError(f"--gain {gain:g}: must be a positive number")
    if tonic_input is not None and not 0 < tonic_input < np.inf:
        raise UsageError(
            f"--tonic-input {tonic_input:g}: must be a positive number. Oscillators without input "
            "rest"
        )


def _chain(tree: Tree, settings: CpgSettings, joint: str | None) -> Chain:
    """Return the longest chain, or the longest chain through an oscillator."""
    if joint is None:
        return chains(tree, settings)[0]
    if joint not in tree.dof_names:
        raise UsageError(f"--chain {joint}: no such oscillator: {nearest(joint, tree.dof_names)}")
    index = tree.dof_names.index(joint)
    return next(chain for chain in chains(tree, settings) if index in chain.oscillators)


def _changes(settings: CpgSettings, found: Rhythm) -> dict[str, float]:
    """Return changed keys of `controller.cpg`. The middle of the new range of b is the found b."""
    low, high = settings.min_adaptation_gain, settings.max_adaptation_gain
    factor = 2 * found.adaptation_gain / (low + high)
    then = {key: getattr(found.settings, key) for key in _WEIGHTS}
    then |= {"min_adaptation_gain": factor * low, "max_adaptation_gain": factor * high}
    return {
        key: value
        for key, value in then.items()
        if not np.isclose(value, getattr(settings, key), rtol=1e-6, atol=0)
    }


def _show_found(
    chain: Chain, settings: CpgSettings, gain: float, before: Rhythm | str, found: Rhythm
) -> None:
    rows = [
        ("b", f"{gain:g}", f"{found.adaptation_gain:g}"),
        *(
            (key, f"{getattr(settings, key):g}", f"{getattr(found.settings, key):g}")
            for key in _WEIGHTS
        ),
        *zip(_NAMES, _rhythm_words(before), _rhythm_words(found), strict=True),
    ]
    show_table(("", "present", "found"), rows, title=chain.name)


_NAMES = (
    "frequency, Hz",
    "lag, deg",
    "  from joint to joint",
    "amplitude",
    "multiplier",
    "recovery, s",
)


def _rhythm_words(found: Rhythm | str) -> tuple[str, ...]:
    """Return the numbers of a rhythm, or a word if there is none."""
    if isinstance(found, str):
        return (found, *[""] * (len(_NAMES) - 1))
    cycle, lags = found.cycle, found.lags
    amplitude = cycle.amplitude
    return (
        hertz(cycle),
        f"{found.lag:.2f}" if len(lags) else "",
        f"{lags.min():.1f} to {lags.max():.1f}" if len(lags) else "",
        f"{amplitude.min():.2g} to {amplitude.max():.2g}",
        *stability(cycle, ""),
    )
