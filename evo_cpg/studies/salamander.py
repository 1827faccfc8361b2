"""The salamander in water, on land, across a shore, among boulders; a swimmer with two eyes."""

import dataclasses
from functools import partial

import numpy as np

from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.simulation.measures import measures
from evo_cpg.studies.audits import audit_table, audited
from evo_cpg.studies.lights import light_table, lived, still
from evo_cpg.studies.stills import stills
from evo_cpg.studies.study import Part, Runs, Study, Table, beside, middle, percent
from evo_cpg.studies.workshop import Workshop
from evo_cpg.training.probe import Probe, around, blinded, probe

_REACHED = 0.2  # of the distance left
_BELLY_DOWN = 60  # degrees of tilt, from mean cosine
_BEARINGS = np.deg2rad(np.linspace(-75, 75, 20))
_RANDOM = "evolution={type: random, generations: 50, population: 200}"

RUNS = {
    "water": Runs("iwadate2010_salamander_water", (), 5),
    "water_random": Runs("iwadate2010_salamander_water", (_RANDOM,), 5),
    "land": Runs("iwadate2010_salamander_land", (), 5),
    "land_random": Runs("iwadate2010_salamander_land", (_RANDOM,), 5),
    "shore": Runs("salamander_amphibious", (), 5),
    "shore_random": Runs(
        "salamander_amphibious",
        ("evolution={type: random, generations: 60, population: 400}",),
        5,
    ),
    "boulders": Runs("salamander_boulders", ("evolution.generations=25",), 5),
    "eyes": Runs("two_eyed_swimmer", (), 5),
}


def water(workshop: Workshop) -> list[Table]:
    """Champions in water, random search, and champions of land put into water."""
    table = light_table(workshop, "water", "water_random")
    return [table._replace(rows=[*table.rows, still(workshop, "water"), _guests(workshop)])]


def land(workshop: Workshop) -> list[Table]:
    """Champions on land, and random search."""
    table = light_table(workshop, "land", "land_random")
    return [table._replace(rows=[*table.rows, still(workshop, "land")])]


_AUDITED = {
    "land": "on land",
    "water": "in water",
    "shore": "across the shore",
    "boulders": "among boulders",
    "eyes": "swimmer with two eyes",
}


def audit(workshop: Workshop, name: str) -> list[Table]:
    """Champions of some runs, audited."""
    return [audit_table("", {_AUDITED[name]: audited(workshop, name)})]


def shore(workshop: Workshop) -> list[Table]:
    """Champions across the shore, in each of its situations, and others put there."""
    table = _crossings(workshop, "shore")
    left = np.array(_lived_in(workshop, "shore", "land")["distance"])
    cells = [f"{middle(100 * column, 1)} %" for column in left.T]
    return [table._replace(rows=[*table.rows, ["champions of land", "", *cells, ""]])]


def shore_random(workshop: Workshop) -> list[Table]:
    """Random search at the shore."""
    fitness = {
        name: [champion.worth for champion in workshop.champions(name)]
        for name in ("shore", "shore_random")
    }
    table = _crossings(workshop, "shore_random")
    blank = [""] * (len(table.head) - 2)
    row = ["evolution beats it", beside(fitness, "shore_random")["shore"], *blank]
    return [table._replace(rows=[*table.rows, row])]


def _crossings(workshop: Workshop, name: str) -> Table:
    """What champions of some runs leave of the way in each situation, and how they hold."""
    found = _lived_in(workshop, "shore", name)
    rows = []
    for champion, left, tilt in zip(
        workshop.champions(name), found["distance"], found["tilt"], strict=True
    ):
        cells = *map(percent, left), f"{_angle(max(tilt)):.0f}"
        seed = workshop.experiment(name).seed + champion.run
        rows.append([f"seed {seed}", f"{champion.worth:.3f}", *cells])
    both = (np.array(found["distance"])[:, :2] <= _REACHED).all(1)
    both &= _angle(np.max(found["tilt"], 1)) < _BELLY_DOWN
    words = f"both ways (20 % left) under {_BELLY_DOWN} degrees", f"{both.sum()} of {both.size}"
    ways = ["into the water", "back on land", "from the water's edge to land"]
    heads = [*(f"{way}: distance left" for way in ways), "largest tilt of the head, degrees"]
    head = ["", "fitness", *heads]
    return Table("", head, [*rows, [*words, *[""] * len(heads)]])


