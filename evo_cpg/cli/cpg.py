"""`evo-cpg cpg`: show the rhythm of a configuration's oscillators."""

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
) -> None:
    """Show the rhythm of the oscillators."""
    from evo_cpg.api.advice import about_oscillators
    from evo_cpg.api.experiment import load
    from evo_cpg.api.rhythm import rhythm
    from evo_cpg.cli.errors import ExitCode
    from evo_cpg.cli.terminal import tell, warn

    experiment = load(config, overrides or [])
    shown = rhythm(experiment, gain, tonic_input)
    _show(shown)
    for line in about_oscillators(experiment.parts.simulation):
        warn(f"{config}: {line}")
    failed = [part for part in shown.groups if part.cycle is None and not part.rests]
    for part in failed:
        tell(f"evo-cpg: {config}: {_name(part.oscillators)}: {part.reason}")
    if failed:
        raise SystemExit(ExitCode.FAULT)


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
