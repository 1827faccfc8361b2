"""Of the command cpg: the search for settings that give a wanted rhythm."""

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evo_cpg.analysis.chains import Chain, chains
from evo_cpg.analysis.lag_survey import UnreachableRhythmError
from evo_cpg.analysis.limit_cycle import NoRhythmError, RhythmSearchError
from evo_cpg.analysis.reference_rhythm import Rhythm, reference_rhythm, rhythm
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.exit_codes import ExitCode
from evo_cpg.cli.rhythm import hertz, read_oscillators, stability
from evo_cpg.cli.tables import show_table
from evo_cpg.config.errors import nearest
from evo_cpg.control.matsuoka import CpgSettings
from evo_cpg.creature.tree import Tree
from evo_cpg.training.compile_cache import keep_compiled_programs

# What the search may change, but for the range of b.
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
    """`evo-cpg cpg` with `--frequency` or `--lag`.

    Raises:
        UsageError: an option is wrong, the oscillators rest, or the rhythm is out of reach.
        SystemExit: with `ExitCode.FAULT`, where the search failed.
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
        hint = "; --lag looks for one that does" if lag is None else ""
        raise UsageError(f"{path}: {chain.name}: {error}{hint}") from None
    except RhythmSearchError as error:
        print(f"evo-cpg: {path}: {chain.name}: {error}", file=sys.stderr)
        raise SystemExit(ExitCode.FAULT) from None
    _show(chain, settings, b, before, found)
    changes = _changes(settings, found)
    if not changes:
        print("The settings give it as they are.")
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
            f"\nThe brain sets b within this range, whose middle is {held}. With {held} for both "
            "ends of it\nthe brain can set nothing else."
        )
    print(f"\nThe rhythm, with b held there:\n{shlex.join(shown)}")


def _check(
    frequency: float | None, lag: float | None, gain: float | None, tonic_input: float | None
) -> None:
    if frequency is None and lag is None:
        raise UsageError("--chain goes with --frequency or --lag")
    if frequency is not None and not 0 < frequency < np.inf:
        raise UsageError(f"--frequency {frequency:g}: must be a positive number of Hz")
    if lag is not None and not -180 < lag < 180:
        raise UsageError(f"--lag {lag:g}: must lie between -180 and 180 degrees")
    if gain is not None and not 0 < gain < np.inf:
        raise UsageError(f"--gain {gain:g}: must be a positive number")
    if tonic_input is not None and not 0 < tonic_input < np.inf:
        raise UsageError(
            f"--tonic-input {tonic_input:g}: must be a positive number; without input all rests"
        )


def _chain(tree: Tree, settings: CpgSettings, joint: str | None) -> Chain:
    """The longest, or the longest through an oscillator."""
    if joint is None:
        return chains(tree, settings)[0]
    if joint not in tree.dof_names:
        raise UsageError(f"--chain {joint}: no such oscillator; {nearest(joint, tree.dof_names)}")
    index = tree.dof_names.index(joint)
    return next(chain for chain in chains(tree, settings) if index in chain.oscillators)


def _changes(settings: CpgSettings, found: Rhythm) -> dict[str, float]:
    """The keys of `controller.cpg` whose values are new; the range of b is moved about b."""
    low, high = settings.min_adaptation_gain, settings.max_adaptation_gain
    share = 2 * found.adaptation_gain / (low + high)
    then = {key: getattr(found.settings, key) for key in _WEIGHTS}
    then |= {"min_adaptation_gain": share * low, "max_adaptation_gain": share * high}
    return {
        key: value
        for key, value in then.items()
        if not np.isclose(value, getattr(settings, key), rtol=1e-6, atol=0)
    }


def _show(
    chain: Chain, settings: CpgSettings, gain: float, before: Rhythm | str, found: Rhythm
) -> None:
    rows = [
        ("b", f"{gain:g}", f"{found.adaptation_gain:g}"),
        *(
            (key, f"{getattr(settings, key):g}", f"{getattr(found.settings, key):g}")
            for key in _WEIGHTS
        ),
        *zip(_NAMES, _words(before), _words(found), strict=True),
    ]
    show_table(("", "now", "then"), rows, title=chain.name)


_NAMES = (
    "frequency, Hz",
    "lag, deg",
    "  from joint to joint",
    "amplitude",
    "multiplier",
    "recovery, s",
)


def _words(found: Rhythm | str) -> tuple[str, ...]:
    """A rhythm's numbers, or a word for what there is in its place."""
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
