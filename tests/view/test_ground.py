"""Walkers: the ground is at the height of the physics, and pictures show the contacts."""

import numpy as np
import pytest
import synthetic

from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.view.camera import project
from evo_cpg.view.look import STYLES
from evo_cpg.view.meshes import body_colors
from evo_cpg.view.preview import _apart, preview
from evo_cpg.view.scene import Panel, grid_spacing, mark_spacing, sample, scene_of
from evo_cpg.view.shadows import spot_under
from evo_cpg.view.stage import camera_path
from films import film
from pictures import contrast

SIZE = (640, 360)
INSTANT = 6.25
SHINS = slice(2, 9, 2)
UP = np.array([0.0, 0.0, 1.0])
SIDES = ("left", "right")


@pytest.fixture(scope="module")
def creature():
    return synthetic.walker()


@pytest.fixture(scope="module")
def recording():
    return synthetic.walk(8)


@pytest.fixture(scope="module")
def stills(creature, recording, tmp_path_factory):
    """A function that renders each still only once. ``without`` names a function to skip."""
    folder = tmp_path_factory.mktemp("stills")
    painted = {}

    def still(motion=recording, without="", **settings):
        settings = {"world": "land", "ground": Ground(), "title": "", "seconds": INSTANT} | settings
        key = motion.position.tobytes(), without, repr(settings)
        if key not in painted:
            path = folder / "still.png"
            with pytest.MonkeyPatch.context() as patch:
                if without:
                    patch.setattr(f"evo_cpg.view.drawing.{without}", lambda *_: lambda *_: None)
                film(creature, motion, path, size=SIZE, **settings)
            painted[key] = synthetic.read(path)
        return painted[key]

    return still


def camera(creature, recording):
    clip = sample(recording, 30)
    scene = scene_of(Panel(creature, recording, world="land", ground=Ground()), clip)
    return clip, camera_path(scene, "follow", SIZE[0] / SIZE[1])


def place(creature, recording, points):
    """Columns and rows ``(n, 2)`` of points of the world ``(n, 3)`` in the still."""
    clip, path = camera(creature, recording)
    frame = int(np.abs(clip.time - INSTANT).argmin())
    every = np.repeat(np.asarray(points, float)[None], len(clip.time), 0)
    x, y = project(path, every, SIZE[0] / SIZE[1])[frame].T
    return np.column_stack([SIZE[0] * (1 + x) / 2, SIZE[1] * (1 - y) / 2])


def brightness(image, spots):
    columns, rows = np.rint(spots - 0.5).astype(int).T
    return image[rows, columns].mean(-1)


@pytest.mark.parametrize("height", [0.0, 0.3])
def test_the_ground_is_at_the_height_of_the_physics(creature, recording, stills, height):
    """The strong line 3 m from the start is at the height of the plane."""
    raised = recording._replace(position=recording.position + height * UP)
    image = stills(raised, ground=Ground(floor=Plane(height=height)))
    along = np.linspace(-0.85, -0.35, 10)
    line = np.column_stack([0 * along + 3, along, 0 * along + height])
    here = brightness(image, place(creature, raised, line))
    for offset in ([0.07, 0, 0], [-0.07, 0, 0]):
        next_to_it = brightness(image, place(creature, raised, line + offset))
        assert (next_to_it - here).mean() > 25
    # A plane 5 cm higher is distinguishable.
    above = brightness(image, place(creature, raised, line + 0.05 * UP))
    assert (above - here).mean() > 20


def blue(image):
    return int((image[..., 2] - image[..., 0] > 60)[image.shape[0] // 3 :].sum())


@pytest.mark.slow
def test_the_ground_hides_only_feet_below_it(recording, stills):
    standing = blue(stills())
    sunk = blue(stills(recording._replace(position=recording.position - 0.05 * UP)))
    hovering = blue(stills(recording._replace(position=recording.position + 0.05 * UP)))
    # Two shins rest, one of them nearly hidden behind a third. They lose 5 of their 24 cm.
    assert sunk < 0.94 * standing
    assert hovering == pytest.approx(standing, rel=0.05)


def test_a_spot_pales_as_the_foot_lifts():
    sole = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]]) * synthetic.FOOT
    gaps = (0.0, 0.02, 0.06)
    spots = [spot_under(sole, np.full(4, gap), synthetic.FOOT) for gap in gaps]
    assert all(np.allclose(middle, 0) for middle, _, _ in spots)
    assert spots[0][2] == 1.0 > 1.8 * spots[1][2] > 3 * spots[2][2] > 0


def test_the_sun_shadow_darkens_the_ground_once(stills):
    """Overlapping shadows of two bodies are no darker than one shadow."""
    look = STYLES["land"]
    bare, shaded = stills(without="add_sun_shadows"), stills()
    changed = (bare - shaded).sum(-1) > 60
    assert changed.mean() > 0.01
    black = np.array([int(look.shadow[i : i + 2], 16) for i in (1, 3, 5)])
    fraction = ((bare - shaded).sum(-1) / (bare - black).sum(-1))[changed]
    assert np.median(fraction) == pytest.approx(look.cast_strength, abs=0.03)
    assert np.quantile(fraction, 0.98) < look.cast_strength + 0.06


