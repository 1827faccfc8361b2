"""Pictures with moments of champions' motions, one picture for each table."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from evo_cpg.simulation.recording import Recording
from evo_cpg.studies.study import Part, Table, tabled

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop

# Size of each moment, pixels, and number of moments from the start of a trial to its end.
_SIZE, _MOMENTS = (480, 270), 3


def pictures_part(title: str, *shown: Mapping[str, str]) -> Part:
    """Return a part that draws the best champions of runs.

    Args:
        title: title of the part.
        shown: names of the runs by their captions, for each picture. The first picture is named
            after the part. Each further picture is named after its first run.
    """

    def report(workshop: "Workshop") -> list[Table]:
        names = ["", *(next(iter(runs.values())) for runs in shown[1:])]
        return [stills(workshop, *each) for each in zip(shown, names, strict=True)]

    return Part(title, tuple(name for runs in shown for name in runs.values()), report)


def stills(workshop: "Workshop", shown: Mapping[str, str], picture: str = "") -> Table:
    """Draw the best champion of each run in a row, and return a table of the champions.

    Args:
        workshop: maker of the study, with the runs.
        shown: names of the runs, by their captions in the picture.
        picture: name of the picture within the part, or empty for the part's own name.
    """
    from evo_cpg.training.evaluate import compile_replay
    from evo_cpg.view.film import side_by_side
    from evo_cpg.view.frames import Film
    from evo_cpg.view.scene import panel_of

    rows, panels = [], []
    for title, name in shown.items():
        experiment, champion = workshop.experiment(name), workshop.checkpoint(name).champion
        if champion is None:
            rows.append({"": title, "seed": "no champion"})
            continue
        recording = compile_replay(experiment, workshop.devices)(champion).recording
        panels.append(panel_of(experiment, recording, title))
        instants = np.linspace(recording.time[0], recording.time[-1], _MOMENTS)
        rows.append(
            {
                "": title,
                "seed": str(experiment.seed + champion.run),
                "generation": str(champion.generation),
                "fitness": f"{champion.worth:.3f}",
                "distance": _distance(recording),
                "moments, s": ", ".join(f"{t - recording.time[0]:.1f}" for t in instants),
            }
        )
    if panels:
        path = workshop.picture(picture)
        side_by_side(panels, path, Film(_SIZE, sheet=(_MOMENTS, 1), columns=1))
    return tabled(rows)


def _distance(recording: Recording) -> str:
    """Return text: initial and final distance to the light or, without a light, the distance."""
    first, last = recording.distance[[0, -1]]
    if np.isfinite(recording.goal).all():
        return f"{first:.2f} to {last:.2f} m to the light"
    return f"{last:.2f} m"
