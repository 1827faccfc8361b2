"""Crossover and mutation, gene by gene."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, chi2, chisquare, kstest, norm

from creatures import quick_jit
from evo_cpg.evolution import operators
from evo_cpg.evolution.operators import gaussian_mutation, one_point_crossover, random_places

SEEDS = st.integers(0, 2**31 - 1)
GENES, PAIRS = 7, 50

# Without this, JAX would compile every operation for every length.
mutate = quick_jit(gaussian_mutation, static_argnums=2)
cross = quick_jit(one_point_crossover)


def switches(seed: int, genes: int, pairs: int, probability: float) -> np.ndarray:
    """Return where first children have genes of second parents. Siblings must be complementary."""
    # Every gene has a value of its own, which shows its origin.
    population = np.arange(genes * 2 * pairs, dtype=np.float32).reshape(genes, 2 * pairs)
    mates = np.random.default_rng(seed).permutation(2 * pairs).reshape(2, pairs)
    children = np.asarray(cross(jax.random.key(seed), population, *mates, probability))
    assert children.dtype == population.dtype
    one, two = children[:, ::2], children[:, 1::2]
    first, second = (population[:, parents] for parents in mates)
    from_second = one == second
    np.testing.assert_array_equal(one, np.where(from_second, second, first))
    np.testing.assert_array_equal(two, np.where(from_second, first, second))
    return from_second


@given(SEEDS)
def test_crossed_children_switch_parents_exactly_once(seed):
    from_second = switches(seed, GENES, PAIRS, 1.0)
    assert not from_second[0].any() and from_second[-1].all()
    assert (np.diff(from_second.astype(int), axis=0) != 0).sum(0).tolist() == [1] * PAIRS


@given(SEEDS)
def test_without_crossover_children_are_the_parents(seed):
    assert not switches(seed, GENES, PAIRS, 0.0).any()


def test_a_single_gene_cannot_be_cut():
    assert not switches(0, 1, PAIRS, 1.0).any()


def test_cuts_are_uniform_and_crossover_has_its_probability():
    from_second = switches(4, GENES, 100_000, 0.2)
    crossed = from_second[-1]
    assert chisquare([crossed.sum(), (~crossed).sum()], [20_000, 80_000]).pvalue > 0.01
    cuts = GENES - from_second[:, crossed].sum(0)
    assert chisquare(np.bincount(cuts, minlength=GENES)[1:]).pvalue > 0.01


def test_mutation_adds_normal_noise_to_the_given_fraction_of_genes():
    genes = jnp.zeros((100, 1000))
    mutated = np.asarray(mutate(jax.random.key(5), genes, 0.05, 0.5, 8.0)).ravel()
    changed = mutated[mutated != 0]
    assert chisquare([changed.size, mutated.size - changed.size], [5_000, 95_000]).pvalue > 0.01
    assert kstest(changed, norm(0.0, 0.5).cdf).pvalue > 0.01


def test_genes_mutate_independently_with_equal_probability():
    changed = np.asarray(mutate(jax.random.key(8), jnp.zeros((40, 5000)), 0.3, 0.5, 8.0) != 0)
    each = 5000 * np.array([0.7, 0.3])
    for gene in (0, 1, 20, 39):
        assert chisquare(np.bincount(changed[gene], minlength=2), each).pvalue > 0.01
    # Pairs of neighbours in the genome, then in the population.
    for one, other in ((changed[:-1], changed[1:]), (changed[:, :-1], changed[:, 1:])):
        both = np.bincount(2 * one.ravel() + other.ravel(), minlength=4)
        expected = one.size * np.array([0.49, 0.21, 0.21, 0.09])
        assert chisquare(both, expected).pvalue > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1e-3, 0.05, 0.5, 0.99])
def test_places_are_drawn_with_equal_probability(rate):
    keys = jax.random.split(jax.random.key(9), 20_000)
    places = np.asarray(quick_jit(jax.vmap(lambda key: random_places(key, 30, rate)))(keys))
    there = np.array([(places == place).sum(1) for place in range(30)])
    assert there.max() == 1
    # The padding comes last.
    assert (np.diff(places.astype(int), axis=1)[places[:, 1:] < 30] > 0).all()
    assert (np.diff(places.astype(int), axis=1) >= 0).all() and places.max() <= 30
    counts, expected = there.sum(1), 20_000 * rate
    assert chi2.sf(((counts - expected) ** 2).sum() / (expected * (1 - rate)), 30) > 0.01
    # The number of places is binomial.
    chances = binom.pmf(np.arange(31), 30, rate)
    numbers = np.bincount(there.sum(0), minlength=31)
    common = 20_000 * chances > 5
    observed = np.append(numbers[common], numbers[~common].sum())
    expected = 20_000 * np.append(chances[common], chances[~common].sum())
    assert chisquare(observed, expected).pvalue > 0.01


@pytest.mark.parametrize("rate", [1e-9, 0.001, 0.3])
def test_the_array_is_long_enough_for_all_places(rate):
    # In a shorter array, the last places would be missing.
    count = 2_000_000
    places = np.asarray(
        quick_jit(random_places, static_argnums=(1, 2))(jax.random.key(10), count, rate)
    )
    assert places[-1] == count
    tail = binom.sf((places < count).sum() - 1, count, rate)
    assert 0.001 < tail <= 1.0


@pytest.mark.slow
def test_a_population_mutates_in_parts_as_in_one(monkeypatch):
    monkeypatch.setattr(operators, "_MOST_AT_ONCE", 30_000)
    genes = jnp.zeros((101, 1000))
    in_parts = quick_jit(gaussian_mutation, static_argnums=(2, 3, 4))
    mutated = np.asarray(in_parts(jax.random.key(11), genes, 0.05, 0.5, 8.0))
    changed = mutated != 0
    expected = genes.size * np.array([0.05, 0.95])
    assert chisquare([changed.sum(), (~changed).sum()], expected).pvalue > 0.01
    assert chisquare(changed.sum(1)).pvalue > 0.01
    assert kstest(mutated[changed], norm(0.0, 0.5).cdf).pvalue > 0.01


@given(SEEDS, st.sampled_from([0.0, 0.3, 1.0]), st.sampled_from([0.0, 100.0]), st.just(0.75))
def test_mutated_genes_stay_within_bounds(seed, rate, sigma, bound):
    genes = np.linspace(-0.5, 0.5, 30, dtype=np.float32).reshape(10, 3)
    mutated = mutate(jax.random.key(seed), genes, rate, sigma, bound)
    assert np.abs(mutated).max() <= np.float32(bound)


@pytest.mark.parametrize(("rate", "sigma"), [(0.0, 1.0), (1.0, 0.0)])
def test_nothing_changes_at_rate_or_sigma_zero(rate, sigma):
    genes = jnp.linspace(-1, 1, 30).reshape(10, 3)
    np.testing.assert_array_equal(mutate(jax.random.key(6), genes, rate, sigma, 8.0), genes)
