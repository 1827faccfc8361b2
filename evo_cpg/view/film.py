"""Films and stills of a recording, rendered off screen.

The scene is built once: each ``add_...`` function puts actors into the plotter and, where they
change from frame to frame, returns a function that moves them or overwrites arrays in place;
nothing is meshed again. Frames are rendered larger than the film and averaged down by ffmpeg,
which smooths edges, thin lines and text.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyvista as pv
from jaxtyping import Float

from evo_cpg.creature.creature import Creature
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.camera import CameraPath, course, follow, smooth
from evo_cpg.view.captions import add_captions
from evo_cpg.view.goal_light import add_goal_light
from evo_cpg.view.ground import Marks, add_floor, add_numbers, grid_spacing, mark_spacing
from evo_cpg.view.look import LOOKS, Look
from evo_cpg.view.meshes import add_bodies, head_index
from evo_cpg.view.offscreen import canvas, pixels
from evo_cpg.view.output import FILM_SUFFIXES, frame_writer, output_path
from evo_cpg.view.particles import add_particles
from evo_cpg.view.shadows import add_contacts, add_shadows, add_sun_shadows
from evo_cpg.view.sky import add_sky, sun_direction
from evo_cpg.view.textures import CELLS
from evo_cpg.view.trail import add_trail

# Pixels rendered per pixel of the result, a side. On one core of a software renderer a frame of
# 1280 x 720 costs 46 ms at 1.25, 58 ms at 1.5, which looks hardly better, and 100 ms at 2.
_FILM_OVERSAMPLING = 1.25
_STILL_OVERSAMPLING = 3.0
# Window of the displayed speed, s: long enough to average a tail beat.
_SPEED_WINDOW = 0.5
# The floor lies this many radii of the animal below the lowest point of its way through water.
_DEPTH = 0.55
# Time in which the trail fades to a third, s.
_TRAIL_FADE = 4.0


class Stage(NamedTuple):
    """How a film is made.

    Attributes:
        look: of the world.
        title: caption.
        size: width and height of the film, pixels.
        oversampling: pixels rendered per pixel of the film, a side.
        rate: frames per second of recorded time.
        speed: recorded seconds per second of film.
        ground: z of the ground, m; None where there is none.
    """

    look: Look
    title: str
    size: tuple[int, int]
    oversampling: float
    rate: float
    speed: float
    ground: float | None = None


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


def film(
    creature: Creature,
    recording: Recording,
    path: str | os.PathLike[str],
    *,
    size: tuple[int, int] = (1280, 720),
    fps: float = 30.0,
    seconds: float | None = None,
    speed: float = 1.0,
    title: str | None = None,
    world: str = "water",
    ground: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render a recording.

    Args:
        creature: the animal.
        recording: its motion; without a light (the goal is not finite) the caption tells how far
            the animal has come.
        path: ``.mp4`` (H.264) or ``.gif`` for a film, ``.png`` for a still.
        size: width and height, pixels; rounded down to even numbers.
        fps: frames per second of the film.
        seconds: recorded time to show, s; all of it by default. Of a still: the instant it
            shows, the middle by default.
        speed: recorded seconds per second of film.
        title: caption; the creature's name by default.
        world: where the animal lives, ``water`` or ``land``.
        ground: z of the ground that carries the animal, m, with distances from the start painted
            on it; by default there is none, and a floor is drawn below the animal's way.
        progress: called with the number of frames done and their total.

    Returns:
        The path.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
        ValueError: a setting out of range, or a recording that does not fit the creature, is
            empty or not finite.
    """
    path = output_path(path, FILM_SUFFIXES)
    _check(creature, recording, size, fps, speed, world)
    if ground is not None and not np.isfinite(ground):
        raise ValueError(f"ground is {ground:g}; it must be finite, or None where there is none")
    if seconds is not None and seconds < 0:
        raise ValueError(f"seconds is {seconds:g}; it must not be negative")
    clip = sample(recording, fps, speed, None if path.suffix.lower() == ".png" else seconds)
    frames = range(len(clip.time))
    oversampling = _FILM_OVERSAMPLING
    if path.suffix.lower() == ".png":
        instant = recording.time[0] + seconds if seconds is not None else np.median(clip.time)
        frames = [int(np.abs(clip.time - instant).argmin())]
        oversampling = _STILL_OVERSAMPLING
    width, height = (max(side // 2 * 2, 2) for side in size)
    rendered = (round(width * oversampling), round(height * oversampling))

    stage = Stage(
        look=LOOKS[world],
        title=creature.name if title is None else title,
        size=(width, height),
        oversampling=oversampling,
        rate=fps / speed,
        speed=speed,
        ground=ground,
    )
    with canvas(rendered) as plotter:
        show = _set_scene(plotter, creature, recording, clip, stage)
        with frame_writer(path, (width, height), rendered, fps) as write:
            for done, frame in enumerate(frames):
                show(frame)
                write(pixels(plotter))
                if progress is not None:
                    progress(done + 1, len(frames))
    return path


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
    """The camera that looks at these frames."""
    width, height = stage.size
    look, lit = stage.look, np.isfinite(recording.goal).all()
    return follow(
        clip.position,
        recording.goal,
        _reach(creature),
        stage.rate,
        width / height,
        look.elevation if lit else look.side_elevation,
    )


def _set_scene(
    plotter: pv.Plotter, creature: Creature, recording: Recording, clip: Clip, stage: Stage
) -> Callable[[int], None]:
    """Build everything that the film shows; returns what brings a frame onto the screen."""
    look = stage.look
    camera = camera_path(creature, recording, clip, stage)
    half_extents = np.array([body.shape.half_extents for body in creature.bodies])
    reach = _reach(creature)
    radius = np.linalg.norm(clip.position[0] - clip.position[0].mean(0), axis=-1).max() + reach
    lit = bool(np.isfinite(recording.goal).all())
    shown = np.concatenate([camera.focus, recording.goal[None]]) if lit else camera.focus
    lowest = min(clip.position[..., 2].min() - reach, shown[:, 2].min())
    floor = lowest - _DEPTH * radius if stage.ground is None else stage.ground
    spacing = grid_spacing(2 * radius)
    centre = clip.position.mean(1)
    head = clip.position[:, head_index(creature)]
    sight = camera.focus[0] - camera.position[0]
    away = float(np.linalg.norm(sight))
    sight = sight / away
    marks = None
    if stage.ground is not None:
        # Of the root, as the distance of a recording without a light.
        way = clip.position[:, next(i for i, b in enumerate(creature.bodies) if b.joint is None)]
        bearing = course(way, recording.goal, radius / 10)
        marks = Marks(way[0, :2], bearing, mark_spacing(2 * radius))
        spacing = marks.spacing / CELLS
        head = head * [1.0, 1.0, 0.0] + [0.0, 0.0, floor]

    # Translucent actors are drawn in the order in which they are added: what lies in the plane of
    # the floor comes after it, the light and the trail over the shadows.
    move_sky = add_sky(plotter, look, sight, away)
    move_floor = add_floor(plotter, look, floor, radius, spacing, marks)
    moving = []
    if marks is not None:
        moving.append(add_numbers(plotter, look, marks, centre, floor, radius, sight, away))
    sun = sun_direction(look, sight)
    shadows = [
        add_sun_shadows(plotter, look, creature, floor, sun),
        add_shadows(plotter, look, floor, half_extents),
    ]
    if marks is not None:
        shadows.append(add_contacts(plotter, look, creature, floor))
    if lit:
        add_goal_light(plotter, look, recording.goal, floor, radius, sight)
    grow_trail = add_trail(plotter, look, head, 0.0065 * radius, _TRAIL_FADE * stage.rate)
    if look.particles:
        add_particles(plotter, shown, floor, radius, stage.oversampling)
    bodies = add_bodies(plotter, creature, look.ambient)
    caption = add_captions(
        plotter,
        look,
        stage.title,
        distance="to the light" if lit else "way made",
        note=f"grid {spacing:g} m" + (f", {stage.speed:g} x speed" if stage.speed != 1 else ""),
        height=stage.size[1],
        scale=stage.oversampling,
    )
    plotter.camera.view_angle = camera.view_angle
    plotter.camera.up = (0.0, 0.0, 1.0)
    # Renders once, which makes the window; without it VTK resets the camera later.
    plotter.show(auto_close=False, interactive=False)

    def show(frame: int) -> None:
        plotter.camera.position = camera.position[frame]
        plotter.camera.focal_point = camera.focus[frame]
        plotter.camera.clipping_range = (0.05 * away, 20 * away)
        move_sky(camera.position[frame])
        for move in (move_floor, *moving):
            move(camera.focus[frame])
        for move in shadows:
            move(clip.position[frame], clip.rotation[frame])
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


def _reach(creature: Creature) -> float:
    """Largest distance from a body's centre to its surface, m."""
    return max(float(np.linalg.norm(body.shape.half_extents)) for body in creature.bodies)


def _check(
    creature: Creature,
    recording: Recording,
    size: tuple[int, int],
    fps: float,
    speed: float,
    world: str,
) -> None:
    if world not in LOOKS:
        raise ValueError(f"world is {world!r}; choose {' or '.join(LOOKS)}")
    if min(size) < 16:
        raise ValueError(f"size is {size[0]} x {size[1]} pixels; the smallest is 16 x 16")
    for name, value in (("fps", fps), ("speed", speed)):
        if not 0 < value < np.inf:
            raise ValueError(f"{name} is {value:g}; it must be positive")
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
