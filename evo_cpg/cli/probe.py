"""The command that puts a champion into situations that it never saw: probe."""

import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from evo_cpg.cli.champions import open_champion
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.progress import working
from evo_cpg.config.situations import out_of_reach
from evo_cpg.files import make_folder, write_table
from evo_cpg.simulation.situation import Situation
from evo_cpg.training.experiment import Experiment
from evo_cpg.training.probe import (
    UNSEEING,
    Probe,
    around,
    blinded,
    probe,
    seen_from_start,
)
from evo_cpg.training.run_folder import RunFolder

_BEARINGS = "-75:75:11"
_MOST = 10_000


def probe_run(
    run: Path,
    bearings: str | None,
    distances: str | None,
    own_trials: bool,
    blind: bool,
    reach: float,
    number: int | None,
    out: Path | None,
) -> None:
    """`evo-cpg probe`."""
    if own_trials and (bearings is not None or distances is not None):
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
    experiment, champion, _, folder = open_champion(run, number)
    situations = _own_situations(experiment, folder)
    if not own_trials:
        situations = around(situations[0], turned, away)
        _require_reachable(experiment, situations)
    place = make_folder(out or folder.path)
    simulation, genes = experiment.simulation, champion.genes
    with working(f"compiling, and probing {len(situations)} lights") as work:
        start = time.monotonic()
        found = seeing = probe(simulation, genes, situations)
        if blind:
            took = time.monotonic() - start
            work.doing(f"compiling, and probing {len(situations)} lights blind", expected=took)
            found = probe(blinded(simulation), genes, situations)
    from evo_cpg.view.figure import save_figure
    from evo_cpg.view.probe_plot import probe_figure

    reached = found.reached(reach)
    rows = probe_rows(found, reach)
    result = f"{reached.sum()} of {len(rows)} lights reached"
    name = "probe" if number is None else f"probe_run{number}"
    table = place / f"{name}{'_blind' if blind else ''}.csv"
    write_table(table, rows)
    who = f"{experiment.name}, blind" if blind else experiment.name
    figure = probe_figure(found, reach, f"{who}: {result}")
    picture = save_figure(figure, table.with_suffix(".png"))
    Console().print(_table(rows))
    if blind and seeing.displacement > 0:
        kept = max(0.0, found.displacement) / seeing.displacement
        print(f"blind it keeps {kept:.0%} of its displacement towards the lights")
    print(f"{result} ({reached.mean():.0%}): at most {reach:g} of the distance left")
    print(table)
    print(picture)
    said = _missed(found, reach)
    if blind:
        said = _unseeing(seeing, found) if simulation.sensors.eye_bodies else "it has no eyes"
    if said:
        print(f"evo-cpg: warning: {run}: the champion: {said}", file=sys.stderr)


def _missed(found: Probe, reach: float) -> str:
    """Return what to say of an animal that misses most of its lights; empty if it does not."""
    reached, turned = found.reached(reach), [seen_from_start(s)[1] for s in found.situations]
    count, sides = int(reached.sum()), np.sign(np.round(turned, 9))
    if count >= len(reached) / 2:
        return ""
    side = ""
    for sign, name in ((1, "left"), (-1, "right")):
        if count and (sides[reached] == sign).all() and (sides[~reached] == -sign).any():
            side = f", all of them on the {name}"
    return f"it misses most lights: it reaches {count} of {len(reached)}{side}"


def _unseeing(seeing: Probe, blind: Probe) -> str:
    """Return what to say of an animal that does without its eyes; empty if it does not."""
    if not seeing.displacement > 0:
        return "it comes no nearer to the lights with its eyes, so there is nothing to compare"
    kept = max(0.0, blind.displacement) / seeing.displacement
    if kept < UNSEEING:
        return ""
    return f"it does not use its eyes: blind it keeps {kept:.0%} of its displacement to the lights"


def probe_rows(found: Probe, reach: float) -> list[dict[str, float | int]]:
    """The rows of probe.csv, one for each situation.

    Args:
        found: what became of the animal.
        reach: share of the distance that may be left where a light counts as reached.
    """
    reached = found.reached(reach)
    rows = []
    for i, situation in enumerate(found.situations):
        distance, bearing, elevation = seen_from_start(situation)
        x, y, _ = situation.start_position
        rows.append(
            {
                "start_x": x,
                "start_y": y,
                "start_heading_deg": _degrees(situation.start_heading),
                "bearing_deg": _degrees(bearing),
                "elevation_deg": _degrees(elevation),
                "start_distance": distance,
                "distance": float(found.distance[i]),
                "distance_left": float(found.distance[i]) * distance,
                "light": float(found.light[i]),
                "reached": int(reached[i]),
                "diverged": int(not found.alive[i]),
            }
        )
    return rows


def _numbers(option: str, text: str) -> list[float]:
    """What START:STOP:COUNT or a list says."""
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


def _own_situations(experiment: Experiment, folder: RunFolder) -> tuple[Situation, ...]:
    """Those that the animal evolved in, with their lights."""
    simulation = experiment.simulation
    if None in simulation.lights:
        raise UsageError(f"{folder.path}: its task has no light, so there is none to look for")
    return tuple(
        situation._replace(light=light)
        for situation, light in zip(simulation.situations, simulation.lights, strict=True)
    )


def _require_reachable(experiment: Experiment, situations: tuple[Situation, ...]) -> None:
    world = experiment.simulation.world
    for situation in situations:
        assert situation.light is not None
        problem = out_of_reach(
            experiment.creature, world, situation.start_position, situation.light
        )
        if problem:
            distance, bearing, _ = seen_from_start(situation)
            raise UsageError(
                f"--bearings, --distances: {_degrees(bearing):g} degrees, {distance:g} m: "
                f"{problem}; choose others, or --trials"
            )


def _table(rows: list[dict[str, float | int]]) -> Table:
    """For the terminal."""
    table = Table("bearing", "from (m)", "left (m)", "left", "light seen", "reached")
    for column in table.columns:
        column.justify = "right"
    for row in rows:
        lost = bool(row["diverged"])
        table.add_row(
            f"{row['bearing_deg']:+.1f}",
            f"{row['start_distance']:.2f}",
            "diverged" if lost else f"{row['distance_left']:.2f}",
            "" if lost else f"{row['distance']:.1%}",
            "" if lost else f"{row['light']:.2f}",
            "yes" if row["reached"] else "no",
        )
    return table


def _degrees(angle: float) -> float:
    """Without the last digits, in which 60 becomes 59.99999999999999; never -0."""
    return round(float(np.rad2deg(angle)), 9) + 0.0
