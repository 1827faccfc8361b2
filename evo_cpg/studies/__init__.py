"""Reproductions and their tables. A study is imported when it is requested."""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from evo_cpg.studies.study import Study

# Module of this package and name of each study.
_PLACES = {
    "iwadate2010": ("iwadate2010", "STUDY"),
    "fukui2003": ("fukui2003", "STUDY"),
    "salamander": ("salamander", "STUDY"),
    "hexapod": ("own_animals", "HEXAPOD"),
    "starfish": ("own_animals", "STARFISH"),
    "turtle": ("own_animals", "TURTLE"),
    "animals": ("animals", "STUDY"),
    "search": ("search", "STUDY"),
    "bodies": ("bodies", "STUDY"),
    "benchmarks": ("benchmarks", "STUDY"),
}
NAMES = tuple(_PLACES)


def find_study(name: str) -> "Study":
    """Import and return the study of a name, one of `NAMES`."""
    module, place = _PLACES[name]
    return getattr(importlib.import_module(f"evo_cpg.studies.{module}"), place)
