"""Runs with any strategy: several runs, resuming, and errors."""

import importlib
import importlib.util

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.evolution.genetics import RealGenetics
from evo_cpg.evolution.islands import Islands
from evo_cpg.evolution.map_elites import AlongTheLine, MapElites
from evo_cpg.evolution.strategy import Axis, Strategy
from evo_cpg.io.run import elite, gait_map
from evo_cpg.training.checkpoint import StrategyError
from evo_cpg.training.evaluate import compile_replay
from evo_cpg.training.train import train
from trials import experiment, folder_at, untimed

SIZE, RUNS, GENERATIONS = 12, 2, 4
MAP = MapElites(
    SIZE, (Axis("distance", 1.0, 1.0004, 5), Axis("energy", 0.0, 0.03, 3)), AlongTheLine(0.3)
)
GENETICS = RealGenetics(SIZE // 2, 2, 0.5, 0.2, 0.5, 0.5, 8.0)


def evosax():
    pytest.importorskip("evosax")
    kind = importlib.import_module("evo_cpg.evolution.evosax").Evosax
    return kind("DifferentialEvolution", SIZE, 2)


STRATEGIES = {
    "islands": lambda: Islands(SIZE, GENETICS, 2, every=2, migrants=1),
    "map_elites": lambda: MAP,
    "evosax": evosax,
}


def made(strategy, generations=GENERATIONS):
    return experiment(30, SIZE)._replace(strategy=strategy, runs=RUNS, generations=generations)


@pytest.mark.parametrize("name", STRATEGIES)
@pytest.mark.slow
def test_a_resumed_run_has_the_bits_of_an_uninterrupted_one(name, tmp_path):
    strategy = STRATEGIES[name]()
    whole = train(made(strategy), folder_at(tmp_path / "whole"))
    train(made(strategy, 2), folder_at(tmp_path / "stopped"))
    again = train(made(strategy), folder_at(tmp_path / "stopped"))
    np.testing.assert_array_equal(whole.genes, again.genes)
    assert untimed(whole.history) == untimed(again.history)
    assert whole.state.keys() == again.state.keys() and whole.state
    for key, value in whole.state.items():
        np.testing.assert_array_equal(value, again.state[key])
        assert value.shape[:1] == (RUNS,)
    assert whole.champion is not None and again.champion is not None
    np.testing.assert_array_equal(whole.champion.genes, again.champion.genes)


@pytest.mark.slow
def test_each_run_draws_from_its_own_seed(tmp_path):
    """The second of two runs equals a single run with its seed."""
    both = train(made(MAP), folder_at(tmp_path / "both"))
    lone = made(MAP)._replace(runs=1, seed=1)
    alone = train(lone, folder_at(tmp_path / "alone"))
    np.testing.assert_allclose(both.genes[:, SIZE:], alone.genes, rtol=1e-5)
    for key, value in both.state.items():
        np.testing.assert_allclose(value[1], alone.state[key][0], rtol=1e-4)


class Blank(Strategy):
    """Strategy that returns NaN from generation 2 on."""

    population: int = eqx.field(static=True)

    def init(self, key, genes):
        return genes, 0

    def ask(self, key, state):
        genes, told = state
        return jnp.where(told < 2, genes, jnp.nan), state

    def tell(self, key, state, genes, evaluation):
        return state[0], state[1] + 1


def test_nan_genomes_end_the_run_and_keep_earlier_generations(tmp_path):
    folder = folder_at(tmp_path)
    blank = made(Blank(SIZE))
    with pytest.raises(StrategyError, match=r"Blank returned genomes .* generation 2 \(24 of 24"):
        train(blank, folder)
    kept = folder.load()
    assert kept is not None and kept.generation == 1 and len(kept.history) == RUNS


def test_a_checkpoint_of_another_strategy_is_refused(tmp_path):
    train(made(MAP, 1), folder_at(tmp_path))
    with pytest.raises(StrategyError, match="the state of another strategy"):
        train(made(Islands(SIZE, GENETICS, 2, 2, 1)), folder_at(tmp_path))


def test_a_map_holds_the_champion_of_each_run(tmp_path):
    """The elite of the cell with the highest fitness is the champion of its run."""
    done = train(made(MAP), folder_at(tmp_path))
    state = done.state
    for run in range(RUNS):
        fitness, champion = state["fitness"][run], done.champions[run]
        best = int(np.argmax(fitness))
        assert champion is not None and fitness[best] == np.float32(champion.fitness)
        np.testing.assert_array_equal(state["genes"][run][:, best], champion.genes)
        assert state["generation"][run][best] == champion.generation
        assert state["index"][run][best] == champion.index
        found = state["descriptors"][run][:, best]
        terms = champion.terms["distance"], champion.terms["energy"]
        np.testing.assert_array_equal(found, np.float32(terms))


def test_every_elite_of_a_map_replays_as_recorded(tmp_path):
    """Fitness and descriptors are equal."""
    several = made(MAP)
    done = train(several, folder_at(tmp_path))
    found = gait_map(several, done, 1)
    assert found is not None and found.fitness.shape == (5, 3)
    assert pytest.approx(done.history[-1]["coverage"]) == np.isfinite(found.fitness).mean() > 0.2
    for cell in np.argwhere(np.isfinite(found.fitness)):
        one = elite(several, done, tuple(cell.tolist()), 1)
        fitness, terms, *_ = compile_replay(several, len(jax.devices()))(one)
        assert one.fitness == np.float32(found.fitness[tuple(cell)])
        # The replay rounds the last bit differently for one individual in a hundred.
        assert abs(fitness - one.fitness) <= 2.5e-7 * abs(one.fitness)
        assert {name: terms[name] for name in one.terms} == one.terms
        for axis, place in zip(found.axes, cell, strict=True):
            low, high = axis.edges[place : place + 2]
            # Cells are computed in float32.
            assert low <= one.terms[axis.name] + 1e-6 or place == 0
            assert one.terms[axis.name] - 1e-6 <= high or place == axis.cells - 1


@pytest.mark.parametrize("name", STRATEGIES)
def test_metrics_have_their_names(name, tmp_path):
    strategy = STRATEGIES[name]()
    done = train(made(strategy, 1), folder_at(tmp_path))
    assert set(strategy.metric_names) <= set(done.history[0])
    assert ("coverage" in done.history[0]) == (name == "map_elites")


def test_empty_and_missing_cells_are_named(tmp_path):
    several = made(MAP, 1)
    done = train(several, folder_at(tmp_path))
    empty = tuple(np.argwhere(np.isnan(gait_map(several, done, 0).fitness))[0].tolist())
    islands = made(Islands(SIZE, GENETICS, 2, 2, 1))
    assert gait_map(islands, done, 0) is None
    for searched, cell, words in (
        (several, (5, 0), "no cell 5,0.*distance 0 to 4, energy"),
        (several, (1,), "no cell 1"),
        (several, empty, r"is empty\. The nearest filled cell is \d,\d"),
        (islands, (0, 0), "there is no map"),
    ):
        with pytest.raises(StrategyError, match=words):
            elite(searched, done, cell, 0)
