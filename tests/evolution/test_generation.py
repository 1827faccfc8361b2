"""The generation step: elites, children, and populations with few finite individuals."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_bits import generation_of

from creatures import quick_jit
from evo_cpg.evolution.genetics import RealGenetics

POPULATION, ELITES, GENES = 9, 3, 6


def genetics(**changes) -> RealGenetics:
    """Return a genetic algorithm in which every child differs from its parents, with changes."""
    settings = {
        "population": POPULATION,
        "elites": ELITES,
        "parent_fraction": 0.5,
        "crossover_probability": 0.5,
        "mutation_rate": 1.0,
        "mutation_sigma": 0.1,
        "gene_bound": 8.0,
    }
    return RealGenetics(**settings | changes)


@functools.cache
def compiled(changes: tuple):
    """Return the generation step with these settings."""
    return quick_jit(generation_of(genetics(**dict(changes))))


def bred(fitness, seed: int = 0, **changes) -> tuple[np.ndarray, np.ndarray]:
    """Return a population and its children."""
    genes = jax.random.normal(jax.random.key(99), (GENES, POPULATION))
    breed = compiled(tuple(changes.items()))
    children = breed(jax.random.key(seed), genes, jnp.asarray(fitness, jnp.float32))
    assert children.shape == genes.shape and children.dtype == genes.dtype
    return np.asarray(genes), np.asarray(children)


@given(st.permutations(range(POPULATION)))
def test_elites_stay_bit_for_bit_best_first(fitness):
    genes, children = bred(fitness)
    best = sorted(range(POPULATION), key=lambda i: -fitness[i])[:ELITES]
    np.testing.assert_array_equal(children[:, :ELITES], genes[:, best])
    for child in children[:, ELITES:].T:
        assert not (child == genes.T).all(1).any()


def test_without_mutation_and_crossover_children_are_copies_of_parents():
    fitness = np.arange(POPULATION)
    genes, children = bred(fitness, mutation_rate=0.0, crossover_probability=0.0)
    allowed = genes[:, fitness >= POPULATION - round(0.5 * POPULATION)].T
    for child in children.T:
        assert (allowed == child).all(1).any()


@pytest.mark.parametrize("dead", [-np.inf, np.nan])
def test_diverged_individuals_are_never_elites(dead):
    fitness = np.full(POPULATION, dead)
    fitness[[4, 7]] = -1.0, -0.5
    genes, children = bred(fitness)
    np.testing.assert_array_equal(children[:, :2], genes[:, [7, 4]])
    # A child takes the third elite's place, not a diverged individual.
    assert not (children[:, 2] == genes.T).all(1).any()


def test_children_fill_every_place_if_all_diverged():
    genes, children = bred(np.full(POPULATION, -np.inf))
    assert np.isfinite(children).all()
    for child in children.T:
        assert not (child == genes.T).all(1).any()


def test_no_elites_and_a_single_parent():
    fitness = np.arange(POPULATION)
    genes, children = bred(fitness, elites=0, parent_fraction=0.01, mutation_rate=0.0)
    np.testing.assert_array_equal(children, np.repeat(genes[:, -1:], POPULATION, 1))


def test_the_key_alone_decides():
    fitness = np.arange(POPULATION)
    np.testing.assert_array_equal(bred(fitness, 1)[1], bred(fitness, 1)[1])
    assert (bred(fitness, 1)[1] != bred(fitness, 2)[1])[:, ELITES:].all()


@pytest.mark.slow
def test_batched_runs_equal_single_runs():
    seeds = range(3)
    step = generation_of(genetics(population=23, mutation_rate=0.05))
    keys = jnp.stack([jax.random.key(seed) for seed in seeds])
    genes = jax.random.normal(jax.random.key(98), (3, 301, 23))
    fitness = jax.random.normal(jax.random.key(97), (3, 23))
    together = quick_jit(jax.vmap(step))(keys, genes, fitness)
    for seed in seeds:
        alone = quick_jit(step)(keys[seed], genes[seed], fitness[seed])
        np.testing.assert_array_equal(together[seed], alone)
