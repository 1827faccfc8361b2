"""Every strategy improves on a sphere function, and keeps its state in arrays."""

import dataclasses
import functools
import importlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.evolution.genetics import BitGenetics, RealGenetics
from evo_cpg.evolution.islands import Islands
from evo_cpg.evolution.map_elites import AlongTheLine, MapElites, Mapped, OfBits
from evo_cpg.evolution.strategy import Axis, Evaluation, RandomSearch, Strategy, worst_finite
from evo_cpg.training.checkpoint import StrategyError, state_arrays, state_from

GENES, SIZE = 6, 24
GENETICS = RealGenetics(SIZE, 3, 0.5, 0.2, 0.3, 0.3, 8.0)
AXES = (Axis("first", -2.0, 2.0, 4), Axis("second", -2.0, 2.0, 3))


class Climber(Strategy):
    """The example in the docstring of `Strategy`."""

    population: int = eqx.field(static=True)
    sigma: float = 0.1

    def init(self, key, genes):
        return genes[:, 0], -jnp.inf

    def ask(self, key, state):
        best, _ = state
        noise = jax.random.normal(key, (len(best), self.population), best.dtype)
        return best[:, None] + self.sigma * noise, state

    def tell(self, key, state, genes, evaluation):
        best, fitness = state
        i = jnp.argmax(evaluation.fitness)
        better = evaluation.fitness[i] > fitness
        best = jnp.where(better, genes[:, i], best)
        return best, jnp.where(better, evaluation.fitness[i], fitness)


def evosax(name, genes=GENES, **settings):
    pytest.importorskip("evosax")
    kind = importlib.import_module("evo_cpg.evolution.evosax").Evosax
    return kind(name, SIZE, genes, **settings)


# LM-MA-ES needs more genes than individuals.
MANY_GENES = 60


def genes_of(name):
    return MANY_GENES if name == "LM_MA_ES" else GENES


