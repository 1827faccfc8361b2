"""Elites that learn improve the next generation, independently in each run."""

import numpy as np
import pytest

from evo_cpg.training.experiment import Learning
from trials import evolve, experiment, untimed

SEED = 3
MADE = experiment(60, 6, seed=SEED)._replace(generations=3, learning=Learning(2, 2, 4))


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    return evolve(MADE, tmp_path_factory.mktemp("learned") / "run")[1]


@pytest.mark.slow
def test_learning_improves_the_next_generation(learned, tmp_path):
    _, plain = evolve(MADE._replace(learning=None), tmp_path / "run")
    with_it, without = untimed(learned.history), untimed(plain.history)
    # The elites first learn after two generations, so these are equal.
    assert with_it[:2] == without[:2]
    # The next generations differ in their elites only.
    assert with_it[2]["mean"] > without[2]["mean"] + 1e-5


@pytest.mark.slow
def test_learning_does_not_depend_on_other_runs(learned, tmp_path):
    _, pair = evolve(MADE._replace(seed=SEED - 1, runs=2), tmp_path / "run")
    beside = [row for row in pair.history if row.pop("run") == 1]
    assert untimed(beside) == untimed(learned.history)


@pytest.mark.slow
def test_a_resumed_run_learns_equally(learned, tmp_path):
    evolve(MADE._replace(generations=1), tmp_path / "run")
    _, resumed = evolve(MADE, tmp_path / "run")
    assert untimed(resumed.history) == untimed(learned.history)
    np.testing.assert_array_equal(resumed.genes, learned.genes)
