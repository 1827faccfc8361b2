"""Films: the files decode to the given size and frames, and show the animal."""

import contextlib
import dataclasses
import itertools
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import imageio_ffmpeg
import numpy as np
import pytest
import synthetic
from PIL import Image

from evo_cpg.files import OutputError
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Boulder, Plane
from evo_cpg.simulation.recording import Recording
from evo_cpg.view import film as view_film
from evo_cpg.view import output
from evo_cpg.view.camera import BodyBoxes, follow, in_camera, project, smooth
from evo_cpg.view.captions import edge_places, fitted
from evo_cpg.view.film import Film, Frames, RenderError, side_by_side
from evo_cpg.view.legible import font
from evo_cpg.view.meshes import body_colors
from evo_cpg.view.scene import Panel, sample, scene_of
from evo_cpg.view.stage import camera_path
from films import film

SMALL = (192, 108)


@pytest.fixture(scope="module")
def creature():
    return synthetic.swimmer()


@pytest.fixture(scope="module")
def recording():
    return synthetic.swim()


def ten_frames(creature, recording, path, **given):
    """Film of the whole recording, and the progress that was reported."""
    told = []
    film(
        creature,
        recording,
        path,
        size=SMALL,
        fps=10,
        speed=recording.time[-1] / 0.9,
        title="",
        progress=lambda done, total: told.append((done, total)),
        **given,
    )
    return path, told


@pytest.fixture(scope="module")
def movie(creature, recording, tmp_path_factory):
    return ten_frames(creature, recording, tmp_path_factory.mktemp("film") / "swim.mp4")


