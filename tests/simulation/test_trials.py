"""Trials: NumPy recomputes the terms of the task from recordings."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from creatures import quick_jit
from evo_cpg.simulation.judge import Outcome, score
from evo_cpg.simulation.observers import EachPhysicsStep
from evo_cpg.simulation.recording import Recorder, as_recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.tasks import ReachLight
from trials import experiment

# Amplitude (rad/s) and frequency (Hz): two swimmers, one at rest, one with NaN, and one with a rate
# that no body can follow.
GENES = np.array([[3.0, 2.0, 0.0, np.nan, 1e7], [1.0, 2.0, 1.0, 1.0, 3.0]], np.float32)
SURVIVORS = 3
STEPS = 90


@pytest.fixture(scope="module")
def trial():
    """Outcome, and recordings with one more step, for the last rates."""
    short, long = experiment(STEPS).simulation, experiment(STEPS + 1).simulation
    outcome, frames = quick_jit(
        lambda g: (rollout(short, g), rollout(long, g, observers=Recorder(SURVIVORS)))
    )(GENES)
    names = ["tail", "head"]
    return outcome, [as_recording(long, frames, names, i) for i in range(SURVIVORS)]


@pytest.mark.parametrize("individual", range(SURVIVORS))
def test_terms_follow_from_the_recording(trial, individual):
    outcome, recordings = trial
    terms = {name: float(values[individual]) for name, values in outcome.terms.items()}
    motion = recordings[individual]
    head, light = motion.position[:STEPS, 1].astype(float), np.array([3.0, 1.0, 0.5])
    distance = np.linalg.norm(light - head, axis=1)
    np.testing.assert_allclose(motion.distance[:STEPS], distance, rtol=1e-6)
    assert terms["distance"] == pytest.approx(distance[-60:].mean() / distance[0], rel=1e-5)

    rate = np.diff(motion.joint_angle.astype(float), axis=0) * 60
    middle = (rate + np.vstack([np.zeros_like(rate[:1]), rate[:-1]])) / 2
    energy = np.abs(motion.torque[:STEPS] * middle).sum() / 60
    assert terms["energy"] == pytest.approx(energy, rel=1e-3, abs=1e-6)

    rotation = motion.rotation[:STEPS].astype(float)
    strength = []
    for body, place, axis, field in (
        (1, [0.1, 0, 0], [1, 0, 0], np.pi),
        (0, [-0.1, 0, 0.02], [0, 1, 0], np.pi / 2),
    ):
        ray = light - motion.position[:STEPS, body] - rotation[:, body] @ place
        cosine = (rotation[:, body] @ axis * ray).sum(1) / np.linalg.norm(ray, axis=1)
        angle = np.arccos(cosine)
        strength.append(np.where(angle < field / 2, np.cos(np.pi * angle / field), 0.0))
    assert terms["light"] == pytest.approx(np.max(strength, 0).mean(), abs=1e-5)


def test_the_commanded_wave_follows_the_genes(trial):
    _, recordings = trial
    time = recordings[1].time[:, None]
    assert time[1] == pytest.approx(1 / 60)
    np.testing.assert_allclose(
        recordings[1].target_rate, 2.0 * np.sin(2 * np.pi * 2.0 * time), atol=1e-4
    )
    assert recordings[1].dof_names == ("tail.z",)
    assert np.abs(recordings[1].joint_angle).max() > 0.1
    # The individual without drive does not move, because its density equals the water's.
    assert np.ptp(recordings[2].position, axis=0).max() < 1e-5


def test_diverged_individuals_score_minus_infinity(trial):
    outcome, _ = trial
    assert np.asarray(outcome.alive).tolist() == [True] * SURVIVORS + [False] * 2
    task = experiment(STEPS).simulation.task
    fitness = np.asarray(score(task, outcome, {"energy": jnp.float32(2.0)}))
    assert (fitness[SURVIVORS:] == -np.inf).all()
    terms = {name: np.asarray(values[:SURVIVORS]) for name, values in outcome.terms.items()}
    expected = (
        -np.minimum(terms["distance"], 1.5)
        - 0.2 * np.minimum(terms["energy"] / 2.0, 1.0)
        + 0.5 * terms["light"]
    )
    np.testing.assert_allclose(fitness[:SURVIVORS], expected, rtol=1e-6)


def test_a_fitness_that_is_not_finite_becomes_minus_infinity():
    task = ReachLight((1.0, 0.0, 0.0))
    terms = {name: jnp.array([jnp.nan, jnp.inf, 0.5]) for name in ("distance", "energy", "light")}
    fitness = score(task, Outcome(terms, jnp.ones(3, bool)), {"energy": jnp.float32(1.0)})
    assert np.asarray(fitness).tolist() == [-np.inf, -np.inf, pytest.approx(-0.35)]


NUMBERS = st.floats(0, 1)


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_distance_outweighs_light_and_light_outweighs_energy(distance, light, energy, other):
    # Eq. 10: the full range of a term outweighs the full range of the next one.
    task, scales = ReachLight((1.0, 0.0, 0.0)), {"energy": jnp.float32(4.0)}

    def fitness(distance, light, energy):
        terms = {"distance": distance, "energy": 4.0 * energy, "light": light}
        return float(task.fitness({name: jnp.float32(x) for name, x in terms.items()}, scales))

    assert fitness(0.0, 0.0, energy) >= fitness(1.0, 1.0, energy)
    assert fitness(distance, 1.0, 1.0) >= fitness(distance, 0.0, 0.0)
    low, high = sorted((light, other))
    assert fitness(distance, high, energy) >= fitness(distance, low, energy)
    assert fitness(low, light, energy) >= fitness(high, light, energy)
    assert fitness(distance, light, low) >= fitness(distance, light, high)


def test_terms_beyond_their_scales_do_not_change_the_fitness():
    task, scales = ReachLight((1.0, 0.0, 0.0)), {"energy": jnp.float32(4.0)}
    terms = {"distance": jnp.array([1.5, 9.0]), "energy": jnp.array([4.0, 1e9])}
    fitness = task.fitness(terms | {"light": jnp.zeros(2)}, scales)
    assert float(fitness[0]) == float(fitness[1]) == pytest.approx(-1.7)


def test_the_energy_scale_can_be_given():
    task = ReachLight((1.0, 0.0, 0.0), energy_max=250.0)
    spent = {"energy": jnp.array([5.0, 250.0, jnp.nan])}
    scales = task.scales(spent)
    assert float(scales["energy"]) == 250.0
    terms = spent | {"distance": jnp.zeros(3), "light": jnp.zeros(3)}
    np.testing.assert_allclose(task.fitness(terms, scales)[:2], [-0.004, -0.2], rtol=1e-6)


def test_the_energy_scale_is_the_95th_percentile_of_finite_energies():
    task = ReachLight((1.0, 0.0, 0.0))
    energy = np.random.default_rng(0).uniform(1, 5, 40).astype(np.float32)
    given_energy = np.append(energy, [np.nan, np.inf]).astype(np.float32)
    top = task.scales({"energy": jnp.asarray(given_energy)})["energy"]
    assert float(top) == pytest.approx(np.percentile(energy, 95), rel=1e-6)
    for idle in (np.zeros(5), np.full(5, np.nan)):
        assert float(task.scales({"energy": jnp.asarray(idle, jnp.float32)})["energy"]) == 1.0


def test_an_animal_without_eyes_completes_its_trial():
    simulation = experiment(2, eyes=()).simulation
    terms = jax.eval_shape(lambda: rollout(simulation, jnp.ones((2, 3)))).terms
    assert {values.shape for values in terms.values()} == {(3,)}


def test_a_control_step_has_mean_forces_and_total_energy():
    """Forces are means over the physics steps. Energy is their sum."""
    finer = dataclasses.replace(experiment(20).simulation, substeps=3)
    genes = GENES[:, :1]
    both = EachPhysicsStep(), Recorder()
    steps, frames = quick_jit(lambda g: rollout(finer, g, observers=both))(genes)
    each = np.asarray(steps.torque, float).reshape(1, 20, 3)
    np.testing.assert_allclose(frames["torque"][:, 0, 0], each.mean(2)[0], rtol=1e-4, atol=1e-5)
    assert np.ptp(each, axis=2).max() > 0.1 * np.abs(each).max()
    rate = np.asarray((steps.before.qd + steps.after.qd) / 2, float).reshape(1, 20, 3)
    spent = np.abs(each * rate).sum((0, 2)) / 180
    np.testing.assert_allclose(frames["energy"][:, 0], spent, rtol=1e-3, atol=1e-7)
