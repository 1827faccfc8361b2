"""Topologies of body plans, their edit distance, and diversity over generations."""

import functools
import types

import numpy as np
import pytest

from evo_cpg.analysis.diversity import diversity, topology_of, tree_edit_distance
from plans import hand_plan, paired

LEAF, OTHER = ("z", ()), ("y", ())


def tree(*children):
    return "", children


@pytest.mark.parametrize(
    ("one", "other", "distance"),
    [
        (tree(), tree(), 0),
        (tree(LEAF), tree(OTHER), 1),
        (tree(LEAF, LEAF), tree(), 2),
        # A link is inserted in the middle of a chain.
        (tree(("z", (LEAF,))), tree(("z", (("y", (LEAF,)),))), 1),
        # The middle of a chain is removed, and its children move up.
        (tree(("z", (LEAF, OTHER))), tree(LEAF, OTHER), 1),
    ],
)
def test_edit_distances_count_changes(one, other, distance):
    assert tree_edit_distance(one, other) == tree_edit_distance(other, one) == distance


@functools.cache
def by_definition(one, other):
    """Edit distance of forests: the last root is removed, added or kept."""
    if not one or not other:
        return sum(1 + by_definition(below, ()) for _, below in one or other)
    (kind, below), (other_kind, other_below) = one[-1], other[-1]
    return min(
        by_definition(one[:-1] + below, other) + 1,
        by_definition(one, other[:-1] + other_below) + 1,
        by_definition(one[:-1], other[:-1])
        + by_definition(below, other_below)
        + (kind != other_kind),
    )


def random_tree(rng, depth=3):
    below = (random_tree(rng, depth - 1) for _ in range(rng.integers(3) if depth else 0))
    return str(rng.choice(["y", "z"])), tuple(below)


def test_edit_distances_match_their_definition():
    rng = np.random.default_rng(0)
    for _ in range(40):
        one, other = (random_tree(rng) for _ in range(2))
        assert tree_edit_distance(one, other) == by_definition((one,), (other,))


def test_topologies_ignore_order_labels_and_sizes():
    tail = {"label": 9, "axes": (0, 1, 1)}
    one = hand_plan({}, tail, *paired(3, (0, 0.1, 0)))
    other = hand_plan({"half": (1, 1, 1)}, *paired(5, (0.1, 0.1, 0)), tail)
    assert topology_of(one) == topology_of(other) == ("", (("yz", ()), ("z", ()), ("z", ())))
    assert topology_of(hand_plan({}, tail)) != topology_of(hand_plan({}, {}))
    assert topology_of(hand_plan({}, {}, {"parent": 1})) != topology_of(hand_plan({}, {}, {}))


def test_diversity_counts_topologies_and_founders():
    kinds = [hand_plan(*[{}] * count) for count in (1, 2, 4)]
    plans = types.SimpleNamespace(kept=lambda genomes: [kinds[genome[0]] for genome in genomes])
    block = np.zeros((2, 1, 3), [("genome", np.uint8, (1,)), ("fitness", float), ("first", int)])
    block["genome"][:, 0, :, 0] = [0, 1, 2], [1, 1, 0]
    block["first"][0] = [[2, 1, 1]]
    found = diversity(plans, list(block))
    np.testing.assert_array_equal(found.generations, [0, 1])
    np.testing.assert_array_equal(found.topologies, [3, 2])
    np.testing.assert_array_equal(found.best, [3, 2])
    np.testing.assert_array_equal(found.founders, [3, 2])
    # Between 1, 2 and 4 bodies, then between 2, 2 and 1.
    np.testing.assert_allclose(found.distance, [(1 + 3 + 2) / 3, 2 / 3])
