"""Tables, files and warnings of the command `probe`."""

from pathlib import Path

import numpy as np

from evo_cpg.api.display import working
from evo_cpg.cli.champions import open_champion
from evo_cpg.cli.errors import UsageError, warn
from evo_cpg.cli.options import Which
from evo_cpg.cli.tables import show_table
from evo_cpg.files import make_folder, write_table
from evo_cpg.io.run import Run
from evo_cpg.io.situations import out_of_reach
from evo_cpg.simulation.situation import Situation
from evo_cpg.training.conditions import UNSEEING, Probe, around, blinded, probe, seen_from_start
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.view.answer_plots import probe_figure
from evo_cpg.view.figure import save_figure

_BEARINGS = "-75:75:11"
_MOST = 10_000


def probe_champion(
    run: Path,
    which: Which,
    lights: tuple[str | None, str | None] | None,
    blind: bool,
    reach: float,
    place: Path,
) -> None:
    """Probe a champion, and print, write and draw the results.

    Args:
        run: path of the run folder.
        which: champion to probe.
        lights: bearings and distances of the lights, as on the command line; None for the lights of
            the configuration.
        blind: set all light sensors to 0.
        reach: fraction of the distance that may be left to a light that counts as reached.
        place: folder for the files.

    Raises:
        UsageError: the lights are wrong, or cannot be reached.
    """
    given = None if lights is None else _places(*lights)
    opened = open_champion(run, which)
    experiment, situations = opened.experiment, own_situations(opened)
    if given is not None:
        situations = around(situations[0], *given)
        require_reachable(experiment, situations)
    make_folder(place)
    simulation, genes = experiment.simulation, opened.champion.genes
    with working(f"compiling, and probing {len(situations)} lights") as work:
        found = seeing = probe(simulation, genes, situations)
        if blind:
            work.doing(f"compiling, and probing {len(situations)} lights blind")
            found = probe(blinded(simulation), genes, situations)
    reached = found.reached(reach)
    rows = probe_rows(found, reach)
    result = f"{reached.sum()} of {len(rows)} lights reached"
    table = place / f"probe{which.of_run}{'_blind' if blind else ''}.csv"
    write_table(table, rows)
    name = f"{experiment.name}, blind" if blind else experiment.name
    figure = probe_figure(found, reach, f"{name}: {result}")
    picture = save_figure(figure, table.with_suffix(".png"))
    show_probe(rows)
    if blind and seeing.displacement > 0:
        kept = max(0.0, found.displacement) / seeing.displacement
        print(f"blinded, it keeps {kept:.0%} of its displacement towards the lights")
    print(f"{result} ({reached.mean():.0%}), with at most {reach:g} of the distance left")
    print(table)
    print(picture)
    words = missed(found, reach)
    if blind:
        words = unseeing(seeing, found) if simulation.sensors.eye_bodies else "it has no eyes"
    if words:
        warn(f"{run}: the champion: {words}")


def _places(bearings: str | None, distances: str | None) -> tuple[np.ndarray, list[float]]:
    """Return bearings, rad, and distances, m, of lights.

    The list of distances is empty if the configuration's distance applies.
    """
    turned = _numbers("--bearings", _BEARINGS if bearings is None else bearings)
    away = [] if distances is None else _numbers("--distances", distances)
    lights = len(turned) * max(len(away), 1)
    if lights > _MOST:
        raise UsageError(f"--bearings, --distances: {lights} lights. Allowed: up to {_MOST}")
    if min(away, default=1.0) <= 0:
        raise UsageError(f"--distances: must be greater than 0, got {min(away):g}")
    return np.deg2rad(turned), away


def _numbers(option: str, text: str) -> list[float]:
    """Return the numbers of START:STOP:COUNT or of a list."""
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
            f"such as -60,0,60. Allowed: at most {_MOST} numbers"
        )
    return numbers


def missed(found: Probe, reach: float) -> str:
    """Return a warning if an animal misses most of its lights, else an empty text."""
    reached, turned = found.reached(reach), [seen_from_start(s)[1] for s in found.situations]
    count, sides = int(reached.sum()), np.sign(np.round(turned, 9))
    if count >= len(reached) / 2:
        return ""
    side = ""
    for sign, name in ((1, "left"), (-1, "right")):
        if count and (sides[reached] == sign).all() and (sides[~reached] == -sign).any():
            side = f", all of them on the {name}"
    return f"it misses most lights: it reaches {count} of {len(reached)}{side}"


def unseeing(seeing: Probe, blind: Probe) -> str:
    """Return a warning if an animal does not use its eyes, else an empty text."""
    if not seeing.displacement > 0:
        return "it does not approach the lights with its eyes, so there is nothing to compare"
    kept = max(0.0, blind.displacement) / seeing.displacement
    if kept < UNSEEING:
        return ""
    return (
        f"it does not use its eyes: blinded, it keeps {kept:.0%} of its displacement to the lights"
    )


def probe_rows(found: Probe, reach: float) -> list[dict[str, float | int]]:
    """Return the rows of probe.csv, one for each situation.

    Args:
        found: results of the probe.
        reach: fraction of the distance that may be left to a light that counts as reached.
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


def own_situations(opened: Run) -> tuple[Situation, ...]:
    """Return the situations that the animal evolved in, with their lights.

    Raises:
        UsageError: the task has no light.
    """
    simulation = opened.experiment.simulation
    if None in simulation.lights:
        raise UsageError(
            f"{opened.folder.path}: its task has no light, so there is nothing to probe"
        )
    return tuple(
        situation._replace(light=light)
        for situation, light in zip(simulation.situations, simulation.lights, strict=True)
    )


def require_reachable(experiment: ExperimentParts, situations: tuple[Situation, ...]) -> None:
    """Check that every light can be reached.

    Raises:
        UsageError: a light cannot be reached.
    """
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
                f"{problem}. Choose others, or --trials"
            )


def show_probe(rows: list[dict[str, float | int]]) -> None:
    """Print the rows of probe.csv as a table."""
    cells = []
    for row in rows:
        lost = bool(row["diverged"])
        cells.append(
            (
                f"{row['bearing_deg']:+.1f}",
                f"{row['start_distance']:.2f}",
                "diverged" if lost else f"{row['distance_left']:.2f}",
                "" if lost else f"{row['distance']:.1%}",
                "" if lost else f"{row['light']:.2f}",
                "yes" if row["reached"] else "no",
            )
        )
    show_table(("bearing", "from (m)", "left (m)", "left", "light seen", "reached"), cells, left=0)


def _degrees(angle: float) -> float:
    """Convert rad to degrees, rounded to 9 decimals and without -0."""
    return round(float(np.rad2deg(angle)), 9) + 0.0
