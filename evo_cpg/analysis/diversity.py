"""Diversity of body plans over the generations of a run (`evo_cpg.creature.topology`).

The edit distance of two topologies is the least number of bodies that are added, removed or given
other joint axes to make one from the other (Zhang and Shasha 1989, "Simple fast algorithms for the
editing distance between trees and related problems"). Children are compared in the sorted order of
`topology_of`, because the distance of unordered trees takes exponential time.
"""

import itertools
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from evo_cpg.creature.development import Plan
from evo_cpg.io.plans import EvolvedPlans

Topology = tuple[str, tuple["Topology", ...]]
"""Axes of the joint to the parent, such as ``yz``, and the topologies of the children."""

BEST = 30
"""Number of the fittest individuals whose topologies are counted, and of those compared."""


class Diversity(NamedTuple):
    """Diversity of some generations.

    Attributes:
        generations: numbers of the generations.
        topologies: number of different topologies.
        best: number of different topologies among the `BEST` fittest.
        distance: mean edit distance between two of a sample of `BEST` individuals.
        founders: number of individuals of generation 0 with descendants by first parents.
    """

    generations: Int[np.ndarray, " n"]
    topologies: Int[np.ndarray, " n"]
    best: Int[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    founders: Int[np.ndarray, " n"]


def topology_of(plan: Plan) -> Topology:
    """Return the tree of a plan's bodies, with sorted children. Equal trees are equal values."""

    def tree(body: Any) -> Topology:
        kind = "".join(itertools.compress("xyz", plan.axes[body]))
        return kind, tuple(sorted(map(tree, np.flatnonzero(plan.parent == body))))

    return tree(0)


def tree_edit_distance(one: Topology, other: Topology) -> int:
    """Return the edit distance of two topologies, where each operation costs 1."""
    (kinds, first), (others, second) = (zip(*_postorder(x), strict=True) for x in (one, other))
    whole = [[0] * len(others) for _ in kinds]
    # Roots of subtrees that do not begin at the first leaf of a larger subtree.
    roots = (sorted({leaf: i for i, leaf in enumerate(x)}.values()) for x in (first, second))
    for i, j in itertools.product(*roots):
        # Distances between forests that begin at the first leaves of both subtrees.
        a, b = first[i], second[j]
        forest = [[p + q for q in range(j - b + 2)] for p in range(i - a + 2)]
        for x, y in itertools.product(range(a, i + 1), range(b, j + 1)):
            p, q, trees = x - a, y - b, first[x] == a and second[y] == b
            joined = forest[first[x] - a][second[y] - b] + whole[x][y]
            if trees:
                joined = forest[p][q] + (kinds[x] != others[y])
            least = min(forest[p][q + 1] + 1, forest[p + 1][q] + 1, joined)
            forest[p + 1][q + 1] = least
            whole[x][y] = least if trees else whole[x][y]
    return whole[-1][-1]


def _postorder(tree: Topology, start: int = 0) -> list[tuple[str, int]]:
    """Return the kind and the first leaf of every node, children first."""
    found: list[tuple[str, int]] = []
    for child in tree[1]:
        found += _postorder(child, start + len(found))
    return [*found, (tree[0], start)]


def diversity(
    plans: EvolvedPlans, family: list[np.ndarray], run: int = 0, most: int = 100
) -> Diversity:
    """Return the diversity of a run's generations, of which at most some are evaluated.

    Args:
        plans: plans of the experiment.
        family: generations of the family tree, see `evo_cpg.training.family.read_family`.
        run: number of the run.
        most: largest number of generations. They are spaced evenly, and the last one is there.
    """
    chosen = np.unique(np.linspace(0, len(family) - 1, most).round().astype(int))
    rows, known, founder = [], {}, np.arange(family[0].shape[1])
    for number, block in enumerate(block[run] for block in family):
        if number in chosen:
            genomes = {genome.tobytes(): genome for genome in block["genome"]}
            new = [genome for key, genome in genomes.items() if key not in known]
            grown = map(topology_of, plans.kept(np.array(new)))
            known |= zip((genome.tobytes() for genome in new), grown, strict=True)
            found = [known[genome.tobytes()] for genome in block["genome"]]
            best = {found[i] for i in np.argsort(-block["fitness"], kind="stable")[:BEST]}
            sample = np.random.default_rng(number).permutation(len(found))[:BEST]
            distance = _mean_distance([found[i] for i in sample])
            rows.append((number, len({*found}), len(best), distance, len({*founder})))
        founder = founder[block["first"]]
    return Diversity(*map(np.array, zip(*rows, strict=True)))


def _mean_distance(sample: list[Topology]) -> float:
    """Return the mean edit distance between two different individuals of a sample."""
    pairs = itertools.combinations(Counter(sample).items(), 2)
    total = sum(n * m * tree_edit_distance(one, other) for (one, n), (other, m) in pairs)
    return 2 * total / max(len(sample) * (len(sample) - 1), 1)
