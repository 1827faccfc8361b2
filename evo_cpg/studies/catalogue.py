"""Catalogue of all studies. Each study is imported when it is requested."""

import importlib

from evo_cpg.studies.study import Study

NAMES = (
    "iwadate2010",
    "fukui2003",
    "salamander",
    "hexapod",
    "starfish",
    "turtle",
    "animals",
    "search",
    "benchmarks",
)


def study(name: str) -> Study:
    """Import and return the study of a name, one of `NAMES`."""
    return importlib.import_module(f"evo_cpg.studies.{name}").STUDY
