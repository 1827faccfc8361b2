"""Tasks without a light: terms from made-up motions, from trials, and from a falling box."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_foot_slip import trial_of

from creatures import quick_jit
from evo_cpg.control.controller import Command, Observation
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.recording import Recorder, as_recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.snapshot import Forces, Snapshot
from evo_cpg.simulation.task import Transition
from evo_cpg.simulation.tasks import Distance, Walk
from trials import experiment

STEPS, ANIMALS = 40, 5
BOX = Creature("box", (Body("box", Box((0.2, 0.2, 0.2)), Material(300.0, 0.0)),))
GENES = np.array([[3.0, 2.0, 0.0], [1.0, 2.0, 1.0]], np.float32)


@pytest.fixture(scope="module")
def motion():
    """Random motion of some animals, in which no two terms are equal."""
    rng = np.random.default_rng(0)
    position = rng.normal(size=(STEPS, 3, ANIMALS)).cumsum(0) + 5.0
    turns = Rotation.from_quat(rng.normal(size=(STEPS * ANIMALS, 4)))
    return position, turns, rng.uniform(size=(STEPS, ANIMALS))


def taken(step, place, turn, airborne):
    """Return a control step with this initial pose. These tasks use nothing else of it."""
    still = jnp.zeros((6, *place.shape[1:]))
    none = jnp.zeros((0, *place.shape[1:]))
    world = World(build_tree(BOX), 9.81)
    before = Snapshot(world, 1 / 60, State(place, turn, still, none, none))
    unseen = Observation(*[none] * 7)
    forces = Forces(none, jnp.zeros((3, 0, *place.shape[1:])), none[:0])
    energy = jnp.zeros(place.shape[1:])
    command = Command(none, none)
    return Transition(step, before, before, unseen, command, forces, energy, airborne)


def judged(task, motion):
    """Return the terms of a made-up motion."""
    position, turns, airborne = motion
    quaternion = turns.as_quat()[:, [3, 0, 1, 2]].reshape(STEPS, ANIMALS, 4)
    tally = task.begin((ANIMALS,), jnp.dtype(jnp.float32), STEPS)
    for k in range(STEPS):
        place, turn = jnp.float32(position[k]), jnp.float32(quaternion[k].T)
        fraction = jnp.float32(airborne[k])
        tally = task.update(tally, taken(jnp.array(k), place, turn, fraction), STEPS)
    return task.terms(tally, STEPS)


@pytest.mark.parametrize("heading", ["any", "forward"])
def test_distance_is_the_straight_line_over_ground(motion, heading):
    position = motion[0]
    terms = judged(Distance(heading=heading), motion)
    displacement = position[-1] - position[0]
    np.testing.assert_allclose(
        terms["distance"], np.hypot(displacement[0], displacement[1]), rtol=1e-5
    )
    np.testing.assert_allclose(terms["forward"], displacement[0], rtol=1e-5, atol=1e-5)
    assert (displacement[0] < 0).any()
    fitness = Distance(heading=heading).fitness(terms, {})
    np.testing.assert_array_equal(fitness, terms["distance" if heading == "any" else "forward"])


def test_a_walk_is_scored_by_tilt_bounce_and_airborne_time(motion):
    position, turns, airborne = motion
    terms = judged(Walk(torso_length=0.6), motion)
    up = turns.apply([0, 0, 1])[:, 2].reshape(STEPS, ANIMALS)
    np.testing.assert_allclose(terms["tilt"], (1 - up).mean(0), rtol=1e-5)
    np.testing.assert_allclose(terms["bounce"], position[:, 2].std(0), rtol=1e-4)
    np.testing.assert_allclose(terms["airborne"], airborne.mean(0), rtol=1e-5)
    np.testing.assert_array_equal(terms["distance"], judged(Distance(), motion)["distance"])


@pytest.mark.parametrize("heading", ["any", "forward"])
def test_the_weights_of_a_walk_are_in_torso_lengths(heading):
    weights = {"distance_weight": 2.0, "tilt_weight": 3.0}
    weights |= {"bounce_weight": 5.0, "airborne_weight": 7.0}
    task = Walk(torso_length=0.5, heading=heading, **weights)
    terms = {"distance": 4.0, "forward": -3.0, "tilt": 0.1, "bounce": 0.02, "airborne": 0.3}
    displacement = 4.0 if heading == "any" else -3.0
    fitness = float(task.fitness({name: jnp.float32(x) for name, x in terms.items()}, {}))
    assert fitness == pytest.approx(2 * displacement / 0.5 - 3 * 0.1 - 5 * 0.02 / 0.5 - 7 * 0.3)


@pytest.mark.parametrize("bounce", [0.0, 1e-3])
def test_a_small_bounce_keeps_its_digits_in_a_long_trial(bounce):
    """The trial has 1200 steps at a height of 100 m, in float32."""
    steps, task = 1200, Walk(torso_length=0.6)
    heights = 100.0 + np.float32(bounce) * np.sign(np.arange(steps) % 2 - 0.5)
    upright = jnp.array([1.0, 0.0, 0.0, 0.0])

    def advance(tally, now):
        step, height = now
        place = jnp.array([0.0, 0.0, 1.0]) * height
        return task.update(tally, taken(step, place, upright, jnp.float32(0)), steps), None

    start = task.begin((), jnp.dtype(jnp.float32), steps)
    course = jnp.arange(steps), jnp.float32(heights)
    terms = task.terms(jax.lax.scan(advance, start, course)[0], steps)
    assert float(terms["bounce"]) == pytest.approx(np.float32(heights).std(dtype=float), rel=1e-3)
    assert float(terms["tilt"]) == 0.0


@pytest.mark.slow
def test_a_trial_in_the_dark_measures_distance_from_the_start():
    """The motion is equal with and without a light, because the sine wave ignores the light."""
    lit = experiment(40).simulation
    dark = dataclasses.replace(lit, task=Distance(), situations=(Situation((0.0, 0.0, 0.75)),))
    by_light, in_dark, outcome = quick_jit(
        lambda genes: (
            *(rollout(each, genes, observers=Recorder()) for each in (lit, dark)),
            rollout(dark, genes),
        )
    )(GENES)
    recordings = [
        as_recording(simulation, frames, ["tail", "head"])
        for simulation, frames in ((lit, by_light), (dark, in_dark))
    ]
    head = [recording.position[:, 1] for recording in recordings]
    np.testing.assert_allclose(head[1][0], [0, 0, 0.75], atol=1e-7)
    np.testing.assert_allclose(head[1] - [0, 0, 0.75], head[0], atol=1e-5)
    assert np.isnan(recordings[1].goal).all() and np.isfinite(recordings[0].goal).all()
    distance = np.linalg.norm((head[1] - head[1][0])[:, :2], axis=1)
    np.testing.assert_allclose(recordings[1].distance, distance, atol=1e-7)
    assert distance[-1] > 5e-3
    assert float(outcome.terms["distance"][0]) == pytest.approx(distance[-1], rel=1e-5)
    assert outcome.alive.all()


@pytest.mark.slow
def test_airborne_time_equals_the_free_fall():
    """A box falls 0.5 m without bouncing, for sqrt(2 h / g) of one second."""
    terms, _ = trial_of(BOX.bodies[0].shape, 0.5, 0.6, 1.0, (0,) * 6, rate=60)
    # The box lands within a physics step of this time, and rests a few steps later.
    fall = np.sqrt(2 * 0.5 / 9.81)
    assert fall - 1 / 240 < terms["airborne"] < fall + 10 / 240
    assert terms["distance"] < 1e-6


def test_the_airborne_fraction_is_1_without_ground():
    simulation = dataclasses.replace(experiment(3).simulation, task=Walk(torso_length=0.2))
    terms = quick_jit(lambda genes: rollout(simulation, genes))(GENES).terms
    np.testing.assert_allclose(terms["airborne"], 1.0, rtol=1e-6)
