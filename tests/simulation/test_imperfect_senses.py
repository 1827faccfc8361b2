"""Noise, delay and rate of senses, alone and in a trial."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.control.controller import Observation
from evo_cpg.control.feedback import make_delay
from evo_cpg.io.errors import ConfigError
from evo_cpg.simulation.imperfect import Imperfection, first_memories, imperfect
from tiny_run import CONFIG, SMALL

SHORT = SMALL | {"creature.sensors": [{"type": "velocity", "body": "head"}]}
STEPS = 12


def readings(imperfection, truth, keys=None):
    """Return what is felt of three readings, ``(steps, 3, n)``, of which the last two differ."""
    memories, felt = first_memories((imperfection,), truth.shape[2:], jnp.float32), []
    for index, light in enumerate(jnp.asarray(truth)):
        seen = Observation(light, *[light[:0]] * 6)
        seen, memories = imperfect((imperfection,), index, seen, memories, keys)
        felt.append(np.asarray(seen.light))
    return np.stack(felt)


TRUTH = np.random.default_rng(0).random((STEPS, 3, 4)).astype(np.float32)


def test_a_delay_shows_former_readings_and_first_none():
    felt = readings(Imperfection("light", 1, 2, delay=make_delay(2.25, 1.0)), TRUTH)
    np.testing.assert_array_equal(felt[:, 0], TRUTH[:, 0])
    assert not felt[:2, 1:].any()
    expected = 0.75 * TRUTH[1:-2, 1:] + 0.25 * TRUTH[:-3, 1:]
    np.testing.assert_allclose(felt[3:, 1:], expected, rtol=1e-5)


def test_a_slow_sense_holds_its_last_sample():
    felt = readings(Imperfection("light", 1, 2, period=4), TRUTH)
    np.testing.assert_array_equal(felt[:, 1:], TRUTH[::4, 1:].repeat(4, 0))


def test_noise_is_normal_and_new_in_each_step_and_trial():
    count = 2000
    keys = jax.random.key_data(jax.random.split(jax.random.key(0), count)).T
    truth = np.full((3, 3, count), 0.5, np.float32)
    noise = readings(Imperfection("light", 1, 2, noise=0.2), truth, keys)[:, 1:] - 0.5
    numbers = noise.reshape(6, -1)
    assert np.abs(numbers.mean(1)).max() < 4 * 0.2 / np.sqrt(count)
    np.testing.assert_allclose(numbers.std(1), 0.2, rtol=4 / np.sqrt(2 * count))
    others = np.corrcoef(numbers)[~np.eye(6, dtype=bool)]
    assert np.abs(others).max() < 4.5 / np.sqrt(count)


def seen(senses, steps=STEPS):
    """Return the named observations of a swimmer that moves, in control steps."""
    experiment = evo.load(CONFIG, SHORT | senses)
    environment = experiment.environment()
    step, state = jax.jit(environment.step), environment.reset(jax.random.key(0))
    found = [state.obs]
    for k in range(steps):
        state = step(state, jnp.sin(0.5 * k + jnp.arange(environment.action_size)))
        found.append(state.obs)
    ends = np.cumsum([0, *environment.observation_sizes.values()])
    places = zip(environment.observation_sizes, ends[:-1], ends[1:], strict=True)
    return {name: np.stack(found)[:, a:b] for name, a, b in places}


def test_senses_of_a_trial_are_delayed_and_held_and_the_others_are_not():
    delayed = {"delay": 3 / 60}
    perfect = seen({})
    found = seen({"creature.senses": {"velocity": delayed, "light": {"rate_hz": 20}}})
    assert np.ptp(perfect["custom"][:, 0]) > 1e-3
    np.testing.assert_allclose(found["custom"][3:], perfect["custom"][:-3], rtol=1e-5, atol=1e-6)
    held = perfect["light"][::3].repeat(3, 0)[: STEPS + 1]
    np.testing.assert_allclose(found["light"], held, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(found["joint_rate"], perfect["joint_rate"], rtol=1e-5, atol=1e-6)


def test_a_silent_sense_reads_0_and_the_others_do_not_change():
    perfect = seen({})
    silent = {"silent": True, "noise": 0.5, "delay": 0.1}
    found = seen({"creature.senses": {"light": silent, "velocity": silent}})
    assert perfect["light"].any()
    assert perfect["custom"].any()
    for name, readings in found.items():
        expected = perfect[name] * (name not in ("light", "custom"))
        np.testing.assert_allclose(readings, expected, rtol=1e-5, atol=1e-6)


def test_noisy_senses_make_a_trial_random():
    experiment = evo.load(
        CONFIG, SHORT | {"creature.senses": {"joint_angle": {"noise": 0.5}}, "simulation.trials": 2}
    )
    genomes = experiment.random_genomes(0, 3)
    first, again, other = (experiment.evaluate(k, genomes) for k in (0, 0, 1))
    assert first.trial_fitness.shape == (2, 3)
    np.testing.assert_array_equal(first.fitness, again.fitness)
    assert (first.trial_fitness[0] != first.trial_fitness[1]).all()
    assert (first.fitness != other.fitness).all()


@pytest.mark.parametrize(
    ("senses", "words"),
    [
        ({"flow": {"noise": 0.1}}, r"senses.flow: the creature has no such sense. It has: light, "),
        ({"light": {"rate_hz": 25}}, r"rate_hz.* must be a multiple of it, got 25. Nearest: 30"),
        ({"light": {"delay": 2}}, r"senses.light.delay: 2: must be less than or equal to 1"),
        ({"ligth": {"noise": 1}}, r"did you mean 'light'"),
    ],
)
def test_wrong_imperfections_are_refused(senses, words):
    with pytest.raises(ConfigError, match=words):
        evo.load(CONFIG, {"creature.senses": senses})


def test_acceleration_in_a_trial_is_that_of_the_last_step():
    """A resting animal feels its weight. It then falls in a vacuum and feels nothing."""
    falling = {k: v for k, v in SMALL.items() if not k.startswith("world")}
    sensors = {"creature.sensors": [{"type": "acceleration", "body": "head", "full_scale": 20}]}
    experiment = evo.load(CONFIG, falling | sensors | {"world": {"gravity": 9.81, "water": None}})
    environment = experiment.environment()
    state = environment.reset(jax.random.key(0))
    np.testing.assert_allclose(state.obs[-3:], [0, 0, 9.81 / 20], rtol=1e-5)
    state = jax.jit(environment.step)(state, jnp.zeros(environment.action_size))
    np.testing.assert_allclose(state.obs[-3:], 0, atol=1e-5)
