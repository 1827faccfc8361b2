"""`evo-cpg cpg`: the rhythm of a configuration's oscillators."""

from typing import Annotated

import typer

from evo_cpg.cli.options import Config, Overrides


def cpg(
    config: Config,
    overrides: Overrides = None,
    gain: Annotated[
        float | None,
        typer.Option(min=0, help="Adaptation gain b; the middle of its range by default."),
    ] = None,
    tonic_input: Annotated[
        float | None, typer.Option(min=0, help="Tonic input u; the largest by default.")
    ] = None,
    frequency: Annotated[
        float | None, typer.Option(help="Look for settings that give this frequency, in Hz.")
    ] = None,
    lag: Annotated[
        float | None,
        typer.Option(
            help="Look for settings that give this mean lag along a chain, in degrees; "
            "negative from tail to head."
        ),
    ] = None,
    chain: Annotated[
        str | None,
        typer.Option(
            metavar="JOINT", help="Mean the longest chain through this oscillator, not of all."
        ),
    ] = None,
) -> None:
    """Show the rhythm of a config's oscillators, or settings that give a wanted one."""
    if frequency is not None or lag is not None or chain is not None:
        from evo_cpg.cli.wanted import find_rhythm

        find_rhythm(config, overrides or [], gain, tonic_input, frequency, lag, chain)
        return
    from evo_cpg.cli.rhythm import show_rhythm

    show_rhythm(config, overrides or [], gain, tonic_input)
