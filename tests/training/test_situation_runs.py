"""Individuals in several situations: means, resuming and exact replays."""

import csv
import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.simulation.judge import JUDGE, score
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.situation import Situation
from evo_cpg.training.devices import chunk_width, population_mesh
from evo_cpg.training.evaluate import compile_replay, compile_trials
from evo_cpg.training.experiment import begin, generation_keys, situation_numbers
from trials import evolve, experiment, untimed
from watching import Watcher

STEPS, SIZE = 20, 6
SITUATIONS = (
    Situation(light=(3.0, 1.0, 0.5)),
    Situation(light=(2.0, -2.0, 0.0)),
    Situation((1.0, -0.5, 0.25), 2.0, (0.0, 2.0, 0.0)),
)


def in_situations(situations=SITUATIONS, size=SIZE, noise=None, **changes):
    made = experiment(STEPS, size, seed=5)
    simulation = dataclasses.replace(
        made.simulation, controller=Watcher(), situations=situations, noise=noise or Noise()
    )
    return made._replace(simulation=simulation, trials=len(situations))._replace(**changes)


MADE = in_situations()
NOISY = in_situations(noise=Noise(joint_angle=0.1, push=0.2), runs=2)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(MADE, id="silent", marks=pytest.mark.slow),
        pytest.param(NOISY, id="noisy"),
    ],
)
def evolved(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("situations") / "run"
    return request.param, *evolve(request.param, path)


@pytest.mark.slow
def test_fitness_and_terms_are_means_over_the_situations(evolved):
    """Compare the first generation with separate simulations of one situation each."""
    made, folder, done = evolved
    genes = np.asarray(begin(made)[0])
    keys = generation_keys(made, np.int32(0))
    lone = []
    for number, situation in enumerate(SITUATIONS):
        simulation = dataclasses.replace(made.simulation, situations=(situation,))
        own = None if keys is None else np.asarray(keys)[:, number::3]
        lone.append(compile_trials(simulation, population_mesh(1))(genes, own))
    terms = {name: np.mean([one.terms[name] for one in lone], axis=0) for name in lone[0].terms}
    scale = np.array(done.scales["energy"], np.float32)
    scales = {"energy": jnp.repeat(scale, SIZE)}
    task = made.simulation.task
    fitness = np.mean([jax.vmap(functools.partial(score, task))(one, scales) for one in lone], 0)
    with folder.metrics.open() as file:
        rows = list(csv.DictReader(file))[: made.runs]
    for run, row in enumerate(rows):
        own = slice(run * SIZE, (run + 1) * SIZE)
        best = int(np.argmax(fitness[own]))
        assert float(row["best"]) == pytest.approx(fitness[own].max(), rel=1e-4)
        assert float(row["mean"]) == pytest.approx(fitness[own].mean(), rel=1e-4)
        for name, values in terms.items():
            assert float(row[f"best_{name}"]) == pytest.approx(values[own][best], rel=1e-4)
    # The scale is measured over all trials of a run.
    energy = np.array([one.terms["energy"] for one in lone]).reshape(3, made.runs, SIZE)
    expected = np.percentile(np.moveaxis(energy, 1, 0).reshape(made.runs, -1), 95, axis=1)
    np.testing.assert_allclose(scale, expected, rtol=1e-4)


@pytest.mark.slow
def test_a_resumed_run_equals_an_uninterrupted_one(evolved, tmp_path):
    made, _, done = evolved
    evolve(made._replace(generations=1), tmp_path / "run")
    _, resumed = evolve(made, tmp_path / "run")
    np.testing.assert_array_equal(resumed.genes, done.genes)
    assert untimed(resumed.history) == untimed(done.history)


@pytest.mark.slow
def test_champions_replay_as_recorded_in_any_trial(evolved):
    made, _, done = evolved
    for trial, champion in zip((2, 0), done.champions, strict=False):
        fitness, terms, _, motion = compile_replay(made, 2, trial)(champion)
        assert (fitness, terms) == (champion.fitness, champion.terms)
        situation = SITUATIONS[trial]
        assert tuple(motion.goal) == situation.light
        # The head is the second body.
        np.testing.assert_allclose(motion.position[0, 1], situation.start_position, atol=1e-6)
        heading = situation.start_heading
        facing = np.cos(heading), np.sin(heading), 0
        np.testing.assert_allclose(motion.rotation[0, 1, :, 0], facing, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("devices", "noise"), [(2, None), (1, Noise(joint_angle=0.1))])
def test_more_situations_than_a_chunk_holds_replay_exactly(devices, noise):
    """One individual has 40 trials, in smaller chunks."""
    lights = np.random.default_rng(2).uniform(-3, 3, (40, 3))
    made = in_situations(tuple(Situation(light=tuple(place)) for place in lights), 1, noise)
    genes = np.asarray(begin(made)[0])
    keys = generation_keys(made, np.int32(3))
    keys = None if keys is None else np.asarray(keys)
    numbers = situation_numbers(made)
    live = compile_trials(made.simulation, population_mesh(devices))
    outcome = live(genes, keys, numbers, 40)
    recorded = JUDGE, Recorder()
    width = chunk_width(40, devices)
    again = compile_trials(made.simulation, population_mesh(1), width, observers=recorded)
    replayed, _ = again(genes, keys, numbers, 40)
    assert len(np.unique(outcome.terms["distance"])) == 40
    for name, values in outcome.terms.items():
        np.testing.assert_array_equal(replayed.terms[name], values)


def test_only_several_situations_are_numbered():
    assert situation_numbers(MADE).tolist() == [0, 1, 2]
    assert situation_numbers(in_situations(SITUATIONS[:1])) is None
    assert situation_numbers(in_situations(SITUATIONS[:1], trials=4)) is None
