"""Comparison of searches: fitness, and the fraction of a map of gaits that each search fills.

The settings are in `searches/`. `evo-cpg sweep` also accepts these files.
"""

from functools import partial
from pathlib import Path

import numpy as np

from evo_cpg.io.load import as_overrides
from evo_cpg.io.settings import read_settings
from evo_cpg.studies.study import Part, Runs, Study, Table, beside, middle
from evo_cpg.studies.workshop import Workshop

_FOLDER = Path(__file__).parent / "searches"
_GENETIC, _RANDOM = "genetic algorithm", "random search"

# Files of search settings in `_FOLDER`, each with its configuration and number of runs.
# Fewer than six runs cannot be significant against seven other searches.
_FILES = {
    "swimmer": ("iwadate2010_swimmer", 6),
    "walker": ("fukui2003_model1", 6),
    "two_eyes": ("two_eyed_swimmer", 6),
    "swimmer_map": ("iwadate2010_swimmer", 1),
    "walker_map": ("fukui2003_model1", 1),
}


def _declared(part: str) -> dict[str, Runs]:
    config, count = _FILES[part]
    return {
        f"{part} {name}": Runs(config, tuple(as_overrides(values)), count)
        for name, values in read_settings(_FOLDER / f"{part}.yaml").items()
    }


RUNS = {name: runs for part in _FILES for name, runs in _declared(part).items()}


def searches(workshop: Workshop, part: str) -> list[Table]:
    """Compare each search with the genetic algorithm and with random search."""
    from evo_cpg.view.search_plots import Curves, colors, sweep_figure

    # A search has the same colour in all figures.
    everywhere = list(dict.fromkeys(map(_own, RUNS)))
    color = dict(zip(everywhere, colors(len(everywhere)), strict=True))
    names = [name for name in RUNS if name.startswith(f"{part} ")]
    fitness = {_own(name): _fitness(workshop, name) for name in names}
    against = {first: beside(fitness, first) for first in (_GENETIC, _RANDOM)}
    rows, curves = [], []
    for name in sorted(names, key=lambda name: -float(np.median(fitness[_own(name)]))):
        own = _own(name)
        population = workshop.experiment(name).strategy.population
        best = workshop.column(name, "champion").T
        tried = population * np.arange(1, best.shape[1] + 1)
        curves.append(Curves(own, tried, best, np.array(fitness[own]), color[own]))
        left = [champion.terms["distance"] for champion in workshop.champions(name)]
        words = [against[first][own] for first in (_GENETIC, _RANDOM)]
        rows.append([own, f"{tried[-1]:,}", middle(fitness[own], 3), middle(left, 3), *words])
    workshop.draw(sweep_figure(curves, f"{part}: {len(names)} searches"))
    head = ["search", "evaluations", "fitness, median (range)", "distance (fraction left, or m)",
            f"beats {_GENETIC}", f"beats {_RANDOM}"]  # fmt: skip
    return [Table("", head, rows)]


def maps(workshop: Workshop, part: str) -> list[Table]:
    """Compare the fractions of a map that the searches fill."""
    from evo_cpg.io.run import gait_map
    from evo_cpg.view.search_plots import map_figure

    rows = []
    for name in (name for name in RUNS if name.startswith(f"{part} ")):
        experiment, found = workshop.experiment(name), workshop.checkpoint(name)
        tried = experiment.strategy.population * found.generation
        last = found.history[-1]
        own = _own(name)
        rows.append([own, f"{tried:,}", f"{last['coverage']:.1%}", f"{last['mean_elite']:.3f}"])
        cells = gait_map(experiment, found, 0)
        if cells is not None:
            figure = map_figure(cells.axes, cells.fitness, f"{part}, {own}")
            workshop.draw(figure, own.replace(" ", "_").lower())
    head = ["search", "evaluations", "cells filled", "mean fitness of elites"]
    return [Table("", head, rows)]


def _own(name: str) -> str:
    """Return the name of a setting without its part."""
    return name.partition(" ")[2]


def _fitness(workshop: Workshop, name: str) -> list[float]:
    return [champion.worth for champion in workshop.champions(name)]


def _part(part: str, title: str) -> Part:
    make = maps if part.endswith("_map") else searches
    names = tuple(name for name in RUNS if name.startswith(f"{part} "))
    return Part(title, names, partial(make, part=part))


STUDY = Study(
    "search",
    "Comparison of searches",
    RUNS,
    {
        "swimmer": _part("swimmer", "eight searches for the swimmer"),
        "walker": _part("walker", "eight searches for Fukui's first walker"),
        "two_eyes": _part("two_eyes", "six searches for a swimmer with two eyes"),
        "swimmer_map": _part("swimmer_map", "maps of a swimmer's gaits"),
        "walker_map": _part("walker_map", "maps of a walker's gaits"),
    },
)
