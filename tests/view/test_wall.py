"""A wall of animals: its cells, motion, colours and captions, and the data of its page."""

import base64
import colorsys

import numpy as np
import pytest
import synthetic
from PIL import ImageColor

from creatures import box_chain
from evo_cpg.api.film import chosen_of_lines
from evo_cpg.creature.creature import Actuator
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.view.camera import project
from evo_cpg.view.captions import legend_of
from evo_cpg.view.film import Film, picture
from evo_cpg.view.meshes import body_colors, painted
from evo_cpg.view.run_page.viewer_data import WALL_RATE, wall_data
from evo_cpg.view.scene import Exhibit, Panel, sample
from evo_cpg.view.wall import colors_of_lines, hung, wall_view

ASPECT = 16 / 9
LINES = (7, 3, 7, 7, 5, 3, 7)


def wall(world: str, count: int = len(LINES)) -> Panel:
    """A wall of swimmers of two lengths, or of walkers."""
    short, motion = box_chain(5, "z", Actuator(gain=20.0)), synthetic.swim(3.0)
    part = motion._replace(position=motion.position[:, :5], rotation=motion.rotation[:, :5])
    kinds = [(synthetic.swimmer(), motion), (short, part)]
    if world == "land":
        kinds = [(synthetic.walker(), synthetic.walk(3.0))]
    colors = colors_of_lines(LINES[:count], world)
    shown = tuple(
        Exhibit(painted(kinds[i % len(kinds)][0], color), kinds[i % len(kinds)][1], color,
                10 + i, 0.9 - i / 10, LINES[i])
        for i, color in enumerate(colors)
    )  # fmt: skip
    ground = Ground() if world == "land" else None
    creature, motion = kinds[0]
    return Panel(creature, motion, "wall", world, ground, note="7 of 30", exhibits=shown)


def placed(panel: Panel):
    """Return the scene of a wall, and the places of the bodies of each animal."""
    scene = hung(panel, sample(panel.exhibits[0].recording, 10.0), ASPECT)
    ends = np.cumsum([len(one.creature.bodies) for one in panel.exhibits])[:-1]
    return scene, np.split(scene.clip.position, ends, axis=1)


@pytest.mark.parametrize("world", ["water", "land"])
def test_animals_stay_in_their_cells(world):
    scene, bodies = placed(wall(world))
    rows = 1 if world == "land" else 2
    for own, middle in zip(bodies, scene.wall.middles, strict=True):
        away = np.abs(own - middle)
        assert (away[..., 0] < scene.wall.cell[0] / 2).all()
        assert (away[..., rows] < scene.wall.cell[1] / 2).all()
    assert len(np.unique(scene.wall.middles, axis=0)) == len(LINES)


@pytest.mark.parametrize("world", ["water", "land"])
def test_animals_keep_size_and_bending(world):
    panel = wall(world)
    scene, bodies = placed(panel)
    for one, own in zip(panel.exhibits, bodies, strict=True):
        clip = sample(one.recording, 10.0)
        apart = [np.linalg.norm(x[:, :1] - x, axis=-1) for x in (own, clip.position)]
        np.testing.assert_allclose(*apart, atol=1e-9)
        if world == "land":
            np.testing.assert_allclose(own[..., 2], clip.position[..., 2], atol=1e-6)
            # The tile moves as far as the animal went.
            far = np.linalg.norm(np.diff(scene.wall.drift[[0, -1], 0], axis=0))
            assert far == pytest.approx(synthetic.PACE * 2.9, rel=0.05)


def test_lines_have_their_colours():
    colors = colors_of_lines(LINES, "water")
    assert len(set(colors)) == len(set(LINES))
    assert all(colors[i] == colors[LINES.index(line)] for i, line in enumerate(LINES))
    hues = [colorsys.rgb_to_hls(*np.array(ImageColor.getrgb(each)) / 255)[0] for each in colors]
    # The two largest lines are more than a quarter of the circle apart.
    assert 0.25 < abs(hues[0] - hues[1]) < 0.75
    assert len(set(colors_of_lines([None] * 5, "water"))) == 5
    assert legend_of(wall("water")) == [
        (colors[0], "line 7: 4 of 7"),
        (colors[1], "line 3: 2 of 7"),
    ]


def test_a_painted_animal_is_paler_in_front():
    tones = body_colors(painted(synthetic.swimmer(), "#3060c0")).sum(1)
    assert (np.diff(tones) < 0).all()


@pytest.mark.parametrize("world", ["water", "land"])
def test_every_animal_is_seen_in_its_cell(world):
    """Pixels around the middle of a cell have the hue of its animal, and captions are legible."""
    panel, size = wall(world), (480, 270)
    seen = picture([panel], Film(size)).convert("HSV")
    pixels = np.asarray(seen).astype(int)
    scene, bodies = placed(panel)
    view = wall_view(scene, ASPECT)
    half = len(scene.clip.time) // 2
    for one, own in zip(panel.exhibits, bodies, strict=True):
        places = project(view, own[half : half + 1], ASPECT)[0]
        right, up = ((places * [1, -1] + 1) / 2 * size).round().astype(int).T
        hue = colorsys.rgb_to_hsv(*np.array(ImageColor.getrgb(one.color)) / 255)[0] * 255
        off = np.abs((pixels[up, right, 0] - hue + 128) % 256 - 128)
        assert (off < 12).mean() > 0.5
    # Time and scale are in the lower left corner.
    assert np.ptp(pixels[-40:, :120, 2]) > 120


def test_the_page_has_every_animal():
    panel = wall("land")
    made = wall_data(panel, ASPECT)
    scene = hung(panel, sample(panel.recording, WALL_RATE), ASPECT)
    assert len(made["herd"]) == len(LINES) == len(made["tiles"]["middles"])
    first = made["herd"][0]
    places = np.frombuffer(base64.b64decode(made["arrays"][first["position"]]), "<f4")
    count = len(panel.creature.bodies)
    np.testing.assert_allclose(
        places.reshape(made["count"], count, 3), scene.clip.position[:, :count], atol=1e-6
    )
    assert first["words"] == f"animal 10: fitness 0.9, {count} bodies, line 7"
    assert wall_data(wall("water"), ASPECT)["water"]


@pytest.mark.parametrize(
    ("lines", "bodies", "first"),
    [
        (None, None, [4, 0, 2, 5]),
        ([1, 1, 2, 1, 1, 2], None, [4, 2, 0, 5]),
        (None, [3, 3, 3, 3, 3, 5], [4, 5, 0, 2]),
    ],
)
def test_the_fittest_of_each_kind_come_first(lines, bodies, first):
    """Individual 1 diverges, and 3 is a copy of 2."""
    fitness = np.array([0.8, -np.inf, 0.5, 0.5, 0.9, 0.3])
    lines, bodies = (None if x is None else np.array(x) for x in (lines, bodies))
    assert chosen_of_lines(fitness, lines, bodies).tolist() == first
