"""Under noise, the champion is the best individual in fresh draws, not the luckiest."""

import csv
import dataclasses

import jax
import numpy as np
import pytest

from evo_cpg.api.sweep import Member
from evo_cpg.io.load import load_config
from evo_cpg.io.settings import Setting
from evo_cpg.simulation.noise import Noise
from evo_cpg.training.checkpoint import Champion, Checkpoint, champion_arrays, read_champion
from evo_cpg.training.evaluate import compile_replay
from evo_cpg.training.experiment import generation_keys, trial_keys
from evo_cpg.training.reevaluation import EVALUATIONS, FIRST_ROUND, Choice, Contest
from evo_cpg.training.train import train
from evo_cpg.view.live_page.standing import Standing
from tiny_run import REPOSITORY
from trials import experiment, folder_at

NOISE = Noise(joint_angle=0.1, tilt=0.05, push=0.2)
# Two populations of six, with two trials of each individual.
MADE = experiment(20, 6, seed=5)._replace(runs=2, trials=2, generations=2)
NOISY = MADE._replace(simulation=dataclasses.replace(MADE.simulation, noise=NOISE))


def candidate(number: int, fitness: float = 0.0) -> Champion:
    return Champion(np.full(3, number, np.float32), fitness, 7, {}, {}, 0, number)


def fight(contest: Contest, life) -> None:
    """Run all rounds. ``life`` returns the fitness from candidate, round and draw."""
    number = 0
    while not contest.done:
        pairs = contest.places().T
        contest.take(
            np.array([life(int(individual), number, int(draw)) for individual, draw in pairs])
        )
        number += 1


@pytest.mark.parametrize("population", [4, 15, 200])
def test_the_best_mean_wins_over_lucky_fitness(population):
    rng = np.random.default_rng(3)
    true = rng.permutation(min(population, 16)).astype(float)
    lucky = [candidate(i, fitness=100.0 - true[i]) for i in range(len(true))]
    contest = Contest(lucky, population)
    fight(contest, lambda individual, *_: true[individual] + 0.2 * rng.normal())
    chosen = contest.chosen()
    assert chosen is not None
    assert chosen.index == true.argmax()
    assert chosen.expected == pytest.approx(true.max(), abs=0.5)
    assert chosen.worth == chosen.expected
    assert chosen.fitness == 100.0 - true.max()


def test_candidates_share_draws_and_are_halved():
    contest = Contest([candidate(i) for i in range(16)], 48)
    candidates, draws = contest.places()
    np.testing.assert_array_equal(candidates, np.repeat(np.arange(16), 3))
    np.testing.assert_array_equal(draws, np.tile(np.arange(3), 16))
    contest.take(candidates.astype(float))
    candidates, draws = contest.places()
    assert sorted(set(candidates)) == list(range(8, 16))
    np.testing.assert_array_equal(draws, np.tile(np.arange(6), 8))
    fight(contest, lambda individual, *_: float(individual))
    rows = contest.rows()
    # The rounds have 3, 6 and 12 evaluations.
    assert [row["lives"] for row in rows] == [3] * 8 + [9] * 4 + [21] * 4
    assert [row["chosen"] for row in rows] == [0] * 15 + [1]
    assert max(row["lives"] for row in rows) >= EVALUATIONS


def test_fewer_early_ends_rank_first():
    contest = Contest([candidate(0), candidate(1)], 8)
    fight(
        contest,
        lambda individual, number, draw: (
            -np.inf if individual == 0 and draw == 0 else 1.0 - individual
        ),
    )
    chosen = contest.chosen()
    assert chosen is not None and (chosen.index, chosen.expected) == (1, 0.0)
    first = contest.rows()[0]
    assert (first["ended_early"], first["expected"]) == (1, 1.0)


def test_no_candidates_give_no_champion_and_early_ends_no_mean():
    nobody = Contest([], 4)
    assert nobody.done and nobody.chosen() is None and nobody.rows() == []
    contest = Contest([candidate(0)], 4)
    fight(contest, lambda *_: -np.inf)
    chosen = contest.chosen()
    assert chosen is not None and chosen.expected is None and chosen.worth == -np.inf


def test_the_champion_of_several_runs_has_fewest_early_ends():
    fit, steady, dead = (
        candidate(0, 9.0)._replace(lives=8, expected=5.0, ended_early=2),
        candidate(1, 2.0)._replace(lives=8, expected=1.0),
        candidate(2, 9.0)._replace(lives=8, ended_early=8),
    )
    found = Checkpoint(2, np.zeros((3, 1)), (), [], {}, chosen=(fit, None, steady, dead))
    assert found.champion is steady
    assert found._replace(chosen=(dead, fit)).champion is fit
    again = read_champion({name: np.asarray(x) for name, x in champion_arrays(fit).items()})
    assert again.ended_early == 2


def test_equal_genomes_are_one_candidate():
    twins = [candidate(4, 1.0), candidate(5, 0.5), candidate(4, 0.2)]
    assert [one.fitness for one in Contest(twins, 8).candidates] == [1.0, 0.5]


