"""Lights that move, and numbers that are drawn for each trial."""

import dataclasses
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.analysis.laboratory.courses import course_keys, held_out
from evo_cpg.analysis.laboratory.settings import LabError
from evo_cpg.api.advice import about_courses
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import dump_config
from evo_cpg.simulation.courses import Follow, Waypoints
from evo_cpg.simulation.judge import Outcome
from evo_cpg.simulation.noise import raw_keys
from evo_cpg.simulation.task import CourseStart
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.experiment import FIRST_ROUND, judge, trial_keys
from tiny_run import CONFIG, SMALL

STEP = 0.1
COUNT = 500
ZERO = jnp.zeros((3, COUNT))
START = CourseStart(
    ZERO, ZERO.at[0].set(1.0), raw_keys(jax.random.split(jax.random.key(0), COUNT))[2:]
)
ROW = Waypoints(
    light=(1.0, 0.0, 0.0), lights=4, spacing=2.0, turn=np.deg2rad(120), radius=0.5, enough=3
)
LEADER = dict(
    light=(1.0, 0.0, 0.0), speed=0.5, every=0.5, turn=np.pi / 2, radius=1.0, settle_seconds=0.2
)


def at(*places):
    """Return a view of an animal whose root is at a place."""
    place = jnp.asarray(places, float).T if len(places) > 1 else jnp.asarray(places[0], float)
    return types.SimpleNamespace(state=types.SimpleNamespace(position=place), control_step=STEP)


def turns_of(paths):
    legs = np.diff(paths, axis=1)
    heading = np.unwrap(np.arctan2(legs[1], legs[0]), axis=0)
    return np.rad2deg((np.diff(heading, axis=0) + np.pi) % (2 * np.pi) - np.pi)


def test_waypoints_have_their_spacing_and_uniform_turns():
    lights = np.asarray(ROW.begin_course(START).lights)
    assert lights.shape == (3, 4, COUNT) and not lights[2].any()
    # The first leg begins at the start, and its turn counts from straight ahead.
    behind = np.zeros((3, 2, COUNT))
    behind[0, 0] = -2.0
    behind = np.concatenate([behind, lights], axis=1)
    lengths = np.linalg.norm(np.diff(behind, axis=1), axis=0)
    np.testing.assert_allclose(lengths, 2.0, rtol=1e-4)
    turns = turns_of(behind)
    assert np.abs(turns).max() <= 120.01
    # The standard deviation of uniform turns, to four times its error of 1 %.
    assert turns.std() == pytest.approx(120 / np.sqrt(3), rel=0.04) and abs(turns.mean()) < 6


def test_an_arena_holds_all_lights_evenly():
    lights = np.asarray(dataclasses.replace(ROW, arena=3.0).begin_course(START).lights)[:2]
    assert np.abs(lights).max() <= 1.5
    assert lights.std() == pytest.approx(3 / np.sqrt(12), rel=0.03)


def test_the_next_light_appears_when_one_is_reached():
    alone = CourseStart(*(x[:, 0] for x in START))
    course, seen = ROW.begin_course(alone), []
    for k in range(6):
        seen.append(np.asarray(ROW.place_light(course)))
        course = ROW.advance_course(course, at(seen[-1] + [0.4, 0, 0]), jnp.int32(k))
    lights = np.asarray(course.lights).T
    np.testing.assert_allclose(seen, lights[[0, 1, 2, 3, 3, 3]])
    assert course.count == 4
    away = ROW.advance_course(ROW.begin_course(alone), at(lights[0] + [0.6, 0, 0]), jnp.int32(0))
    assert away.count == 0


@pytest.mark.parametrize(
    ("reached", "left", "fitness", "success"),
    [(0, 1.0, 0.0, 0), (2, 0.25, 2.75, 0), (3, 9.0, 2.5, 1), (4, 0.1, 4.0, 1)],
)
def test_waypoints_score_lights_and_the_last_leg(reached, left, fitness, success):
    terms = ROW.terms((jnp.float32(reached), jnp.float32(left)), 10)
    assert float(ROW.fitness(terms, {})) == pytest.approx(fitness)
    assert float(terms["success"]) == success


def followed(task, places):
    """Return the places of the light while the animal is at some places."""
    course, lights = task.begin_course(START), []
    for k, place in enumerate(places):
        lights.append(np.asarray(task.place_light(course)))
        course = task.advance_course(
            course, at(np.tile(np.array(place)[:, None], COUNT)), jnp.int32(k)
        )
    return np.stack(lights, 1)


def test_a_light_turns_by_at_least_its_least_turn():
    path = followed(Follow(**LEADER, legs=4), np.zeros((20, 3)))
    speeds = np.linalg.norm(np.diff(path, axis=1), axis=0) / STEP
    np.testing.assert_allclose(speeds, 0.5, rtol=1e-4)
    turns = np.abs(turns_of(path))
    corner = turns > 1
    assert turns[corner].min() > 89.9 and (corner.sum(0) == 3).all()


