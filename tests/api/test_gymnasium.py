"""Animals as environments of Gymnasium: its checker, seeds, ends of episodes, and rewards."""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import evo_cpg as evo
from evo_cpg.gymnasium import (
    AnimalEnv,
    AnimalVectorEnv,
    command_range,
    natural_actions,
    reading_bounds,
)
from evo_cpg.io.shipped import shipped_names
from tiny_run import CONFIG, SMALL

NOISY = SMALL | {"noise.joint_angle_deg": 5.0, "noise.push": 0.1}
STEPS = 30


@pytest.fixture(scope="module")
def animal():
    return AnimalEnv(CONFIG, NOISY)


@pytest.fixture(scope="module")
def animals():
    return AnimalVectorEnv(CONFIG, 3, NOISY)


def actions_of(space, count=STEPS):
    space.seed(0)
    return [space.sample() for _ in range(count)]


def test_gymnasium_finds_every_animal_by_name():
    evolving = "evolving_", "virtual_", "follow_"
    animals = {name for name in shipped_names() if not name.startswith(evolving)}
    found = {name[8:-3] for name in gymnasium.registry if name.startswith("evo_cpg/")}
    assert found == animals | {"swimmer"}
    made = gymnasium.make_vec("evo_cpg/swimmer-v0", num_envs=2, overrides=SMALL)
    assert isinstance(made.unwrapped, AnimalVectorEnv) and made.num_envs == 2


def test_a_name_with_its_module_needs_no_import():
    program = "import gymnasium; gymnasium.make('evo_cpg.gymnasium:evo_cpg/swimer-v0')"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "Environment `swimer` doesn't exist in namespace evo_cpg. Did you mean" in run.stderr


def test_the_checker_of_gymnasium_has_no_complaint():
    made = gymnasium.make("evo_cpg/swimmer-v0", overrides=NOISY)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(made.unwrapped)
    for space in (made.action_space, made.observation_space):
        assert space.dtype == np.float32 and space.is_bounded()
    assert (made.action_space.low == -1).all() and (made.action_space.high == 1).all()


def test_a_seed_repeats_a_trial_bit_for_bit(animal):
    def trial(seed):
        first, _ = animal.reset(seed=seed)
        return first, [animal.step(action)[0] for action in actions_of(animal.action_space, 5)]

    (start, seen), (again, same), (other, _) = trial(3), trial(3), trial(4)
    np.testing.assert_array_equal([start, *seen], [again, *same])
    assert (start != other).any()
    animal.reset(seed=3)
    assert (animal.reset()[0] != start).any()


def test_time_truncates_and_rewards_add_up_to_the_fitness(animal):
    animal.reset(seed=0)
    steps = [animal.step(action) for action in actions_of(animal.action_space)]
    assert [step[3] for step in steps] == [False] * (STEPS - 1) + [True]
    assert not any(step[2] for step in steps)
    task, terms = animal._spaces.environment._simulation.task, steps[-1][4]
    fitness = task.fitness(terms, animal._spaces.environment._scales)
    assert sum(step[1] for step in steps) == pytest.approx(float(fitness), abs=1e-4)
    assert {"distance", "light", "energy"} <= terms.keys() and steps[0][4] == {}


def test_many_animals_move_as_each_alone(animal, animals):
    """Each gets the same seed of noise as alone, and restarts in the step after its end."""
    assert animals.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    actions = actions_of(animals.action_space)
    first, _ = animals.reset(seed=5)
    steps = [animals.step(action) for action in actions]
    seeds = np.random.default_rng(5).integers(2**31, size=3)
    for i, seed in enumerate(seeds):
        readings, _ = animal._session.reset(int(seed))
        np.testing.assert_allclose(first[i], readings, rtol=1e-6)
        for action, step in zip(actions, steps, strict=True):
            seen, reward, diverged, over, _ = animal.step(action[i])
            np.testing.assert_allclose(step[0][i], seen, rtol=1e-4, atol=1e-5)
            assert step[1][i] == pytest.approx(reward, abs=1e-5)
            assert (step[2][i], step[3][i]) == (diverged, over)
    assert steps[-1][3].all() and steps[-1][4]["_distance"].all()
    again, reward, ended, over, _ = animals.step(actions[0])
    assert not reward.any() and not ended.any() and not over.any()
    assert (again != first).any() and np.abs(again - first).max() < 1


def test_only_animals_that_have_ended_restart(animals):
    animals.reset(seed=1)
    actions = actions_of(animals.action_space, 4)
    before = [animals.step(action)[0] for action in actions[:2]][-1]
    animals._state.done[1] = True
    after = animals.step(actions[2])[0]
    np.testing.assert_array_equal(animals._state.inner.number, [3, 0, 3])
    assert (after[1] != before[1]).any()


def test_animals_of_one_experiment_share_their_code():
    """The second is not traced again, and the first's steps do not change its motion."""
    experiment = evo.load(CONFIG, NOISY)
    first, second = AnimalEnv(experiment), AnimalEnv(experiment)
    assert first._spaces is second._spaces and first._session._reset is second._session._reset
    actions = actions_of(first.action_space, 4)
    first.reset(seed=1)
    second.reset(seed=1)
    alone = [first.step(action)[0] for action in actions]
    first.reset(seed=2)
    for action, seen in zip(actions, alone, strict=True):
        np.testing.assert_array_equal(second.step(action)[0], seen)
        first.step(-action)


def test_divergence_terminates():
    """An animal that falls in a vacuum counts as diverged at 100 m/s, after 0.4 s."""
    falling = {k: v for k, v in SMALL.items() if not k.startswith("world")}
    animal = AnimalEnv(CONFIG, falling | {"world": {"gravity": 250, "water": None}})
    animal.reset(seed=0)
    steps = [animal.step(action) for action in actions_of(animal.action_space)]
    ends = [step[2] for step in steps]
    assert ends.index(True) == pytest.approx(24, abs=1) and all(ends[25:])
    assert not any(step[3] for step in steps) and np.isfinite([step[1] for step in steps]).all()


@pytest.mark.parametrize(
    ("config", "kind", "low", "high"),
    [
        (CONFIG, "rates", -5.0, 5.0),
        pytest.param("eel", "activations", 0.0, 1.0, marks=pytest.mark.slow),
        ("half_cheetah", "torques", -120.0, 120.0),
    ],
)
def test_actions_cover_the_range_of_motors_and_muscles(config, kind, low, high):
    """Half a cheetah hangs on a root with three axes, which nothing drives."""
    experiment = evo.load(config, SMALL if config == CONFIG else {})
    assert natural_actions(experiment) == kind
    environment = experiment.environment(kind)
    lower, upper = command_range(environment, experiment)
    assert (lower.min(), upper.max()) == (low, high)
    driven = (upper > lower).sum()
    assert driven == (6 if config == "half_cheetah" else environment.action_size)
    least, most = reading_bounds(environment)
    assert least.shape == (environment.observation_size,) and (least < most).all()
