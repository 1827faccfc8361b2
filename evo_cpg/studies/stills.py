"""Moments of champions' motions, in one picture for each table."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from evo_cpg.simulation.recording import Recording
from evo_cpg.studies.study import Part, Table

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop

HEAD = ["", "seed", "generation", "fitness", "way", "moments, s"]
# Size of each moment, pixels, and how many there are, from the start of a trial to its end.
_SIZE, _MOMENTS = (480, 270), 3


def pictures_part(title: str, *shown: Mapping[str, str]) -> Part:
    """Return a part that draws the best champions of runs.

    Args:
        title: of the part.
        shown: for each picture: names of the runs, by what is written in it. The name of a second
            picture is that of its first run.
    """

    def report(workshop: "Workshop") -> list[Table]:
        names = ["", *(next(iter(runs.values())) for runs in shown[1:])]
        return [stills(workshop, *each) for each in zip(shown, names, strict=True)]

    return Part(title, tuple(name for runs in shown for name in runs.values()), report)


def stills(workshop: "Workshop", shown: Mapping[str, str], picture: str = "") -> Table:
    """Draw the best champion of some runs, each in a row, and tell which they are.

    Args:
        workshop: where the runs are.
        shown: names of the runs, by what is written in the picture.
        picture: name of the picture; that of the part where it is the only one.
    """
    from evo_cpg.training.replay import compile_replay
    from evo_cpg.view.film import side_by_side
    from evo_cpg.view.frames import Film
    from evo_cpg.view.scene import panel_of

    rows, panels = [], []
    for title, name in shown.items():
        experiment, champion = workshop.experiment(name), workshop.checkpoint(name).champion
        if champion is None:
            rows.append([title, "nobody lives", "", "", "", ""])
            continue
        _, _, recording = compile_replay(experiment, workshop.devices)(champion)
        panels.append(panel_of(experiment, recording, title))
        instants = np.linspace(recording.time[0], recording.time[-1], _MOMENTS)
        rows.append(
            [
                title,
                str(experiment.seed + champion.run),
                str(champion.generation),
                f"{champion.worth:.3f}",
                _way(recording),
                ", ".join(f"{instant - recording.time[0]:.1f}" for instant in instants),
            ]
        )
    if panels:
        path = workshop.picture(picture)
        side_by_side(panels, path, Film(_SIZE, sheet=(_MOMENTS, 1), columns=1))
    return Table("", HEAD, rows)


def _way(recording: Recording) -> str:
    """In words: to the light, or over ground."""
    first, last = recording.distance[[0, -1]]
    if np.isfinite(recording.goal).all():
        return f"{first:.2f} to {last:.2f} m to the light"
    return f"{last:.2f} m"
