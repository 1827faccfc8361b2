"""Crossover and mutation, gene by gene."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare, kstest

from evo_cpg.evolution.variation import gaussian_mutation, one_point_crossover

SEEDS = st.integers(0, 2**31 - 1)
GENES, PAIRS = 7, 50


def parents(genes: int, pairs: int) -> tuple[jax.Array, jax.Array]:
    """Genomes in which every gene tells where it comes from."""
    first = jnp.arange(genes * pairs, dtype=jnp.float32).reshape(genes, pairs)
    return first, -1.0 - first


def switches(seed: int, genes: int, pairs: int, probability: float) -> np.ndarray:
    """Where children take the other parent's genes; checks that the two are complementary."""
    first, second = parents(genes, pairs)
    one, two = one_point_crossover(jax.random.key(seed), first, second, probability)
    from_second = np.asarray(one == second)
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


@given(SEEDS, st.floats(0, 1))
def test_children_have_a_gene_of_one_parent_at_each_locus(seed, probability):
    from_second = switches(seed, GENES, PAIRS, probability)
    assert ((np.diff(from_second.astype(int), axis=0) != 0).sum(0) <= 1).all()


def test_a_single_gene_cannot_be_cut():
    assert not switches(0, 1, PAIRS, 1.0).any()


def test_cuts_are_uniform_and_crossover_as_frequent_as_asked():
    from_second = switches(4, GENES, 100_000, 0.2)
    crossed = from_second[-1]
    assert chisquare([crossed.sum(), (~crossed).sum()], [20_000, 80_000]).pvalue > 0.01
    cuts = GENES - from_second[:, crossed].sum(0)
    assert chisquare(np.bincount(cuts, minlength=GENES)[1:]).pvalue > 0.01


def test_mutation_changes_the_asked_share_of_genes_by_normal_noise():
    genes = jnp.zeros((100, 1000))
    mutated = np.asarray(gaussian_mutation(jax.random.key(5), genes, 0.05, 0.5, 8.0)).ravel()
    changed = mutated[mutated != 0]
    assert chisquare([changed.size, mutated.size - changed.size], [5_000, 95_000]).pvalue > 0.01
    assert kstest(changed, "norm", args=(0.0, 0.5)).pvalue > 0.01


@given(SEEDS, st.floats(0, 1), st.floats(0, 100), st.floats(0.5, 8))
def test_mutated_genes_stay_within_bounds(seed, rate, sigma, bound):
    genes = jnp.linspace(-0.5, 0.5, 30).reshape(10, 3)
    mutated = gaussian_mutation(jax.random.key(seed), genes, rate, sigma, bound)
    assert float(jnp.abs(mutated).max()) <= np.float32(bound)


@pytest.mark.parametrize(("rate", "sigma"), [(0.0, 1.0), (1.0, 0.0)])
def test_without_rate_or_size_nothing_changes(rate, sigma):
    genes = jnp.linspace(-1, 1, 30).reshape(10, 3)
    np.testing.assert_array_equal(
        gaussian_mutation(jax.random.key(6), genes, rate, sigma, 8.0), genes
    )


def test_everything_changes_at_rate_one():
    genes = jnp.linspace(-1, 1, 3000).reshape(1000, 3)
    assert (gaussian_mutation(jax.random.key(7), genes, 1.0, 0.5, 8.0) != genes).mean() > 0.999