def test_each_run_has_its_own_contest():
    contests = [Contest([candidate(0), candidate(1)], 4), Contest([], 4)]
    choice = Choice(contests)
    genes = np.arange(24, dtype=np.float32).reshape(3, 8)
    population = choice.genes(genes)
    np.testing.assert_array_equal(population[:, :4], np.tile([0, 0, 1, 1], (3, 1)))
    np.testing.assert_array_equal(population[:, 4:], genes[:, 4:])
    keys = np.arange(2 * 8 * 3, dtype=np.uint32).reshape(2, -1)
    given = choice.keys(keys, 3).reshape(2, 2, 4, 3)
    own = keys.reshape(2, 2, 4, 3)
    np.testing.assert_array_equal(given[:, 0], own[:, 0][:, [0, 1, 0, 1]])
    np.testing.assert_array_equal(given[:, 1], own[:, 1])
    choice.take(np.array([[0.0, 0.0, 1.0, 1.0], [9.0] * 4]))
    assert choice.done and choice.generation == FIRST_ROUND + 1
    first, second = (contest.chosen() for contest in choice.contests)
    assert first is not None and first.index == 1 and second is None


@pytest.fixture(scope="module")
def evolved(tmp_path_factory):
    folder = folder_at(tmp_path_factory.mktemp("noisy") / "run")
    rows = []
    return folder, train(NOISY, folder, rows.extend), rows


@pytest.mark.slow
def test_a_noisy_run_chooses_champions_by_fresh_draws(evolved):
    folder, done, rows = evolved
    assert len(rows) == 4 == len(done.history)
    assert done.generation == 2
    # One of the six is left after rounds of 1, 2 and 3 evaluations, fewer than 16.
    assert all(one is not None and one.lives == 6 for one in done.chosen)
    assert done.champions is done.chosen
    assert all(one is not None and one.expected is None for one in done.records)
    assert done.champion is max(done.chosen, key=lambda one: one.expected)
    champion, _, _ = folder.load_champion()
    assert champion.expected == done.champion.expected
    assert champion.ended_early == done.champion.ended_early
    np.testing.assert_array_equal(champion.genes, done.champion.genes)
    with (folder.path / "candidates.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["chosen"] for row in table].count("1") == 2
    assert {row["generation"] for row in table} <= {"0", "1", "2"}


@pytest.mark.slow
def test_expected_fitness_is_the_mean_over_the_fresh_draws(evolved):
    _, done, _ = evolved
    chosen = done.chosen[1]
    fitness = []
    # Six candidates have one evaluation each, then three have two, and two have three.
    for number, lives in enumerate((1, 2, 3)):
        keys = generation_keys(NOISY, FIRST_ROUND + number)
        assert keys is not None
        for draw in range(lives):
            trial = np.arange(2)
            own = trial_keys(NOISY, FIRST_ROUND + number, np.full(2, 1), np.full(2, draw), trial)
            place = (6 + draw) * 2
            np.testing.assert_array_equal(np.asarray(keys)[:, place : place + 2], own)
            again = chosen._replace(generation=FIRST_ROUND + number, index=draw)
            fitness.append(compile_replay(NOISY, jax.local_device_count())(again)[0])
    assert chosen.expected == pytest.approx(np.mean(fitness), rel=1e-5)


@pytest.mark.slow
def test_chosen_champions_replay_as_recorded(evolved):
    _, done, _ = evolved
    for champion in done.chosen:
        fitness, terms, _, _ = compile_replay(NOISY, jax.local_device_count())(champion)
        assert fitness == champion.fitness
        assert terms == champion.terms


@pytest.mark.slow
def test_a_run_stopped_before_the_choice_chooses_equally(evolved, tmp_path):
    _, done, _ = evolved
    folder = folder_at(tmp_path / "run")
    # Nothing is chosen without noise.
    silent = train(MADE._replace(generations=1), folder)
    assert silent.chosen == () and silent.champions == silent.records
    other = folder_at(tmp_path / "other")
    other.save(done._replace(chosen=()))
    again = train(NOISY, other)
    assert [one.expected for one in again.chosen] == [one.expected for one in done.chosen]
    loaded = other.load()
    assert loaded is not None
    assert [one and one.lives for one in loaded.chosen] == [6, 6]


@pytest.mark.slow
def test_sweeps_and_watchers_wait_for_the_choice(evolved, tmp_path):
    """A run that was stopped between the last generation and the choice is not finished."""
    _, done, _ = evolved
    folder = folder_at(tmp_path / "run")
    waiting = Standing(done._replace(chosen=()), 2, True, None)
    assert not waiting.finished and Standing(done, 2, True, None).finished
    assert waiting._replace(choosing=False).finished
    worm = REPOSITORY / "configs" / "worm.yaml"
    for checkpoint, finished in ((done._replace(chosen=()), False), (done, True)):
        folder.save(checkpoint)
        member = Member(folder, load_config(worm), NOISY, Setting("any", {}), worm)
        assert (member.generation, member.finished) == (2, finished)


def test_an_extended_run_chooses_again(evolved, tmp_path):
    _, done, _ = evolved
    folder = folder_at(tmp_path / "run")
    folder.save(done)
    longer = train(NOISY._replace(generations=3), folder)
    whole = folder_at(tmp_path / "whole")
    straight = train(NOISY._replace(generations=3), whole)
    assert [x.fitness for x in longer.records] == [x.fitness for x in straight.records]
    assert [x.expected for x in longer.chosen] == [x.expected for x in straight.chosen]
