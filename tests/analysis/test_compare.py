"""Comparisons of settings by ranks, against brute force."""

import itertools

import numpy as np
import pytest

from evo_cpg.analysis.compare import compare, holm, spread


def test_the_chance_to_win_counts_ties_half():
    first, second = [1.0, 2.0, 3.0, 3.0], [3.0, 0.5, 2.0]
    (found,) = compare({"a": first, "b": second})
    wins = sum((x > y) + 0.5 * (x == y) for x, y in itertools.product(first, second))
    assert (found.first, found.second) == ("a", "b")
    assert found.wins == pytest.approx(wins / 12)


def test_p_value_equals_exact_permutation_test():
    """p is the fraction of all choices of four of eight values that are at least as uneven."""
    first, second = [0.1, 0.2, 0.35, 0.8], [0.3, 0.5, 0.7, 0.9]
    (found,) = compare({"a": first, "b": second})
    pooled = np.array(first + second)

    def lead(chosen):
        own = pooled[list(chosen)]
        others = np.delete(pooled, list(chosen))
        return abs(sum(x > y for x, y in itertools.product(own, others)) - 8)

    leads = [lead(chosen) for chosen in itertools.combinations(range(8), 4)]
    assert found.p_value == pytest.approx(np.mean(np.array(leads) >= lead(range(4))))


def test_holm_correction_grows_with_the_number_of_tests():
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03])), [0.03, 0.06, 0.06])
    np.testing.assert_allclose(holm(np.array([0.5, 0.9])), [1.0, 1.0])
    assert holm(np.array([])).size == 0
    settings = {name: list(range(5 * i, 5 * i + 5)) for i, name in enumerate("abc")}
    for found in compare(settings):
        assert found.wins == 0.0
        assert found.adjusted == pytest.approx(3 * found.p_value)


def test_runs_without_a_champion_are_left_out():
    nan = float("nan")
    assert compare({"a": [1.0, nan], "b": [2.0, 3.0]}) == []
    found = spread("a", [nan, 4.0, 2.0, 3.0])
    assert found[1:] == (3, 3.0, 2.5, 3.5, 2.0, 4.0)
    assert spread("b", [nan]).runs == 0 and np.isnan(spread("b", [nan]).median)
