"""Films and stills of a recording, rendered off screen.

The scene is built once: each ``add_...`` function puts actors into the plotter and, where they
change from frame to frame, returns a function that moves them or overwrites arrays in place;
nothing is meshed again. Frames are rendered larger than the film and averaged down by ffmpeg,
which smooths edges, thin lines and text.
"""

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyvista as pv
from jaxtyping import Float

from evo_cpg.creature.creature import Creature
from evo_cpg.physics.footing import Ground
from evo_cpg.physics.terrain import Plane
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.experiment import Experiment
from evo_cpg.view.camera import CameraPath, aspect_of, course, follow, hidden, smooth
from evo_cpg.view.captions import add_captions
from evo_cpg.view.goal_light import add_goal_light
from evo_cpg.view.ground import Marks, Update, add_floor, add_numbers, grid_spacing, mark_spacing
from evo_cpg.view.heading import heading
from evo_cpg.view.look import LOOKS, SHORE, Look
from evo_cpg.view.meshes import add_bodies, head_index, shape_mesh
from evo_cpg.view.obstacles import add_obstacles, obstacle_mesh, obstacle_top
from evo_cpg.view.offscreen import canvas, pixels
from evo_cpg.view.output import (
    FILM_SUFFIXES,
    GUTTER,
    SettingError,
    frame_writer,
    is_numbered,
    numbered_path,
    output_path,
)
from evo_cpg.view.particles import add_particles
from evo_cpg.view.relief import (
    LIFT,
    add_draped_contacts,
    add_draped_light,
    add_draped_patches,
    add_draped_shadows,
    add_relief,
)
from evo_cpg.view.shadows import add_contacts, add_shadows, add_sun_shadows
from evo_cpg.view.signals import LOWEST, SHARE, SMALLEST, Signals, Strip
from evo_cpg.view.sky import add_sky, sun_direction
from evo_cpg.view.terrain import Terrain, heights, make_terrain
from evo_cpg.view.textures import CELLS
from evo_cpg.view.trail import add_trail
from evo_cpg.view.water import add_water, add_waterlines

# Pixels rendered per pixel of the result, a side. On one core of a software renderer a frame of
# 1280 x 720 costs 46 ms at 1.25, 58 ms at 1.5, which looks hardly better, and 100 ms at 2.
_FILM_OVERSAMPLING = 1.25
_STILL_OVERSAMPLING = 3.0
# On a sheet of several animals: the heading of a moment, and what sets moments apart, pixels.
_HEAD, _GAP = 40, 24
# Window of the displayed speed, s: long enough to average a tail beat.
_SPEED_WINDOW = 0.5
# The floor lies this many radii of the animal below the lowest point of its way through water.
FLOOR_DEPTH = 0.55
# Time in which the trail fades to a third, s.
_TRAIL_FADE = 4.0
# Angles of the camera that are tried in turn where something stands in its way, rad, and how far
# above the ground it stays, in radii of the animal. Of all bodies and instants this share may be
# hidden: stones that pass in front show how far away they are.
_ELEVATIONS, _CLEARANCE, _HIDDEN = np.radians([16.0, 22.0, 28.0, 35.0, 45.0]), 0.3, 0.03
# Land rises out of the water within so many radii of the animal's way: the film shows the surface.
_NEARBY = 4.0
# The ground's mesh ends so many visibilities from the way, where it has faded to nothing.
HORIZON = 2.4


# Columns of so many animals side by side; of more the square root, rounded up.
_COLUMNS = (1, 1, 2, 3, 2)


class Panel(NamedTuple):
    """An animal that a film shows.

    Attributes:
        creature: the animal.
        recording: its motion.
        title: caption; the creature's name by default.
        world: where the animal lives, ``water`` or ``land``.
        ground: that carries the animal; None where there is none.
        surface: height of the water's surface, m.
        signals: shown in a strip under it; None for none.
        note: below the title, in small letters.
    """

    creature: Creature
    recording: Recording
    title: str | None = None
    world: str = "water"
    ground: Ground | None = None
    surface: float | None = None
    signals: Signals | None = None
    note: str = ""


