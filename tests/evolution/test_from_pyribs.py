"""CMA-MAE of pyribs, converted to arrays between calls, equals pyribs' own scheduler."""

import functools
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.evolution.archive import Axis
from evo_cpg.evolution.from_pyribs import Ribs
from evo_cpg.evolution.pyribs_host import ALGORITHMS, UnknownPyribsError
from evo_cpg.evolution.strategy import Evaluation

ribs_archives = pytest.importorskip("ribs.archives")
ribs_emitters = pytest.importorskip("ribs.emitters")
ribs_schedulers = pytest.importorskip("ribs.schedulers")

GENES, SIZE, EMITTERS = 20, 24, 3
AXES = (Axis("first", -2.0, 2.0, 4), Axis("second", -2.0, 2.0, 3))
WORST = -60.0


def made(es="sep_cma_es", **settings):
    given = {"emitters": EMITTERS, "es": es, "learning_rate": 0.1, "threshold_min": WORST}
    return Ribs(SIZE, GENES, AXES, **given | {"gene_bound": None} | settings)


def worth(rows, flat=0.0):
    """Evaluate a sphere function, individuals first. Emitters converge on its plateau."""
    rows = np.ascontiguousarray(rows, np.float32)
    fitness = -((rows - np.float32(0.7)) ** 2).sum(1, dtype=np.float32)
    return np.minimum(fitness, -np.float32(flat)), rows[:, :2]


def evaluation(fitness, measures):
    first, second = jnp.asarray(np.asarray(measures).T)
    fitness = jnp.asarray(fitness)
    return Evaluation(fitness, {}, {"first": first, "second": second}, fitness[None])


@functools.cache
def programs(strategy):
    return jax.jit(strategy.init), jax.jit(strategy.ask), jax.jit(strategy.tell)


def through_arrays(tree):
    """Return the arrays that a checkpoint stores."""
    return jax.tree.map(lambda x: np.array(x), jax.device_get(tree))


def search(strategy, generations, evaluate=worth, start=None, key=0):
    """Return the populations, individuals first, and the last state."""
    init, ask, tell = programs(strategy)
    genes = jnp.zeros((strategy.gene_count, SIZE)) if start is None else start
    key = jax.random.key(key)
    genes, state = ask(key, init(key, genes))
    populations = [np.asarray(genes).T]
    for _ in range(generations):
        found = evaluation(*evaluate(populations[-1]))
        genes, state = ask(key, through_arrays(tell(key, state, genes, found)))
        state = through_arrays(state)
        populations.append(np.asarray(genes).T)
    return populations, state


def plain(strategy, generations, evaluate=worth):
    """Return the populations and the scheduler of pyribs, which keeps its objects."""
    seeds = jax.random.bits(jax.random.key(0), (1 + EMITTERS, 4), jnp.uint32)
    first, *others = np.asarray(seeds).tolist()
    archive = ribs_archives.GridArchive(
        solution_dim=GENES,
        dims=[4, 3],
        ranges=[(-2.0, 2.0)] * 2,
        learning_rate=strategy.learning_rate,
        threshold_min=strategy.threshold_min,
        seed=first,
        dtype=np.float32,
    )
    emitters = [
        ribs_emitters.EvolutionStrategyEmitter(
            archive,
            x0=np.zeros(GENES),
            sigma0=np.float64(strategy.sigma),
            ranker="imp",
            es=strategy.es,
            es_kwargs=dict(strategy.options),
            selection_rule="mu",
            restart_rule="basic",
            batch_size=SIZE // EMITTERS,
            seed=seed,
        )
        for seed in others
    ]
    scheduler = ribs_schedulers.Scheduler(archive, emitters)
    populations = [scheduler.ask().copy()]
    for _ in range(generations):
        scheduler.tell(*evaluate(populations[-1]))
        populations.append(scheduler.ask().copy())
    return populations, scheduler


def require_same(strategy, generations, evaluate=worth):
    """Check that populations, map and restarts equal pyribs' bits. Return the restarts."""
    ours, state = search(strategy, generations + 1, evaluate)
    theirs, scheduler = plain(strategy, generations, evaluate)
    # The first population is not drawn by pyribs. All its genes are 0, so the emitters start at 0.
    np.testing.assert_array_equal(np.array(ours[1:]), np.array(theirs))
    data = scheduler.archive.data()
    count = int(state.cells["count"])
    np.testing.assert_array_equal(state.cells["order"][:count], data["index"])
    for name in ("solution", "objective", "measures", "threshold"):
        np.testing.assert_array_equal(state.cells[name][data["index"]], data[name])
    restarts = [emitter.restarts for emitter in scheduler.emitters]
    assert restarts == state.emitters["counters"][:, -1].tolist()
    return restarts


