"""Stories: takes that dissolve, crowds of ghosts, and words."""

import itertools

import numpy as np
import pytest
import synthetic

from evo_cpg.api.story import Cast, apart, story_of
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Plane, Relief
from evo_cpg.training.crowd import CrowdMotion
from evo_cpg.view.camera import CameraPath, between, overview, project
from evo_cpg.view.captions import placed_tags, wrapped
from evo_cpg.view.lanes import course_of, in_lanes, tank_of
from evo_cpg.view.legible import font
from evo_cpg.view.look import STYLES
from evo_cpg.view.output import picture_of
from evo_cpg.view.scene import Clip, Panel, Staging, moved_aside, sample, scene_of
from evo_cpg.view.stage import bends_sideways
from evo_cpg.view.story import (
    DISSOLVE,
    FPS,
    GLIDE,
    Overview,
    StoryFrames,
    Take,
    camera_of,
    clip_of,
    spans,
)

SIZE = (192, 108)
POINTS = np.array([[-0.5, -0.5, 0.0], [1.0, 2.5, 0.6]])
WALKER, WALK = synthetic.walker(), synthetic.walk(2.0, 30.0)
PANEL = Panel(WALKER, WALK, "", world="land", ground=Ground(floor=Plane()), numbers=False)


def beside(*steps):
    """Return a crowd that walks like `WALK`, each some distance to the left, m."""
    moved = [WALK.position + np.array([0.0, step, 0.0]) for step in steps]
    turns = np.repeat(WALK.rotation[:, None], len(steps), 1)
    return CrowdMotion(WALK.time, np.stack(moved, 1), turns, np.full(3, np.nan))


def take(seconds=1.0, crowd=None, start=0.0, hold=0.0):
    seen = Overview(POINTS, 0.0, STYLES["land"].side_elevation)
    return Take(PANEL._replace(crowd=crowd), seconds, start, 1.0, [(0.0, seen)], hold)


def drawn(takes, *numbers):
    frames = StoryFrames(takes, SIZE)
    with frames.drawn() as draw:
        return [np.asarray(picture_of(draw(number), SIZE)).astype(int) for number in numbers]


def test_takes_share_the_frames_of_a_dissolve():
    found = spans([2.0, 1.0, 3.0])
    assert found[0][0] == 0 and found[-1][1] == 6 * FPS
    shared = [before[1] - after[0] for before, after in itertools.pairwise(found)]
    assert shared == [12, 12]
    assert (found[0][1] + found[1][0]) / 2 == 2 * FPS


def test_the_motion_waits_and_then_starts_gently():
    time = clip_of(take(hold=0.5), 40).time
    assert (time[:16] == 0).all()
    pace = np.diff(time) * FPS
    assert pace[16] < 0.2 and pace[-1] == pytest.approx(1.0)
    np.testing.assert_allclose(clip_of(take(start=0.4), 3).time, 0.4 + np.arange(3) / FPS)


def test_the_motion_comes_to_rest_after_the_arrival():
    time = clip_of(take()._replace(stop=1.0), 90).time
    np.testing.assert_allclose(time[:31], np.arange(31) / FPS)
    pace = np.diff(time)[30:] * FPS
    assert pace[0] > 0.8 and (np.diff(pace) < 0).all() and pace[-1] < 0.01
    assert time[-1] == pytest.approx(1.0 + GLIDE, abs=0.01)


@pytest.mark.parametrize("aspect", [16 / 9, 9 / 16])
def test_an_overview_shows_all_points_and_uses_the_picture(aspect):
    points = np.random.default_rng(0).uniform(-1, 1, (40, 3)) * [4, 2, 0.5]
    path = overview(points, 0.4, 0.3, aspect)
    seen = project(path, points[None], aspect)
    assert np.abs(seen).max() < 1
    assert max(np.ptp(seen[0], axis=0) / 2) > 0.8
    # The animals go to the right.
    ahead = np.array([[[0, 0, 0], [np.cos(0.4), np.sin(0.4), 0]]], float)
    start, end = project(path, ahead, aspect)[0]
    along = (end - start) * [aspect, 1]
    assert along[0] > abs(along[1])


