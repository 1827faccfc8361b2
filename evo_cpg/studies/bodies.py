"""Study of bodies: one brain for all, a map of bodies, and searches that are scored on it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import rankdata

from evo_cpg.creature.creature import Creature
from evo_cpg.studies import controls, showcase
from evo_cpg.studies.body_map import GENES, Family, Map, made_map, trained
from evo_cpg.studies.body_searches import SCHEMES, final_bodies
from evo_cpg.studies.newborns import report as report_newborns
from evo_cpg.studies.study import Part, Study, Table, middle, percent
from evo_cpg.studies.workshop import Workshop


class _Sizes(NamedTuple):
    """Values of each gene, training of a body, trial (s), and a search's runs and their sizes."""

    cells: int
    generations: int
    seconds: float
    runs: int
    individuals: int
    trials: int


_FULL, _QUICK = _Sizes(27, 10, 5.0, 20, 20, 1000), _Sizes(3, 2, 1.0, 2, 4, 80)
# Fraction of the bodies that are the best, and of those that the best should reach again.
_NEAR, _LOOSE = 0.01, 0.05
# Bodies that are trained again, and the seed.
_AGAIN, _SEED = 200, 1


def report_map(workshop: Workshop) -> list[Table]:
    """Make the map, its picture, and a table of how far it can be trusted."""
    from evo_cpg.view.body_plots import bodies_figure

    sizes, family, found = _map(workshop)
    axes, cube = [gene[:4] for gene in GENES], found.fitness.reshape((family.cells,) * 3)
    label = f"distance in {sizes.seconds:g} s (m)"
    workshop.draw(bodies_figure(axes, cube, _NEAR, label, _drawn(family, found)))
    rows = {
        "bodies": f"{cube.size:,}",
        "bodies better than their neighbours": f"{peaks(cube):,}",
        "distance, median (range), m": middle(found.fitness),
    }
    return [Table("", ["map", "value"], [*(rows | _trust(sizes, family, found)).items()])]


def _trust(sizes: _Sizes, family: Family, found: Map) -> dict[str, str]:
    """Repeat some bodies, and the best ones, with another seed, and the former at half the step."""
    fitness, draw = found.fitness, np.random.default_rng(_SEED)
    some = draw.permutation(len(fitness))[:_AGAIN]
    best = np.flatnonzero(fitness >= np.quantile(fitness, 1 - _NEAR))
    again, best_again = (
        trained(family, each, sizes.generations, (_SEED,))[0] for each in (some, best)
    )
    correlation = np.corrcoef(rankdata(fitness[some]), rankdata(again))[0, 1]
    still = best_again >= np.quantile(fitness, 1 - _LOOSE)
    finer = Family(family.cells, sizes.seconds, substeps=4)
    kept = finer.fitness(some, found.rhythm[some, None])[:, 0] / fitness[some]
    return {
        f"rank correlation with another seed, {len(some)} bodies": f"{correlation:.3f}",
        "least distance of the best 1 %, m": f"{fitness[best].min():.2f}",
        "of these, in the best 5 % with another seed": percent(still.mean().item()),
        "distance kept at half the step, median": percent(np.median(kept).item()),
        "bodies that keep less than 95 %": percent((kept < 0.95).mean().item()),
    }


def report_searches(workshop: Workshop) -> list[Table]:
    """Score each search by the runs that end near the best bodies."""
    sizes, family, found = _map(workshop)
    rows = []
    for number, scheme in enumerate(SCHEMES):
        body, fitness = final_bodies(family, scheme, *sizes[3:], seed=number)
        ahead = (found.fitness > found.fitness[body, None]).mean(1)
        near = f"{(ahead < _NEAR).sum()} of {len(body)}"
        rows.append([scheme.name, near, f"{middle(100 * ahead, 1)} %", middle(fitness)])
        workshop.work.reached(number + 1, len(SCHEMES))
    head = ["search", "runs near the best", "better bodies, median (range)", "distance, m"]
    return [Table("", head, rows)]


def _map(workshop: Workshop) -> tuple[_Sizes, Family, Map]:
    """Return the finished map, with its sizes and its bodies."""
    sizes = _QUICK if workshop.quick else _FULL
    family, path = Family(sizes.cells, sizes.seconds), workshop.map_file("map")
    return sizes, family, made_map(path, family, sizes.generations, workshop.work.reached)


def _drawn(family: Family, found: Map) -> dict[str, Creature]:
    """Return creatures by caption: each gene at its ends, the others in the middle; the best."""
    bodies = {}
    for number, gene in enumerate(GENES):
        for end, word in enumerate(gene.words):
            genes = np.where(np.arange(len(GENES)) == number, end, 0.5)
            bodies[f"{word}\n({gene[2 + end]:.2g})"] = family.nearest(genes[None])[0]
    bodies["best body\n"] = found.fitness.argmax()
    genomes = ((name, family.genomes[:, body]) for name, body in bodies.items())
    return {name: family.plans.alone(own)[0].creature.build() for name, own in genomes}


def peaks(fitness: Float[np.ndarray, "a b c"]) -> int:
    """Return the number of bodies that are better than all their neighbours, at most six."""
    padded, peak = np.pad(fitness, 1, constant_values=-np.inf), np.ones(fitness.shape, bool)
    for axis in range(3):
        for step in (-1, 1):
            peak &= fitness > np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1]
    return int(peak.sum())


_PARTS = {
    "controls": controls.PART,
    "learning": controls.LEARNING,
    "newborns": Part("one brain drives bodies that it has never seen", (), report_newborns),
    "map": Part("best rhythm of each of 19,683 bodies", (), report_map),
    "searches": Part("searches that end near the best bodies", (), report_searches),
    "showcase": showcase.PART,
}
STUDY = Study(
    "bodies", "Bodies that evolve, and brains that fit them", controls.RUNS | showcase.RUNS, _PARTS
)