@pytest.mark.parametrize(
    "es",
    [
        pytest.param(
            es,
            marks=[pytest.mark.slow]
            if es in ("cma_es", "sep_cma_es", "lm_ma_es", "openai_es")
            else [],
            id=es,
        )
        for es in ALGORITHMS
    ],
)
def test_it_equals_pyribs_to_the_bit(es):
    """Emitters also restart, because their samples converge on the plateau."""
    options = (("lr", 0.05),) if es == "openai_es" else ()
    strategy = made(es, learning_rate=1.0, threshold_min=-1000.0, options=options)
    restarts = require_same(strategy, 60, functools.partial(worth, flat=7.0))
    assert sum(restarts) >= 2


@pytest.mark.slow
def test_annealed_thresholds_equal_pyribs():
    require_same(made(), 30)


@pytest.mark.slow
def test_a_run_under_vmap_equals_the_run_alone():
    strategy = made()
    keys = jax.vmap(jax.random.key)(jnp.arange(3))
    start = jax.random.normal(jax.random.key(9), (3, GENES, SIZE))
    init, ask, tell = (jax.jit(jax.vmap(f)) for f in (strategy.init, strategy.ask, strategy.tell))
    genes, state = ask(keys, init(keys, start))
    for _ in range(3):
        found = [worth(np.asarray(one).T) for one in genes]
        stacked = jax.tree.map(lambda *x: jnp.stack(x), *(evaluation(*one) for one in found))
        genes, state = ask(keys, tell(keys, state, genes, stacked))
    for run in range(3):
        populations, alone = search(strategy, 3, start=start[run], key=run)
        np.testing.assert_array_equal(np.asarray(genes[run]).T, populations[-1])
        one = jax.tree.map(lambda x, run=run: x[run], state)
        jax.tree.map(np.testing.assert_array_equal, one, alone)


@pytest.mark.slow
def test_the_reported_map_keeps_the_fittest_unlike_the_emitters_map():
    populations, state = search(made(learning_rate=0.05, sigma=0.3), 40)
    best = {}
    for rows in populations[:-1]:
        fitness, measures = worth(rows)
        for value, place in zip(fitness, measures, strict=True):
            cell = tuple(np.clip(np.floor((place + 2) / 4 * [4, 3]), 0, [3, 2]).astype(int))
            best[cell] = max(best.get(cell, -np.inf), value)
    shown = state.archive.fitness.reshape(4, 3)
    assert {tuple(cell) for cell in np.argwhere(np.isfinite(shown))} == set(best)
    for cell, value in best.items():
        assert shown[cell] == value
    order = state.cells["order"][: state.cells["count"]]
    assert (state.cells["objective"][order] <= state.archive.fitness[order]).all()
    assert (state.cells["objective"][order] < state.archive.fitness[order]).any()
    assert (state.cells["threshold"][order] > WORST).all()


def state_after(strategy, change):
    """Return the state of a search after a generation with changed results."""
    rows, state = search(strategy, 3)
    fitness, measures = worth(rows[-1])
    genes, fitness, measures = change(rows[-1].copy(), fitness.copy(), measures.copy())
    found = evaluation(fitness, measures)
    return through_arrays(programs(strategy)[2](jax.random.key(0), state, genes.T, found))


OUT = np.array([0, 1, 5, 9])


def hopeless(genes, fitness, measures):
    fitness[OUT] = 10 * WORST
    return genes, fitness, measures


def diverged(genes, fitness, measures):
    fitness[OUT] = -np.inf
    return genes, fitness, measures


def unmeasured(genes, fitness, measures):
    measures[OUT[:2], 0], measures[OUT[2:], 1] = np.nan, np.inf
    return genes, fitness, measures


def replaced(genes, fitness, measures):
    genes[OUT], fitness[OUT] = 0.7, 0.0
    return genes, fitness, measures


@pytest.mark.slow
@pytest.mark.parametrize("change", [diverged, unmeasured, replaced])
def test_excluded_individuals_rank_last_and_stay_off_the_emitters_map(change):
    """The emitters' state equals the state with individuals that are worst and below thresholds."""
    other, same = (state_after(made(), each) for each in (change, hopeless))
    jax.tree.map(np.testing.assert_array_equal, other.cells, same.cells)
    jax.tree.map(np.testing.assert_array_equal, other.emitters, same.emitters)
    # The reported map has the individuals that replaced others.
    fittest = other.archive.fitness.max()
    assert (fittest == 0.0) if change is replaced else (fittest < 0.0)


