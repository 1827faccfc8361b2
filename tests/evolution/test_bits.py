"""The genetic algorithm on bits against the numbers of Fukui 2003, chapter 3."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, chisquare

from creatures import quick_jit
from evo_cpg.evolution.genetics import BitGenetics
from evo_cpg.evolution.operators import MUTATIONS, bit_mutation, different_places
from evo_cpg.evolution.strategy import Evaluation

POPULATION, ELITES, GENES = 15, 7, 192
RANKS = np.array([0.30, 0.20, 0.20, 0.10, 0.10, 0.05, 0.03, 0.02])
SEEDS = st.integers(0, 2**31 - 1)
STILL = {"mutation_probability": 0.0}
CHANGED = {"mutation_probability": 1.0, "mutation": "flip"}

# The last individual is the best.
FITNESS = np.arange(POPULATION)


def generation_of(genetics):
    """Return the function that breeds the next generation."""

    def breed(key, genes, fitness):
        return genetics.tell(key, (), genes, Evaluation(fitness, {}, {}))

    return breed


@functools.cache
def compiled(*settings: tuple):
    """Return one program with the generation step of each of these settings, on equal draws."""
    steps = [generation_of(BitGenetics(**dict(changes))) for changes in settings]
    return quick_jit(lambda *given: [step(*given) for step in steps])


def bred_under(settings, genes, fitness=FITNESS, seed: int = 0) -> list[np.ndarray]:
    """Return the next generation for each of several settings."""
    breed = compiled(*(tuple(changes.items()) for changes in settings))
    generations = breed(jax.random.key(seed), genes, jnp.asarray(fitness, jnp.float32))
    for children in generations:
        assert children.shape == genes.shape and children.dtype == genes.dtype
    return [np.asarray(children) for children in generations]


def bred(genes, fitness=FITNESS, seed: int = 0, **changes) -> np.ndarray:
    """Return the next generation."""
    return bred_under([changes], genes, fitness, seed)[0]


def bits(seed: int = 99, dtype=jnp.float32) -> jax.Array:
    """Return a population in which all individuals differ."""
    drawn = jax.random.bernoulli(jax.random.key(seed), 0.5, (GENES, POPULATION))
    return drawn.astype(dtype)


def ranks(genes: int = GENES) -> jax.Array:
    """Return a population in which every gene is the rank of its individual, from 0."""
    return jnp.broadcast_to(POPULATION - 1.0 - jnp.arange(POPULATION), (genes, POPULATION))


@pytest.fixture(scope="module")
def picks():
    """Ranks of 100,000 parents, which are all pairs of 12,500 generations."""
    step = generation_of(BitGenetics(mutation_probability=0.0, mutated_genes=(2, 2)))
    keys = jax.random.split(jax.random.key(1), 12_500)
    fitness = jnp.asarray(FITNESS, jnp.float32)
    children = quick_jit(jax.vmap(lambda key: step(key, ranks(2), fitness)))(keys)
    # First genes of siblings come from different parents of the pair.
    return np.asarray(children)[:, 0, ELITES:].reshape(-1, 2).astype(int)


@pytest.mark.slow
def test_the_parents_of_a_pair_are_drawn_independently(picks):
    counts = np.bincount(8 * picks[:, 0] + picks[:, 1], minlength=64)
    assert chisquare(counts, 50_000 * np.outer(RANKS, RANKS).ravel()).pvalue > 0.01


@given(SEEDS)
def test_four_pairs_have_two_complementary_children_each(seed):
    children = bred(ranks(), seed=seed, **STILL)[:, ELITES:]
    for one, two in zip(children[:, ::2].T, children[:, 1::2].T, strict=True):
        parents = one[0], one[-1]
        cut = int((one == one[0]).sum())
        assert max(parents) < 8
        if parents[0] != parents[1]:
            assert 1 <= cut < GENES
        np.testing.assert_array_equal(one, np.repeat(parents, [cut, GENES - cut]))
        np.testing.assert_array_equal(two, np.repeat(parents[::-1], [cut, GENES - cut]))


@given(st.permutations(range(POPULATION)), SEEDS)
def test_the_best_seven_are_kept_bit_for_bit_best_first(fitness, seed):
    genes = np.asarray(bits())
    children = bred(genes, fitness, seed)
    best = sorted(range(POPULATION), key=lambda i: -fitness[i])[:ELITES]
    np.testing.assert_array_equal(children[:, :ELITES], genes[:, best])


@pytest.mark.slow
def test_copies_of_the_best_replace_the_worst_elites():
    numbers = (1, 3, 7)
    settings = [STILL] + [{"best_copies": copies, **STILL} for copies in numbers]
    plain, *generations = bred_under(settings, ranks())
    for copies, children in zip(numbers, generations, strict=True):
        kept = [0] * copies + list(range(1, 1 + ELITES - copies))
        np.testing.assert_array_equal(children[:, :ELITES], np.tile(np.float32(kept), (GENES, 1)))
        np.testing.assert_array_equal(children[:, ELITES:], plain[:, ELITES:])


def test_children_fill_all_places_without_elites():
    # Only the best is a parent, so all children are its mutated copies.
    changes = {"rank_probabilities": (1.0,), **CHANGED}
    genes = np.asarray(bits())
    numbers = (0, 5, 6, 14)
    generations = bred_under([{"elites": n, **changes} for n in numbers], genes)
    for elites, children in zip(numbers, generations, strict=True):
        np.testing.assert_array_equal(children[:, :elites], genes[:, ::-1][:, :elites])
        changed = (children != genes[:, -1:]).sum(0)[elites:]
        assert len(changed) == POPULATION - elites
        assert changed.min() >= 2 and changed.max() <= 30


@pytest.mark.parametrize("dead", [-np.inf, np.nan])
def test_diverged_individuals_are_never_elites(dead):
    genes = np.asarray(bits())
    fitness = np.full(POPULATION, dead)
    fitness[[4, 11]] = -1.0, -0.5
    children = bred(genes, fitness, best_copies=2, **CHANGED)
    np.testing.assert_array_equal(children[:, :3], genes[:, [11, 11, 4]])
    for child in children[:, 3:].T:
        assert not (child == genes.T).all(1).any()


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.bfloat16, jnp.float32])
def test_genes_stay_bits_in_their_own_type(dtype):
    settings = [{"mutation": mutation} for mutation in MUTATIONS]
    lines = [bits(dtype=dtype)] * len(settings)
    for seed in range(20):
        # Each lineage continues with the children of its own kind of mutation.
        lines = [
            bred_under(settings, jnp.asarray(genes), seed=seed)[i] for i, genes in enumerate(lines)
        ]
        assert np.isin(lines, [0.0, 1.0]).all()
    assert all(genes.dtype == dtype for genes in lines)


mutate = quick_jit(bit_mutation, static_argnums=(4, 5))


def mutant(seed: int, genes, probability: float, fewest: int, most: int, mutation: str):
    """Return the genomes after mutation."""
    return np.asarray(mutate(jax.random.key(seed), genes, probability, fewest, most, mutation))


@functools.partial(quick_jit, static_argnums=2)
def genes_changed(seed: int, fewest: int, most: int) -> list[jax.Array]:
    """Return the number of changed genes (of 9) of each individual, by flips and by redraws."""
    key = jax.random.key(seed)
    genes = jax.random.bernoulli(key, 0.5, (9, 40)).astype(jnp.float32)
    mutants = [bit_mutation(key, genes, 1.0, fewest, most, kind) for kind in ("flip", "redraw")]
    return [(mutated != genes).sum(0) for mutated in mutants]


@pytest.mark.slow
@given(SEEDS, st.sampled_from([(1, 1), (2, 5), (1, 9), (9, 9)]))
def test_a_flip_changes_the_given_number_of_genes(seed, bounds):
    changed, redrawn = map(np.asarray, genes_changed(seed, *bounds))
    assert bounds[0] <= changed.min() and changed.max() <= bounds[1]
    # A redraw selects equal genes, and leaves each unchanged with probability 1/2.
    assert (redrawn <= changed).all()


def test_half_of_the_individuals_mutate_in_2_to_30_genes():
    changed = mutant(2, jnp.zeros((GENES, 20_000)), 0.5, 2, 30, "flip") == 1
    number = changed.sum(0)
    mutated = number[number > 0]
    assert binomtest(mutated.size, number.size, 0.5).pvalue > 0.01
    counts = np.bincount(mutated, minlength=31)
    assert counts[:2].sum() == 0 and counts.size == 31
    assert chisquare(counts[2:]).pvalue > 0.01
    assert chisquare(changed.sum(1)).pvalue > 0.01


@pytest.mark.parametrize("number", [1, 2, 3, 5])
def test_all_sets_of_different_genes_are_equally_likely(number):
    draw = quick_jit(different_places, static_argnums=(1, 3))
    places = np.asarray(draw(jax.random.key(6), 5, jnp.full(30_000, number), 5))
    assert (places[number:] == 5).all()
    # Each set is a number with one binary digit for each gene.
    sets = (1 << places[:number]).sum(0)
    counts = np.bincount(sets, minlength=32)
    possible = [i for i in range(32) if i.bit_count() == number]
    assert counts[possible].sum() == 30_000
    assert chisquare(counts[possible]).pvalue > 0.01 or len(possible) == 1


def test_half_of_the_redrawn_genes_change():
    ones = mutant(3, jnp.zeros((50, 2000)), 1.0, 50, 50, "redraw").sum()
    assert binomtest(int(ones), 100_000, 0.5).pvalue > 0.01


@pytest.mark.slow
def test_about_half_of_the_children_of_a_generation_mutate():
    step = generation_of(BitGenetics(mutation="flip"))
    keys = jax.random.split(jax.random.key(4), 1000)
    zeros = jnp.zeros((GENES, POPULATION))
    children = quick_jit(jax.vmap(lambda key: step(key, zeros, ranks()[0])))(keys)
    mutated = np.asarray(children).any(1)
    assert not mutated[:, :ELITES].any()
    each = mutated[:, ELITES:]
    assert binomtest(int(each.sum()), each.size, 0.5).pvalue > 0.01
    # Siblings mutate independently of each other.
    both = 2 * each[:, ::2] + each[:, 1::2]
    assert chisquare(np.bincount(both.ravel(), minlength=4)).pvalue > 0.01


def test_the_key_alone_decides():
    genes = bits()
    np.testing.assert_array_equal(bred(genes, seed=1), bred(genes, seed=1))
    assert (bred(genes, seed=1) != bred(genes, seed=2)).any(0)[ELITES:].all()


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        ("population must be", [{"population": 0}]),
        ("less than the population of 15", [{"elites": 15}, {"elites": -1}]),
        ("best_copies must be from 1 to 7", [{"best_copies": 0}, {"best_copies": 8}]),
        ("best_copies must be from 1 to 1", [{"elites": 0, "best_copies": 2}]),
        ("must be 1 to 15 numbers", [{"rank_probabilities": ()}]),
        ("must be 1 to 7 numbers", [{"population": 7, "elites": 3}]),
        ("must not be negative", [{"rank_probabilities": x} for x in ((1.5, -0.5), (np.nan,))]),
        ("must add up to 1", [{"rank_probabilities": (30.0, 70.0)}]),
        ("mutation_probability must be", [{"mutation_probability": 1.5}]),
        ("mutated_genes must be", [{"mutated_genes": (0, 30)}, {"mutated_genes": (31, 30)}]),
        ("redraw or flip", [{"mutation": "swap"}]),
    ],
)
def test_settings_outside_their_range_are_refused(words, wrong):
    for changes in wrong:
        with pytest.raises(ValueError, match=words):
            BitGenetics(**changes)


def test_a_genome_shorter_than_a_mutation_is_refused():
    with pytest.raises(ValueError, match=r"30 genes, .* only 24"):
        breed = generation_of(BitGenetics())
        jax.eval_shape(breed, jax.random.key(0), ranks(24), jnp.asarray(FITNESS, float))
