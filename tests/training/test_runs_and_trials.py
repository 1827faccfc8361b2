"""Several runs equal single runs. Several trials are averaged and replay exactly."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.evolution.genetics import BitGenetics, RealGenetics
from evo_cpg.simulation.judge import JUDGE, Outcome, no_terms, score
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recorder
from evo_cpg.training.devices import chunk_width, population_mesh
from evo_cpg.training.evaluate import compile_replay, compile_trials
from evo_cpg.training.experiment import (
    begin,
    evaluated,
    generation_keys,
    judge,
    judge_each,
    next_generation,
    trial_keys,
)
from trials import OneTerm, SineController, evolve, experiment, untimed

SEED, SIZE, GENERATIONS = 5, 6, 3
NOISE = Noise(joint_angle=0.1, tilt=0.05, push=0.2)


def alone(seed: int):
    """Return an experiment with a single run."""
    return experiment(20, SIZE, seed=seed)._replace(generations=GENERATIONS)


def noisy(made):
    return made._replace(simulation=dataclasses.replace(made.simulation, noise=NOISE))


PAIR = alone(SEED)._replace(runs=2)
REAL, BITS = PAIR.strategy, BitGenetics(SIZE, 2, 1, (0.6, 0.4), 0.5, (1, 2))
# Every individual of two noisy runs has two trials.
NOISY = noisy(PAIR)._replace(trials=2, generations=2)


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Evolve two runs together."""
    return evolve(PAIR, tmp_path_factory.mktemp("pair") / "run")


@pytest.fixture(scope="module")
def noisy_pair(tmp_path_factory):
    return evolve(NOISY, tmp_path_factory.mktemp("noisy") / "run")


def test_first_genomes_equal_the_single_runs():
    both = [np.asarray(begin(alone(seed))[0]) for seed in (SEED, SEED + 1)]
    np.testing.assert_array_equal(begin(PAIR)[0], np.concatenate(both, axis=1))
    last = alone(2**31 - 2)
    np.testing.assert_array_equal(
        np.asarray(begin(last._replace(runs=2))[0])[:, SIZE:],
        begin(last._replace(seed=2**31 - 1))[0],
    )


