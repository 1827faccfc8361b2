"""Relief, obstacles and the water's surface: drawn where the physics has them, and distinct."""

import numpy as np
import pytest
import pyvista as pv
import synthetic

from creatures import quick_jit
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Block, Boulder, Plane, Relief, Shore
from evo_cpg.view.camera import hidden, project
from evo_cpg.view.look import SHORE
from evo_cpg.view.scene import Panel, sample, scene_of, surface_is_seen
from evo_cpg.view.stage import camera_path
from evo_cpg.view.terrain import add_obstacles, heights, make_terrain, obstacle_mesh, obstacle_top
from evo_cpg.view.water import Ripples
from films import film
from pictures import contrast

SIZE = (320, 180)
INSTANT = 3.0
SLANT = (0.28, 0.0, 0.96)
# A shore that falls from 0.3 m on the animal's left to -0.5 m on its right, on the viewer's side.
SHORE_BESIDE = Shore("y", -1.0, 1.0, -0.5, 0.3)
WATERLINE = 0.25


def bumps(spacing=0.1, height=0.2):
    """Smooth hills around the origin."""
    x = spacing * np.arange(-40, 41)
    wave = height * np.sin(1.7 * x)[:, None] * np.cos(1.3 * x)
    return Relief(wave, (float(x[0]), float(x[0])), spacing)


FLOORS = {
    "plane": Plane(height=0.4),
    "slope": Plane(SLANT, 0.2),
    "shore": SHORE_BESIDE,
    "relief": bumps(),
    "fine relief": bumps(0.01),
}


def height_of(floor, x, y):
    """Heights from the definitions of the floors."""
    if isinstance(floor, Plane):
        n = np.array(floor.normal)
        return (floor.height - n[0] * x - n[1] * y) / n[2]
    if isinstance(floor, Shore):
        return np.interp(y, (-1.0, 1.0), (-0.5, 0.3))
    steps = [(value - floor.corner[0]) / floor.spacing for value in (x, y)]
    steps = [np.clip(s, 0, n - 1) for s, n in zip(steps, floor.heights.shape, strict=True)]
    (i, u), (j, v) = ((c := np.minimum(s.astype(int), 79), s - c) for s in steps)
    h = floor.heights
    near = h[i, j] + u * (h[i + 1, j] - h[i, j])
    far = h[i, j + 1] + u * (h[i + 1, j + 1] - h[i, j + 1])
    return near + v * (far - near)


@pytest.mark.parametrize("name", FLOORS)
def test_the_mesh_has_the_terrains_heights(name):
    floor = FLOORS[name]
    path = np.array([[-0.5, 0.0], [0.7, 0.3]])
    terrain = make_terrain(floor, path, 0.5, 10.0)
    x, y, z = terrain.points().T
    assert np.allclose(z, height_of(floor, x, y), atol=1e-5)
    assert (np.diff(terrain.x) > 0).all() and (np.diff(terrain.y) > 0).all()
    assert terrain.x[0] < -10 and terrain.x[-1] > 10
    # Between its lines, the error of the mesh depends on the size of its triangles.
    spots = np.random.default_rng(1).uniform(-2, 2, (500, 2))
    off = terrain.height(spots) - height_of(floor, *spots.T)
    assert np.abs(off).max() < (0.006 if "relief" in name else 1e-5)
    normal = terrain.normals()
    assert np.allclose(np.linalg.norm(normal, axis=1), 1) and (normal[:, 2] > 0).all()


def test_the_triangles_lie_at_the_height_of_the_mesh():
    terrain = make_terrain(bumps(), np.zeros((1, 2)), 0.5, 3.0)
    corners = terrain.points()[terrain.triangles()]
    middle = corners.mean(1)
    assert np.allclose(terrain.height(middle[:, :2]), middle[:, 2])
    # They face up.
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert (np.cross(edge, other)[:, 2] > 0).all()


STONES = [Boulder((0.3, -0.2, 0.1), 0.4), Block((0.2, 0.1, 0.3), (0.4, 0.2, 0.1), 0.6)]


@pytest.mark.parametrize("stone", STONES, ids=("boulder", "block"))
def test_a_stone_has_the_shape_of_the_physics(stone):
    mesh, place, turn = obstacle_mesh(stone)
    world = np.asarray(mesh.points) @ turn.T + place
    distance = quick_jit(stone.distance)
    gap, outward = distance(world.T)
    assert np.abs(gap).max() < 1e-5
    normal = np.asarray(mesh.point_data.active_normals) @ turn.T
    # At an edge of two faces, the outward direction belongs to one of them.
    along = np.einsum("ij,ji->i", normal, np.asarray(outward))
    assert along.min() > -1e-6 and (along > 0.99).mean() > 0.9
    # The top is the upper side over the stone, and -inf outside of it.
    spots = np.random.default_rng(2).uniform(-1, 1, (600, 2))
    top = obstacle_top(stone, spots)
    over = np.isfinite(top)
    assert 20 < over.sum() < 500
    gap, _ = distance(np.column_stack([spots[over], top[over]]).T)
    assert np.abs(np.asarray(gap)).max() < 1e-5
    column = np.linspace(-1, 1, 41)
    for spot in spots[~over][:20]:
        points = np.column_stack([np.tile(spot, (41, 1)), column])
        gap, _ = distance(points.T)
        assert np.asarray(gap).min() > -1e-6