def test_emitters_keep_their_distribution_below_the_threshold():
    populations, state = search(made(threshold_min=1.0), 30)
    assert state.cells["count"] == 0 and not state.emitters["counters"].any()
    assert np.isfinite(state.archive.fitness).sum() > 8
    drawn = np.array(populations)
    assert abs(drawn.mean()) < 0.02 and drawn.std() == pytest.approx(0.5, rel=0.03)
    metrics = made().metrics(jax.tree.map(jnp.asarray, state))
    assert metrics["coverage"] > 0.7 and metrics["restarts"] == 0


@pytest.mark.slow
def test_thresholds_start_at_the_median_of_the_first_finite_fitness():
    def evaluate(rows):
        fitness, measures = worth(rows)
        return np.where(np.arange(SIZE) < 5, -np.inf, fitness), measures

    strategy = made(threshold_min=None)
    rows, state = search(strategy, 1)
    assert np.isnan(state.cells["threshold_min"])
    median = np.median(worth(rows[1])[0][5:])
    for generations in (2, 5):
        _, state = search(strategy, generations, evaluate)
        assert state.cells["threshold_min"] == pytest.approx(median) and state.cells["count"] > 2
        taken = state.cells["order"][: state.cells["count"]]
        assert (state.cells["objective"][taken] >= median).all()
    # There is no threshold until an individual has a finite fitness.
    _, state = search(strategy, 3, lambda rows: (np.full(SIZE, -np.inf), worth(rows)[1]))
    assert np.isnan(state.cells["threshold_min"]) and state.cells["count"] == 0


@pytest.mark.slow
def test_genes_are_clipped_after_the_draw():
    populations, state = search(made(gene_bound=0.4), 20)
    assert np.abs(populations[-1]).max() == np.float32(0.4)
    free = state.drawn["_solutions"].reshape(SIZE, GENES)
    assert np.abs(free).max() > 0.5
    np.testing.assert_array_equal(np.clip(free, -0.4, np.float32(0.4)), populations[-1])
    # Clipped individuals do not count as replaced.
    assert state.cells["count"] >= 1


@pytest.mark.parametrize("es", [pytest.param("sep_cma_es", marks=pytest.mark.slow), "openai_es"])
def test_it_searches_bits(es):
    """Fitness is the number of bits that agree with a pattern."""
    pattern = np.tile([1.0, 0, 1, 1, 0], GENES // 5)

    def agreeing(rows):
        return np.float32((rows == pattern).sum(1)), rows[:, :2] + rows[:, 2:4]

    options = (("lr", 0.1),) if es == "openai_es" else ()
    strategy = made(es, binary=True, learning_rate=0.2, threshold_min=0.0, options=options)
    random = jax.random.bernoulli(jax.random.key(1), 0.5, (GENES, SIZE)).astype(jnp.float32)
    populations, _ = search(strategy, 60, agreeing, random)
    assert set(np.unique(populations[-1])) == {0.0, 1.0}
    first, last = (agreeing(rows)[0].mean() for rows in (populations[0], populations[-1]))
    assert first == pytest.approx(GENES / 2, abs=1.5) and last > first + 3


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"es": "cma"}, ValueError, "one of sep_cma_es, lm_ma_es, openai_es, cma_es, got 'cma'"),
        ({"emitters": 5}, ValueError, "24 cannot be divided equally among 5 emitters"),
        ({"emitters": 24}, ValueError, "each of 24 emitters needs at least two individuals"),
        ({"es": "openai_es", "emitters": 8}, ValueError, "even number"),
        ({"es": "lm_ma_es", "emitters": 1}, ValueError, r"\(24\) is greater than .* \(20\)"),
        ({"options": (("lr", 0.1),)}, TypeError, "'lr'"),
    ],
)
def test_invalid_settings_of_pyribs_are_refused(settings, error, words):
    with pytest.raises(error, match=words):
        made(**settings)


def test_an_unknown_pyribs_is_reported(monkeypatch):
    """The strategy of this pyribs has an attribute that cannot become an array."""
    opt = pytest.importorskip("ribs.emitters.opt")

    class Longer(opt.SeparableCMAEvolutionStrategy):
        def __init__(self, *given, **settings):
            super().__init__(*given, **settings)
            self.past = [0.0]

    monkeypatch.setattr(opt, "SeparableCMAEvolutionStrategy", Longer)
    with pytest.raises(
        UnknownPyribsError,
        match=r"differently from pyribs 0\.12 \(past of Longer is a list\)\. .*`pip install",
    ):
        made(sigma=0.123)


def test_importing_the_module_imports_no_pyribs():
    code = "import sys, evo_cpg.evolution.from_pyribs; sys.exit('ribs' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