def test_ghosts_are_drawn_in_their_places():
    alone, crowded = drawn([take()], 10)[0], drawn([take(crowd=beside(1.0, 2.0))], 10)[0]
    changed = np.abs(crowded - alone).max(-1) > 12
    elevation = STYLES["land"].side_elevation
    path = overview(POINTS, 0.0, elevation, SIZE[0] / SIZE[1])
    clip = sample(WALK, FPS)
    for step, seen in ((0.0, False), (1.0, True), (2.0, True)):
        trunk = clip.position[10, 0] + [0.0, step, 0.0]
        across, up = project(path, trunk[None, None], SIZE[0] / SIZE[1])[0, 0]
        column, row = round((across + 1) / 2 * SIZE[0]), round((1 - up) / 2 * SIZE[1])
        assert changed[row, column] == seen, step


def test_a_take_dissolves_into_the_next():
    ends = [take(), take(crowd=beside(1.0))]
    (first, _), (_, second) = spans([1.0, 1.0])[0], spans([1.0, 1.0])[1]
    before, middle, after = drawn(ends, first + 20, 30, second - 20)
    assert np.abs(after - before).max() > 40
    assert np.abs(middle - before).max() > 4 and np.abs(middle - after).max() > 4


def test_a_long_title_is_broken_between_words():
    lines = wrapped("Nobody taught it to swim.", 40, 300)
    assert " ".join(lines) == "Nobody taught it to swim." and len(lines) > 1
    assert all(font(40).getlength(line) <= 300 for line in lines)
    assert wrapped("swim", 400, 30) == ["swim"]


def test_a_moving_camera_scales_the_picture_about_a_point():
    """Two cameras with one line of sight, of which one is four times as far away."""
    eye = np.array([[0.0, -4.0, 1.0]])
    near = CameraPath(eye, np.zeros((1, 3)), 32.0)
    far = CameraPath(4 * eye + [3.0, 0.0, 0.0], np.array([[3.0, 0.0, 0.0]]), 32.0)
    path = between(near, far, np.array([0.0, 0.5, 1.0]))
    away = np.linalg.norm(path.position - path.focus, axis=1)
    np.testing.assert_allclose(away / away[0], [1.0, 2.0, 4.0])
    fixed = np.array([-1.0, 0.0, 0.0])
    seen = project(path, np.tile(fixed, (3, 1, 1)), 1.0)
    np.testing.assert_allclose(seen, seen[:1].repeat(3, 0), atol=1e-9)


def test_the_finish_is_the_last_line_that_the_champion_passes():
    course = course_of(PANEL, 0.5, forward=True)
    progress = WALK.position[:, 0, 0] - WALK.position[0, 0, 0]
    assert course.finish is not None and course.target is not None
    distance, instant = course.finish, course.arrival
    assert instant is not None
    assert distance / course.spacing == pytest.approx(round(distance / course.spacing))
    assert (
        distance <= progress[WALK.time <= WALK.time[-1] - GLIDE].max() < distance + course.spacing
    )
    assert np.interp(instant, WALK.time, progress) >= distance
    np.testing.assert_allclose(course.target, WALK.position[0, 0] + [distance, 0, 0])


def test_the_champion_arrives_when_a_body_touches_the_light():
    """The trunk is 0.6 m long, and the light 0.4 m ahead of it."""
    light = WALK.position[0, 0] + np.array([0.7, 0.0, 0.0])
    lit = PANEL._replace(recording=synthetic.with_light(WALK, light))
    arrival = course_of(lit, 0.5, forward=False).arrival
    assert arrival is not None
    progress = np.interp(arrival, WALK.time, WALK.position[:, 0, 0] - WALK.position[0, 0, 0])
    assert progress == pytest.approx(0.4, abs=0.04)
    beside_it = synthetic.with_light(WALK, light + np.array([0.0, 0.4, 0.0]))
    assert course_of(PANEL._replace(recording=beside_it), 0.5, forward=False).arrival is None


