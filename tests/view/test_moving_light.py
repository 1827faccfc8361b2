"""Lights that move or jump in films, plots, pages and scenes."""

import base64

import numpy as np
import pytest
import synthetic

from evo_cpg.simulation.recording import appearances
from evo_cpg.training.crowd import CrowdMotion
from evo_cpg.view.camera import in_camera, project
from evo_cpg.view.captions import edge_places
from evo_cpg.view.gltf_film import gltf_film
from evo_cpg.view.offscreen import canvas
from evo_cpg.view.plots import path_figure
from evo_cpg.view.run_page.viewer_data import viewer_data
from evo_cpg.view.scene import Panel, sample, scene_of
from evo_cpg.view.scenery import add_goal_light
from evo_cpg.view.stage import Stage, camera_path

CREATURE, SWIM = synthetic.swimmer(), synthetic.swim(9.0)
TIME = SWIM.time
# A light that circles, one that flees twice for a second, and three lights in a row.
CIRCLE = np.stack([9 * np.cos(TIME), 9 * np.sin(TIME), 0 * TIME], 1)
FLEES = np.clip(TIME - 2, 0, 1)[:, None] + np.clip(TIME - 5, 0, 1)[:, None] * [0.0, 1.0, 0.0]
THREE = np.array([[2.0, 1.0, 0.0], [4.0, 0.0, 0.0], [8.0, 4.0, 0.0]])[(TIME // 3).astype(int)]


def scene_with(light, fps=30):
    panel = Panel(CREATURE, SWIM._replace(light=light))
    scene = scene_of(panel, sample(panel.recording, fps))
    return panel, scene, camera_path(scene, "follow", 16 / 9)


@pytest.mark.parametrize(
    ("light", "found"),
    [(CIRCLE, [0]), (FLEES, [0]), (THREE, [0, 180, 360]), (SWIM.light, [0]), (np.nan * THREE, [])],
)
def test_only_lights_that_jump_appear_again(light, found):
    assert appearances(light).tolist() == found


def test_no_frame_shows_a_light_between_two():
    _, scene, _ = scene_with(THREE, fps=47)
    assert len(np.unique(scene.goal, axis=0)) == 3
    _, scene, _ = scene_with(CIRCLE, fps=47)
    np.testing.assert_allclose(scene.goal[:, 0], 9 * np.cos(scene.clip.time), atol=1e-3)


def test_the_drawn_light_is_at_its_place():
    _, scene, camera = scene_with(THREE)
    with canvas((64, 36)) as plotter:
        stage = Stage(plotter, scene, camera)
        update = add_goal_light(stage, scene.goal)
        reached = [*plotter.actors.values()][-2:]
        for number in (0, 100, 200):
            update(stage.shot(number))
            assert plotter.renderer.lights[-1].position == pytest.approx(scene.goal[number])
            assert sum(actor.visibility for actor in reached) == number // 100


@pytest.mark.parametrize("light", [CIRCLE, THREE])
def test_the_light_or_its_arrow_is_in_view(light):
    _, scene, camera = scene_with(light)
    tips, goal = edge_places(camera, scene.goal, 16 / 9), scene.goal[:, None]
    hidden = np.isfinite(tips).all(-1)
    assert hidden.any()
    assert np.abs(project(camera, goal, 16 / 9)[~hidden]).max() < 1
    across, _, _ = in_camera(camera, goal)[hidden, 0].T
    assert (np.sign(tips[hidden, 0]) == np.sign(across)).all()


def test_a_path_shows_how_its_lights_move():
    above = path_figure(SWIM._replace(light=THREE), 0).axes[0]
    assert [text.get_text() for text in above.texts] == ["1", "2", "3"]
    above = path_figure(SWIM._replace(light=CIRCLE), 0).axes[0]
    drawn = [line.get_xydata() for line in above.lines]
    assert any(len(line) == len(TIME) and np.allclose(line, CIRCLE[:, :2]) for line in drawn)
    assert "light at the end" in [text.get_text() for text in above.get_legend().get_texts()]


@pytest.mark.slow
def test_pages_and_scenes_move_the_light():
    panel, scene, _ = scene_with(CIRCLE)
    made = viewer_data(panel)
    light = np.frombuffer(base64.b64decode(made["arrays"][made["light"]]), "<f4").reshape(-1, 3)
    np.testing.assert_allclose(light, scene.goal, atol=1e-5)
    made, still = gltf_film(panel), gltf_film(Panel(CREATURE, SWIM))
    assert made.count(b'"path":"translation"') == still.count(b'"path":"translation"') + 1


def test_a_crowd_advances_towards_lights_that_move():
    """The first animal stands, and the second one follows its light at a distance of 1 m."""
    line = TIME[:, None] * [1.0, 0.0, 0.0]
    place, light = np.zeros((len(TIME), 2, 1, 3)), np.repeat(line[:, None] + [1.0, 0, 0], 2, 1)
    place[:, 1, 0] = line
    rotation = np.broadcast_to(np.eye(3), (*place.shape, 3))
    crowd = CrowdMotion(TIME, place, rotation, light[0, 0], light)
    np.testing.assert_allclose(crowd.advance(0, "any"), [0.0, TIME[-1]], atol=1e-9)
    np.testing.assert_allclose(crowd.recording(1, 0).distance, 1.0)
