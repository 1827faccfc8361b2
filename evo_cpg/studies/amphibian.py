"""Study of an amphibian: one controller takes a salamander into the water and back to land."""

import dataclasses

import numpy as np

from evo_cpg.analysis.laboratory.courses import on_courses
from evo_cpg.simulation.measures import measures
from evo_cpg.studies.parts import audit_part, pictures_part
from evo_cpg.studies.study import Part, Runs, Study, Table, percent, tabled
from evo_cpg.studies.workshop import Workshop

_REACHED = 0.2  # largest fraction of the distance left
_BELLY_DOWN = 60  # largest tilt, from the mean cosine, degrees
_TRIALS = 40  # new trials of each situation
_SITUATIONS = ("into the water", "back on land", "from the water's edge to land")

RUNS = {"amphibian": Runs("salamander_amphibious", (), 5)}


def crossings(workshop: Workshop) -> list[Table]:
    """Return a row for each champion: distance left (trials that reach the light), and tilt."""
    found = workshop.kept("crossings", ["amphibian"], lambda: _measured(workshop))
    rows, both = [], 0
    for champion, left, reached, tilt in zip(workshop.champions("amphibian"), *found, strict=True):
        both += max(left[:2]) <= _REACHED and tilt < _BELLY_DOWN
        row = {"": f"seed {workshop.member('amphibian').experiment.seed + champion.run}"}
        for name, own, part in zip(_SITUATIONS, left, reached, strict=True):
            row[name] = f"{percent(own)} ({100 * part:.0f} %)"
        rows.append(row | {"largest tilt, degrees": f"{tilt:.0f}"})
    rows.append({"": f"both ways, belly down: {both} of {len(rows)}"})
    return [tabled(rows)]


def _measured(workshop: Workshop) -> list[list]:
    """Return medians of what is left, fractions of trials that reach the light, and tilts."""
    experiment = workshop.member("amphibian").experiment
    simulation = dataclasses.replace(experiment.simulation, measures=measures("tilt"))
    genes = np.stack([each.genes for each in workshop.champions("amphibian")], axis=1)
    found = on_courses(experiment, genes, _TRIALS * len(_SITUATIONS), simulation)
    # A diverged animal counts as distant and on its back.
    left, tilt = (
        np.where(found.alive, found.terms[name], lost).reshape(-1, _TRIALS, len(_SITUATIONS))
        for name, lost in (("distance", 9.0), ("tilt", 2.0))
    )
    # The tilt is a mean of 1 - cos(angle).
    worst = np.rad2deg(np.arccos(1 - np.median(tilt, 1).max(1)))
    return [np.median(left, 1).tolist(), (left <= _REACHED).mean(1).tolist(), worst.tolist()]


STUDY = Study(
    "amphibian",
    "A salamander that crosses a shore both ways",
    RUNS,
    {
        "crossings": Part("across the shore", ("amphibian",), crossings),
        "audit": audit_part("audit of the champions", {"across the shore": "amphibian"}),
        "pictures": pictures_part("moments of the best champion", {"amphibian": "amphibian"}),
    },
)