def test_buried_obstacles_are_not_drawn():
    """Buried parts would be visible through ground that fades towards the horizon."""
    stones = (Boulder((0.0, 0.0, 0.0), 1.0), Boulder((5.0, 0.0, -1.5), 1.0))
    plotter = pv.Plotter(off_screen=True)
    add_obstacles(plotter, stones, 0.3, lambda place: np.zeros(len(place)))
    (actor,) = plotter.actors.values()
    seen = actor.mapper.dataset
    plotter.close()
    corners = np.asarray(seen.points)[seen.regular_faces]
    # The upper half is drawn, and below it at most 1/50 of the diameter and a facet of 5 degrees.
    assert corners[..., 2].max() == pytest.approx(1.0, abs=1e-3)
    deep = 0.04 + np.radians(180 / 35)
    assert -deep < corners[..., 2].min() < 0.0
    assert 2 * np.pi * 0.99 < seen.area < 2 * np.pi * (1 + deep)


def test_ripples_repeat_and_move_like_waves():
    ripples = Ripples(2.0)
    still, later = ripples.slopes(0.0), ripples.slopes(0.1)
    assert np.array_equal(still, Ripples(2.0).slopes(0.0))
    assert np.sqrt((still**2).sum(0).mean()) == pytest.approx(0.12, rel=1e-6)
    # The slopes of a periodic field are zero on average, and have no curl.
    assert np.abs(still.mean((1, 2))).max() < 1e-12
    number = 2 * np.pi * np.fft.fftfreq(256, 2.0 / 256)
    spectrum = np.fft.fft2(still)
    curl = number[:, None] * spectrum[1] - number * spectrum[0]
    assert np.abs(curl).max() < 1e-9 * np.abs(number[:, None] * spectrum[0]).max()
    # In a tenth of a second the longest wave turns by the phase that omega^2 = g k gives.
    first, then = (np.fft.fft2(s[0])[7, 0] for s in (still, later))
    turned = np.angle(then / first)
    assert abs(turned) == pytest.approx(0.1 * np.sqrt(9.81 * 2 * np.pi * 7 / 2.0), rel=1e-6)


@pytest.fixture(scope="module")
def creature():
    return synthetic.walker()


@pytest.fixture(scope="module")
def wading():
    """The walker along the shore, with its feet a quarter of a metre deep."""
    walk = synthetic.walk(6)
    return walk._replace(position=walk.position - [0.0, 0.0, WATERLINE])


def still(creature, motion, folder, **settings):
    path = film(
        creature, motion, folder / "s.png", size=SIZE, title="", seconds=INSTANT, **settings
    )
    return synthetic.read(path)


def seen(creature, motion, ground, surface=None):
    """The scene and its camera."""
    world = "water" if surface is not None else "land"
    panel = Panel(creature, motion, world=world, ground=ground, surface=surface)
    scene = scene_of(panel, sample(motion, 30))
    return scene, camera_path(scene, "follow", SIZE[0] / SIZE[1])


def spots(creature, motion, ground, surface, points):
    """Columns and rows of points of the world ``(n, 3)`` in the still."""
    scene, path = seen(creature, motion, ground, surface)
    clip = scene.clip
    frame = int(np.abs(clip.time - INSTANT).argmin())
    every = np.repeat(np.asarray(points, float)[None], len(clip.time), 0)
    x, y = project(path, every, SIZE[0] / SIZE[1])[frame].T
    return np.column_stack([SIZE[0] * (1 + x) / 2, SIZE[1] * (1 - y) / 2]).astype(int)