def decode(path):
    """All frames of a film, in the size that the file states."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path)]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    result = subprocess.run(command, capture_output=True, check=True)
    stated = re.search(rb"Video: h264.*yuv420p.*?(\d+)x(\d+)", result.stderr)
    width, height = map(int, stated.groups())
    return list(np.frombuffer(result.stdout, np.uint8).reshape(-1, height, width, 3))


def seen(creature, motion, world="water", view="follow", ground=None):
    """The motion at 30 frames a second, and a camera for it in 16:9."""
    clip = sample(motion, 30)
    scene = scene_of(Panel(creature, motion, world=world, ground=ground), clip)
    return clip, camera_path(scene, view, 16 / 9)


def orange(image):
    """Pixels that only the head has: red far above blue."""
    return (image[..., 0].astype(int) - image[..., 2] > 90) & (image[..., 1] < 165)


def test_a_film_has_the_given_frames_and_the_animal_moves(movie):
    path, told = movie
    frames = decode(path)
    assert [frame.shape for frame in frames] == [(108, 192, 3)] * 10
    assert told == [(i, 10) for i in range(1, 11)]
    for one, next_one in itertools.pairwise(frames):
        assert np.abs(one.astype(int) - next_one).max() > 60
    heads = [np.argwhere(orange(frame)).mean(0) for frame in frames]
    assert np.ptp(heads, axis=0).max() > 5


def test_the_head_is_where_the_camera_projects_it(creature, recording, tmp_path):
    path = film(creature, recording, tmp_path / "still.png", size=(640, 360), seconds=14, title="")
    image = synthetic.read(path)
    assert image.shape == (360, 640, 3)
    clip, camera = seen(creature, recording)
    x, y = project(camera, clip.position[:, :2].mean(1, keepdims=True), 640 / 360)[14 * 30, 0]
    row, column = np.argwhere(orange(image)).mean(0)
    # The two orange bodies at the front are about 40 pixels long. Their sides are in shade.
    assert np.hypot(column - 320 * (1 + x), row - 180 * (1 - y)) < 12


@pytest.mark.parametrize("world", ["water", "land"])
def test_bodies_and_light_stay_in_the_frame_of_a_calm_camera(creature, recording, world):
    clip, camera = seen(creature, recording, world)
    place = project(camera, clip.position, 1280 / 720)
    assert np.abs(place).max() < 0.96
    # The animal fills a third to a half of the width, a little less between the centres of its
    # bodies. The first picture shows the light.
    assert 0.28 < np.median(np.ptp(place, axis=1)[:, 0]) / 2 < 0.5
    goal = project(camera, np.repeat(recording.goal[None, None], len(place), 0), 1280 / 720)
    assert np.abs(goal[0]).max() < 0.92 and np.abs(goal).max() < 1
    assert np.linalg.norm(camera.position - recording.goal, axis=1).min() > 2
    # The camera moves about as fast as the animal, without its tail beat.
    speed = np.linalg.norm(np.diff(camera.focus, axis=0), axis=1) * 30
    assert speed.max() < 1.35 * clip.speed.max()


def test_an_arrow_points_to_a_light_outside_the_picture(creature, recording):
    """The orbiting camera loses sight of a far light, and finds it again."""
    far = synthetic.with_light(recording, np.array([300.0, 200.0, 0.0]))
    clip = sample(far, 30)
    orbit = camera_path(scene_of(Panel(creature, far), clip), "orbit", 16 / 9)
    tips = edge_places(orbit, far.goal, 16 / 9)
    hidden = np.isfinite(tips).all(-1)
    assert 0.2 < hidden.mean() < 1
    # The tip lies on the side of the light, at the edge of the room for it.
    across, _, _ = in_camera(orbit, far.goal[None, None])[:, 0].T
    assert (np.sign(tips[hidden, 0]) == np.sign(across[hidden])).all()
    assert np.abs(tips[hidden]).max() < 0.94


@pytest.mark.parametrize("world", ["water", "land"])
@pytest.mark.parametrize("view", ["side", "top"])
def test_the_animal_crosses_the_picture_from_side_and_top(creature, recording, world, view):
    clip, camera = seen(creature, recording, world, view)
    place = project(camera, clip.position, 1280 / 720)
    assert np.abs(place).max() < 0.95
    # The path goes to the right. Points above the animal (side) or to its left (top) are higher in
    # the picture.
    towards = recording.goal - clip.position[0].mean(0)
    towards /= np.linalg.norm(towards)
    upward = {"side": [0.0, 0.0, 1.0], "top": [-towards[1], towards[0], 0.0]}[view]
    points = camera.focus[:, None] + 0.1 * np.stack([0 * towards, towards, upward])
    middle, ahead, up = project(camera, points, 1280 / 720).swapaxes(0, 1)
    assert np.allclose(middle, 0, atol=1e-9)
    assert (ahead[:, 0] > 0.01).all() and np.abs(ahead[:, 1]).max() < 1e-3
    assert (up[:, 1] > 0.02).all() and np.abs(up[:, 0]).max() < 1e-6


@pytest.mark.parametrize("world", ["water", "land"])
def test_the_camera_goes_around_once(creature, recording, world):
    """It turns evenly, at one height and distance, with the animal in the middle."""
    for motion in (recording, synthetic.with_light(recording, np.full(3, np.nan))):
        clip, camera = seen(creature, motion, world, "orbit")
        offset = camera.position - camera.focus
        bearing = np.unwrap(np.arctan2(offset[:, 1], offset[:, 0]))
        turns = np.diff(bearing)
        assert np.allclose(turns, 2 * np.pi / len(bearing), rtol=0.01)
        assert np.allclose(np.linalg.norm(offset, axis=1), np.linalg.norm(offset[0]))
        assert np.allclose(offset[:, 2], offset[0, 2])
        assert np.degrees(np.arcsin(offset[0, 2] / np.linalg.norm(offset[0]))) == pytest.approx(14)
        place = project(camera, clip.position, 1280 / 720)
        assert np.abs(place).max() < 0.95
        assert np.abs(np.median(place.mean(1), axis=0)).max() < 0.1


def test_the_orbit_stays_above_a_boulder(creature, recording):
    """A boulder on the camera's path lifts the whole orbit."""
    _, bare = seen(creature, recording, "land", "orbit")
    place = bare.position[len(bare.position) // 2]
    stone = Boulder(tuple(place - [0, 0, 1.0]), 1.6)
    ground = Ground(floor=Plane(height=-1.0), obstacles=(stone,))
    _, camera = seen(creature, recording, "land", "orbit", ground)
    assert np.linalg.norm(camera.position - place + [0, 0, 1.0], axis=1).min() > 1.6
    assert np.linalg.norm(bare.position - place + [0, 0, 1.0], axis=1).min() < 1.6


def beginning(recording: Recording, count: int) -> Recording:
    """The first instants of a recording."""
    kept = {"dof_names"}
    fields = {name: getattr(recording, name)[:count] for name in set(recording._fields) - kept}
    return recording._replace(**fields)


@pytest.mark.slow
def test_several_processes_draw_the_same_film(movie, creature, recording, tmp_path, monkeypatch):
    """Frames are in order. The last round is not full: 10 frames, 6 ahead."""
    monkeypatch.setattr(view_film, "_WORTH", 3)
    path, told = ten_frames(creature, recording, tmp_path / "two.mp4", processes=2)
    assert told == movie[1]
    alone, together = (np.array(decode(each)) for each in (movie[0], path))
    assert np.ptp(alone.astype(int), axis=0).max() > 50  # something moves
    np.testing.assert_array_equal(together, alone)


def test_a_process_that_cannot_draw_is_reported(creature, recording, monkeypatch):
    """A thread replaces the process."""
    frames = Frames([Panel(creature, recording)], Film(SMALL, 10, 0.5, camera="missing"))
    monkeypatch.setattr(view_film, "_laid_out", [frames])
    words = "draws frames failed: camera is 'missing'"
    with ThreadPoolExecutor(1) as pool, pytest.raises(RenderError, match=words):
        next(view_film._in_order(pool, 5, 2))


@pytest.mark.parametrize(
    ("frames", "cores", "processes"), [(239, 8, 1), (240, 64, 2), (990, 2, 2), (990, 64, 8)]
)
def test_short_films_use_fewer_processes(frames, cores, processes, monkeypatch):
    used = [1]

    def pool(count, *_):
        used.append(count)
        return ThreadPoolExecutor(1)

    monkeypatch.setattr(view_film, "ProcessPoolExecutor", pool)
    reel = SimpleNamespace(count=frames, drawn=lambda: contextlib.nullcontext(len))
    with view_film.drawn_frames(reel, cores):
        assert used[-1] == processes


@pytest.mark.slow
def test_animals_stand_side_by_side(creature, recording, tmp_path):
    """Each is in its place, row by row. A shorter recording stops at its last frame."""
    short = beginning(recording, 61)
    walk = synthetic.walk(2.0)
    panels = [
        Panel(creature, recording, ""),
        Panel(creature, short, ""),
        Panel(synthetic.walker(), walk, "", world="land", ground=Ground(floor=Plane())),
        Panel(creature, short, ""),
    ]
    image = synthetic.read(side_by_side(panels, tmp_path / "all.png", Film(SMALL, 10, 3)))
    (width, height), gap = SMALL, 4
    assert image.shape == (2 * height + gap, 2 * width + gap, 3)
    assert (image[height : height + gap] == 255).all()
    cells = [
        image[row : row + height, column : column + width]
        for row in (0, height + gap)
        for column in (0, width + gap)
    ]
    for cell, motion in zip(cells, (recording, short), strict=False):
        alone = film(creature, motion, tmp_path / "i.png", size=SMALL, fps=10, seconds=3, title="")
        assert np.abs(cell - synthetic.read(alone)).mean() < 1.0
    assert np.array_equal(cells[1], cells[3])
    # Land: bright, and blue above.
    assert cells[2].mean() > cells[0].mean() + 60
    movie = side_by_side(panels[:3], tmp_path / "all.mp4", Film(SMALL, 10, 0.2))
    assert decode(movie)[0].shape == (height, 3 * width + 2 * gap, 3)


def test_the_camera_stays_off_a_light_that_the_animal_overshoots():
    frames = np.linspace(0, 1, 200)[:, None]
    position = (frames * [40.0, 0.0, 0.0])[:, None]
    goal = np.array([20.0, 0.0, 0.0])
    turn = np.broadcast_to(np.eye(3), (200, 1, 3, 3))
    bodies = BodyBoxes(position, turn, np.full((1, 3), 1 / np.sqrt(3)))
    camera = follow(bodies, goal, 30, 16 / 9, 0.0)
    assert np.linalg.norm(camera.position - goal, axis=1).min() > 1.5


def test_smoothing_keeps_a_straight_path_and_removes_a_wobble():
    time = np.linspace(0, 20, 601)
    steady = np.column_stack([time, -2 * time, 0 * time])
    assert np.allclose(smooth(steady, 24), steady)
    wobble = np.column_stack([0 * time, np.sin(2 * np.pi * 1.08 * time), 0 * time])
    assert np.abs(smooth(wobble, 24)[100:-100]).max() < 1e-3
    assert np.array_equal(smooth(steady[:1], 24), steady[:1])


def test_head_and_tail_differ_in_colour(creature):
    colors = body_colors(creature)
    head, tail = colors[0], colors[-1]
    assert head[0] > 0.8 and head[2] < 0.3
    assert tail[2] > 0.8 and tail[0] < 0.4
    assert len(np.unique(colors, axis=0)) == len(creature.bodies)
    *others, last = creature.bodies
    own = dataclasses.replace(last, color="#00ff00")
    painted = dataclasses.replace(creature, bodies=(*others, own))
    assert np.allclose(body_colors(painted)[-1], [0, 1, 0])


def test_sampling_interpolates_between_steps(recording):
    clip = sample(recording, fps=25, speed=0.5, seconds=2)
    assert np.allclose(clip.time, np.arange(101) / 50)
    identity = np.einsum("tbij,tbkj->tbik", clip.rotation, clip.rotation)
    assert np.allclose(identity, np.eye(3))
    exact = np.interp(clip.time, recording.time, recording.position[:, 3, 1])
    assert np.allclose(clip.position[:, 3, 1], exact)
    # 8 m in 33 s.
    assert sample(recording, 30).speed.mean() == pytest.approx(7.7 / 33, rel=0.1)


def test_an_animal_that_starts_from_rest_shows_no_speed_at_first(recording):
    """It accelerates by 1 m/s^2, so the mean of a second is its speed half a second before."""
    away = np.outer(0.5 * recording.time**2, [1.0, 0.0, 0.0])
    moved = recording.position[:1] + away[:, None]
    clip = sample(recording._replace(position=moved), 30, seconds=4)
    time, speed = clip.time, clip.speed
    assert speed[0] == 0
    assert np.allclose(speed[:31], time[:31] / 2)
    assert np.allclose(speed[30:], time[30:] - 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_a_film_of_an_odd_size_is_animated_in_an_even_size(creature, recording, tmp_path, kind):
    path = film(creature, recording, tmp_path / f"s.{kind}", size=(193, 109), fps=10, seconds=0.2)
    with Image.open(path) as picture:
        assert (picture.size, picture.n_frames) == (SMALL, 3)


@pytest.mark.slow
def test_a_sheet_shows_moments_from_the_first_to_the_last(creature, recording, tmp_path):
    """Each picture equals the still of its instant. Pictures are in rows."""
    settings = {"size": SMALL, "title": "", "fps": 1}
    sheet = film(creature, recording, tmp_path / "s.png", sheet=(2, 2), **settings)
    image, (width, height), gap = synthetic.read(sheet).astype(int), SMALL, 4
    assert image.shape == (2 * height + gap, 2 * width + gap, 3)
    assert (image[height : height + gap] == 255).all()
    assert len(sample(recording, 1).time) == 33
    for i, instant in enumerate((0, 11, 21, 32)):
        row, column = i // 2 * (height + gap), i % 2 * (width + gap)
        still = film(creature, recording, tmp_path / "i.png", seconds=instant, **settings)
        assert np.array_equal(
            image[row : row + height, column : column + width], synthetic.read(still)
        )


def test_every_frame_gets_a_picture_of_its_own(creature, recording, tmp_path):
    settings = {"size": SMALL, "title": "", "fps": 10, "seconds": 0.3}
    folder = film(creature, recording, tmp_path / "frames" / "f%03d.png", **settings)
    assert folder == tmp_path / "frames"
    assert sorted(p.name for p in folder.iterdir()) == [f"f{i:03d}.png" for i in range(4)]
    assert [p.name for p in tmp_path.iterdir()] == ["frames"]
    movie = film(creature, recording, tmp_path / "film.mp4", **settings)
    for i, frame in enumerate(decode(movie)):
        difference = synthetic.read(folder / f"f{i:03d}.png").astype(int) - frame
        # Loss of the film's compression.
        assert np.abs(difference).mean() < 6
    absent = tmp_path / "missing" / "frames"
    for place, words in ((folder, "frames is not empty"), (absent, "no folder .*missing")):
        with pytest.raises(OutputError, match=words):
            film(creature, recording, place / "%04d.png", **settings)


@pytest.mark.parametrize("name", ["swim.mp4", "frames/%04d.png"])
def test_no_permission_is_refused(creature, recording, tmp_path, monkeypatch, name):
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(OutputError, match="no permission"):
        film(creature, recording, tmp_path / name, size=SMALL)


def test_a_folder_name_may_have_a_colon(creature, recording, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkdir("run:1")
    made = film(creature, recording, "run:1/swim.png", size=SMALL, sheet=(1, 1))
    assert synthetic.read(made).shape == (SMALL[1], SMALL[0], 3)


def test_errors_of_ffmpeg_are_reported(creature, recording, tmp_path, monkeypatch):
    monkeypatch.setitem(output._ENCODERS, ".mp4", "-c:v nonsense")
    with pytest.raises(OutputError, match=r"swim\.mp4: ffmpeg failed: .*'nonsense'"):
        film(creature, recording, tmp_path / "swim.mp4", size=SMALL, fps=10, seconds=0.2)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["swim.mp4", "new/%d.png"])
def test_an_interrupted_film_leaves_the_old_one(creature, recording, tmp_path, name):
    path = tmp_path / "swim.mp4"
    path.write_bytes(b"old")

    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        film(creature, recording, tmp_path / name, size=SMALL, seconds=0.2, progress=interrupt)
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["swim.mp4"]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"world": "air"}, r"world is 'air'\. Allowed: water, land"),
        ({"surface": np.nan}, "surface is nan"),
        ({"camera": "front"}, r"camera is 'front'\. Allowed: follow, side, top, orbit"),
        ({"fps": np.nan}, "fps is nan"),
        ({"speed": -1}, "speed is -1"),
    ],
)
def test_settings_out_of_range_are_refused(creature, recording, tmp_path, settings, words):
    with pytest.raises(ValueError, match=words):
        film(creature, recording, tmp_path / "swim.mp4", **settings)


