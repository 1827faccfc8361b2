"""Study of the salamander in three environments, and of a swimmer with two eyes."""

from functools import partial

import numpy as np

from evo_cpg.studies.parts import audit_part, evaluate, light_tables, pictures_part
from evo_cpg.studies.study import Part, Runs, Study, Table, middle, percent, tabled
from evo_cpg.studies.workshop import Workshop
from evo_cpg.training.conditions import around, blinded, probe

_REACHED = 0.2  # largest fraction of the distance left
_BEARINGS = np.deg2rad(np.linspace(-75, 75, 20))
_RANDOM = "evolution={type: random, generations: 50, population: 200}"

# Number of runs of the slow settings.
_FEW = 3

RUNS = {
    "water": Runs("iwadate2010_salamander_water", (), 5),
    "water_random": Runs("iwadate2010_salamander_water", (_RANDOM,), 5),
    "land": Runs("iwadate2010_salamander_land", (), 5),
    "land_random": Runs("iwadate2010_salamander_land", (_RANDOM,), _FEW),
    "boulders": Runs("salamander_boulders", ("evolution.generations=25",), _FEW),
    "eyes": Runs("two_eyed_swimmer", (), 5),
}


def water(workshop: Workshop) -> list[Table]:
    """Compare champions in water with random search, and with champions evolved on land."""
    left = 100 * np.array(_left_in_water(workshop, "land"))
    guests = {
        "": "champions evolved on land",
        "seed": "all",
        "distance left": f"{middle(left, 1)} %",
    }
    return light_tables(workshop, "water", "water_random", guests)


_AUDITED = {"in water": "water", "among boulders": "boulders", "swimmer with two eyes": "eyes"}


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


def _left_in_water(workshop: Workshop, name: str) -> list[list[float]]:
    """Return the fraction of the distance that each champion leaves in water, without noise."""

    def measure() -> list[list[float]]:
        genes = np.stack([each.genes for each in workshop.champions(name)], axis=1)
        found = evaluate(workshop.member("water").experiment.simulation, genes)["distance"]
        # A diverged animal counts as distant.
        return np.nan_to_num(found.astype(float), nan=9.0).tolist()

    return workshop.kept(f"{name}_in_water", [name], measure)


STUDY = Study(
    "salamander",
    "The salamander in water and on land",
    RUNS,
    {
        "water": Part("in water", ("water", "water_random", "land"), water),
        "land": Part(
            "on land",
            ("land", "land_random"),
            partial(light_tables, evolved="land", random="land_random"),
        ),
        "audit": audit_part("audit of the champions on land", {"on land": "land"}),
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
            {"in water": "water", "on land": "land"},
            {"among boulders": "boulders"},
        ),
    },
)
