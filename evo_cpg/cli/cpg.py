"""`evo-cpg cpg`: show or find the rhythm of a configuration's oscillators."""

from typing import Annotated

import typer

from evo_cpg.cli.options import Config, Overrides


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
    from evo_cpg.cli.rhythm import find_rhythm, show_rhythm

    given = config, overrides or [], gain, tonic_input
    if frequency is None and lag is None and chain is None:
        show_rhythm(*given)
    else:
        find_rhythm(*given, frequency, lag, chain)
