"""Study of the hexapod, a walker of our own: distance, tilt and audits."""

from evo_cpg.studies.audits import audit_part
from evo_cpg.studies.stills import pictures_part
from evo_cpg.studies.study import Part, Runs, Study, Table, in_order, middle
from evo_cpg.studies.workshop import Workshop

RUNS = {"hexapod": Runs("hexapod", (), 5)}


def walk(workshop: Workshop) -> list[Table]:
    """Return a table with fitness and terms of the five champions."""
    champions = workshop.champions("hexapod")
    found = {"fitness": [champion.worth for champion in champions]}
    for name in ("distance", "tilt", "bounce", "airborne"):
        found[name] = [each.terms[name] for each in champions if name in each.terms]
    rows = [[name, middle(values), in_order(values)] for name, values in found.items() if values]
    return [Table("", ["", "median (range)", "all, sorted"], rows)]


STUDY = Study(
    "hexapod",
    "The hexapod",
    RUNS,
    {
        "walk": Part("five champions", ("hexapod",), walk),
        "audit": audit_part("audit of the champions", {"hexapod": "hexapod"}, medians=True),
        "pictures": pictures_part("moments of the best champion", {"hexapod": "hexapod"}),
    },
)
