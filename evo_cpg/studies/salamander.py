"""Study of the salamander in four environments, and of a swimmer with two eyes."""

import dataclasses
from functools import partial

import numpy as np

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.simulation.measures import measures
from evo_cpg.studies.parts import audit_part, evaluate, light_tables, pictures_part
from evo_cpg.studies.study import Part, Runs, Study, Table, middle, percent, tabled
from evo_cpg.studies.workshop import Workshop
from evo_cpg.training.conditions import around, blinded, probe

_REACHED = 0.2  # largest fraction of the distance left
_BELLY_DOWN = 60  # largest tilt, from the mean cosine, degrees
_BEARINGS = np.deg2rad(np.linspace(-75, 75, 20))
_RANDOM = "evolution={type: random, generations: 50, population: 200}"

# Number of runs of the slow settings, and generations at the shore.
_FEW, _AT_SHORE = 3, 40

RUNS = {
    "water": Runs("iwadate2010_salamander_water", (), 5),
    "water_random": Runs("iwadate2010_salamander_water", (_RANDOM,), 5),
    "land": Runs("iwadate2010_salamander_land", (), 5),
    "land_random": Runs("iwadate2010_salamander_land", (_RANDOM,), _FEW),
    "shore": Runs("salamander_amphibious", (f"evolution.generations={_AT_SHORE}",), _FEW),
    "boulders": Runs("salamander_boulders", ("evolution.generations=25",), _FEW),
    "eyes": Runs("two_eyed_swimmer", (), 5),
}


def water(workshop: Workshop) -> list[Table]:
    """Compare champions in water with random search, and with champions evolved on land."""
    left = 100 * np.array(_evaluated_in(workshop, "water", "land")["distance"])
    guests = {
        "": "champions evolved on land",
        "seed": "all",
        "distance left": f"{middle(left, 1)} %",
    }
    return light_tables(workshop, "water", "water_random", guests)


_AUDITED = {
    "in water": "water",
    "across the shore": "shore",
    "among boulders": "boulders",
    "swimmer with two eyes": "eyes",
}


_LEFT = [
    f"{leg}: distance left"
    for leg in ("into the water", "back on land", "from the water's edge to land")
]


def shore(workshop: Workshop) -> list[Table]:
    """Compare champions of the shore with champions evolved on land, in each situation.

    A row has the distance left in each situation, and the largest tilt.
    """
    found = _evaluated_in(workshop, "shore", "shore")
    # The tilt is a mean of 1 - cos(angle).
    tilts = np.rad2deg(np.arccos(1 - np.max(found["tilt"], 1)))
    rows = []
    for champion, left, tilt in zip(
        workshop.champions("shore"), found["distance"], tilts, strict=True
    ):
        seed = workshop.member("shore").experiment.seed + champion.run
        rows.append(
            {"": f"seed {seed}", "fitness": f"{champion.worth:.3f}"}
            | dict(zip(_LEFT, map(percent, left), strict=True))
            | {"largest tilt of the head, degrees": f"{tilt:.0f}"}
        )
    both = (np.array(found["distance"])[:, :2] <= _REACHED).all(1) & (tilts < _BELLY_DOWN)
    words = f"into the water and back (20 % left), tilt below {_BELLY_DOWN} degrees"
    rows.append({"": words, "fitness": f"{both.sum()} of {both.size}"})
    left = 100 * np.array(_evaluated_in(workshop, "shore", "land")["distance"])
    cells = [f"{middle(column, 1)} %" for column in left.T]
    rows.append({"": "champions evolved on land"} | dict(zip(_LEFT, cells, strict=True)))
    return [tabled(rows)]


def eyes(workshop: Workshop) -> list[Table]:
    """Probe the two-eyed swimmer of seed 0 with new lights, with its eyes and blind."""
    from evo_cpg.view.answer_plots import probe_figure

    simulation = workshop.member("eyes").experiment.simulation
    champion = workshop.champions("eyes")[0]
    first = simulation.situations[0]._replace(light=simulation.lights[0])
    lights, rows = around(first, _BEARINGS), []
    for title, name, animal in (
        ("with its eyes", "", simulation),
        ("blind", "blind", blinded(simulation)),
    ):
        found = probe(animal, champion.genes, lights)
        reached, left = found.reached(_REACHED), found.distance
        rows.append(
            {
                "": title,
                "lights reached (20 % left or less)": f"{reached.sum()} of {reached.size}",
                "distance left, median": percent(float(np.nanmedian(left))),
                "worst": percent(float(np.nanmax(left))),
            }
        )
        workshop.draw(probe_figure(found, _REACHED, f"two-eyed swimmer, {title}"), name)
    return [tabled(rows)]


def _evaluated_in(workshop: Workshop, world: str, name: str) -> dict[str, list[list[float]]]:
    """Evaluate champions in each situation of a world, without noise.

    Returns:
        The fraction of the distance left, and the tilt: the mean of 1 - cos(angle of the head's up
        axis to the vertical). Both have a list for each champion.
    """

    def measure() -> dict[str, list[list[float]]]:
        simulation = workshop.member(world).experiment.simulation
        if world == "shore" and name != "shore":
            # Animals that did not evolve at the shore have no depth sensor.
            declared, source = workshop.member(world).config, workshop.member(world).source
            seconds = f"simulation.seconds={declared.simulation.seconds}"
            config = load_config(source, ["creature.depth_sensors=[]", seconds])
            simulation = build_experiment(config, source).simulation
        genes = np.stack([each.genes for each in workshop.champions(name)], axis=1)
        measured = dataclasses.replace(simulation, measures=measures("tilt"))
        terms = {key: x.astype(float) for key, x in evaluate(measured, genes).items()}
        # A diverged animal counts as distant and on its back.
        return {
            "distance": np.nan_to_num(terms["distance"], nan=9.0).tolist(),
            "tilt": np.nan_to_num(terms["tilt"], nan=2.0).tolist(),
        }

    return workshop.kept(f"{name}_in_{world}", [name], measure)


STUDY = Study(
    "salamander",
    "The salamander in water, on land and at the shore",
    RUNS,
    {
        "water": Part("in water", ("water", "water_random", "land"), water),
        "land": Part(
            "on land",
            ("land", "land_random"),
            partial(light_tables, evolved="land", random="land_random"),
        ),
        "audit": audit_part("audit of the champions on land", {"on land": "land"}),
        "shore": Part("across the shore", ("shore", "land"), shore),
        "boulders": Part(
            "among boulders", ("boulders",), partial(light_tables, evolved="boulders")
        ),
        "eyes": Part("a swimmer with two eyes", ("eyes",), eyes),
        **{
            f"audit_{name}": audit_part(f"audit: {title}", {title: name})
            for title, name in _AUDITED.items()
        },
        "pictures": pictures_part(
            "moments of the best champions",
            {"in water": "water", "on land": "land", "across the shore": "shore"},
            {"among boulders": "boulders"},
        ),
    },
)