def test_a_light_is_the_goal_and_has_no_finish():
    lit = PANEL._replace(recording=synthetic.with_light(WALK, np.array([1.0, 1.0, 0.2])))
    course = course_of(lit, 0.5, forward=False)
    assert course.finish is None and course.bearing == pytest.approx(np.pi / 4, abs=0.05)
    tank = tank_of(lit, course, [], 1.0)
    assert tank.near and tank.track is None
    far = lit._replace(recording=synthetic.with_light(WALK, np.array([90.0, 90.0, 0.2])))
    tank = tank_of(far, course_of(far, 0.5, forward=False), [], 1.0)
    assert not tank.near and tank.track is not None


@pytest.mark.parametrize("aspect", [16 / 9, 9 / 16])
def test_no_lane_is_closer_to_the_next_than_the_animal_is_wide(aspect):
    tank = tank_of(PANEL, course_of(PANEL, 0.5, forward=True), [], 1.0)
    lanes = tank.staging(tank.others).lanes
    corners = tank.course.corners
    assert tank.others >= 3
    assert np.diff(lanes[:, 1], prepend=0.0).min() > np.ptp(corners[:, 1])
    # All animals are in the view, at their start.
    every = (corners + np.concatenate([np.zeros((1, 3)), lanes])[:, None]).reshape(1, -1, 3)
    wide = tank.wide
    path = overview(wide.points, wide.bearing, wide.elevation, aspect)
    assert np.abs(project(path, every, aspect)).max() < 1


def test_animals_of_all_ranks_are_in_the_lanes():
    crowd = beside(*range(9))
    order = [4, 0, 7, 2, 8, 1, 6, 3, 5]
    crowd.position[-1, :, :, 0] = crowd.position[0, :, :, 0] + 0.1 * np.array(order)[:, None]
    first, others = in_lanes(crowd, 0, "forward", 4)
    np.testing.assert_array_equal(first.position, crowd.position[:, 0])
    # Of the eight others, the second, fourth, sixth and last by progress, in their own order.
    far = (others.position[-1, :, 0, 0] - others.position[0, :, 0, 0]) / 0.1
    np.testing.assert_allclose(far, [0, 7, 2, 5], atol=1e-5)


def test_a_story_has_crowds_a_race_and_an_arrival():
    crowds = [(number, beside(*range(5))) for number in (0, 2, 7)]
    course = course_of(PANEL, 0.5, forward=True)
    aim = "Its task: get as far as it can."
    racers = [(number, WALK) for number in (0, 7)]
    material = Cast(PANEL, 20, "forward", aim, course, 1.0, True, True, crowds, racers)
    takes, words = story_of(material, None, 16 / 9)
    assert sum(take.seconds for take in takes) == pytest.approx(15.0)
    assert len(takes) == 6
    keys = ["walk", aim, "first", "best", "2 ", "7 ", "0, 7 and 20", "slow", f"{course.finish:g} m"]
    assert all(key in each.text for key, each in zip(keys, words, strict=True))
    # Only takes of equal length show progress.
    assert len({(take.seconds, take.speed, take.start) for take in takes[1:4]}) == 1
    # The first frame shows motion, and so does the last one.
    for still in (takes[0], takes[-1]):
        assert (np.diff(clip_of(still, round(still.seconds * FPS)).time) > 0).all()
    race, arrival = takes[4:]
    staging = race.panel.staging
    assert staging is not None and staging.names == ("20", "0", "7")
    # The winner is at the goal before the next take appears, and the words come after it.
    ended = clip_of(race, round((race.hold + race.seconds - DISSOLVE) * FPS)).time[-1]
    assert course.arrival is not None and ended >= course.arrival
    slow = clip_of(arrival, round((arrival.seconds + DISSOLVE / 2) * FPS)).time
    there = 15.0 - arrival.seconds - DISSOLVE / 2 + (slow < course.arrival).sum() / FPS
    assert there <= words[-1].start <= there + 0.5
    # No word appears before the one at the same place has gone.
    captions = [each for each in words if each.kind == "caption"]
    assert all(one.end <= two.start for one, two in itertools.pairwise(captions))
    assert captions[0].start >= words[0].end


def test_walkers_in_lanes_follow_the_ground_and_swimmers_keep_their_height():
    """The ground rises to the left. The second animal is high above it, in water."""
    slope = Ground(floor=Relief(np.array([[0.0, 1.0], [0.0, 1.0]]), spacing=2.0))
    place = np.array([[[0.5, 0.2, 0.15]], [[0.5, 0.2, 1.5]]])
    lanes = np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    moved = moved_aside(place, lanes, slope, 0.5)
    np.testing.assert_allclose(moved[:, 0], [[0.5, 1.2, 0.65], [0.5, 1.2, 1.5]], atol=1e-6)


