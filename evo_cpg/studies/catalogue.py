"""Which studies there are; each is imported when it is asked for."""

import importlib

from evo_cpg.studies.study import Study

NAMES = (
    "iwadate2010",
    "fukui2003",
    "salamander",
    "hexapod",
    "starfish",
    "turtle",
    "search",
    "benchmarks",
)


def study(name: str) -> Study:
    """The study of that name, one of `NAMES`."""
    return importlib.import_module(f"evo_cpg.studies.{name}").STUDY
