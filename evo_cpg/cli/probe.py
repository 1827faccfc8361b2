"""`evo-cpg probe`: test a champion in new situations."""

import time
from typing import Annotated

import typer

from evo_cpg.cli.errors import UsageError, warn
from evo_cpg.cli.options import Folder, Number, Run, Which
from evo_cpg.cli.writing import writes_to_run

_BEARINGS = "-75:75:11"
_MOST = 10_000


@writes_to_run("out", "--out")
def probe(
    run: Run,
    bearings: Annotated[
        str | None,
        typer.Option(
            help="Bearings of the light, degrees to the left: START:STOP:COUNT, -75:75:11 by "
            "default, or a list such as -60,0,60."
        ),
    ] = None,
    distances: Annotated[
        str | None,
        typer.Option(
            help="Distances of the light, m, in the same form; that of the config by default."
        ),
    ] = None,
    trials: Annotated[
        bool, typer.Option("--trials", help="Use the situations of the config instead.")
    ] = False,
    blind: Annotated[bool, typer.Option("--blind", help="Set all light sensors to 0.")] = False,
    reach: Annotated[
        float,
        typer.Option(
            min=0,
            help="Fraction of the distance that may be left to a light that counts as reached.",
        ),
    ] = 0.2,
    number: Number = None,
    out: Folder = None,
) -> None:
    """Test the champion in new situations."""
    import numpy as np

    from evo_cpg.api.display import working
    from evo_cpg.cli.champions import open_champion
    from evo_cpg.cli.probed import (
        missed,
        own_situations,
        probe_rows,
        require_reachable,
        show_probe,
        unseeing,
    )
    from evo_cpg.files import make_folder, write_table
    from evo_cpg.training.probe import around, blinded
    from evo_cpg.training.probe import probe as live
    from evo_cpg.view.figure import save_figure
    from evo_cpg.view.probe_plot import probe_figure

    if trials and (bearings is not None or distances is not None):
        raise UsageError(
            "--trials takes the lights of the config: leave out --bearings and --distances, or it"
        )
    turned = np.deg2rad(_numbers("--bearings", _BEARINGS if bearings is None else bearings))
    away = [] if distances is None else _numbers("--distances", distances)
    lights = len(turned) * max(len(away), 1)
    if lights > _MOST:
        raise UsageError(f"--bearings, --distances: {lights} lights; allowed: up to {_MOST}")
    if min(away, default=1.0) <= 0:
        raise UsageError(f"--distances: must be greater than 0, got {min(away):g}")
    which = Which(number)
    opened = open_champion(run, which)
    experiment, situations = opened.experiment, own_situations(opened)
    if not trials:
        situations = around(situations[0], turned, away)
        require_reachable(experiment, situations)
    place = make_folder(out or run)
    simulation, genes = experiment.simulation, opened.champion.genes
    with working(f"compiling, and probing {len(situations)} lights") as work:
        start = time.monotonic()
        found = seeing = live(simulation, genes, situations)
        if blind:
            took = time.monotonic() - start
            work.doing(f"compiling, and probing {len(situations)} lights blind", expected=took)
            found = live(blinded(simulation), genes, situations)
    reached = found.reached(reach)
    rows = probe_rows(found, reach)
    result = f"{reached.sum()} of {len(rows)} lights reached"
    table = place / f"probe{which.of_run}{'_blind' if blind else ''}.csv"
    write_table(table, rows)
    who = f"{experiment.name}, blind" if blind else experiment.name
    figure = probe_figure(found, reach, f"{who}: {result}")
    picture = save_figure(figure, table.with_suffix(".png"))
    show_probe(rows)
    if blind and seeing.displacement > 0:
        kept = max(0.0, found.displacement) / seeing.displacement
        print(f"blind it keeps {kept:.0%} of its displacement towards the lights")
    print(f"{result} ({reached.mean():.0%}): at most {reach:g} of the distance left")
    print(table)
    print(picture)
    said = missed(found, reach)
    if blind:
        said = unseeing(seeing, found) if simulation.sensors.eye_bodies else "it has no eyes"
    if said:
        warn(f"{run}: the champion: {said}")


def _numbers(option: str, text: str) -> list[float]:
    """What START:STOP:COUNT or a list says."""
    import numpy as np

    try:
        if ":" not in text:
            numbers = [float(part) for part in text.split(",")]
        else:
            start, stop, count = text.split(":")
            many = min(int(count), _MOST + 1)
            numbers = np.linspace(float(start), float(stop), many).tolist()
    except ValueError:
        numbers = []
    if not numbers or len(numbers) > _MOST or not np.isfinite(numbers).all():
        raise UsageError(
            f"{option}: {text!r} is neither START:STOP:COUNT, such as {_BEARINGS}, nor a list, "
            f"such as -60,0,60; at most {_MOST} numbers"
        )
    return numbers