def boulders(workshop: Workshop) -> list[Table]:
    """Champions among boulders."""
    return [light_table(workshop, "boulders")]


def eyes(workshop: Workshop) -> list[Table]:
    """The two-eyed swimmer of seed 0 is shown lights that it never saw, seeing and blind."""
    from evo_cpg.view.probe_plot import probe_figure

    simulation = workshop.experiment("eyes").simulation
    champion = workshop.champions("eyes")[0]
    first = simulation.situations[0]._replace(light=simulation.lights[0])
    lights, rows = around(first, _BEARINGS), []
    for title, name, animal in (
        ("with its eyes", "", simulation),
        ("blind", "blind", blinded(simulation)),
    ):
        found = probe(animal, champion.genes, lights)
        rows.append([title, *_probed(found)])
        workshop.draw(probe_figure(found, _REACHED, f"two-eyed swimmer, {title}"), name)
    head = ["", "lights reached (20 % left or less)", "distance left, median", "worst"]
    return [Table("", head, rows)]


def pictures(workshop: Workshop) -> list[Table]:
    """The best champions in water, on land and across the shore, and another among boulders."""
    shown = {"in water": "water", "on land": "land", "across the shore": "shore"}
    worlds = stills(workshop, shown)
    return [worlds, stills(workshop, {"among boulders": "boulders"}, "boulders")]


def _probed(found: Probe) -> list[str]:
    reached = found.reached(_REACHED)
    left = found.distance
    ends = percent(float(np.nanmedian(left))), percent(float(np.nanmax(left)))
    return [f"{reached.sum()} of {reached.size}", *ends]


def _guests(workshop: Workshop) -> list[str]:
    """The line of land's champions in water."""
    left = np.array(_lived_in(workshop, "water", "land")["distance"])
    return ["champions of land", "all", "", f"{middle(100 * left, 1)} %", "", "", ""]


def _angle(tilt: float | np.ndarray) -> np.ndarray:
    """Of a mean of 1 - cos, degrees."""
    return np.rad2deg(np.arccos(1 - np.asarray(tilt)))


def _lived_in(workshop: Workshop, world: str, name: str) -> dict[str, list[list[float]]]:
    """What becomes of champions in each of a world's situations, without noise.

    That is the share of the distance that is left, and the tilt: the mean of 1 - cos(angle of the
    head's up to the vertical).
    """

    def measure() -> dict[str, list[list[float]]]:
        simulation = workshop.experiment(world).simulation
        if world == "shore" and not name.startswith("shore"):
            # Who did not evolve at the shore has no depth gauge.
            declared, source = workshop.member(world).config, workshop.source(world)
            steps = f"simulation.steps={declared.simulation.steps}"
            config = load_config(source, ["creature.depth_sensors=[]", steps])
            simulation = build_experiment(config, source).simulation
        genes = np.stack([each.genes for each in workshop.champions(name)], axis=1)
        measured = dataclasses.replace(simulation, measures=measures("tilt"))
        terms = {key: x.astype(float) for key, x in lived(measured, genes).items()}
        # Who diverged is far away, and on its back.
        return {
            "distance": np.nan_to_num(terms["distance"], nan=9.0).tolist(),
            "tilt": np.nan_to_num(terms["tilt"], nan=2.0).tolist(),
        }

    return workshop.kept(f"{name}_in_{world}", [name], measure)


STUDY = Study(
    "salamander",
    "Salamander: water, land, and the shore between",
    RUNS,
    {
        "water": Part("in water", ("water", "water_random", "land"), water),
        "land": Part("on land", ("land", "land_random"), land),
        "audit": Part("champions on land, audited", ("land",), partial(audit, name="land")),
        "shore": Part("across the shore", ("shore", "land"), shore),
        "shore_random": Part("random search at the shore", ("shore", "shore_random"), shore_random),
        "boulders": Part("among boulders", ("boulders",), boulders),
        "eyes": Part("a swimmer with two eyes", ("eyes",), eyes),
        **{
            f"audit_{name}": Part(f"{title}, audited", (name,), partial(audit, name=name))
            for name, title in _AUDITED.items()
            if name != "land"
        },
        "pictures": Part(
            "moments of the best champions", ("water", "land", "shore", "boulders"), pictures
        ),
    },
)
