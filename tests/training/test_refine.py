"""A refined champion is better, is evaluated as in training, and replays exactly."""

import equinox as eqx
import numpy as np
import pytest

from evo_cpg.physics.water.fluid import Drag
from evo_cpg.training.ascent import Free
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.refine import (
    Refinement,
    _Parent,
    _starts,
    compile_evaluation,
    compile_refinement,
)
from evo_cpg.training.train import train
from trials import experiment, folder_at

MADE = experiment(60, 6)._replace(generations=2, runs=2)
SETTINGS = Refinement(rounds=2, steps=5)


@pytest.fixture(scope="module")
def evolved(tmp_path_factory):
    folder = folder_at(tmp_path_factory.mktemp("evolved") / "run")
    return folder, train(MADE, folder)


@pytest.fixture(scope="module")
def refined(evolved):
    rounds = []
    champion = evolved[1].champions[1]
    return champion, compile_refinement(MADE, SETTINGS)(champion, rounds.append), rounds


@pytest.mark.slow
def test_evaluation_repeats_the_results_of_training(evolved):
    _, checkpoint = evolved
    evaluate = compile_evaluation(MADE, population_mesh(), 2)
    for champion in checkpoint.champions:
        others = np.linspace(0.5, 2, 10).reshape(2, 5).astype(np.float32)
        genes = np.concatenate([others, champion.genes[:, None]], 1)
        fitness, mean, _ = evaluate(genes, champion)
        terms = {name: float(values[-1]) for name, values in mean.terms.items()}
        assert (float(fitness[-1]), terms) == (champion.fitness, champion.terms)


@pytest.mark.slow
def test_rounds_only_gain_and_add_up(refined):
    before, after, rounds = refined
    assert [done.number for done in rounds] == [0, 1]
    assert after == rounds[-1].champion
    fitness = [before.fitness] + [done.champion.fitness for done in rounds]
    assert all(done.gain >= 0 for done in rounds)
    assert all(done.finite == done.gradients for done in rounds)
    np.testing.assert_allclose(np.diff(fitness), [done.gain for done in rounds], atol=1e-9)
    assert after.fitness > before.fitness + 1e-3
    assert (after.run, after.index, after.generation) == (*before[5:7], before.generation)


@pytest.mark.slow
def test_refinement_depends_on_its_seed_and_ignores_recorded_fitness(refined):
    before, _, rounds = refined
    settings, again = SETTINGS._replace(rounds=1), []
    same = compile_refinement(MADE, settings)(before._replace(fitness=99.0), again.append)
    np.testing.assert_array_equal(same.genes, rounds[0].champion.genes)
    assert again[0].initial_fitness == rounds[0].initial_fitness == before.fitness


@pytest.mark.slow
def test_values_that_cannot_be_built_are_skipped(evolved):
    """The drag is free. Worlds with its two most promising values cannot be built."""
    champion, tried, rounds = evolved[1].champions[0], [], []

    def with_drag(value):
        return eqx.tree_at(lambda s: s.world.law(Drag).form_drag, MADE.simulation, value)

    def rebuild(values):
        tried.append(values[0])
        if len(tried) < 3:
            return None
        return MADE._replace(simulation=with_drag(float(values[0])))

    drag = np.array([float(MADE.simulation.world.law(Drag).form_drag)])
    free = Free(drag, lambda values: with_drag(values[0]), rebuild)
    found = compile_refinement(MADE, SETTINGS._replace(rounds=1), free=free)(
        champion, rounds.append
    )
    assert len(set(tried)) == 3
    assert found.fitness > champion.fitness
    assert rounds[0].values == pytest.approx(tried[2])


def test_lanes_start_with_the_free_numbers_of_their_parents(evolved):
    champion = evolved[1].champions[0]
    parents = [
        _Parent(champion._replace(genes=np.full(2, place)), np.array([place]))
        for place in (1.0, 2.0)
    ]
    starts = _starts(parents, np.random.default_rng(0), 64, 1e-3)
    assert starts.shape == (3, 64)
    assert set(np.round(starts[2])) == {1.0, 2.0}
    np.testing.assert_allclose(starts[0], starts[2], atol=1e-2)


@pytest.mark.slow
def test_the_folder_replaces_the_champion_of_the_run(evolved, refined, tmp_path):
    _, checkpoint = evolved
    _, after, _ = refined
    folder = folder_at(tmp_path / "run")
    folder.save(checkpoint)
    first = folder.load_champion()[0]
    folder.keep_before(checkpoint.champions[1])
    folder.replace_champion(after, "name: graded\n")
    assert folder.config.read_text() == "name: graded\n"
    assert (folder.path / "config_before.yaml").read_text() == ""
    with np.load(folder.path / "champion_before.npz") as before:
        np.testing.assert_array_equal(before["genes"], checkpoint.champions[1].genes)
    kept = folder.load()
    assert kept is not None
    assert kept.champions[1].fitness == after.fitness
    assert kept.champions[0].fitness == checkpoint.champions[0].fitness
    changed = (kept.genes != checkpoint.genes).any(0)
    assert changed.nonzero()[0].tolist() == [11]
    np.testing.assert_array_equal(kept.genes[:, 11], after.genes)
    best = max(kept.champions, key=lambda one: one.fitness)
    assert folder.load_champion()[0].fitness == best.fitness >= first.fitness
    # Evolution continues from the refined champion.
    final = train(MADE._replace(generations=3), folder)
    assert final.champions[1].fitness >= after.fitness
