"""Each lane has the situation of its trial, and equals a simulation with this one only."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recorder, as_recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.task import Task
from evo_cpg.simulation.tasks import ReachLight
from trials import experiment
from watching import Watcher

STEPS = 30
# Two places of the light, then another start with the light of the task.
SITUATIONS = (
    Situation(light=(3.0, 1.0, 0.5)),
    Situation(light=(3.0, -2.0, 0.5)),
    Situation((1.0, -0.5, 0.25), 2.0),
)
TRIAL = np.array([0, 1, 2, 2, 1, 0, 0, 1])
GENES = np.random.default_rng(0).uniform(1, 2, (2, len(TRIAL))).astype(np.float32)
KEYS = np.random.default_rng(1).integers(0, 2**32, (2, len(TRIAL)), dtype=np.uint32)


@pytest.fixture(scope="module")
def simulation():
    made = experiment(STEPS).simulation
    return dataclasses.replace(made, controller=Watcher(), situations=SITUATIONS)


def only(simulation, number: int):
    return dataclasses.replace(simulation, situations=simulation.situations[number : number + 1])


def simulate(simulation, trial=None, keys=None):
    """Return the outcome and the frames of all lanes."""

    def run(genes, keys, trial):
        frames = rollout(simulation, genes, keys, trial, Recorder(len(TRIAL)))
        return rollout(simulation, genes, keys, trial), frames

    return jax.device_get(quick_jit(run)(GENES, keys, trial))


@pytest.fixture(scope="module")
def together(simulation):
    return simulate(simulation, TRIAL)


@pytest.mark.slow
def test_a_lane_equals_a_simulation_with_its_situation_only(simulation, together):
    """They agree to the last bit, although one situation gives constants of the program."""
    outcome, frames = together
    assert outcome.alive.all()
    for number in range(3):
        lanes = number == TRIAL
        alone, motion = simulate(only(simulation, number))
        for name, values in outcome.terms.items():
            np.testing.assert_array_equal(values[lanes], alone.terms[name][lanes])
        for name, values in frames.items():
            np.testing.assert_array_equal(values[..., lanes], motion[name][..., lanes])
    # Commands differ between the situations.
    one, other = (np.asarray(frames["target_rate"])[..., lane] for lane in (1, 7))
    assert np.abs(one - other).max() > 0.1


@pytest.mark.slow
def test_the_order_of_situations_does_not_matter(simulation, together):
    """Only the numbers of the situations change. Results are equal to the last bit."""
    order = (2, 0, 1)
    turned = dataclasses.replace(simulation, situations=tuple(SITUATIONS[i] for i in order))
    outcome, frames = simulate(turned, np.argsort(order)[TRIAL])
    jax.tree.map(np.testing.assert_array_equal, (outcome, frames), together)


def test_animals_start_in_their_situations(simulation, together):
    _, frames = together
    motions = [
        as_recording(simulation, frames, ["tail", "head"], lane, int(TRIAL[lane]))
        for lane in range(3)
    ]
    heads = [motion.position[0, 1] for motion in motions]
    np.testing.assert_allclose(heads, [(0, 0, 0), (0, 0, 0), (1, -0.5, 0.25)], atol=1e-6)
    facing = motions[2].rotation[0, 1, :, 0]
    np.testing.assert_allclose(facing, (np.cos(2), np.sin(2), 0), atol=1e-6)
    goals = [tuple(motion.goal) for motion in motions]
    assert goals == [(3.0, 1.0, 0.5), (3.0, -2.0, 0.5), (3.0, 1.0, 0.5)]
    for motion in motions:
        goal_distance = np.linalg.norm(motion.position[0, 1] - motion.goal)
        assert motion.distance[0] == pytest.approx(goal_distance, rel=1e-6)


class Where(Task):
    """Task that returns the place of the light."""

    light: tuple[float, float, float] | None = (7.0, 8.0, 9.0)

    def begin(self, batch, dtype, steps):
        return jnp.zeros((3, *batch), dtype)

    def update(self, tally, transition, steps):
        return tally + transition.before.light_position

    def terms(self, tally, steps):
        return dict(zip("xyz", tally / steps, strict=True))

    def fitness(self, terms, scales):
        return terms["x"]


def test_a_users_task_gets_the_place_of_the_light(simulation):
    short = dataclasses.replace(simulation, task=Where(), steps=2)

    def places(simulation, trial):
        outcome = quick_jit(lambda genes, trial: rollout(simulation, genes, None, trial))
        return np.transpose([outcome(GENES, trial).terms[name] for name in "xyz"])

    expected = np.array([(3, 1, 0.5), (3, -2, 0.5), (7, 8, 9)])[TRIAL]
    np.testing.assert_array_equal(places(short, TRIAL), expected)
    single = dataclasses.replace(short, situations=(Situation(),))
    np.testing.assert_array_equal(places(single, None), np.tile([7.0, 8.0, 9.0], (8, 1)))


@pytest.mark.slow
def test_one_situation_is_a_constant_of_the_program(simulation):
    """The program has no look-up, with or without numbers of trials."""

    def program(simulation, trial):
        trial = None if trial is None else jnp.asarray(trial)
        lowered = jax.jit(lambda genes: rollout(simulation, genes, None, trial)).lower(GENES)
        return lowered.as_text()

    first = only(simulation, 0)
    built_in = dataclasses.replace(
        first, task=ReachLight((3.0, 1.0, 0.5)), situations=(Situation(),)
    )
    single = program(first, None)
    assert single == program(first, TRIAL) == program(built_in, None) == program(simulation, None)
    assert program(simulation, TRIAL) != single


@pytest.mark.slow
def test_every_trial_adds_its_noise_to_its_situation(simulation):
    noisy = dataclasses.replace(simulation, noise=Noise(joint_angle=0.1, push=0.3))
    outcome, frames = simulate(noisy, TRIAL, KEYS)
    angles = np.asarray(frames["joint_angle"])[0]
    assert len(np.unique(angles)) == len(TRIAL)
    alone, motion = simulate(only(noisy, 1), None, KEYS)
    lanes = TRIAL == 1
    np.testing.assert_array_equal(angles[:, lanes], motion["joint_angle"][0][:, lanes])
    for name, values in outcome.terms.items():
        np.testing.assert_array_equal(values[lanes], alone.terms[name][lanes])


def test_a_single_individual_has_a_situation(simulation):
    one = quick_jit(lambda genes, trial: rollout(simulation, genes, None, trial))
    all_of_them = one(GENES, TRIAL)
    for lane in (0, 3):
        alone = one(GENES[:, lane], TRIAL[lane])
        for name, values in all_of_them.terms.items():
            assert float(alone.terms[name]) == pytest.approx(float(values[lane]), rel=2e-5)