STRATEGIES = {
    "genetics": lambda: GENETICS,
    "lexicase": lambda: dataclasses.replace(GENETICS, selection="lexicase"),
    "climber": lambda: Climber(SIZE),
    "islands": lambda: Islands(
        SIZE,
        RealGenetics(SIZE // 3, 2, 0.5, 0.2, 0.3, 0.3, 8.0, "lexicase"),
        3,
        every=2,
        migrants=1,
    ),
    "islands of climbers": lambda: Islands(SIZE, Climber(SIZE // 2), 2, 3, 1),
    "genetics with a map": lambda: Mapped(SIZE, AXES, GENETICS),
    "map_elites": lambda: MapElites(SIZE, AXES, AlongTheLine(0.1, 0.2, 8.0)),
    "random": lambda: RandomSearch(
        SIZE, lambda key: jax.random.uniform(key, (GENES, SIZE), jnp.float32, -2.0, 2.0)
    ),
    "Sep_CMA_ES": lambda: evosax("Sep_CMA_ES"),
    "LM_MA_ES": lambda: evosax("LM_MA_ES", MANY_GENES),
    "Open_ES": lambda: evosax("Open_ES", sigma=0.2, learning_rate=0.2),
    "DifferentialEvolution": lambda: evosax("DifferentialEvolution"),
}


@functools.cache
def made(name):
    return STRATEGIES[name]()


# The fast tests run one algorithm of evosax with a distribution and one with a population, and
# islands and a map around one search.
SLOW = "LM_MA_ES", "Open_ES", "islands of climbers", "genetics with a map"
NAMES = [
    pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in STRATEGIES
]


@jax.jit
def sphere(genes):
    """Evaluate genomes: best if all genes are 0.7, diverged if the first is below -1.5."""
    fitness = -((genes - 0.7) ** 2).sum(0)
    fitness = jnp.where(genes[0] < -1.5, -jnp.inf, fitness)
    about = {"cost": -fitness}, {"first": genes[0], "second": genes[1]}
    return Evaluation(fitness, *about, jnp.stack([fitness + genes[0], fitness - genes[0]]))


# Compiled programs of strategies that several tests share, by identity. Each entry keeps its
# strategy, so that no other strategy gets its identity.
_PROGRAMS: dict = {}


def programs(strategy):
    """Return a strategy's first and later generations, compiled once."""

    @jax.jit
    def begin(start_key, key, start):
        return strategy.ask(jax.random.fold_in(key, 0), strategy.init(start_key, start))

    @jax.jit
    def step(key, i, genes, state, worth):
        tell_key, ask_key = jax.random.split(jax.random.fold_in(key, i))
        return strategy.ask(ask_key, strategy.tell(tell_key, state, genes, worth))

    return _PROGRAMS.setdefault(id(strategy), (strategy, begin, step))[1:]


def search(strategy, generations=40, seed=0, evaluate=sphere, genes=GENES):
    """Return the populations, the fitness of each, and the last state."""
    start_key, key = jax.random.split(jax.random.key(seed))
    start = jax.random.uniform(start_key, (genes, SIZE), jnp.float32, -2.0, 2.0)
    begin, step = programs(strategy)
    genes, state = begin(start_key, key, start)
    populations, found = [genes], []
    for i in range(1, generations + 1):
        worth = evaluate(genes)
        genes, state = step(key, i, genes, state, worth)
        found.append(np.asarray(worth.fitness))
        populations.append(np.asarray(genes))
    return populations, found, state


@pytest.mark.parametrize("name", NAMES)
def test_a_search_improves_with_finite_genes(name):
    populations, found, _ = search(made(name), genes=genes_of(name))
    assert all(genes.shape == (genes_of(name), SIZE) for genes in populations)
    assert np.isfinite(np.array(populations)).all()
    # The error falls to half the error of random genomes.
    last = max(fitness.max() for fitness in found[-5:])
    assert name == "random" or last > 0.5 * found[0].max()


@pytest.mark.parametrize("name", NAMES)
def test_a_state_survives_conversion_to_arrays(name):
    strategy = made(name)
    populations, _, state = search(strategy, 6, genes=genes_of(name))
    arrays = {name: np.array(value) for name, value in state_arrays(state).items()}
    like = jax.eval_shape(lambda: state)
    again = jax.tree.map(jnp.asarray, state_from(arrays, like))
    last = jnp.asarray(populations[-1])
    worth, (_, step) = sphere(last), programs(strategy)
    for one, other in zip(
        jax.tree.leaves(step(jax.random.key(1), 7, last, state, worth)),
        jax.tree.leaves(step(jax.random.key(1), 7, last, again, worth)),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_search_survives_generations_in_which_all_diverge(name):
    def deadly(genes):
        diverged = jnp.full(genes.shape[1], -jnp.inf)
        lost = jnp.full(genes.shape[1], jnp.nan)
        about = {"cost": lost}, {"first": lost, "second": lost}
        return Evaluation(diverged, *about, jnp.stack([diverged, diverged]))

    populations, _, _ = search(made(name), 5, evaluate=deadly, genes=genes_of(name))
    assert np.isfinite(np.array(populations)).all()


def test_random_search_draws_every_generation():
    populations, _, _ = search(made("random"), 4)
    assert len({np.asarray(genes).tobytes() for genes in populations}) == 5
    later = np.array(populations[1:])
    assert abs(later.mean()) < 0.2 and later.std() == pytest.approx(4 / 12**0.5, rel=0.05)


def test_a_state_of_another_strategy_is_refused():
    arrays = state_arrays({"archive": {"genes": np.zeros((2, 3), np.float32)}})
    assert list(arrays) == ["archive.genes"]
    with pytest.raises(StrategyError, match=r"archive\.genes \(2, 3\).*needs nothing"):
        state_from(arrays, ())
    with pytest.raises(StrategyError, match="the state of another strategy"):
        state_from(arrays, {"archive": {"genes": np.zeros((2, 4), np.float32)}})


def test_a_state_of_any_arrays_survives_a_file(tmp_path):
    """The state has names that would collide, types that NumPy lacks, and random keys."""

    def state():
        return {
            "a.b": jnp.arange(3.0),
            "a": {"b": jnp.arange(3.0) + 5},
            "half": jnp.array([0.1, -3.0], jnp.bfloat16),
            "few": jnp.array(-3, jnp.int4),
            "key": jax.random.split(jax.random.key(3), 2),
            "other": jax.random.key(4, impl="rbg"),
        }

    arrays = state_arrays(state())
    assert set(arrays) == {
        "a.b", "a.b'", "half.bfloat16", "few.int4", "key.key<fry>", "other.key<rbg>"
    }  # fmt: skip
    np.savez(tmp_path / "x.npz", **arrays)
    with np.load(tmp_path / "x.npz") as file:
        again = state_from(dict(file), jax.eval_shape(state))
    for one, other in zip(jax.tree.leaves(state()), jax.tree.leaves(again), strict=True):
        assert one.dtype == other.dtype and one.shape == other.shape
        if jnp.issubdtype(one.dtype, jax.dtypes.prng_key):
            one, other = jax.random.key_data(one), jax.random.key_data(other)
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))
    with pytest.raises(StrategyError, match="the state of another strategy"):
        state_from(arrays, state() | {"half": jnp.zeros(2, jnp.uint16)})


def test_diverged_individuals_get_the_worst_finite_fitness():
    for given, found in (([1.0, -np.inf, -2.0, np.nan], [1, -2, -2, -2]), ([-np.inf], [0])):
        np.testing.assert_array_equal(worst_finite(jnp.array(given)), found)


def genes_after_migration(genes):
    """Return the genes that `tell` of the islands' strategies receives after two generations."""

    class Echo(Strategy):
        population: int = eqx.field(static=True)

        def init(self, key, genes):
            return genes

        def ask(self, key, state):
            return state, ()

        def tell(self, key, state, genes, evaluation):
            return genes

    islands = Islands(12, Echo(4), 3, every=2, migrants=2)

    @jax.jit
    def two_generations(key, genes):
        _, state = islands.ask(key, islands.init(key, genes))
        for _ in range(2):
            worth = Evaluation(genes[0], {}, {}, genes)
            genes, state = islands.ask(key, islands.tell(key, state, genes, worth))
        return genes[0]

    return np.asarray(two_generations(jax.random.key(0), genes))


def test_the_best_of_an_island_replace_the_worst_of_the_next():
    fitness = np.array([[3, 1, 4, 2], [8, 7, 5, 6], [9, 12, 10, 11]], np.float32)
    after = genes_after_migration(jnp.asarray(fitness.reshape(1, -1)))
    # No individual migrates in the first generation. The two best migrate in the second.
    expected = np.array([[3, 12, 4, 11], [8, 7, 4, 3], [8, 12, 7, 11]])
    np.testing.assert_array_equal(np.sort(after.reshape(3, 4)), np.sort(expected))


@pytest.mark.slow
def test_islands_without_migration_evolve_as_if_alone():
    genetics = RealGenetics(8, 2, 0.5, 0.2, 0.3, 0.3, 8.0)
    islands = Islands(SIZE, genetics, 3, every=1000, migrants=1)
    genes = jax.random.normal(jax.random.key(1), (GENES, SIZE))
    worth, key = sphere(genes), jax.random.key(2)

    @jax.jit
    def search_together(genes):
        _, state = islands.ask(jax.random.key(0), islands.init(jax.random.key(0), genes))
        return islands.ask(key, islands.tell(key, state, genes, worth))[0]

    together, breed_alone = search_together(genes), jax.jit(genetics.tell)
    for i in range(3):
        own = slice(8 * i, 8 * i + 8)
        own_worth = Evaluation(worth.fitness[own], {}, {})
        alone = breed_alone(jax.random.fold_in(key, i), (), genes[:, own], own_worth)
        np.testing.assert_array_equal(together[:, own], alone)


@pytest.mark.parametrize(
    "side, children", [(10, 2**12), pytest.param(100, 2**20, marks=pytest.mark.slow)]
)
def test_parents_come_from_occupied_cells_only(side, children):
    """A third of the cells is filled. Rounded sums of probabilities once drew empty cells."""
    axes = tuple(Axis(axis.name, axis.low, axis.high, side) for axis in AXES)
    strategy = MapElites(children, axes, AlongTheLine(0.0, 0.0, 1e5))
    rng = np.random.default_rng(0)
    filled = rng.random(side**2) < 0.3
    empty = strategy.empty(jnp.zeros((1, children)))
    state = empty._replace(
        fitness=jnp.where(filled, 1.0, -jnp.inf),
        genes=jnp.where(filled, 1.0 + jnp.arange(float(side**2)), 0.0)[None],
    )
    ask = jax.jit(strategy.ask)
    drawn = np.unique([ask(jax.random.key(i), state)[0] for i in range(4)])
    # Each elite has at least 400 children.
    np.testing.assert_array_equal(drawn, 1.0 + np.flatnonzero(filled))


def test_a_map_keeps_the_fittest_of_every_cell():
    """The map equals a plain loop over all individuals of all generations."""
    strategy = MapElites(SIZE, AXES, AlongTheLine(0.5, 0.2, 8.0))

    def evaluate(genes):
        found = sphere(genes)
        # Some individuals have no place on the map.
        first = jnp.where(genes[2] > 1.0, jnp.nan, found.descriptors["first"])
        return dataclasses.replace(found, descriptors=found.descriptors | {"first": first})

    populations, found, archive = search(strategy, 12, evaluate=evaluate)
    best: dict[int, tuple] = {}
    for generation, (genes, fitness) in enumerate(zip(populations, found, strict=False)):
        for index in range(SIZE):
            column = np.asarray(genes)[:, index]
            if column[2] > 1.0 or not np.isfinite(fitness[index]):
                continue
            row, line = (
                int(np.clip(np.floor((value + 2.0) / 4.0 * cells), 0, cells - 1))
                for value, cells in ((column[0], 4), (column[1], 3))
            )
            cell = row * 3 + line
            if cell not in best or fitness[index] > best[cell][0]:
                best[cell] = fitness[index], generation, index, column
    filled = np.isfinite(np.asarray(archive.fitness))
    assert sorted(best) == list(np.flatnonzero(filled)) and len(best) >= 6
    for cell, (fitness, generation, index, column) in best.items():
        assert archive.fitness[cell] == fitness
        assert (archive.generation[cell], archive.index[cell]) == (generation, index)
        np.testing.assert_array_equal(archive.genes[:, cell], column)
    assert (np.asarray(archive.generation)[~filled] == -1).all()
    assert archive.told == 12


def test_a_map_does_not_influence_the_search():
    plain, _, _ = search(GENETICS, 6)
    mapped, _, state = search(Mapped(SIZE, AXES, GENETICS), 6)
    for one, other in zip(plain, mapped, strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.isfinite(state.archive.fitness).sum() >= 4


def test_children_of_bits_are_bits_of_two_parents():
    vary = OfBits(mutated_genes=(2, 2), mutation_probability=0.0)
    genes = jnp.asarray(np.random.default_rng(0).integers(0, 2, (GENES, 5)), jnp.float32)
    parents = jnp.array([[0, 1, 2, 3], [4, 3, 2, 0]])
    children = np.asarray(jax.jit(vary)(jax.random.key(0), genes, parents))
    assert children.shape == (GENES, 4)
    for child, (first, second) in zip(children.T, np.asarray(parents).T, strict=True):
        a, b = np.asarray(genes[:, first]), np.asarray(genes[:, second])
        cuts = [np.concatenate([a[:cut], b[cut:]]) for cut in range(1, GENES)]
        assert any((child == cut).all() for cut in cuts)


@pytest.mark.slow
def test_uncrossed_children_of_bits_are_mutated_first_parents():
    vary = OfBits(0.0, 1.0, (1, 3), "flip")
    genes = jnp.asarray(np.random.default_rng(0).integers(0, 2, (GENES, 2)), jnp.float32)
    parents = jnp.array([[0] * 500, [1] * 500])
    for children in (
        jax.jit(vary)(jax.random.key(0), genes, parents),
        jax.jit(vary.copies)(jax.random.key(1), genes[:, parents[0]]),
    ):
        changed = np.asarray(children != genes[:, :1]).sum(0)
        assert set(changed.tolist()) == {1, 2, 3}


def test_children_of_numbers_lie_on_the_line_through_their_parents():
    vary = AlongTheLine(iso_sigma=0.0, line_sigma=0.5, gene_bound=100.0)
    genes = jnp.asarray(np.random.default_rng(0).normal(size=(GENES, 2)), jnp.float32)
    parents = jnp.array([[0] * 2000, [1] * 2000])
    children = np.asarray(vary(jax.random.key(0), genes, parents))
    a, b = np.asarray(genes).T
    fractions = (children - a[:, None]).T @ (b - a) / ((b - a) @ (b - a))
    np.testing.assert_allclose(children, a[:, None] + fractions * (b - a)[:, None], atol=1e-5)
    assert abs(fractions.mean()) < 0.04 and fractions.std() == pytest.approx(0.5, rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Sep_CMA_ES", "DifferentialEvolution"])
def test_evosax_searches_bits(name):
    """Fitness is the number of bits that agree with a pattern."""
    pattern = jnp.array([1.0, 0, 1, 1, 0, 1])

    def agreeing(genes):
        fitness = (genes == pattern[:, None]).sum(0).astype(jnp.float32)
        return Evaluation(fitness, {}, {}, fitness[None])

    strategy = evosax(name, binary=True, gene_bound=None)
    populations, found, _ = search(strategy, 20, evaluate=agreeing)
    assert set(np.unique(populations[-1])) <= {0.0, 1.0}
    assert found[-1].mean() > found[0].mean() + 1


@pytest.mark.slow
def test_evosax_starts_with_given_genomes_and_learns_of_replaced_ones():
    strategy = evosax("DifferentialEvolution", gene_bound=1.0)
    given = 5.0 * jnp.ones((GENES, SIZE))
    genes, state = strategy.ask(jax.random.key(0), strategy.init(jax.random.key(0), given))
    np.testing.assert_array_equal(genes, jnp.ones((GENES, SIZE)))
    moved = genes.at[:, 3].set(0.5)
    after = strategy.tell(jax.random.key(0), state, moved, sphere(moved))
    np.testing.assert_array_equal(after.numbers[:, 3], moved[:, 3])
    # A clipped individual is reported with its numbers before clipping.
    np.testing.assert_array_equal(after.numbers[:, 4], given[:, 4])
    np.testing.assert_array_equal(after.state.population, after.numbers.T)
    # Differential evolution keeps an individual that is better than its child.
    np.testing.assert_allclose(after.state.fitness, -sphere(moved).fitness)


@pytest.mark.slow
def test_a_distribution_starts_at_the_mean_of_the_better_half():
    strategy = evosax("Sep_CMA_ES")
    given = jax.random.normal(jax.random.key(0), (GENES, SIZE))
    genes, state = strategy.ask(jax.random.key(0), strategy.init(jax.random.key(0), given))
    worth = sphere(genes)
    after = strategy.tell(jax.random.key(0), state, genes, worth)
    better = np.argsort(-np.asarray(worth.fitness))[: SIZE // 2]
    np.testing.assert_allclose(after.state.mean, np.asarray(genes)[:, better].mean(1), rtol=1e-5)


def test_unknown_parameters_of_evosax_are_refused():
    with pytest.raises(ValueError, match=r"no parameter crossover .*elitism"):
        evosax("DifferentialEvolution", params=(("crossover", 0.5),))


@pytest.mark.parametrize("name", [*NAMES, "bits"])
def test_a_population_around_an_individual_keeps_it(name):
    strategy = BitGenetics(SIZE, mutated_genes=(2, 3)) if name == "bits" else made(name)
    one = jnp.tile(jnp.array([1.0, 0, 1, 1, 0, 1]), genes_of(name) // GENES)
    around = jax.jit(strategy.around)(jax.random.key(0), jnp.tile(one[:, None], (1, SIZE)))
    assert around.shape == (len(one), SIZE)
    np.testing.assert_array_equal(around[:, 0], one)
    if name not in ("climber", "islands of climbers", "random"):
        assert (np.asarray(around[:, 1:]) != np.asarray(one)[:, None]).any(0).mean() > 0.5
