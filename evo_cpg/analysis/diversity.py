"""Diversity of body plans over the generations of a run.

The *topology* of a plan is its tree of bodies with the axes of their joints. It has no labels,
sizes or places, and the order of children does not count. So two plans have one topology if and
only if one can be drawn over the other, joint by joint.

The edit distance of two topologies is the least number of bodies that are added, removed or given
other joint axes to make one from the other (Zhang and Shasha 1989, "Simple fast algorithms for the
editing distance between trees and related problems"). Children are compared in the sorted order of
`topology_of`, because the distance of unordered trees takes exponential time.
"""

import itertools
from collections import Counter
from typing import NamedTuple

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
    below: list[list[Topology]] = [[] for _ in plan.present]
    for i in reversed(np.flatnonzero(plan.present)):
        kind = "".join(itertools.compress("xyz", plan.axes[i]))
        tree = kind, tuple(sorted(below[i]))
        if plan.parent[i] >= 0:
            below[plan.parent[i]].append(tree)
    return tree


def tree_edit_distance(one: Topology, other: Topology) -> int:
    """Return the edit distance of two topologies, where each operation costs 1."""
    (kinds, first, roots), (others, other_first, other_roots) = _postorder(one), _postorder(other)
    whole = [[0] * len(others) for _ in kinds]
    for i, j in itertools.product(roots, other_roots):
        # Distances between forests that begin at the first leaves of the subtrees i and j.
        a, b = first[i], other_first[j]
        forest = [[p + q for q in range(j - b + 2)] for p in range(i - a + 2)]
        for x, y in itertools.product(range(a, i + 1), range(b, j + 1)):
            p, q = x - a + 1, y - b + 1
            trees = first[x] == a and other_first[y] == b
            if trees:
                joined = forest[p - 1][q - 1] + (kinds[x] != others[y])
            else:
                joined = forest[first[x] - a][other_first[y] - b] + whole[x][y]
            forest[p][q] = min(forest[p - 1][q] + 1, forest[p][q - 1] + 1, joined)
            if trees:
                whole[x][y] = forest[p][q]
    return whole[-1][-1]


def _postorder(tree: Topology) -> tuple[list[str], list[int], list[int]]:
    """Return the kinds of all nodes, children first, their first leaves, and the key roots.

    A key root is the root of the whole tree, or a node with an earlier sibling.
    """
    kinds: list[str] = []
    first: list[int] = []

    def visit(node: Topology) -> None:
        begin = len(kinds)
        for child in node[1]:
            visit(child)
        kinds.append(node[0])
        first.append(begin)

    visit(tree)
    return kinds, first, sorted({leaf: node for node, leaf in enumerate(first)}.values())


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
            new = np.array([x for x in np.unique(block["genome"], axis=0) if x.tobytes() not in known])
            for genome, plan in zip(new, plans.kept(new), strict=True):
                known[genome.tobytes()] = topology_of(plan)
            found = [known[genome.tobytes()] for genome in block["genome"]]
            best = [found[i] for i in np.argsort(-block["fitness"], kind="stable")[:BEST]]
            sample = np.random.default_rng(number).permutation(len(found))[:BEST]
            distance = _mean_distance([found[i] for i in sample])
            rows.append((number, len({*found}), len({*best}), distance, len({*founder})))
        founder = founder[block["first"]]
    return Diversity(*map(np.array, zip(*rows, strict=True)))


def _mean_distance(sample: list[Topology]) -> float:
    """Return the mean edit distance between two different individuals of a sample."""
    pairs = itertools.combinations(Counter(sample).items(), 2)
    total = sum(n * m * tree_edit_distance(one, other) for (one, n), (other, m) in pairs)
    return 2 * total / max(len(sample) * (len(sample) - 1), 1)
