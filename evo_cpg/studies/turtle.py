"""Study of the tutorial's turtle: effects of its three lights and of the twist of its flippers."""

import dataclasses

import numpy as np

from evo_cpg.studies.audits import audit_part
from evo_cpg.studies.lights import evaluate
from evo_cpg.studies.study import Part, Runs, Study, Table, beside, middle
from evo_cpg.studies.workshop import Workshop
from evo_cpg.training.conditions import around

# Largest fraction of the distance left at a reached light. Fraction for a diverged animal.
_REACHED, _LOST = 0.2, 9.0
_BEARINGS = np.deg2rad(np.linspace(-75, 75, 11))

# Title and overrides of each variant.
_CHANGES = {
    "turtle": ("as shipped", ()),
    "one_light": (
        "one light, 45 degrees to the left",
        ("simulation.trials=[{light: {bearing_deg: 45}}]",),
    ),
    "no_twist": (
        "without the twist",
        ("controller.axes.left/y.gain=0", "controller.axes.right/y.gain=0"),
    ),
}
RUNS = {name: Runs("turtle", changes, 5) for name, (_, changes) in _CHANGES.items()}


def changes(workshop: Workshop) -> list[Table]:
    """Compare champions of changed configurations, with their own lights and with other lights."""
    rows, mean_left = [], {}
    for name, (title, _) in _CHANGES.items():
        simulation, champions = workshop.experiment(name).simulation, workshop.champions(name)
        first = simulation.situations[0]._replace(light=simulation.lights[0])
        before = dataclasses.replace(simulation, situations=around(first, _BEARINGS))
        found = evaluate(before, np.stack([champion.genes for champion in champions], 1))[
            "distance"
        ]
        found = np.nan_to_num(found, nan=_LOST)
        mean_left[name] = found.mean(1)
        own = [100 * champion.terms["distance"] for champion in champions]
        worth = middle([champion.worth for champion in champions], 3)
        reached = (found <= _REACHED).sum(1)
        others = middle(100 * mean_left[name], 1)
        rows.append([title, worth, f"{middle(own, 1)} %", middle(reached, 0), f"{others} %"])
    against = beside({name: -left for name, left in mean_left.items()}, "turtle")
    lights = f"{len(_BEARINGS)} lights"
    head = ["", "fitness", "distance left", f"reached, of {lights}", f"distance left, {lights}",
            "comes nearer than as shipped"]  # fmt: skip
    return [Table("", head, [[*row, against[name]] for row, name in zip(rows, RUNS, strict=True)])]


STUDY = Study(
    "turtle",
    "The turtle",
    RUNS,
    {
        "changes": Part("effects of the lights and of the twist", tuple(RUNS), changes),
        "audit": audit_part("audit of the champions", {"`turtle`": "turtle"}),
    },
)
