"""Study of bodies that evolve with their brains: one brain for every body, and controls."""

from evo_cpg.studies.newborns import report as newborns
from evo_cpg.studies.study import Part, Study

STUDY = Study(
    "bodies",
    "Bodies that evolve with their brains",
    {},
    {"newborns": Part("one brain drives bodies that it has never seen", (), newborns)},
)