@pytest.mark.slow
@pytest.mark.parametrize(("genetics", "trials"), [(REAL, 1), (REAL, 3), (BITS, 1), (BITS, 3)])
def test_breeding_several_runs_equals_breeding_each_alone(genetics, trials):
    rng = np.random.default_rng(0)
    places = (2, SIZE * trials)
    genes = rng.integers(0, 2, (2, 2 * SIZE)).astype(np.float32)
    terms = {name: rng.random(places, dtype=np.float32) for name in ("distance", "energy", "light")}
    alive = rng.random(places) > 0.1
    scales = {"energy": rng.random(2, dtype=np.float32)}

    def program(made):
        made = made._replace(strategy=genetics, trials=trials)

        def step(seed, genes, outcome, index, scales):
            own = made._replace(seed=seed)
            found = evaluated(own, outcome, index, scales)
            return found, next_generation(own, genes, found.worth, index, ())

        return quick_jit(step)

    several, single = program(PAIR), program(alone(SEED))

    def bred(breeding, seed, chosen, index):
        outcome = Outcome(
            {k: v[chosen].reshape(-1) for k, v in terms.items()}, alive[chosen].ravel()
        )
        own = genes.reshape(2, 2, SIZE)[:, chosen].reshape(2, -1)
        own_scales = {name: values[chosen] for name, values in scales.items()}
        return breeding(np.int32(seed), own, outcome, np.int32(index), own_scales)

    for index in (0, 4):
        together = bred(several, SEED, slice(0, 2), index)
        lone = [bred(single, SEED + run, slice(run, run + 1), index) for run in (0, 1)]
        joined = jax.tree.map(lambda *x: np.concatenate(x), *lone)
        next_genes = np.concatenate([result.next_genes for _, result in lone], axis=1)
        joined = joined[0], joined[1]._replace(next_genes=next_genes)
        for one, other in zip(jax.tree.leaves(together), jax.tree.leaves(joined), strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_evolving_several_runs_equals_evolving_each_alone(pair, tmp_path):
    """Results are equal up to rounding, which depends on the width of a chunk."""
    _, done = pair
    assert [(row["generation"], row["run"]) for row in done.history] == [
        (generation, run) for generation in range(GENERATIONS) for run in (0, 1)
    ]
    for run in (0, 1):
        _, lone = evolve(alone(SEED + run), tmp_path / str(run))
        own = slice(run * SIZE, (run + 1) * SIZE)
        np.testing.assert_allclose(done.genes[:, own], lone.genes, rtol=1e-5)
        rows = untimed([row for row in done.history if row["run"] == run])
        for row, expected in zip(rows, untimed(lone.history), strict=True):
            assert "run" not in expected and row.pop("run") == run
            assert row == pytest.approx(expected, rel=1e-4)
        champion, expected = done.champions[run], lone.champion
        assert (champion.run, champion.index) == (run, expected.index)
        assert champion.fitness == pytest.approx(expected.fitness, rel=1e-4)
        np.testing.assert_allclose(champion.genes, expected.genes, rtol=1e-5)


@pytest.mark.slow
def test_a_resumed_noisy_run_equals_an_uninterrupted_one(noisy_pair, tmp_path):
    _, done = noisy_pair
    evolve(NOISY._replace(generations=1), tmp_path / "run")
    _, resumed = evolve(NOISY, tmp_path / "run")
    np.testing.assert_array_equal(resumed.genes, done.genes)
    assert untimed(resumed.history) == untimed(done.history)


def test_every_champion_replays_as_recorded_with_its_noise(noisy_pair):
    _, done = noisy_pair
    for champion in done.champions:
        fitness, terms, _, _ = compile_replay(NOISY, 2)(champion)
        assert (fitness, terms) == (champion.fitness, champion.terms)
    other = champion._replace(index=(champion.index + 1) % SIZE)
    assert compile_replay(NOISY, 2)(other)[0] != champion.fitness


@pytest.mark.slow
def test_more_trials_than_a_chunk_holds_replay_exactly():
    """One individual has 40 trials, which two devices share."""
    single = noisy(experiment(20, 1))._replace(trials=40)
    assert chunk_width(40, 2) < 40
    genes = np.asarray(begin(single)[0])
    keys = np.asarray(generation_keys(single, np.int32(3)))
    outcome = compile_trials(single.simulation, population_mesh(2))(genes, keys, None, 40)
    recorded = JUDGE, Recorder()
    width = chunk_width(40, 2)
    live = compile_trials(single.simulation, population_mesh(1), width, observers=recorded)
    again, _ = live(genes, keys, None, 40)
    for name, values in outcome.terms.items():
        assert len(np.unique(values)) > 30
        np.testing.assert_array_equal(again.terms[name], values)


@pytest.mark.slow
def test_random_keys_belong_to_seed_generation_individual_and_trial():
    def keys(generation=2, **changes):
        made = noisy(alone(SEED))._replace(trials=3)._replace(**changes)
        drawn = np.asarray(generation_keys(made, np.int32(generation)))
        return drawn.reshape(2, made.runs, made.strategy.population, made.trials)

    base = keys()
    assert len(np.unique(base.reshape(2, -1), axis=1).T) == 3 * SIZE
    np.testing.assert_array_equal(keys(runs=2)[:, :1], base)
    np.testing.assert_array_equal(keys(runs=2)[:, 1:], keys(seed=SEED + 1))
    np.testing.assert_array_equal(keys(trials=5)[..., :3], base)
    larger = experiment(20, 2 * SIZE).strategy
    np.testing.assert_array_equal(keys(strategy=larger)[:, :, :SIZE], base)
    assert (keys(generation=3) != base).any(0).all()
    some = np.array([2, 4]), np.array([1, 0])
    np.testing.assert_array_equal(
        trial_keys(noisy(alone(SEED)), 2, np.zeros(2, int), *some), base[:, 0, some[0], some[1]]
    )
    assert generation_keys(alone(SEED), np.int32(2)) is None


def test_fitness_is_a_mean_and_one_diverged_trial_disqualifies():
    task, scales = PAIR.simulation.task, {"energy": jnp.float32(2.0)}
    rng = np.random.default_rng(1)
    terms = {name: rng.random((4, 3), dtype=np.float32) for name in ("distance", "energy", "light")}
    alive = np.ones((4, 3), bool)
    alive[1, 2] = False
    terms["light"][2, 0] = np.nan
    outcome = Outcome(terms, alive)

    @quick_jit
    def judged(outcome):
        first = jax.tree.map(lambda x: x[:, :1], outcome)
        return (
            *judge(task, outcome, scales),
            score(task, outcome, scales),
            judge(task, first, scales)[0],
            judge_each(task, outcome, scales),
        )

    fitness, mean, single, of_the_first, each = jax.device_get(judged(outcome))
    np.testing.assert_array_equal(each, single.T)
    assert np.isneginf(fitness).tolist() == [False, True, True, False]
    assert np.asarray(mean.alive).tolist() == [True, False, True, True]
    np.testing.assert_allclose(np.asarray(fitness)[[0, 3]], single[[0, 3]].mean(1), rtol=1e-6)
    np.testing.assert_allclose(mean.terms["energy"], terms["energy"].mean(1), rtol=1e-6)
    np.testing.assert_array_equal(of_the_first, single[:, 0])


class Whole(SineController):
    """Controller whose genes are drawn as integers or Boolean values."""

    kind: str = eqx.field(static=True, default="int32")

    def random_genes(self, key, batch, dtype):
        return jax.random.randint(key, (self.gene_count, *batch), 0, 2).astype(self.kind)


class Rounded(RealGenetics):
    """Strategy that returns integers."""

    def ask(self, key, state):
        genes, state = super().ask(key, state)
        return jnp.round(genes).astype(jnp.int32), state


@pytest.mark.parametrize("kind", ["int32", "bool"])
def test_genes_become_real_numbers(kind):
    made = alone(SEED)
    simulation = dataclasses.replace(made.simulation, controller=Whole(kind=kind))
    genetics = Rounded(**{f.name: getattr(REAL, f.name) for f in dataclasses.fields(REAL)})
    made = made._replace(simulation=simulation, strategy=genetics)
    genes, state = jax.jit(functools.partial(begin, made))()
    assert genes.dtype == np.float32 and set(np.unique(genes)) == {0, 1}
    outcome = Outcome(no_terms(simulation, (SIZE,)), jnp.ones(SIZE, bool))
    scales = {"energy": jnp.ones(1)}
    worth = evaluated(made, outcome, 0, scales).worth
    told = jax.eval_shape(functools.partial(next_generation, made), genes, worth, 0, state)
    assert told.next_genes.dtype == np.float32


def test_the_mean_of_a_boolean_term_is_the_fraction_of_trials():
    found = jnp.array([[True, True], [True, False], [False, False]])
    _, mean = judge(OneTerm("fell"), Outcome({"fell": found}, jnp.ones((3, 2), bool)), {})
    np.testing.assert_array_equal(mean.terms["fell"], [1, 0.5, 0])


class Unjudged(OneTerm):
    """Task whose fitness is always NaN."""

    def fitness(self, terms, scales):
        return terms[self.name] * jnp.nan


def test_a_nan_fitness_does_not_count_as_diverged(tmp_path):
    made = alone(SEED)
    simulation = dataclasses.replace(made.simulation, task=Unjudged("x"))
    _, done = evolve(made._replace(simulation=simulation, generations=1), tmp_path / "run")
    assert done.champion is None
    assert done.history[0]["diverged"] == 0 and np.isnan(done.history[0]["best"])