@pytest.mark.slow
@pytest.mark.parametrize("world", list(STYLES))
def test_captions_contrast_with_their_background(world, stills):
    assert contrast(stills(world=world)[300:], STYLES[world].text) > 4.5


def test_left_and_right_legs_differ(creature):
    colors = body_colors(creature)
    names = [body.name for body in creature.bodies]
    for name in ("front", "hind"):
        for part in ("thigh", "shin"):
            left, right = (colors[names.index(f"{name}_{side}_{part}")] for side in SIDES)
            assert left.sum() < 0.8 * right.sum()
    # Bodies in the middle keep their colour.
    assert np.allclose(body_colors(synthetic.swimmer())[0], colors[0])


@pytest.mark.parametrize("course", [0.0, 2.3])
def test_the_camera_sees_a_walker_from_the_side_and_does_not_sway(creature, course):
    motion = synthetic.walk(8, course=course)
    clip, path = camera(creature, motion)
    spots = project(path, clip.position, SIZE[0] / SIZE[1])
    assert np.abs(spots).max() < 0.8
    # The animal keeps its place in the picture, and crosses the world to the right.
    trunk = spots[:, 0]
    assert np.ptp(trunk, axis=0).max() < 0.05
    start = project(path, np.repeat(clip.position[:1, :1], len(spots), 0), SIZE[0] / SIZE[1])
    assert start[-1, 0, 0] < start[0, 0, 0] - 1
    speed = np.linalg.norm(np.diff(path.focus, axis=0), axis=1) * 30
    assert np.allclose(speed, synthetic.PACE, rtol=0.05)
    # Low enough to see under the trunk, and above the ground.
    slant = path.position[0] - path.focus[0]
    assert 8 < np.degrees(np.arctan2(slant[2], np.hypot(*slant[:2]))) < 15


@pytest.mark.slow
def test_the_pattern_stays_where_the_animal_started(recording, stills):
    """Moved and turned in the world, an animal without a light gives the same picture."""
    shift = np.array([3.3, -1.7, 0.0])
    elsewhere = synthetic.walk(8, course=1.1)
    elsewhere = elsewhere._replace(position=elsewhere.position + shift)
    assert np.abs(stills() - stills(elsewhere)).mean() < 1.5
    # One step later, in the same pose, the ground below has moved in the picture.
    later = stills(seconds=INSTANT + 1 / synthetic.STEP_RATE)
    assert np.abs(stills() - later)[200:].mean() > 5


@pytest.mark.slow
def test_without_ground_the_floor_is_below_the_path(creature, recording, stills):
    """The floor has no numbers and is far below the animal, so it does not look like ground."""
    deep = recording._replace(position=recording.position - 40 * UP)
    assert np.abs(stills(ground=None) - stills(deep, ground=None)).mean() < 1.0
    assert np.abs(stills(ground=None) - stills()).mean() > 5


@pytest.mark.parametrize(
    ("length", "number", "grid"),
    [(1.0, 1.0, 0.5), (0.9, 1.0, 0.2), (0.5, 0.5, 0.2), (2.2, 2.0, 1.0), (0.05, 0.05, 0.02)],
)
def test_numbers_are_a_body_length_apart_and_the_grid_is_round(length, number, grid):
    assert mark_spacing(length) == pytest.approx(number)
    assert grid_spacing(length) == pytest.approx(grid)


def test_a_preview_of_a_walker_stands_on_its_ground(creature, tmp_path):
    bare, standing = (
        synthetic.read(preview(creature, tmp_path / f"{on}.png", size=SIZE, ground=on))
        for on in (False, True)
    )
    changed = np.abs(bare - standing).sum(-1) > 20
    # The ground fades towards the title and the scale bar, and lies behind names and bodies.
    assert changed[SIZE[1] // 2 :].mean() > 0.5
    assert changed[:30].mean() < 0.05
    # A dark spot lies at the sole of the nearest leg, which is lowest in the picture.
    feet = np.argwhere(bare[..., 2] - bare[..., 0] > 40)
    row, column = feet[feet[:, 0].argmax()]
    assert standing[row + 1 : row + 4, column - 2 : column + 3].mean() < 165
    assert bare[row + 3 : row + 6, column - 2 : column + 3].mean() > 215


def test_overlapping_names_are_moved_apart():
    places = np.array([(100.0, 50.0), (110.0, 54.0), (400.0, 50.0), (105.0, 50.0)])
    sizes = np.full((4, 2), (80.0, 20.0))
    apart = _apart(places, sizes)
    assert np.array_equal(apart[[0, 2]], places[[0, 2]])
    for i in range(4):
        for j in range(i):
            assert (np.abs(apart[i] - apart[j]) >= (80, 20)).any()
    assert np.abs(apart - places).max() <= 31
