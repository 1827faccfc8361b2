"""Rank roulette against stated probabilities, lexicase selection against all orders of trials."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare

from evo_cpg.evolution.operators import (
    draw_by_lexicase,
    draw_parents,
    linear_rank_probabilities,
    rank_order,
)

DRAWS = 100_000

by_lexicase = jax.jit(draw_by_lexicase, static_argnums=3)

# Any fitness that `score` returns, and NaN.
FITNESS = st.lists(
    st.sampled_from([-2.5, -1.0, 0.0, 0.5, 0.5, 3.0, -np.inf, np.nan]), min_size=6, max_size=6
)


@pytest.mark.parametrize(
    ("count", "fraction", "weights"),
    [
        (4, 1.0, [4, 3, 2, 1]),
        (8, 0.5, [4, 3, 2, 1, 0, 0, 0, 0]),
        (5, 0.01, [1, 0, 0, 0, 0]),
        (1, 1.0, [1]),
    ],
)
def test_probabilities_fall_linearly_to_zero_after_the_last_parent(count, fraction, weights):
    probabilities = linear_rank_probabilities(count, fraction)
    np.testing.assert_allclose(probabilities, np.array(weights) / np.sum(weights), rtol=1e-12)


@pytest.mark.parametrize("fraction", [0.5, 1.0])
def test_parents_are_drawn_with_the_stated_frequencies(fraction):
    fitness = jnp.asarray(np.random.default_rng(0).permutation(20).astype(np.float32))
    probabilities = linear_rank_probabilities(20, fraction)
    drawn = draw_parents(jax.random.key(1), fitness, probabilities, DRAWS)
    rank = 19 - np.asarray(fitness)[np.asarray(drawn)].astype(int)
    counts = np.bincount(rank, minlength=20)
    allowed = probabilities > 0
    assert counts[~allowed].sum() == 0
    assert chisquare(counts[allowed], DRAWS * probabilities[allowed]).pvalue > 0.01


@given(FITNESS)
def test_order_is_a_stable_sort_with_the_diverged_last(fitness):
    order = np.asarray(rank_order(jnp.asarray(fitness, jnp.float32)))
    keys = [-np.inf if np.isnan(f) else f for f in fitness]
    assert order.tolist() == sorted(range(6), key=lambda i: -keys[i])


def lexicase_chances(trial_fitness: np.ndarray) -> np.ndarray:
    """Return the probability of each individual as a parent, averaged over all orders of trials."""
    middle = np.median(trial_fitness, 1, keepdims=True)
    tolerance = np.median(np.abs(trial_fitness - middle), 1)
    chances = np.zeros(trial_fitness.shape[1])
    orders = list(itertools.permutations(range(len(trial_fitness))))
    for order in orders:
        left = np.arange(trial_fitness.shape[1])
        for trial in order:
            rivals = trial_fitness[trial, left]
            left = left[rivals >= rivals.max() - tolerance[trial]]
        chances[left] += 1 / (len(left) * len(orders))
    return chances


@pytest.mark.slow
@pytest.mark.parametrize("trials", [1, 2, 4])
def test_lexicase_frequencies_equal_the_mean_over_orders_of_trials(trials):
    trial_fitness = np.random.default_rng(trials).normal(size=(trials, 9)).astype(np.float32)
    chances = lexicase_chances(trial_fitness)
    assert 1 < (chances > 0).sum() < 9
    fitness = jnp.asarray(trial_fitness.mean(0))
    drawn = by_lexicase(jax.random.key(4), fitness, jnp.asarray(trial_fitness), DRAWS)
    counts = np.bincount(np.asarray(drawn), minlength=9)
    assert counts[chances == 0].sum() == 0
    assert chisquare(counts[chances > 0], DRAWS * chances[chances > 0]).pvalue > 0.01


@pytest.mark.slow
def test_lexicase_draws_no_diverged_individual_while_others_are_finite():
    trial_fitness = jnp.asarray([[9.0, -1.0, -2.0, jnp.nan], [-jnp.inf, -1.0, 0.5, 3.0]])
    fitness = trial_fitness.mean(0)
    drawn = by_lexicase(jax.random.key(6), fitness, trial_fitness, 1000)
    assert set(np.asarray(drawn).tolist()) == {1, 2}
    diverged = jnp.full((2, 4), -jnp.inf)
    drawn = by_lexicase(jax.random.key(6), diverged[0], diverged, 1000)
    assert set(np.asarray(drawn).tolist()) == {0, 1, 2, 3}
