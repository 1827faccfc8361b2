"""`evo-cpg probe`: test a champion in new situations."""

from typing import Annotated

import typer

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.options import Folder, Number, Run, Which
from evo_cpg.cli.writing import writes_to_run


@writes_to_run("out", "--out")
def probe(
    run: Run,
    bearings: Annotated[
        str | None,
        typer.Option(
            help="Bearings of the light, degrees to the left: START:STOP:COUNT or a list such as "
            "-60,0,60 (default: -75:75:11)."
        ),
    ] = None,
    distances: Annotated[
        str | None,
        typer.Option(
            help="Distances of the light, m, in the same form (default: from the configuration)."
        ),
    ] = None,
    trials: Annotated[
        bool, typer.Option("--trials", help="Use the situations of the configuration instead.")
    ] = False,
    blind: Annotated[bool, typer.Option("--blind", help="Set all light sensors to 0.")] = False,
    reach: Annotated[
        float,
        typer.Option(
            min=0,
            help="Largest fraction of the distance that may be left to a reached light.",
        ),
    ] = 0.2,
    number: Number = None,
    out: Folder = None,
) -> None:
    """Test the champion in new situations."""
    from evo_cpg.cli.probed import probe_champion

    if trials and (bearings is not None or distances is not None):
        raise UsageError(
            "--trials uses the lights of the configuration. Leave out --bearings and --distances, "
            "or --trials"
        )
    lights = None if trials else (bearings, distances)
    probe_champion(run, Which(number), lights, blind, reach, out or run)
