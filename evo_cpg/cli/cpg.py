"""`evo-cpg cpg`: show or find the rhythm of a configuration's oscillators."""

import shlex
from typing import TYPE_CHECKING, Annotated

import typer

from evo_cpg.cli.options import Config, Overrides

if TYPE_CHECKING:
    from evo_cpg.analysis.limit_cycle import LimitCycle
    from evo_cpg.api.rhythm import Rhythms


def cpg(
    config: Config,
    overrides: Overrides = None,
    gain: Annotated[
        float | None,
        typer.Option(min=0, help="Adaptation gain b (default: the middle of its range)."),
    ] = None,
    tonic_input: Annotated[
        float | None, typer.Option(min=0, help="Tonic input u (default: the largest).")
    ] = None,
    frequency: Annotated[
        float | None, typer.Option(help="Find settings with this frequency, Hz.")
    ] = None,
    lag: Annotated[
        float | None,
        typer.Option(
            help="Find settings with this mean lag along a chain, degrees (negative: from tail "
            "to head)."
        ),
    ] = None,
    chain: Annotated[
        str | None,
        typer.Option(metavar="JOINT", help="Use the longest chain that contains this oscillator."),
    ] = None,
) -> None:
    """Show the rhythm of the oscillators, or find settings for one."""
    from evo_cpg.analysis.limit_cycle import RhythmSearchError
    from evo_cpg.api.advice import about_oscillators
    from evo_cpg.api.experiment import load
    from evo_cpg.api.rhythm import CHANGED, find_rhythm, rhythm
    from evo_cpg.cli.errors import ExitCode
    from evo_cpg.cli.terminal import show_table, tell, warn

    experiment = load(config, overrides or [])
    if frequency is None and lag is None and chain is None:
        shown = rhythm(experiment, gain, tonic_input)
        _show(shown)
        for line in about_oscillators(experiment.parts.simulation):
            warn(f"{config}: {line}")
        failed = [part for part in shown.groups if part.cycle is None and not part.rests]
        for part in failed:
            tell(f"evo-cpg: {config}: {_name(part.oscillators)}: {part.reason}")
        if failed:
            raise SystemExit(ExitCode.FAULT)
        return
    try:
        found = find_rhythm(
            experiment, frequency, lag, gain=gain, tonic_input=tonic_input, joint=chain
        )
    except RhythmSearchError as error:
        tell(f"evo-cpg: {error}")
        raise SystemExit(ExitCode.FAULT) from None
    # Print the settings and the rhythm, before and after.
    names = ("frequency, Hz", "amplitude", "multiplier", "recovery, s", "lag, deg")
    names += ("  from joint to joint",)
    now, then = found.present, found.found
    cells = []
    for one in (found.before, then):
        if isinstance(one, str):
            cells.append((one, *[""] * (len(names) - 1)))
            continue
        along = f"{one.lags.min():.1f} to {one.lags.max():.1f}" if len(one.lags) else ""
        cells.append((*_numbers(one.cycle), f"{one.lag:.2f}" if len(one.lags) else "", along))
    rows = [
        ("b", f"{found.present_gain:g}", f"{then.adaptation_gain:g}"),
        *((key, f"{getattr(now, key):g}", f"{getattr(then.settings, key):g}") for key in CHANGED),
        *zip(names, *cells, strict=True),
    ]
    show_table(("", "present", "found"), rows, title=found.chain.name)
    if not found.changes:
        print("The present settings already have this rhythm.")
        return
    print("controller:\n  cpg:")
    for key, value in found.changes.items():
        print(f"    {key}: {value:.8g}")
    words = [f"controller.cpg.{key}={value:.8g}" for key, value in found.changes.items()]
    held = f"{then.adaptation_gain:.8g}"
    again = ["evo-cpg", "cpg", str(config), *(overrides or []), *words, "--gain", held]
    again += [] if tonic_input is None else ["--tonic-input", f"{tonic_input:.8g}"]
    if "min_adaptation_gain" in found.changes:
        print(
            f"\nThe brain sets b within this range, whose middle is {held}. To fix b, set both "
            f"ends to {held}."
        )
    print(f"\nTo show the rhythm with b held at this value:\n{shlex.join(again)}")


def _name(oscillators: tuple[str, ...]) -> str:
    first, *others = oscillators
    return f"{first} + {len(others)}" if others else first


def _show(shown: "Rhythms") -> None:
    """Print a row for each group of oscillators, and the lags of legs and rings below."""
    from evo_cpg.cli.terminal import show_table, show_words

    heads = ("joints", "Hz", "lag, deg", "amplitude", "multiplier", "recovery")
    rows = []
    for part in shown.groups:
        if part.cycle is None:
            rows.append((_name(part.oscillators), "rest" if part.rests else "not found"))
            continue
        # An oscillator has no lag to an oscillator at rest.
        known = part.cycle.lag[part.cycle.lag == part.cycle.lag]
        lag = f"{known.min():.1f} to {known.max():.1f}" if len(known) else ""
        hertz, swing, multiplier, recovery = _numbers(part.cycle)
        lag = "below" if part.branched else lag
        rows.append((_name(part.oscillators), hertz, lag, swing, multiplier, recovery))
    title = f"b = {shown.adaptation_gain:g}, u = {shown.tonic_input:g}"
    show_table(heads, rows, title=title)
    for part in shown.groups:
        if part.branched and part.cycle is not None:
            first, *others = part.cycle.oscillators
            behind = [part.cycle.lags((first, i))[1] for i in others]
            names = zip(part.oscillators[1:], behind, strict=True)
            listed = ", ".join(f"{name} {round(lag)}" for name, lag in names if lag == lag)
            show_words(f"lag of each oscillator behind {part.oscillators[0]}, deg: {listed}")
    for names, lags in shown.rings:
        words = ", ".join(f"{lag:.1f}" for lag in lags)
        show_words(f"ring of {', '.join(names)}: each lags behind the one before by {words} deg")
    resting: dict[str, list[str]] = {}
    for part in shown.groups:
        if part.rests:
            resting.setdefault(part.reason, []).append(_name(part.oscillators))
    for reason, names in resting.items():
        show_words(f"{', '.join(names)}: {reason}")
    if shown.open_loop:
        show_words(
            "open loop: without the senses of controller.cpg.feedback, which change the rhythm"
        )


def _numbers(cycle: "LimitCycle") -> tuple[str, str, str, str]:
    """Return frequency (Hz), amplitudes, size of the largest multiplier, and recovery time (s)."""
    digits, swing = 5 if cycle.frequency >= 1 else 4, cycle.amplitude
    frequency = f"{cycle.frequency:#.{digits}g}"
    amplitude = f"{swing.min():.2g} to {swing.max():.2g}"
    size, recovery = abs(cycle.multipliers[0]), f"{cycle.recovery_time:.3g}"
    if size != size:
        return frequency, amplitude, "unknown", "unknown"
    return frequency, amplitude, f"{size:.3g}", recovery if cycle.stable else "unstable"
