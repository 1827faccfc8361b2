"""A probe in several situations gives the results of each situation alone."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.sensors import light_readings
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.tasks import Distance
from evo_cpg.training.conditions import around, blinded, probe, seen_from_start
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from trials import experiment
from watching import Watcher

STEPS = 70
GENES = np.array([1.5, 1.2], np.float32)
SITUATIONS = around(
    Situation((1.0, -1.0, 0.5), 0.5, (4.0, 0.0, 1.5)), np.deg2rad([-60, 10, 80]), [2, 4]
)


@pytest.fixture(scope="module")
def simulation():
    return dataclasses.replace(experiment(STEPS).simulation, controller=Watcher())


@pytest.fixture(scope="module")
def found(simulation):
    # Neither noise nor the task changes the path.
    noisy = dataclasses.replace(simulation, noise=Noise(0.1, 0.1, 0.5), task=Distance())
    return probe(noisy, GENES, SITUATIONS)


def test_lights_move_around_the_start_at_equal_elevation():
    seen = np.array([seen_from_start(situation) for situation in SITUATIONS])
    elevation = np.arcsin(1 / np.sqrt(11))
    expected = [(d, np.deg2rad(b), elevation) for d in (2, 4) for b in (-60, 10, 80)]
    np.testing.assert_allclose(seen, expected, atol=1e-12)
    for situation in SITUATIONS:
        away = np.subtract(situation.light, situation.start_position)
        assert np.linalg.norm(away) in (pytest.approx(2), pytest.approx(4))
    ahead = np.subtract(SITUATIONS[1].light, SITUATIONS[1].start_position)
    level = 2 * np.cos(elevation)
    turn = 0.5 + np.deg2rad(10)
    expected = (level * np.cos(turn), level * np.sin(turn), 2 / np.sqrt(11))
    np.testing.assert_allclose(ahead, expected, atol=1e-12)
    (kept,) = around(SITUATIONS[0], [np.pi])
    assert seen_from_start(kept)[0] == pytest.approx(2)


@pytest.mark.slow
def test_each_situation_gives_the_result_of_a_run_alone(simulation, found):
    assert found.alive.all() and len(found.paths) == 6
    for i in (0, 4):
        alone = dataclasses.replace(simulation, situations=SITUATIONS[i : i + 1])
        outcome = compile_trials(alone, population_mesh(1))(GENES[:, None])
        assert found.distance[i] == pytest.approx(float(outcome.terms["distance"][0]), rel=1e-5)
        assert found.light[i] == pytest.approx(float(outcome.terms["light"][0]), rel=1e-5)
        frames = quick_jit(lambda g, alone=alone: rollout(alone, g, observers=Recorder()))(
            GENES[:, None]
        )
        path = np.asarray(frames["position"])[:, :, 0, 0]
        np.testing.assert_allclose(found.paths[i], path, atol=1e-5)
        # The remaining distance is the mean of the last second.
        distance = np.linalg.norm(path - SITUATIONS[i].light, axis=1)
        assert found.start_distance[i] == pytest.approx(distance[0], rel=1e-6)
        assert found.distance[i] == pytest.approx(distance[-60:].mean() / distance[0], rel=1e-5)
    assert len(np.unique(found.light)) == 6


def test_a_light_is_reached_if_little_distance_is_left_and_alive(found):
    some = float(np.sort(found.distance)[2])
    assert found.reached(some).sum() == 3 and not found.reached(0.0).any()
    dead = found._replace(alive=np.zeros(6, bool))
    assert not dead.reached(9.0).any()


def test_results_of_a_diverged_animal_are_nan(simulation):
    lost = probe(simulation, np.array([np.nan, 1.0], np.float32), SITUATIONS[:2])
    assert not lost.alive.any() and np.isnan([lost.distance, lost.light]).all()


def test_a_blinded_animal_loses_only_its_light_sensors(simulation):
    blind = blinded(simulation)
    tree = simulation.world.tree
    light = jnp.array([3.0, 1.0, 0.5])[:, None]

    @quick_jit
    def seen(state):
        kin = kinematics(tree, state)
        return [light_readings(one.sensors, kin, light) for one in (simulation, blind)]

    (strength, *others), (nothing, *felt) = seen(resting_state(tree, (2,)))
    assert float(strength.max()) > 0.5
    np.testing.assert_array_equal(nothing, np.zeros_like(strength))
    np.testing.assert_array_equal(felt, others)
    restored = dataclasses.replace(blind, sensors=blind.sensors._replace(blind=False))
    assert repr(restored) == repr(simulation)


def test_a_blinded_animal_ignores_the_place_of_the_light(simulation, found):
    """Its path differs from the paths with eyes."""
    unseen = probe(blinded(simulation), GENES, SITUATIONS)
    np.testing.assert_array_equal(unseen.light, 0)
    np.testing.assert_array_equal(unseen.paths, np.broadcast_to(unseen.paths[0], (6, STEPS, 3)))
    assert np.abs(found.paths - unseen.paths).max() > 1e-3
    assert np.ptp(found.paths[:, -1], axis=0).max() > 1e-3