@pytest.mark.slow
def test_water_and_land_differ_in_colour(creature, wading, tmp_path):
    ground = Ground(floor=SHORE_BESIDE)
    image = still(creature, wading, tmp_path, ground=ground, surface=0.0)
    x = wading.position[int(INSTANT * 60), 0, 0]
    land = [(x + a, 0.9, 0.26) for a in (-0.8, 0.9)]
    water = [(x + a, -0.7, 0.0) for a in (-0.4, 0.1, 0.5)]
    mean = []
    for points in (land, water):
        places = spots(creature, wading, ground, 0.0, points)
        assert ((places > 8) & (places < np.array(SIZE) - 8)).all()
        mean.append(
            np.mean([image[r - 3 : r + 4, c - 3 : c + 4].mean((0, 1)) for c, r in places], 0)
        )
    (red, _, blue), (red_water, _, blue_water) = mean
    assert red - blue > 20
    assert blue_water - red_water > 10
    # The orange trunk is above the surface, and the feet are visible below it.
    orange = (image[..., 0] - image[..., 2] > 150) & (image[..., 1] < 140)
    assert orange.mean() > 0.01
    bare = still(creature, wading, tmp_path, ground=ground, world="land")
    # At its edges, smoothed pixels mix with what is behind.
    assert np.median(np.abs(bare - image)[orange]) < 6


@pytest.mark.slow
def test_only_bodies_under_water_are_tinted(creature, wading, tmp_path):
    """A surface above the trunk's lower half removes the red there."""
    ground = Ground(floor=SHORE_BESIDE)
    low = still(creature, wading, tmp_path, ground=ground, surface=0.0)
    high = still(creature, wading, tmp_path, ground=ground, surface=0.25)
    trunk = wading.position[int(INSTANT * 60), 0]
    side = trunk - [0.0, 0.16, 0.0]
    heights_on_it = np.array([[0, 0, 0.04], [0, 0, -0.06]])
    above, below = spots(creature, wading, ground, 0.25, side + heights_on_it)
    for (column, row), tinted in ((above, False), (below, True)):
        change = (low - high)[row, column]
        assert (change[0] > 20) == tinted
        assert (np.abs(change).max() < 12) == (not tinted)


@pytest.mark.parametrize(("surface", "seen"), [(-0.3, True), (0.2, True), (0.45, False)])
def test_the_surface_is_shown_if_something_rises_out_of_it(creature, surface, seen):
    """The walker's back is at about 0.58 - 0.3 m, and the ridge next to it at 0.4 m."""
    walk = synthetic.walk(2)
    clip = sample(walk._replace(position=walk.position - [0.0, 0.0, 0.5]), 30)
    ridge = Ground(floor=Shore("y", -1.0, 1.0, -0.5, 0.4))
    assert surface_is_seen(creature, clip, ridge, surface) == seen
    assert not surface_is_seen(creature, clip, None, 0.2)


@pytest.mark.slow
def test_a_deep_animal_is_drawn_without_the_surface(tmp_path):
    swimmer, swim = synthetic.swimmer(), synthetic.swim(6)
    deep, boundless = (still(swimmer, swim, tmp_path, surface=s) for s in (5.0, None))
    assert np.array_equal(deep, boundless)
    shallow = still(swimmer, swim, tmp_path, surface=0.0)
    assert shallow.mean() > deep.mean() + 40
    assert contrast(shallow[150:], SHORE.text) > 4.5


@pytest.mark.slow
def test_ground_with_relief_hides_what_is_behind_it(creature, tmp_path):
    """If the walker sinks by a quarter of a metre, the hills hide most of the blue shins."""
    floor = bumps(height=0.1)
    walk = synthetic.over(synthetic.walk(6), lambda place: heights(floor, place))
    sunk = walk._replace(position=walk.position - [0.0, 0.0, 0.25])
    count = []
    for motion in (walk, sunk):
        image = still(creature, motion, tmp_path, world="land", ground=Ground(floor=floor))
        count.append(int((image[60:, :, 2] - image[60:, :, 0] > 60).sum()))
    assert count[0] > 150
    assert count[1] < 0.35 * count[0]


def test_the_camera_rises_over_a_wall_that_hides_the_animal(creature):
    walk = synthetic.walk(6)
    wall = Block((1.5, -1.0, 0.0), (6.0, 0.1, 0.55))
    (scene, low), (_, high) = (
        seen(creature, walk, Ground(obstacles=stones)) for stones in ((), (wall,))
    )
    position = scene.clip.position

    def top(place):
        return np.maximum(obstacle_top(wall, place), 0.0)

    assert hidden(low, position, top, 0.0) > 0.3
    assert hidden(high, position, top, 0.0) < 0.1
    assert high.position[0, 2] > low.position[0, 2] + 0.3


@pytest.mark.parametrize("ground", [None, Ground(floor=Plane(height=-6.0))])
def test_the_camera_is_above_the_surface_of_a_diver(creature, ground):
    """The animal is a body length deep. The camera at its usual slant would be under water."""
    walk = synthetic.walk(2)
    rising = walk._replace(position=walk.position - [0.0, 0.0, 1.0])
    rising.position[-4:] += [0.0, 0.0, 1.0]
    scene, path = seen(creature, rising, ground, 0.0)
    assert scene.surface == 0.0
    assert path.position[:, 2].min() > 0.1