def panel_of(
    experiment: Experiment,
    recording: Recording,
    title: str,
    signals: Signals | None = None,
    note: str = "",
) -> Panel:
    """A motion in the world of the experiment that it was recorded in."""
    world = experiment.simulation.world
    return Panel(
        experiment.creature,
        recording,
        title,
        world="land" if world.water is None else "water",
        ground=world.ground,
        surface=None if world.water is None else world.water.surface,
        signals=signals,
        note=note,
    )


class Stage(NamedTuple):
    """How a film is made.

    Attributes:
        look: of the world.
        title: caption.
        note: below it.
        size: width and height of the film, pixels.
        oversampling: pixels rendered per pixel of the film, a side.
        rate: frames per second of recorded time.
        speed: recorded seconds per second of film.
        ground: None where there is none.
        surface: height of the water's surface, m; None where none is seen.
        camera: from where the animal is seen, one of `evo_cpg.view.camera.CAMERAS`.
    """

    look: Look
    title: str
    size: tuple[int, int]
    oversampling: float
    rate: float
    speed: float
    ground: Ground | None = None
    surface: float | None = None
    camera: str = "follow"
    note: str = ""

    @property
    def level(self) -> float | None:
        """Height of the ground where it is level and bare, and no water covers it, m."""
        return None if self.ground is None or self.surface is not None else self.ground.level


class Clip(NamedTuple):
    """A recording sampled at the film's frames.

    Attributes:
        time: s.
        position: centre of every body, m.
        rotation: body to world.
        distance: to the goal, or, where there is none, from the start over ground, m.
        speed: of the mean of the bodies' centres, smoothed, m/s.
    """

    time: Float[np.ndarray, " frames"]
    position: Float[np.ndarray, "frames b 3"]
    rotation: Float[np.ndarray, "frames b 3 3"]
    distance: Float[np.ndarray, " frames"]
    speed: Float[np.ndarray, " frames"]


