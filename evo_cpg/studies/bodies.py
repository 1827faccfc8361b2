"""Study of a map of bodies: the map with its picture, and searches that are scored on it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import rankdata

from evo_cpg.studies.body_map import GENES, Family, Map, made_map, outline, trained
from evo_cpg.studies.body_searches import SCHEMES, final_bodies
from evo_cpg.studies.study import Part, Study, Table, middle, percent
from evo_cpg.studies.workshop import Workshop


class _Sizes(NamedTuple):
    """Sizes of the study.

    Attributes:
        cells: number of values of each gene.
        generations: number of generations for a body.
        seconds: duration of a trial, s.
        runs: number of runs of each search.
        individuals: number of individuals in a run.
        trials: number of trials in a run.
    """

    cells: int = 27
    generations: int = 10
    seconds: float = 5.0
    runs: int = 20
    individuals: int = 20
    trials: int = 1000


_FULL, _QUICK = _Sizes(), _Sizes(3, 2, 1.0, 2, 4, 80)
# Fraction of the bodies that are the best.
_NEAR = 0.01
# Bodies that are trained again, and the seed.
_AGAIN, _SEED = 200, 1


def report_map(workshop: Workshop) -> list[Table]:
    """Make the map and its picture. Repeat some bodies with another seed, and at half the step."""
    from evo_cpg.view.body_plots import bodies_figure

    sizes, family, found = _map(workshop)
    axes, cube = [gene[:4] for gene in GENES], found.fitness.reshape((family.cells,) * 3)
    label = f"distance in {sizes.seconds:g} s (m)"
    workshop.draw(bodies_figure(axes, cube, _NEAR, label, _drawings(family, found)))
    chosen = np.random.default_rng(_SEED).permutation(cube.size)[:_AGAIN]
    first = found.fitness[chosen]
    again, _ = trained(family, chosen, sizes.generations, (_SEED,))
    correlation = np.corrcoef(rankdata(first), rankdata(again))[0, 1]
    finer = Family(family.cells, sizes.seconds, substeps=4)
    kept = finer.fitness(chosen, found.rhythm[chosen, None])[:, 0] / first
    worst, median, near, best = np.quantile(cube, (0, 0.5, 1 - _NEAR, 1))
    rows = {
        "bodies": f"{cube.size:,}",
        "bodies better than their neighbours": f"{_peaks(cube):,}",
        "distance, median (range), m": f"{median:.2f} ({worst:.2f} to {best:.2f})",
        "least distance of the best 1 %, m": f"{near:.2f}",
        f"rank correlation with another seed, {len(chosen)} bodies": f"{correlation:.3f}",
        "distance kept at half the step, median": percent(np.median(kept)),
        "bodies that keep less than 95 %": percent((kept < 0.95).mean()),
    }
    return [Table("", ["map", "value"], [list(row) for row in rows.items()])]


def report_searches(workshop: Workshop) -> list[Table]:
    """Score each search by the runs that end near the best bodies."""
    sizes, family, found = _map(workshop)
    rows = []
    for number, scheme in enumerate(SCHEMES):
        given = sizes.runs, sizes.individuals, sizes.trials
        body, fitness = final_bodies(family, scheme, *given, seed=number)
        ahead = (found.fitness > found.fitness[body, None]).mean(1)
        near = f"{(ahead < _NEAR).sum()} of {len(body)}"
        rows.append([scheme.name, near, f"{middle(100 * ahead, 1)} %", middle(fitness)])
        workshop.work.reached(number + 1, len(SCHEMES))
    head = ["search", "runs near the best", "better bodies, median (range)", "distance, m"]
    return [Table("", head, rows)]


def _map(workshop: Workshop) -> tuple[_Sizes, Family, Map]:
    """Return the finished map, with its sizes and its bodies."""
    sizes = _QUICK if workshop.quick else _FULL
    family = Family(sizes.cells, sizes.seconds)
    path, reached = workshop.map_file("map"), workshop.work.reached
    return sizes, family, made_map(path, family, sizes.generations, reached)


def _drawings(family: Family, found: Map) -> dict[str, Float[np.ndarray, "b 4 2"]]:
    """Return outlines by caption: each gene at its ends, the others in the middle; the best."""
    drawn = {}
    for number, gene in enumerate(GENES):
        for end, word in enumerate(gene.words):
            genes = np.full(len(GENES), 0.5)
            genes[number] = end
            caption = f"{word}\n({gene.value(end):.2g})"
            drawn[caption] = outline(family, int(family.nearest(genes)))
    return drawn | {"best body\n": outline(family, int(found.fitness.argmax()))}


def _peaks(fitness: Float[np.ndarray, "a b c"]) -> int:
    """Return the number of bodies that are better than all their neighbours, at most six."""
    padded, peak = np.pad(fitness, 1, constant_values=-np.inf), np.ones(fitness.shape, bool)
    for axis in range(3):
        for step in (-1, 1):
            peak &= fitness > np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1]
    return int(peak.sum())


STUDY = Study(
    "bodies",
    "Map of bodies, and searches on it",
    {},
    {
        "map": Part("best rhythm of each of 19,683 bodies", (), report_map),
        "searches": Part("searches that end near the best bodies", (), report_searches),
    },
)
