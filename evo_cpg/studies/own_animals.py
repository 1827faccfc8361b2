"""Studies of our own animals: the hexapod, the starfish and the turtle of the tutorial."""

import dataclasses
import itertools

import numpy as np

from evo_cpg.analysis.gait import ring_lags
from evo_cpg.control.couplings import ring_members
from evo_cpg.studies.parts import audit_part, evaluate, pictures_part
from evo_cpg.studies.study import Part, Runs, Study, Table, beside, in_order, middle, tabled
from evo_cpg.studies.workshop import Workshop
from evo_cpg.training.conditions import around

_HEXAPOD_RUNS = {"hexapod": Runs("hexapod", (), 5)}


def walk(workshop: Workshop) -> list[Table]:
    """Return a table with fitness and terms of the five champions."""
    champions = workshop.champions("hexapod")
    found = {"fitness": [champion.worth for champion in champions]}
    for name in ("distance", "tilt", "bounce", "airborne"):
        found[name] = [each.terms[name] for each in champions if name in each.terms]
    rows = [[name, middle(values), in_order(values)] for name, values in found.items() if values]
    return [Table("", ["", "median (range)", "all, sorted"], rows)]


HEXAPOD = Study(
    "hexapod",
    "The hexapod",
    _HEXAPOD_RUNS,
    {
        "walk": Part("five champions", ("hexapod",), walk),
        "audit": audit_part("audit of the champions", {"hexapod": "hexapod"}, medians=True),
        "pictures": pictures_part("moments of the best champion", {"hexapod": "hexapod"}),
    },
)

# Number of windows of the second half of a trial, whose lags are computed separately.
_WINDOWS = 3

_STARFISH_RUNS = {name: Runs(name, (), 5) for name in ("starfish", "starfish_land")}


def lags(workshop: Workshop) -> list[Table]:
    """Return mean lags over the second half of the trial, and the extremes over its thirds."""
    rows = []
    for name in _STARFISH_RUNS:
        simulation = workshop.member(name).experiment.simulation
        oscillators, tree = simulation.controller.rhythm_generator, simulation.world.tree
        assert oscillators is not None
        for champion, recording in workshop.recordings(name):
            edges = (np.linspace(0.5, 1, _WINDOWS + 1) * len(recording.time)).astype(int)
            windows = [
                recording._replace(
                    time=recording.time[start:stop], joint_angle=recording.joint_angle[start:stop]
                )
                for start, stop in itertools.pairwise(edges)
            ]
            for number, ring in enumerate(oscillators.settings.rings):
                joints = [tree.dof_names[i] for i in ring_members(tree, ring, number)]
                whole = ring_lags(recording, joints)
                pieces = [ring_lags(part, joints, last=1.0) for part in windows]
                low, high = np.min(pieces, 0), np.max(pieces, 0)
                row = {
                    "": f"`{name}`",
                    "seed": str(champion.run),
                    "fitness": f"{champion.worth:.3f}",
                    "distance, m": "{:.2f} to {:.2f}".format(*recording.distance[[0, -1]]),
                }
                for joint, *lag in zip(joints, whole, low, high, strict=True):
                    row[f"`{joint}`, degrees"] = "{:.1f} ({:.1f} to {:.1f})".format(*lag)
                rows.append(row)
    return [tabled(rows)]


STARFISH = Study(
    "starfish",
    "The starfish",
    _STARFISH_RUNS,
    {
        "lags": Part("lags around the ring of arms", tuple(_STARFISH_RUNS), lags),
        "audit": audit_part(
            "audit of the champions", {f"`{name}`": name for name in _STARFISH_RUNS}
        ),
        "pictures": pictures_part(
            "moments of the champions", {"in water": "starfish", "on land": "starfish_land"}
        ),
    },
)

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
_TURTLE_RUNS = {name: Runs("turtle", changes, 5) for name, (_, changes) in _CHANGES.items()}


def changes(workshop: Workshop) -> list[Table]:
    """Compare champions of changed configurations, with their own lights and with other lights."""
    rows, mean_left = [], {}
    for name, (title, _) in _CHANGES.items():
        simulation = workshop.member(name).experiment.simulation
        champions = workshop.champions(name)
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
    return [
        Table(
            "", head, [[*row, against[name]] for row, name in zip(rows, _TURTLE_RUNS, strict=True)]
        )
    ]


TURTLE = Study(
    "turtle",
    "The turtle",
    _TURTLE_RUNS,
    {
        "changes": Part("effects of the lights and of the twist", tuple(_TURTLE_RUNS), changes),
        "audit": audit_part("audit of the champions", {"`turtle`": "turtle"}),
    },
)
