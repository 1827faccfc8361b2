"""The hexapod, a walker of our own: how far and how upright it goes, and its audits."""

from evo_cpg.studies.audits import audit_table, audited, kept_table
from evo_cpg.studies.stills import stills
from evo_cpg.studies.study import Part, Runs, Study, Table, in_order, middle
from evo_cpg.studies.workshop import Workshop

RUNS = {"hexapod": Runs("hexapod", (), 5)}


def walk(workshop: Workshop) -> list[Table]:
    """What five champions come to."""
    champions = workshop.champions("hexapod")
    names = ("distance", "tilt", "bounce", "airborne")
    rows = [["fitness", middle([each.worth for each in champions]),
             in_order([each.worth for each in champions])]]  # fmt: skip
    for name in names:
        values = [champion.terms[name] for champion in champions if name in champion.terms]
        if values:
            rows.append([name, middle(values), in_order(values)])
    return [Table("", ["", "median (range)", "all, sorted"], rows)]


def audit(workshop: Workshop) -> list[Table]:
    """The champions audited."""
    rows = {"hexapod": audited(workshop, "hexapod")}
    return [kept_table("Medians and ranges:", rows), audit_table("Every champion:", rows)]


def pictures(workshop: Workshop) -> list[Table]:
    """The best champion."""
    return [stills(workshop, {"hexapod": "hexapod"})]


STUDY = Study(
    "hexapod",
    "The hexapod",
    RUNS,
    {
        "walk": Part("five champions", ("hexapod",), walk),
        "audit": Part("the champions audited", ("hexapod",), audit),
        "pictures": Part("moments of the best champion", ("hexapod",), pictures),
    },
)
