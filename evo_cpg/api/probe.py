"""Test a champion with lights in new places."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from evo_cpg.api.progress import working
from evo_cpg.api.runs import open_champion, suffix
from evo_cpg.errors import UsageError
from evo_cpg.files import make_folder, write_table
from evo_cpg.io.situations import out_of_reach
from evo_cpg.io.trust import trusting
from evo_cpg.training import conditions as trials
from evo_cpg.training.conditions import UNSEEING, Probe, around, blinded, seen_from_start

BEARINGS = tuple(np.linspace(-75, 75, 11).tolist())
"""Default bearings of the light, degrees."""

# Largest number of lights.
_MOST = 10_000


class Probed(NamedTuple):
    """Result of `probe`.

    Attributes:
        name: name of the experiment.
        lights: results with all lights.
        seeing: results with eyes, to compare with those of the blinded animal, or None if it was
            not blinded.
        reach: largest fraction of the distance that may be left to a reached light.
        has_eyes: whether the animal has eyes.
        number: number of the run among several, as requested.
    """

    name: str
    lights: Probe
    seeing: Probe | None
    reach: float
    has_eyes: bool
    number: int | None = None

    @property
    def reached(self) -> Bool[np.ndarray, " n"]:
        """Whether each light was reached."""
        return self.lights.reached(self.reach)

    @property
    def kept(self) -> float | None:
        """Fraction of the displacement to the lights that the blinded animal keeps, or None.

        None if it was not blinded, or does not approach the lights with its eyes.
        """
        if self.seeing is None or not self.seeing.displacement > 0:
            return None
        return max(0.0, self.lights.displacement) / self.seeing.displacement

    @property
    def rows(self) -> list[dict[str, float | int]]:
        """Rows of probe.csv, one for each light."""
        reached, rows = self.reached, []
        for i, situation in enumerate(self.lights.situations):
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
                    "distance": float(self.lights.distance[i]),
                    "distance_left": float(self.lights.distance[i]) * distance,
                    "light": float(self.lights.light[i]),
                    "reached": int(reached[i]),
                    "diverged": int(not self.lights.alive[i]),
                }
            )
        return rows

    @property
    def remark(self) -> str:
        """Sentence about an animal that misses most lights or does not use its eyes, else ""."""
        if self.seeing is not None:
            if not self.has_eyes:
                return "it has no eyes"
            if self.kept is None:
                return "it does not approach the lights with its eyes, so nothing can be compared"
            if self.kept < UNSEEING:
                return ""
            return (
                f"it does not use its eyes: blinded, it keeps {self.kept:.0%} of its displacement "
                "to the lights"
            )
        reached = self.reached
        turned = [seen_from_start(situation)[1] for situation in self.lights.situations]
        count, sides = int(reached.sum()), np.sign(np.round(turned, 9))
        if count >= len(reached) / 2:
            return ""
        side = ""
        for sign, name in ((1, "left"), (-1, "right")):
            if count and (sides[reached] == sign).all() and (sides[~reached] == -sign).any():
                side = f", all of them on the {name}"
        return f"it misses most lights: it reaches {count} of {len(reached)}{side}"

    def save(self, folder: Path | str) -> list[Path]:
        """Write probe.csv and probe.png into a folder, and return their paths.

        Raises:
            OutputError: the files cannot be written.
        """
        from evo_cpg.view.answer_plots import probe_figure
        from evo_cpg.view.figure import save_figure

        blind = "" if self.seeing is None else "blind"
        name = f"probe{suffix(self.number)}{'_' * bool(blind)}{blind}.csv"
        table = make_folder(Path(folder)) / name
        write_table(table, self.rows)
        title = f"{self.name}, {blind}" if blind else self.name
        title += f": {self.reached.sum()} of {len(self.reached)} lights reached"
        figure = probe_figure(self.lights, self.reach, title)
        return [table, save_figure(figure, table.with_suffix(".png"))]


def probe(
    run: Path | str,
    bearings: Sequence[float] | None = BEARINGS,
    distances: Sequence[float] = (),
    blind: bool = False,
    reach: float = 0.2,
    number: int | None = None,
    trust: bool = False,
) -> Probed:
    """Test a champion with lights in new places, without noise.

    Args:
        run: run folder.
        bearings: bearings of the light, degrees to the left, or None for the lights of the
            configuration.
        distances: distances of the light, m, or empty for that of the configuration.
        blind: set all light sensors to 0, and compare with the seeing animal.
        reach: largest fraction of the distance that may be left to a reached light.
        number: number of one of several runs side by side, or None for the best.
        trust: whether to trust the configuration, see `load`.

    Raises:
        RunFolderError: there is no run, or it has no champion.
        UsageError: the task has no light, or a light cannot be reached.
    """
    lights = len(bearings or ()) * max(len(distances), 1)
    if lights > _MOST:
        raise UsageError(f"bearings, distances: {lights} lights. Allowed: up to {_MOST}")
    if min(distances, default=1.0) <= 0:
        raise UsageError(f"distances: must be greater than 0, got {min(distances):g}")
    with trusting(trust):
        opened = open_champion(run, number).on_course()
    simulation, genes = opened.experiment.simulation, opened.champion.genes
    if None in simulation.lights:
        raise UsageError(
            f"{opened.folder.path}: its task has no light, so there is nothing to probe"
        )
    situations = tuple(
        situation._replace(light=light)
        for situation, light in zip(simulation.situations, simulation.lights, strict=True)
    )
    if bearings is not None:
        situations = around(situations[0], np.deg2rad(bearings), distances)
        for situation in situations:
            place, light = situation.start_position, situation.light
            assert light is not None
            creature = opened.experiment.creature
            problem = out_of_reach(creature, simulation.world, place, light)
            if problem:
                distance, bearing, _ = seen_from_start(situation)
                raise UsageError(
                    f"bearings, distances: {_degrees(bearing):g} degrees, {distance:g} m: "
                    f"{problem}. Choose others, or the lights of the configuration"
                )
    with working(f"compiling, and probing {len(situations)} lights") as work:
        found = trials.probe(simulation, genes, situations)
        seeing = found if blind else None
        if blind:
            work.doing(f"compiling, and probing {len(situations)} lights blind")
            found = trials.probe(blinded(simulation), genes, situations)
    eyes = bool(simulation.sensors.eye_bodies)
    return Probed(opened.experiment.name, found, seeing, reach, eyes, number)


def _degrees(angle: float) -> float:
    """Convert rad to degrees, rounded to 9 decimals and without -0."""
    return round(float(np.rad2deg(angle)), 9) + 0.0