def test_a_fleeing_light_runs_straight_away_from_a_near_animal():
    task = Follow(**LEADER, legs=0, flees=1.2)
    path = followed(task, [[-3, 0, 0], [0.4, 0.8, 5.0], [0.4, 0.8, 0.0], [-3, 0, 0]])[:, :, 0].T
    np.testing.assert_allclose(path[:2], [[1, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(path[2], [1 + 0.05 * 0.6, -0.05 * 0.8, 0], atol=1e-6)
    assert not task.draws_course


def test_only_time_near_the_light_counts():
    task = Follow(**LEADER, legs=0)
    none = jnp.zeros(())
    tally, course = (
        task.begin((), jnp.dtype("float32"), 4),
        task.begin_course(CourseStart(none + jnp.zeros(3), jnp.zeros(3), None)),
    )
    for k, far in enumerate([50.0, 50.0, 0.5, 2.0]):
        step = types.SimpleNamespace(
            step=k, course=course, after=at([far, 0, 0]), before=at([0.0, 0, 0])
        )
        tally = task.update(tally, step, 4)
    terms = {name: float(x) for name, x in task.terms(tally, 4).items()}
    assert terms == pytest.approx({"distance": 1.25, "farthest": 2.0, "near": 0.5, "success": 0.0})


def test_the_worst_trial_or_a_quantile_can_count():
    values = np.array([[3.0, 1.0, 2.0, 9.0, 5.0], [1.0, 2.0, -np.inf, 4.0, 5.0]], np.float32)
    task = types.SimpleNamespace(fitness=lambda terms, scales: terms["x"])
    outcome = Outcome({"x": jnp.asarray(values)}, jnp.isfinite(values))
    for quantile, right in ((0.0, [1, -np.inf]), (0.5, [3, 2]), (0.3, [2, 1]), (1.0, [9, 5])):
        assert judge(task, outcome, {}, quantile)[0].tolist() == right
    assert judge(task, outcome, {})[0].tolist() == [4.0, -np.inf]


ROAM = SMALL | {
    "task": {"type": "waypoints", "spacing": 0.2, "radius": 0.15, "lights": 3},
    "simulation.trials": 2,
    "evolution.population": 8,
    "evolution.elites": 2,
}


@pytest.mark.parametrize(("every", "epochs"), [(1, [0, 1, 2]), (2, [0, 0, 2]), (None, [0, 0, 0])])
def test_individuals_share_courses_that_change_every_few_generations(every, epochs):
    parts = evo.load(CONFIG, ROAM | {"courses.every": every}).parts
    run, individual, trial = np.zeros(4, int), np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
    keys = [np.asarray(trial_keys(parts, k, run, individual, trial))[2:] for k in range(3)]
    for own, first in zip(keys, epochs, strict=True):
        np.testing.assert_array_equal(own[:, :2], own[:, 2:])
        assert (own[:, 0] != own[:, 1]).any()
        np.testing.assert_array_equal(own, keys[first])
    fresh = np.asarray(trial_keys(parts, FIRST_ROUND, run, individual, trial))[2:]
    assert len(np.unique(fresh, axis=1).T) == 4


def test_the_recorded_light_moves_and_eyes_follow_it():
    # Each light is reached as soon as it appears.
    made = evo.load(CONFIG, ROAM | {"task.spacing": 2, "task.turn_deg": 60, "task.radius": 30})
    record = made.record(0, made.random_genomes(0, 1)[0])
    recording, light = record.recording, record.recording.light
    away = np.linalg.norm(recording.position[:, 0] - light, axis=1)
    np.testing.assert_allclose(recording.distance, away, atol=1e-5)
    moved = np.flatnonzero(np.diff(light, axis=0).any(1))
    assert moved.tolist() == [0, 1]
    seen = np.stack([record[name] for name in record if name.startswith("sense.light")])
    steps = np.abs(np.diff(seen, axis=1)).max(0)
    assert steps[:2].min() > 10 * steps[2:].max()


DRAWN = SMALL | {
    "courses.draw": {"world.water.current.*": [-0.3, 0.3], "task.light.bearing_deg": [-90, 90]},
    "simulation.trials": 3,
}


def test_a_drawn_trial_equals_one_with_its_numbers():
    made = evo.load(CONFIG, DRAWN)
    genes = made.random_genomes(0, 2)
    found = made.rollout(1, genes)
    keys = made._noise(jax.random.key(1), 2)
    draws = made.parts.simulation.draws
    for i in (0, 1, 2):
        numbers = draws.course(np.asarray(keys)[2:, i])
        assert len(numbers) == 4
        alone = evo.load(CONFIG, SMALL).with_numbers(numbers).rollout(0, genes[:1])
        for name, values in found.terms.items():
            assert values[0, i] == pytest.approx(alone.terms[name][0, 0], rel=2e-4, abs=1e-5)


@pytest.mark.slow
def test_a_distant_drawn_block_leaves_the_start_alone():
    """The start height then differs between courses only by rounding, so it is no drawn number."""
    wall = {"type": "block", "centre": [2.5, 0, 0], "size": [0.4, 2.4, 4]}
    ground = {"floor": {"type": "plane", "height": -0.51}, "obstacles": [wall]}
    changes = {"world.ground": ground, "simulation.start_clearance": 0.5}
    drawn = {"courses.draw": {"world.ground.obstacles.0.heading_deg": [-20, 20]}}
    simulation = evo.load(
        CONFIG, SMALL | changes | drawn | {"simulation.trials": 2}
    ).parts.simulation
    keys = np.random.default_rng(0).integers(2**32, size=(2, 50), dtype=np.uint32)
    assert all(np.isfinite(values).all() for values in simulation.draws.values(keys))


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        ({"world.water.currant.0": [0, 1]}, "world.water.current"),
        ({"world.water.current.0": [1, 0]}, "must rise"),
        ({"controller.rate_gain": [1, 2]}, "cannot differ"),
        ({"world.water.density": [-5, 5]}, "greater than 0"),
        ({"world.water.current.*": [0, 1], "world.water.current.0": [0, 1]}, "two ranges"),
    ],
)
def test_wrong_draws_are_refused_with_their_key(draw, words):
    with pytest.raises(ConfigError, match=words):
        evo.load(CONFIG, SMALL | {"courses.draw": draw})


FUKUI = CONFIG.parent / "fukui2003_model1.yaml"


@pytest.mark.slow
def test_numbers_that_decide_the_form_are_refused():
    with pytest.raises(ConfigError, match=r"cannot be drawn: world\.ground\.floor\.slope_deg"):
        evo.load(FUKUI, {"courses.draw": {"world.ground.floor.slope_deg": [0, 5]}})


@pytest.mark.slow
def test_refused_courses_are_counted_in_a_warning():
    """A block that begins near the quadruped decides which foot touches first."""
    block = {"type": "block", "centre": [1.0, 0, 0], "size": [0.5, 0.5, 1]}
    changes = {"world.ground": {"floor": {"type": "plane"}, "obstacles": [block]}}
    key = "world.ground.obstacles.0.centre.0"
    for ends, refused in (((0.1, 1), True), ((2, 3), False)):
        made = evo.load(FUKUI, changes | {"simulation.trials": 2, "courses.draw": {key: ends}})
        found = about_courses(made.parts.simulation)
        assert found.startswith("courses.draw: ") == refused


@pytest.mark.slow
def test_the_laboratory_silences_each_sense_on_held_out_courses():
    made = evo.load(CONFIG, ROAM | {"simulation.seconds": 6})
    parts, genes = made.parts, made.random_genomes(0, 1)[0]
    champion = Champion(np.asarray(genes), 0.0, 0, {}, {}, 0, 0)
    settings, rows = held_out(parts, "brain_cpg", champion, {}, 5)
    names = [setting["silence"] for setting in settings]
    assert names[0] == "none" and "light" in names and settings[-1]["cut"] != "none"
    keys = course_keys(parts, 5)
    assert len(np.unique(keys, axis=1).T) == 5
    own = made._run_trials(np.asarray(genes, np.float32)[:, None], keys, None, 5)
    assert rows[0]["left"] == pytest.approx(float(np.mean(own.terms["left"])), rel=1e-4)
    # The pair hardly moves, so what is left of the way differs little from 1.
    progress = [1 - rows[names.index(name)]["left"] for name in ("none", "all")]
    assert progress[0] != pytest.approx(progress[1], rel=0.02)
    with pytest.raises(LabError, match="random"):
        held_out(evo.load(CONFIG, SMALL).parts, "brain_cpg", champion, {}, 5)


def test_an_environment_draws_a_course_at_each_reset():
    environment = evo.load(CONFIG, DRAWN).environment()
    states = [environment.reset(jax.random.key(seed)) for seed in (0, 0, 1)]
    drawn = [np.concatenate([np.ravel(x) for x in state.inner.drawn]) for state in states]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert (drawn[0] != drawn[2]).any()


@pytest.mark.parametrize("settings", [ROAM, DRAWN])
def test_the_laboratory_needs_no_held_out_courses(settings, tmp_path):
    path = tmp_path / "roam.yaml"
    path.write_text(dump_config(evo.load(CONFIG, settings).config))
    answer = evo.lab(path, {"u": [0.2, 0.6], "b": [5.0]}, seconds=0.3)
    assert len(answer.rows) == 2
    light = [recording.light for recording in answer.recordings]
    np.testing.assert_array_equal(light[0][0], light[1][0])


def test_numbers_of_a_run_that_draws_them_are_refused():
    made = evo.load(CONFIG, DRAWN)
    density = "world.water.density"
    with pytest.raises(ValueError, match=r"courses\.draw"):
        made.rollout(0, made.random_genomes(0, 1), {density: [900.0]})
    with pytest.raises(ValueError, match=r"courses\.draw"):
        made.fitness_function(0, numbers=[density])
