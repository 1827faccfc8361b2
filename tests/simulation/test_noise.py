"""Noise has its configured size, differs between trials, and costs nothing if it is off."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import hinge, quick_jit
from evo_cpg.creature.axis_kinds import BallComponent
from evo_cpg.creature.creature import Body, Creature, Material, lowest_height
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree
from evo_cpg.native.engine import Engine
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.simulation.judge import JUDGE
from evo_cpg.simulation.noise import Noise, disturb_motion, disturb_start, friction_scale_of
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.situation import Situation
from trials import EYES, experiment, swimmer

COUNT = 4000
KEYS = np.random.default_rng(0).integers(0, 2**32, (2, COUNT), dtype=np.uint32)


@pytest.fixture(scope="module")
def simulation():
    return experiment(20).simulation


def start(simulation, keys=KEYS, **noise):
    world = simulation.world
    rest = resting_state(world.tree, keys.shape[1:], jnp.float32)
    return quick_jit(lambda k: disturb_start(Noise(**noise), world, rest, k))(keys)


def test_initial_angles_are_noisy_within_joint_limits(simulation):
    angles = np.asarray(start(simulation, joint_angle=0.2).q)
    # 4000 draws give the standard deviation to 1.1 %.
    assert angles.std() == pytest.approx(0.2, rel=0.04)
    assert abs(angles.mean()) < 4 * 0.2 / np.sqrt(COUNT)
    wide = np.asarray(start(simulation, joint_angle=2.0).q)
    assert wide.min() == -1.0 and wide.max() == 1.0
    # 62 % of draws lie beyond half a standard deviation.
    assert (np.abs(wide) == 1.0).mean() == pytest.approx(0.617, abs=0.03)


def test_balls_start_within_their_limit():
    ball = hinge("a", (0.2,) * 3, (-0.2,) * 3, "xyz", kinds=(BallComponent(),) * 3)
    body = Body("a", Box((0.2,) * 3), Material(1000.0))
    pair = Creature("pair", (body, dataclasses.replace(body, name="b", joint=ball)))
    world = World(build_tree(pair), 9.81)
    rest = resting_state(world.tree, KEYS.shape[1:], jnp.float32)
    narrow, wide = (
        np.linalg.norm(disturb_start(Noise(joint_angle=x), world, rest, KEYS).q, axis=0)
        for x in (0.2, 1.0)
    )
    # The mean length of a vector of three normal deviates is sqrt(8 / pi).
    assert narrow.mean() == pytest.approx(0.2 * np.sqrt(8 / np.pi), rel=0.03)
    assert wide.max() == pytest.approx(1.0, abs=1e-6)
    # 80 % of draws are longer than one standard deviation.
    assert (wide > 0.999).mean() == pytest.approx(0.801, abs=0.03)


def test_the_root_rolls_and_pitches_but_does_not_turn(simulation):
    state = start(simulation, tilt=0.1)
    w, *vector = np.asarray(state.orientation, float)
    rotation = 2 * np.arccos(w) * np.array(vector) / np.linalg.norm(vector, axis=0)
    np.testing.assert_allclose(rotation[:2].std(1), 0.1, rtol=0.04)
    assert abs(np.corrcoef(rotation[:2])[0, 1]) < 4 / np.sqrt(COUNT)
    assert (rotation[2] == 0).all()
    np.testing.assert_array_equal(state.q, 0)


def test_no_animal_starts_in_the_ground():
    """An animal that would penetrate the ground is lifted until it touches. Others do not move."""
    creature = swimmer(EYES)
    tree = build_tree(creature)
    world = World(tree, 9.81, contact_model=make_contact_model(creature, tree, Ground()))
    place = (0.0, 0.0, 0.01 - float(lowest_height(creature)))
    rest = resting_state(tree, (COUNT,), jnp.float32, place)
    noise = Noise(joint_angle=0.2, tilt=0.2)
    state = quick_jit(lambda k: disturb_start(noise, world, rest, k))(KEYS)
    gap = quick_jit(lambda state: clearance(world.contact_model, kinematics(tree, state)).min(0))(
        state
    )
    gap = np.asarray(gap)
    lifted = np.asarray(state.position[2] > rest.position[2])
    assert 0.2 < lifted.mean() < 0.99
    np.testing.assert_allclose(gap[lifted], 0.0, atol=1e-6)
    assert gap[~lifted].min() >= 0.0


@pytest.mark.parametrize("rate", [60, 240])
def test_pushes_add_up_to_a_random_walk_at_any_control_rate(simulation, rate):
    """After t = 0.5 s the standard deviation of the velocity is push sqrt(t)."""
    noise, rest = Noise(push=0.3), resting_state(simulation.world.tree, (COUNT,), jnp.float32)

    def walk(keys):
        def advance(state, index):
            return disturb_motion(noise, simulation.world.tree, state, keys, index, 1 / rate), None

        return jax.lax.scan(advance, rest, jnp.arange(rate // 2))[0]

    velocity = np.asarray(quick_jit(walk)(KEYS).velocity)
    np.testing.assert_allclose(velocity[3:].std(1), 0.3 * np.sqrt(0.5), rtol=0.04)
    assert (velocity[:3] == 0).all()


def test_noise_of_a_trial_does_not_depend_on_other_trials(simulation):
    noise = {"joint_angle": 0.1, "tilt": 0.1}
    together, alone = start(simulation, **noise), start(simulation, KEYS[:, 7:8], **noise)
    np.testing.assert_array_equal(together.q[:, 7:8], alone.q)
    np.testing.assert_array_equal(together.orientation[:, 7:8], alone.orientation)
    assert len(np.unique(np.asarray(together.q))) > COUNT - 10


@pytest.mark.slow
def test_programs_without_noise_equal_programs_without_keys(simulation):
    genes, keys = jnp.ones((2, 3)), jnp.asarray(KEYS[:, :3])

    def program(simulation, keys):
        return jax.jit(lambda genes: rollout(simulation, genes, keys)).lower(genes).as_text()

    silent = dataclasses.replace(simulation, noise=Noise(0.0, 0.0, 0.0))
    noisy = dataclasses.replace(simulation, noise=Noise(push=0.1))
    assert program(silent, keys) == program(simulation, None) == program(noisy, None)
    assert program(noisy, keys) != program(noisy, None)


def test_friction_is_uniform_over_trials():
    assert friction_scale_of(Noise(push=1.0), jnp.asarray(KEYS)) is None
    assert friction_scale_of(Noise(friction=0.2), None) is None
    friction_scale = np.asarray(friction_scale_of(Noise(friction=0.2), jnp.asarray(KEYS)))
    assert 0.8 <= friction_scale.min() < 0.801 and 1.199 < friction_scale.max() <= 1.2
    # Each tenth of the range has equally many draws, within four standard deviations.
    counts = np.histogram(friction_scale, 10, (0.8, 1.2))[0]
    assert abs(counts - COUNT / 10).max() < 4 * np.sqrt(COUNT * 0.1 * 0.9)
    np.testing.assert_array_equal(
        friction_scale[7:8], friction_scale_of(Noise(friction=0.2), jnp.asarray(KEYS[:, 7:8]))
    )


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("engine", ["auto", pytest.param("jax", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_noise_of_friction_equals_another_friction_coefficient(engine):
    creature = swimmer(EYES)
    tree = build_tree(creature)
    slope = Ground(floor=Plane((0.3, 0.0, 1.0)), static_friction=0.05, dynamic_friction=0.05)
    crawling = dataclasses.replace(
        experiment(20).simulation,
        world=World(tree, 9.81, contact_model=make_contact_model(creature, tree, slope)),
        situations=(Situation((0.0, 0.0, 0.05)),),
        engine=Engine(engine),
    )
    noisy = dataclasses.replace(crawling, noise=Noise(friction=0.9))
    genes, keys = jnp.full((2, 3), 2.0), jnp.asarray(KEYS[:, :3])
    found = quick_jit(lambda g, k: rollout(noisy, g, k, None, Recorder(3)))(genes, keys)["position"]

    @quick_jit
    def alone(genes, factor):
        rough = dataclasses.replace(crawling, world=crawling.world.with_friction(factor))
        return rollout(rough, genes, observers=Recorder())["position"]

    for i, factor in enumerate(np.asarray(friction_scale_of(noisy.noise, keys))):
        expected = alone(genes, float(factor))
        np.testing.assert_allclose(found[..., i], expected[..., 0], atol=1e-6)
    assert np.ptp(np.asarray(found)[-1, 0], axis=-1).max() > 1e-3


def test_the_recording_of_a_noisy_trial_has_the_same_noise(simulation):
    noisy = dataclasses.replace(simulation, noise=Noise(0.1, 0.1, 0.5))
    genes, keys = np.full((2, 4), 2.0, np.float32), KEYS[:, [0, 1, 2, 0]]
    both = JUDGE, Recorder(4)
    outcome, frames = quick_jit(lambda g, k: rollout(noisy, g, k, observers=both))(genes, keys)
    distance = np.asarray(outcome.terms["distance"])
    assert len(np.unique(distance[:3])) == 3 and distance[3] == distance[0]
    place = np.asarray(frames["position"])[:, :, simulation.world.tree.names.index("head")]
    goal_distance = np.linalg.norm(np.array([3.0, 1.0, 0.5])[:, None] - place, axis=1)
    np.testing.assert_allclose(distance, goal_distance.mean(0) / goal_distance[0], rtol=1e-5)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_noise_is_the_same_with_native_code_and_jax(simulation):
    """Noise is drawn in float32 (last digit 1e-7), and moves the animal by centimetres."""
    silent = dataclasses.replace(simulation, steps=3)
    noisy = dataclasses.replace(silent, noise=Noise(0.3, 0.3, 2.0))
    genes, keys = jnp.full((2, 3), 2.0), jnp.asarray(KEYS[:, :3])

    def trial(simulation, engine):
        chosen = dataclasses.replace(simulation, engine=Engine(engine))
        return quick_jit(lambda g, k: rollout(chosen, g, k, None, Recorder(2)))(genes, keys)[
            "position"
        ]

    found, expected = (trial(noisy, engine) for engine in ("native", "jax"))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert np.abs(expected - trial(silent, "native")).max() > 0.05
