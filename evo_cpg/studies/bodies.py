"""Study of a map of bodies: the map with its picture, and searches that are scored on it."""

import numpy as np
from scipy.stats import spearmanr

from evo_cpg.studies.body_map import GENES, Family, Map, made_map, outline, trained
from evo_cpg.studies.body_searches import SCHEMES, final_bodies
from evo_cpg.studies.study import Part, Study, Table, middle, percent
from evo_cpg.studies.workshop import Workshop

# Values of each gene, and generations of each body. The quick study has the second values.
_CELLS, _GENERATIONS = (27, 3), (10, 2)
_SECONDS = 5.0, 1.0
# Bodies that are trained again, with this seed.
_AGAIN, _SEED_AGAIN = 200, 1
# Runs of each search, with their individuals, and trials of a run.
_RUNS, _INDIVIDUALS, _TRIALS = (20, 2), (20, 4), (1000, 80)
NEAR = 0.01
"""Fraction of the bodies that are the best."""


def report_map(workshop: Workshop) -> list[Table]:
    """Make the map and its picture. Repeat some bodies with another seed, and at half the step."""
    from evo_cpg.view.body_plots import bodies_figure

    found, family = _map(workshop)
    cells = (family.cells,) * 3
    middles = np.full((2 * len(GENES), len(GENES)), 0.5)
    middles[np.arange(len(middles)), np.arange(len(middles)) // 2] = np.arange(len(middles)) % 2
    bodies = [*family.nearest(middles), found.fitness.argmax()]
    words = [*(word for gene in GENES for word in gene.words), "best body"]
    drawn = {word: outline(family, body) for word, body in zip(words, bodies, strict=True)}
    axes = [(gene.name, gene.low, gene.high) for gene in GENES]
    label = f"distance in {_of(workshop, _SECONDS):g} s (m)"
    workshop.draw(bodies_figure(axes, found.fitness.reshape(cells), NEAR, label, drawn))
    return [_facts(workshop, found, family)]


def report_searches(workshop: Workshop) -> list[Table]:
    """Score each search by the runs that end near the best bodies."""
    found, family = _map(workshop)
    rows, sizes = [], [_of(workshop, pair) for pair in (_RUNS, _INDIVIDUALS, _TRIALS)]
    for number, scheme in enumerate(SCHEMES):
        body, fitness = final_bodies(family, scheme, *sizes, seed=number)
        ahead = (found.fitness > found.fitness[body, None]).mean(1)
        near = f"{(ahead < NEAR).sum()} of {len(body)}"
        rows.append([scheme.name, near, f"{middle(100 * ahead, 1)} %", middle(fitness)])
        workshop.work.reached(number + 1, len(SCHEMES))
    head = ["search", "runs near the best", "better bodies, median (range)", "distance (m)"]
    return [Table("", head, rows)]


def _of(workshop: Workshop, pair: tuple) -> float:
    """Return the value of the full or of the quick study."""
    return pair[workshop.quick]


def _map(workshop: Workshop) -> tuple[Map, Family]:
    """Return the finished map, and its bodies."""
    family = Family(_of(workshop, _CELLS), _of(workshop, _SECONDS))
    path, generations = workshop.map_file("map"), _of(workshop, _GENERATIONS)
    return made_map(path, family, generations, workshop.work.reached), family


def _facts(workshop: Workshop, found: Map, family: Family) -> Table:
    """Return the table of the map's fitness, repetition and time step."""
    every, fitness = len(found.fitness), found.fitness
    chosen = np.random.default_rng(_SEED_AGAIN).permutation(every)[:_AGAIN]
    generations = _of(workshop, _GENERATIONS)
    again = trained(family, chosen, generations, (_SEED_AGAIN,))[0]
    finer = Family(family.cells, _of(workshop, _SECONDS), substeps=4)
    halved = finer.fitness(chosen, found.rhythm[chosen, None])[:, 0]
    worst, median, near, best = np.quantile(fitness, (0, 0.5, 1 - NEAR, 1))
    values = {
        "bodies": f"{every:,}",
        "distance of the worst, median and best body (m)": f"{worst:.2f}, {median:.2f}, {best:.2f}",
        f"least distance of the best {NEAR:.0%} (m)": f"{near:.2f}",
        "bodies better than their neighbours": str(_peaks(fitness.reshape((family.cells,) * 3))),
        f"rank correlation with another seed, {len(chosen)} bodies": _rank_correlation(
            fitness[chosen], again
        ),
        "distance at half the step, relative, median": percent(np.median(halved / fitness[chosen])),
        "bodies that lose over 5 % at half the step": percent(
            (halved < 0.95 * fitness[chosen]).mean()
        ),
    }
    return Table("", ["", ""], [list(row) for row in values.items()])


def _rank_correlation(one: np.ndarray, other: np.ndarray) -> str:
    """Return the rank correlation of Spearman as text."""
    return f"{spearmanr(one, other).statistic:.3f}"


def _peaks(fitness: np.ndarray) -> int:
    """Return the number of bodies that are better than their up to six neighbours."""
    padded, peak = np.pad(fitness, 1, constant_values=-np.inf), np.ones(fitness.shape, bool)
    for axis in range(3):
        for step in (-1, 1):
            peak &= fitness > np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1]
    return int(peak.sum())


STUDY = Study(
    "bodies",
    "A map of bodies, and searches on it",
    {},
    {
        "map": Part("the best rhythm of each of 19,683 bodies", (), report_map),
        "searches": Part("searches that end near the best bodies", (), report_searches),
    },
)
