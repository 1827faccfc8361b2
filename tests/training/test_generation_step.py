"""One generation on one and two devices. Diverged individuals are counted and never win."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.evolution.operators import rank_order
from evo_cpg.simulation.judge import JUDGE, Outcome, score
from evo_cpg.simulation.recording import Recorder, as_recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.training.devices import chunk_width, population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.experiment import begin, next_generation
from evo_cpg.training.experiment import evaluated as judged
from evo_cpg.training.train import train
from trials import SineController, experiment, folder_at

STEPS = 20


@pytest.fixture(scope="module")
def small():
    return experiment(STEPS, population=11)


@pytest.fixture(scope="module")
def genes(small):
    return np.asarray(begin(small)[0])


@pytest.fixture(scope="module")
def run_trials(small):
    """Return trials on two devices. The second is needed from the 17th individual on."""
    return compile_trials(small.simulation, population_mesh(2))


@pytest.fixture(scope="module")
def evaluated(genes, run_trials):
    """Return outcomes of 11 individuals: alone on one device, and with 9 others on two."""
    more = np.concatenate([genes, genes[:, :9] + 0.1], axis=1)
    first = jax.tree.map(lambda x: x[:11], run_trials(more))
    return run_trials(genes), first


def test_two_devices_give_the_same_bits_as_one(evaluated):
    one, two = evaluated
    assert one.terms.keys() == two.terms.keys()
    for name, values in one.terms.items():
        assert values.shape == (11,)
        np.testing.assert_array_equal(values, two.terms[name])
    np.testing.assert_array_equal(one.alive, two.alive)


def test_padding_a_population_changes_no_result(small, genes, evaluated):
    outcome = jax.jit(lambda g: rollout(small.simulation, g))(genes)
    for name, values in outcome.terms.items():
        np.testing.assert_allclose(evaluated[1].terms[name], values, rtol=1e-5, atol=1e-7)


def test_a_replay_equals_the_trial_and_its_recording(small, genes, evaluated):
    width = chunk_width(small.strategy.population, 2)
    live = compile_trials(
        small.simulation, population_mesh(1), width, observers=(JUDGE, Recorder())
    )
    outcome, frames = live(np.asarray(genes)[:, 4:5])
    for name, values in evaluated[1].terms.items():
        np.testing.assert_array_equal(outcome.terms[name], values[4:5])
    motion = as_recording(small.simulation, frames, ["tail", "head"])
    assert float(outcome.terms["distance"][0]) == pytest.approx(
        motion.distance[-60:].mean() / motion.distance[0], rel=1e-5
    )


@pytest.fixture(scope="module")
def step(small, run_trials):
    judge = jax.jit(functools.partial(judged, small))
    breeding = jax.jit(functools.partial(next_generation, small))

    def step(genes, i, scales):
        found = judge(run_trials(genes), i, scales)
        return found, breeding(genes, found.worth, i, ())

    return step


def test_diverged_individuals_are_counted_and_never_win_or_set_scales(small, genes, step):
    wild = np.array(genes)
    wild[0, 3], wild[0, 7] = np.nan, 1e7
    old = {"energy": np.float32([123.0])}
    found, generation = step(wild, np.int32(0), old)
    fitness = np.asarray(found.worth.fitness[0])
    assert np.flatnonzero(fitness == -np.inf).tolist() == [3, 7]
    assert np.flatnonzero(~np.asarray(found.alive[0])).tolist() == [3, 7]
    living = np.delete(np.asarray(found.worth.terms["energy"][0]), [3, 7])
    assert float(found.scales["energy"][0]) == pytest.approx(np.percentile(living, 95), rel=1e-5)
    order = np.asarray(rank_order(fitness))
    assert int(generation.best[0]) == order[0] and order[-2:].tolist() == [3, 7]
    np.testing.assert_array_equal(generation.next_genes[:, :2], wild[:, order[:2]])
    assert np.isfinite(generation.next_genes).all()
    # Scales stay after the first generation.
    later = jax.tree.map(lambda x: x[0], step(wild, np.int32(1), old)[0])
    assert float(later.scales["energy"]) == 123.0
    expected = score(small.simulation.task, Outcome(later.worth.terms, later.alive), later.scales)
    np.testing.assert_allclose(later.worth.fitness, expected, rtol=1e-6)


def test_the_number_of_the_generation_selects_the_random_stream(small, genes, step):
    scales = {"energy": np.float32([1.0])}
    first, again = (step(genes, np.int32(1), scales)[1].next_genes for _ in range(2))
    np.testing.assert_array_equal(first, again)
    other = step(genes, np.int32(2), scales)[1].next_genes
    np.testing.assert_array_equal(first[:, :2], other[:, :2])
    assert (first != other)[:, 2:].any()


def test_seeds_differ_from_the_first_generation_on(small, genes):
    np.testing.assert_array_equal(begin(small)[0], genes)
    assert (np.asarray(begin(small._replace(seed=1))[0]) != np.asarray(genes)).all()


def test_one_individual_scores_equally_alone_and_among_others(genes, run_trials, evaluated):
    alone = run_trials(genes[:, 6:7])
    for name, values in evaluated[1].terms.items():
        np.testing.assert_array_equal(alone.terms[name], values[6:7])


class Lifeless(SineController):
    """Controller whose individuals all diverge."""

    def random_genes(self, key, batch, dtype):
        return jnp.full((self.gene_count, *batch), jnp.nan, dtype)


def test_a_run_whose_individuals_all_diverge_has_no_champion(small, tmp_path):
    simulation = dataclasses.replace(small.simulation, controller=Lifeless())
    folder = folder_at(tmp_path / "run")
    shown = []
    done = train(small._replace(simulation=simulation), folder, shown.extend)
    assert done.generation == 2 and done.champion is None
    assert shown == done.history
    for row in shown:
        assert row["diverged"] == 11
        assert np.isnan([row["champion"], row["best"], row["mean"]]).all()
    assert done.scales == {"energy": (1.0,)}
    kept = folder.load()
    assert kept is not None and kept.champion is None and kept.scales == done.scales
    assert folder.metrics.exists() and not folder.champion.exists()
