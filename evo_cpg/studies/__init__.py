"""Reproductions and their tables. A study is imported when it is requested."""

import importlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from evo_cpg.studies.study import Study

# Module and name of each study.
_PLACES = {
    "iwadate2010": ("evo_cpg.studies.iwadate2010", "STUDY"),
    "fukui2003": ("evo_cpg.studies.fukui2003", "STUDY"),
    "salamander": ("evo_cpg.studies.salamander", "STUDY"),
    "amphibian": ("evo_cpg.studies.amphibian", "STUDY"),
    "hexapod": ("evo_cpg.studies.own_animals", "HEXAPOD"),
    "starfish": ("evo_cpg.studies.own_animals", "STARFISH"),
    "turtle": ("evo_cpg.studies.own_animals", "TURTLE"),
    "animals": ("evo_cpg.studies.animals", "STUDY"),
    "bodies": ("evo_cpg.studies.bodies", "STUDY"),
    "worlds": ("evo_cpg.studies.worlds", "STUDY"),
    "search": ("evo_cpg.studies.search", "STUDY"),
}
# Only a checkout has the study of the program's speed.
_CHECKOUT = Path(__file__).parents[2]
if (_CHECKOUT / "benchmarks" / "study.py").is_file():
    _PLACES["benchmarks"] = ("benchmarks.study", "STUDY")
NAMES = tuple(_PLACES)


def find_study(name: str) -> "Study":
    """Import and return the study of a name, one of `NAMES`."""
    module, place = _PLACES[name]
    if name == "benchmarks" and str(_CHECKOUT) not in sys.path:
        sys.path.insert(0, str(_CHECKOUT))
    return getattr(importlib.import_module(module), place)