def test_only_a_swimmer_that_bends_sideways_is_seen_from_above():
    count, along = 60, np.linspace(0, 1, 8)
    time = np.arange(count)[:, None] / FPS
    position = np.zeros((count, 8, 3))
    position[..., 0] = time - along
    wave = 0.1 * np.sin(6 * (time + along))
    turns = np.broadcast_to(np.eye(3), (count, 8, 3, 3))
    for axis, sideways in ((1, True), (2, False)):
        bent = position.copy()
        bent[..., axis] = wave
        still = np.full((count, 3), np.nan)
        clip = Clip(time[:, 0], bent, turns, np.zeros(count), still, np.zeros(count), FPS)
        assert bends_sideways(clip) == sideways


def test_the_leader_of_a_crowd_is_ahead():
    crowd = beside(0.0, 1.0, 2.0)
    crowd.position[-1, 1, :, 0] += 0.5
    assert crowd.advance(0, "forward").argmax() == 1
    towards = crowd._replace(goal=np.array([1.0, 2.0, 0.5]))
    assert towards.advance(0, "any").argmax() == 2
    own = crowd.recording(1, 0)
    np.testing.assert_allclose(own.distance[0], 0)
    np.testing.assert_array_equal(own.position, crowd.position[:, 1])


@pytest.mark.parametrize(
    ("progress", "chosen"),
    [
        ([0.0, 1.0, 2.0], [0, 1, 2]),
        # Animals that are no better than an earlier one are left out.
        ([0.0, 0.2, 1.5, 1.4, 2.0], [0, 2, 4]),
        ([3.0, 2.5, 2.0], [2]),
        # Of many, those at even distances stay.
        ([0.0, 1.0, 2.0, 5.0, 6.0, 9.0], [0, 2, 4, 5]),
    ],
)
def test_racers_are_clearly_apart(progress, chosen):
    assert apart(np.array(progress), 0.5, 4) == chosen


def staged(others, names):
    """Return the scene and the camera of some animals beside the first one."""
    crowd = beside(*others)
    lanes = np.zeros((len(others), 3))
    seen = PANEL._replace(crowd=crowd, staging=Staging(lanes, names=names))
    shot = take()._replace(panel=seen)
    scene = scene_of(seen, clip_of(shot, 30))
    return camera_of(shot, scene, SIZE[0] / SIZE[1]), scene


def test_no_word_crosses_another():
    camera, scene = staged((0.05, 0.1, 0.15), ("100", "0", "2", "7"))
    tags = placed_tags(camera, scene, SIZE)
    assert tags[0].opacity.max() == 1.0
    for one, two in itertools.combinations(tags, 2):
        close = (np.abs(one.middle - two.middle) < one.half + two.half).all(-1)
        assert not (close & (one.opacity > 0) & (two.opacity > 0)).any()


def test_names_of_animals_behind_the_camera_are_hidden():
    camera, scene = staged((0.05, 0.1), ("100", "0", "2"))
    away = camera._replace(focus=2 * camera.position - camera.focus)
    assert all((tag.opacity == 0).all() for tag in placed_tags(away, scene, SIZE))


def test_all_lights_of_a_champion_are_in_one_view():
    """The light stands at two places, one after the other. A light at rest has no such view."""
    places = np.array([[2.0, 3.0, 0.2], [-4.0, 1.0, 0.2]])
    late = WALK.time > WALK.time.mean()
    moved = synthetic.with_light(WALK, places[0])._replace(light=places[late.astype(int)])
    tank = tank_of(PANEL, course_of(PANEL, 0.5, forward=True), [], 1.0)
    assert tank.whole(synthetic.with_light(WALK, places[0]), 0.0, 9.0) is None
    view = tank.whole(moved, 0.0, 9.0)
    assert view is not None
    path = overview(view.points, view.bearing, view.elevation, 16 / 9)
    assert np.abs(project(path, places[None], 16 / 9)).max() < 1