def test_recordings_that_cannot_be_shown_are_refused(creature, recording, tmp_path):
    path = tmp_path / "swim.mp4"
    empty = recording._replace(time=recording.time[:0], position=recording.position[:0])
    other = recording._replace(position=recording.position[:, :9])
    lost = recording._replace(position=recording.position.copy())
    lost.position[120:] = np.nan
    for motion, words in ((empty, "no instant"), (other, "9 bodies"), (lost, "diverges at 2 s")):
        with pytest.raises(ValueError, match=words):
            film(creature, motion, path)


def test_importing_the_package_loads_neither_vtk_nor_matplotlib():
    code = (
        "import sys, evo_cpg.view; "
        "print([m for m in ('vtkmodules', 'pyvista', 'matplotlib', 'jax') if m in sys.modules])"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


@pytest.mark.parametrize("room", [100.0, 250.0, 500.0])
def test_a_title_fits_into_its_room(room):
    for title in ("hexapod", "champion: fitness -0.629 in fresh draws", 90 * "x", ""):
        shown, size = fitted(title, 20.0, room)
        assert font(size).getlength(shown) <= room + 1e-9
        assert 10 < size <= 20
        assert shown == title or (shown == title[: len(shown) - 3] + "..." and size == 11)
    assert fitted("hexapod", 20.0, 500.0) == ("hexapod", 20.0)