def side_by_side(
    panels: Sequence[Panel],
    path: str | os.PathLike[str],
    *,
    size: tuple[int, int] = (640, 360),
    fps: float = 30.0,
    seconds: float | None = None,
    speed: float = 1.0,
    camera: str = "follow",
    sheet: tuple[int, int] | None = None,
    columns: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render recordings in one film, row by row; those that are shorter wait at their end.

    Args:
        panels: the animals.
        path: ``.mp4`` (H.264), ``.webp`` or ``.gif`` for a film, ``.png`` for a still or a sheet;
            a name such as ``frames/%04d.png`` for a picture of every frame, counted from 0, in a
            new folder.
        size: width and height of each animal's picture, pixels; rounded down to even numbers.
        fps: frames per second of the film.
        seconds: recorded time to show, s; all of it by default. Of a still: the instant it
            shows, the middle by default.
        speed: recorded seconds per second of film.
        camera: from where the animals are seen: ``follow`` (from behind towards the light, or else
            from the side and a little ahead), ``side``, ``top`` or ``orbit`` (once around).
        sheet: columns and rows of one picture of so many moments, the first and the last of the
            film and others evenly in between, each of which shows all animals; those of a shorter
            recording lie closer together. Of several animals each moment is a column with a
            heading: its time or, where their recordings are not equally long, its number.
        columns: of animals; as many as rows, or one more, by default, and one on a sheet.
        progress: called with the number of frames done and their total.

    Returns:
        The path, or the folder of the pictures.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
        ValueError: a setting out of range, or a recording that does not fit its creature, is
            empty or not finite.
    """
    path = Path(path)
    numbered = sheet is None and is_numbered(path)
    if numbered:
        path = numbered_path(path)
    else:
        path = output_path(path, FILM_SUFFIXES if sheet is None else (".png",))
    still = path.suffix.lower() == ".png" and sheet is None and not numbered
    for panel in panels:
        _check(panel, size, fps, speed)
    aspect_of(camera)
    if seconds is not None and not seconds >= 0:
        raise SettingError(f"seconds is {seconds:g}; it must be a number that is not negative")
    clips = [sample(one.recording, fps, speed, None if still else seconds) for one in panels]
    frames = [_frames(clip, seconds, still, sheet) for clip in clips]
    count = max(map(len, frames))
    scale = _STILL_OVERSAMPLING if still or sheet is not None else _FILM_OVERSAMPLING
    width, height = (max(side // 2 * 2, 2) for side in size)
    # Of several animals a sheet has a column for each moment, with a heading.
    grouped = sheet is not None and len(panels) > 1
    columns, rows = _grid(len(panels), 1 if grouped and columns is None else columns)
    head = _HEAD if grouped else 0
    whole = (columns * (width + GUTTER) - GUTTER, rows * (height + GUTTER) - GUTTER + head)
    drawn_size = round(width * scale), round(height * scale)
    pitch = round((width + GUTTER) * scale), round((height + GUTTER) * scale)
    rendered = (
        (columns - 1) * pitch[0] + drawn_size[0],
        (rows - 1) * pitch[1] + drawn_size[1] + round(head * scale),
    )
    # Filled where an animal is shown.
    picture = np.full((rendered[1], rendered[0], 3), 255, np.uint8)

    with contextlib.ExitStack() as stack:
        shows = [
            stack.enter_context(
                _panel(panel, clip, (width, height), scale, fps / speed, speed, camera)
            )
            for panel, clip in zip(panels, clips, strict=True)
        ]
        gap = _GAP if grouped else GUTTER
        with frame_writer(path, whole, rendered, fps, sheet, gap) as write:
            for done in range(count):
                if grouped:
                    instants = {
                        f"{clip.time[own[done]] - clip.time[0]:.1f} s"
                        for clip, own in zip(clips, frames, strict=True)
                    }
                    # Recordings of different length have moments of their own.
                    words = instants.pop() if len(instants) == 1 else f"moment {done + 1}"
                    high = round(head * scale)
                    picture[-high:] = heading(words, rendered[0], high)
                for i, (show, own) in enumerate(zip(shows, frames, strict=True)):
                    drawn = show(own[min(done, len(own) - 1)])
                    if len(panels) == 1:
                        picture = drawn
                        break
                    # The bottom row comes first.
                    below = (rows - 1 - i // columns) * pitch[1]
                    left = i % columns * pitch[0]
                    picture[below : below + len(drawn), left : left + drawn.shape[1]] = drawn
                write(picture)
                if progress is not None:
                    progress(done + 1, count)
    return path.parent if numbered else path


@contextlib.contextmanager
def _panel(
    panel: Panel,
    clip: Clip,
    size: tuple[int, int],
    scale: float,
    rate: float,
    speed: float,
    camera: str,
) -> Iterator[Callable[[int], np.ndarray]]:
    """An animal's picture, frame by frame: ``(height, width, 3)`` bytes, bottom row first."""
    creature, surface = panel.creature, panel.surface
    if surface is not None and not surface_is_seen(creature, clip, panel.ground, surface):
        surface = None
    look = LOOKS[panel.world] if surface is None else SHORE
    rendered = round(size[0] * scale), round(size[1] * scale)
    strip, above = None, size[1]
    if panel.signals is not None:
        above = size[1] - max(round(SHARE * size[1]), LOWEST)
        strip = Strip(panel.signals, look, (size[0], size[1] - above), scale)
    stage = Stage(
        look=look,
        title=creature.name if panel.title is None else panel.title,
        size=(size[0], above),
        oversampling=scale,
        rate=rate,
        speed=speed,
        ground=panel.ground,
        surface=surface,
        camera=camera,
        note=panel.note,
    )
    high = rendered[1] if strip is None else rendered[1] - strip.height
    with canvas((rendered[0], high)) as plotter:
        show = _set_scene(plotter, creature, panel.recording, clip, stage)

        def draw(frame: int) -> np.ndarray:
            show(frame)
            seen = pixels(plotter)
            return seen if strip is None else np.concatenate([strip.at(clip.time[frame]), seen])

        yield draw


def sample(
    recording: Recording, fps: float, speed: float = 1.0, seconds: float | None = None
) -> Clip:
    """Sample a recording at the frames of a film, interpolating where they fall between steps.

    Args:
        recording: the motion.
        fps: frames per second of the film.
        speed: recorded seconds per second of film.
        seconds: recorded time to show, s; all of it by default.
    """
    start, end = recording.time[0], recording.time[-1]
    if seconds is not None:
        end = min(end, start + seconds)
    # A hundredth of a frame keeps rounding from dropping the last one.
    time = start + np.arange(int((end - start) * fps / speed + 1.01)) * (speed / fps)
    after = np.clip(np.searchsorted(recording.time, time), 1, max(len(recording.time) - 1, 1))
    after = np.minimum(after, len(recording.time) - 1)
    before = np.maximum(after - 1, 0)
    step = recording.time[after] - recording.time[before]
    weight = np.clip((time - recording.time[before]) / np.where(step > 0, step, 1), 0, 1)

    def between(values: np.ndarray) -> np.ndarray:
        share = weight.reshape(-1, *(1,) * (values.ndim - 1))
        return (1 - share) * values[before] + share * values[after]

    # The nearest rotation to a mean of two near rotations: its polar factor.
    left, _, right = np.linalg.svd(between(recording.rotation))
    position = between(recording.position)
    centre = smooth(position.mean(1), _SPEED_WINDOW * fps / speed)
    velocity = np.gradient(centre, time, axis=0) if len(time) > 1 else np.zeros_like(centre)
    return Clip(
        time,
        position,
        left @ right,
        between(recording.distance),
        np.linalg.norm(velocity, axis=-1),
    )


def camera_path(creature: Creature, recording: Recording, clip: Clip, stage: Stage) -> CameraPath:
    """The camera that looks at these frames, over whatever stands in its way."""
    width, height = stage.size
    look, lit = stage.look, np.isfinite(recording.goal).all()
    first, turn = look.elevation if lit else look.side_elevation, None
    if (aspect := aspect_of(stage.camera, len(clip.time))) is not None:
        turn, first = aspect

    def at(elevation: float) -> CameraPath:
        return follow(
            clip.position,
            recording.goal,
            animal_reach(creature),
            stage.rate,
            width / height,
            elevation,
            turn,
        )

    path, ground = at(first), stage.ground
    if stage.surface is None and (ground is None or stage.level is not None):
        return path
    margin = _CLEARANCE * animal_radius(creature, clip)

    def top(place: np.ndarray) -> np.ndarray:
        if ground is None:
            return np.full(place.shape[:-1], -np.inf)
        tops = [obstacle_top(obstacle, place) for obstacle in ground.obstacles]
        return np.maximum.reduce([heights(ground.floor, place), *tops])

    for elevation in _ELEVATIONS[first < _ELEVATIONS]:
        free = stage.surface is None or (path.position[:, 2] > stage.surface + margin).all()
        if isinstance(turn, np.ndarray):
            # Wherever it comes by it stays above the ground.
            free = free and (path.position[:, 2] > top(path.position[:, :2]) + margin).all()
        if free and hidden(path, clip.position, top, margin) <= _HIDDEN:
            break
        path = at(elevation)
    return path


def _set_scene(
    plotter: pv.Plotter, creature: Creature, recording: Recording, clip: Clip, stage: Stage
) -> Callable[[int], None]:
    """Build everything that the film shows; returns what brings a frame onto the screen."""
    look = stage.look
    camera = camera_path(creature, recording, clip, stage)
    half_extents = np.array([body.shape.half_extents for body in creature.bodies])
    reach = animal_reach(creature)
    radius = animal_radius(creature, clip)
    lit = bool(np.isfinite(recording.goal).all())
    shown = np.concatenate([camera.focus, recording.goal[None]]) if lit else camera.focus
    lowest = min(clip.position[..., 2].min() - reach, shown[:, 2].min())
    floor = lowest - FLOOR_DEPTH * radius if stage.level is None else stage.level
    spacing = grid_spacing(2 * radius)
    centre = clip.position.mean(1)
    head = clip.position[:, head_index(creature)]
    sights = camera.focus - camera.position
    away = float(np.linalg.norm(sights[0]))
    sight = sights[0] / away
    # Since the first frame.
    turned = np.arctan2(sights[:, 1], sights[:, 0]) - np.arctan2(sight[1], sight[0])
    turned[np.abs(np.sin(turned / 2)) < 1e-9] = 0.0
    marks = None
    if stage.ground is not None:
        # Of the root, as the distance of a recording without a light.
        way = clip.position[:, next(i for i, b in enumerate(creature.bodies) if b.joint is None)]
        bearing = course(way, recording.goal, radius / 10)
        marks = Marks(way[0, :2], bearing, mark_spacing(2 * radius))
        spacing = marks.spacing / CELLS
    terrain = None
    if stage.surface is not None or (stage.ground is not None and stage.level is None):
        ground = Plane(height=floor) if stage.ground is None else stage.ground.floor
        filmed = np.concatenate([shown, clip.position.reshape(-1, 3)])[:, :2]
        terrain = make_terrain(ground, filmed, radius, HORIZON * look.visibility * radius)
    if stage.ground is not None:
        # Where it swims its way stays in the water.
        deep = np.inf if look.particles else None
        water = deep if stage.surface is None else stage.surface
        head = _laid_down(head, floor if terrain is None else terrain, water, radius)

    # Translucent actors are drawn in the order in which they are added: what lies in the plane of
    # the floor comes after it, the light and the trail over the shadows, the water over all.
    move_sky = add_sky(plotter, look, sight, away)
    sun = sun_direction(look, sight)
    if terrain is None:
        moving = [add_floor(plotter, look, floor, radius, spacing, marks)]
        if marks is not None:
            moving.append(add_numbers(plotter, look, marks, centre, floor, radius, sight, away))
        shadows = [
            add_sun_shadows(plotter, look, creature, floor, sun),
            add_shadows(plotter, look, floor, half_extents),
        ]
        if marks is not None:
            shadows.append(add_contacts(plotter, look, creature, floor))
    else:
        moving, shadows = _add_terrain(
            plotter, creature, clip, stage, terrain, marks, spacing, sight, sun, away
        )
        if lit:
            add_draped_light(plotter, look, terrain, recording.goal, radius)
    face_viewer = None
    if lit:
        height = floor if terrain is None else None
        face_viewer = add_goal_light(plotter, look, recording.goal, height, radius, sight)
    grow_trail = add_trail(plotter, look, head, 0.0065 * radius, _TRAIL_FADE * stage.rate)
    if look.particles:
        depths = floor if terrain is None else terrain
        add_particles(plotter, shown, depths, radius, stage.oversampling, stage.surface)
    flow = None
    if terrain is not None and stage.surface is not None:
        flow = add_water(plotter, look, terrain, stage.surface, radius, sight)
        shadows.append(add_waterlines(plotter, stage.surface, half_extents, radius))
    bodies = add_bodies(plotter, creature, look.ambient)
    grid = f"grid {spacing:g} m" + (f", {stage.speed:g} x speed" if stage.speed != 1 else "")
    caption = add_captions(
        plotter,
        look,
        stage.title,
        distance="to the light" if lit else "way made",
        note=f"{stage.note}; {grid}" if stage.note else grid,
        height=stage.size[1],
        scale=stage.oversampling,
    )
    plotter.camera.view_angle = camera.view_angle
    plotter.camera.up = (0.0, 0.0, 1.0)
    # Makes the window, in which nothing need be drawn yet; without it VTK resets the camera later.
    plotter.renderer.SetDraw(False)
    plotter.show(auto_close=False, interactive=False)
    plotter.renderer.SetDraw(True)

    def show(frame: int) -> None:
        plotter.camera.position = camera.position[frame]
        plotter.camera.focal_point = camera.focus[frame]
        plotter.camera.clipping_range = (0.05 * away, 20 * away)
        move_sky(camera.position[frame], turned[frame])
        if face_viewer is not None:
            face_viewer(turned[frame])
        for move in moving:
            move(camera.focus[frame], turned[frame])
        for move in shadows:
            move(clip.position[frame], clip.rotation[frame])
        if flow is not None:
            flow(camera.focus[frame], camera.position[frame], clip.time[frame], turned[frame])
        grow_trail(frame)
        for actors, place, turn in zip(
            bodies, clip.position[frame], clip.rotation[frame], strict=True
        ):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = turn, place
            for actor in actors:
                actor.user_matrix = pose
        elapsed = clip.time[frame] - clip.time[0]
        caption(elapsed, float(clip.distance[frame]), clip.speed[frame])
        plotter.render()

    return show


def _add_terrain(
    plotter: pv.Plotter,
    creature: Creature,
    clip: Clip,
    stage: Stage,
    terrain: Terrain,
    marks: Marks | None,
    spacing: float,
    sight: np.ndarray,
    sun: np.ndarray,
    away: float,
) -> tuple[list[Update], list[Callable[[np.ndarray, np.ndarray], None]]]:
    """Ground that is not level, its obstacles, and what lies on it."""
    look, surface, radius = stage.look, stage.surface, animal_radius(creature, clip)
    net = marks or Marks(np.zeros(2), 0.0, CELLS * spacing)
    moving = [add_relief(plotter, look, terrain, radius, spacing, net, sight, sun, surface)]

    def dry(place: np.ndarray) -> np.ndarray:
        high = terrain.height(place) + LIFT * radius
        return high if surface is None else np.where(high > surface, high, np.nan)

    if marks is not None:
        centre = clip.position.mean(1)
        moving.append(add_numbers(plotter, look, marks, centre, dry, radius, sight, away))
    obstacles = () if stage.ground is None else stage.ground.obstacles
    add_obstacles(plotter, obstacles, look.ambient)
    if obstacles:
        shades = [obstacle_mesh(obstacle, shade=True) for obstacle in obstacles]
        meshes, places, turns = zip(*shades, strict=True)
        half_extents = np.array([np.ptp(np.asarray(mesh.points), axis=0) / 2 for mesh in meshes])
        for lay in (
            add_draped_patches(plotter, look, terrain, half_extents, radius),
            add_draped_shadows(plotter, look, list(meshes), terrain, sun, radius),
        ):
            lay(np.array(places), np.array(turns))
    bodies = [shape_mesh(body.shape) for body in creature.bodies]
    half_extents = np.array([body.shape.half_extents for body in creature.bodies])
    shadows = [
        add_draped_shadows(plotter, look, bodies, terrain, sun, radius),
        add_draped_patches(plotter, look, terrain, half_extents, radius),
        add_draped_contacts(plotter, look, creature, terrain, radius),
    ]
    return moving, shadows


def _laid_down(
    path: np.ndarray, ground: float | Terrain, surface: float | None, radius: float
) -> np.ndarray:
    """A way on the ground, or through the water where there is water."""
    if not isinstance(ground, Terrain):
        return path * [1.0, 1.0, 0.0] + [0.0, 0.0, ground]
    lift = LIFT * radius
    low = ground.height(path[:, :2]) + lift
    top = low if surface is None else np.maximum(low, surface + lift)
    return np.column_stack([path[:, :2], np.clip(path[:, 2], low, top)])


def surface_is_seen(creature: Creature, clip: Clip, ground: Ground | None, surface: float) -> bool:
    """Whether the animal, or land near its way, rises out of the water."""
    for i, body in enumerate(creature.bodies):
        # Upwards, in the body's frame.
        ups = clip.rotation[:, i, 2]
        tops = [body.shape.support(up) @ up for up in ups]
        if (clip.position[:, i, 2] + tops).max() > surface:
            return True
    if ground is None:
        return False
    near = _NEARBY * animal_radius(creature, clip)
    way = clip.position.reshape(-1, 3)[:, :2]
    return bool(make_terrain(ground.floor, way, near / 4, near).z.max() > surface)


def animal_radius(creature: Creature, clip: Clip) -> float:
    """Distance of the animal's far ends from its middle at the start, m."""
    start = clip.position[0]
    return float(np.linalg.norm(start - start.mean(0), axis=-1).max()) + animal_reach(creature)


def animal_reach(creature: Creature) -> float:
    """Largest distance from a body's centre that a part of it may have, m."""
    return max(body.shape.reach for body in creature.bodies)


def _frames(
    clip: Clip, seconds: float | None, still: bool, sheet: tuple[int, int] | None
) -> Sequence[int]:
    """The frames of a clip that are shown: all, that of an instant, or those of a sheet."""
    if still:
        instant = np.median(clip.time) if seconds is None else clip.time[0] + seconds
        return [int(np.abs(clip.time - instant).argmin())]
    return range(len(clip.time)) if sheet is None else _moments(len(clip.time), sheet)


def _moments(frames: int, sheet: tuple[int, int]) -> list[int]:
    """The frames that a sheet of so many columns and rows shows."""
    columns, rows = sheet
    if min(sheet) < 1:
        raise SettingError(f"sheet is {columns}x{rows}; it needs a column and a row at least")
    if frames < columns * rows:
        raise SettingError(
            f"the film has {frames} frames, fewer than a sheet of {columns}x{rows} shows; "
            "more frames per second or fewer moments would do"
        )
    return np.linspace(0, frames - 1, columns * rows).round().astype(int).tolist()


def _grid(count: int, columns: int | None) -> tuple[int, int]:
    """Columns and rows of so many pictures."""
    if columns is None:
        columns = _COLUMNS[count] if count < len(_COLUMNS) else int(np.ceil(np.sqrt(count)))
    return columns, -(-count // columns)


def _check(panel: Panel, size: tuple[int, int], fps: float, speed: float) -> None:
    creature, recording, world = panel.creature, panel.recording, panel.world
    if panel.surface is not None and not np.isfinite(panel.surface):
        raise ValueError(
            f"surface is {panel.surface:g}; it must be finite, or None where there is none"
        )
    if world not in LOOKS:
        raise ValueError(f"world is {world!r}; choose {' or '.join(LOOKS)}")
    if min(size) < 16:
        raise SettingError(f"size is {size[0]} x {size[1]} pixels; the smallest is 16 x 16")
    if panel.signals is not None and (size[0] < SMALLEST[0] or size[1] < SMALLEST[1]):
        raise SettingError(
            f"size is {size[0]} x {size[1]} pixels; the smallest with signals is "
            f"{SMALLEST[0]} x {SMALLEST[1]}"
        )
    for name, value in (("fps", fps), ("speed", speed)):
        if not 0 < value < np.inf:
            raise SettingError(f"{name} is {value:g}; it must be positive and finite")
    if not len(recording.time):
        raise ValueError("the recording is empty: it holds no instant")
    if recording.position.shape[1] != len(creature.bodies):
        raise ValueError(
            f"the recording has {recording.position.shape[1]} bodies, "
            f"but {creature.name!r} has {len(creature.bodies)}; they do not belong together"
        )
    finite = np.isfinite(recording.position).all((1, 2)) & np.isfinite(recording.rotation).all(
        (1, 2, 3)
    )
    if not finite.all():
        raise ValueError(
            f"the recording diverges at {recording.time[finite.argmin()]:g} s: "
            "positions or rotations are not finite from there on"
        )
