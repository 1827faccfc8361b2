"""A story in one film: takes one after the other that dissolve into each other, and few words.

A take shows an animal, perhaps with others in lanes beside it. Its camera moves from view to view.
Takes of a crowd share a view that stands still, so generations can be compared. The last take
follows the champion.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.view.camera import SMOOTHING, CameraPath, between, overview, smooth
from evo_cpg.view.captions import Words, pointer, tags_of, written
from evo_cpg.view.drawing import set_scene
from evo_cpg.view.film import drawn_frames
from evo_cpg.view.legible import lettering
from evo_cpg.view.meshes import add_bodies
from evo_cpg.view.offscreen import canvas
from evo_cpg.view.output import check_size, film_writer, oversampling
from evo_cpg.view.scene import Clip, Panel, Scene, sample_at, scene_of
from evo_cpg.view.stage import Stage, camera_path

FPS = 30
"""Frames per second of a story."""

DISSOLVE = 0.4
"""Time in which a take turns into the next one, s."""

EASE = 0.5
"""Time in which the motion of a take with a hold reaches its speed, s."""

GLIDE = 0.15
"""Recorded time in which the motion of a take comes to rest, s."""

# Pixels rendered per pixel of the film, along a side.
_OVERSAMPLING = 1.25


class Overview(NamedTuple):
    """A view that stands still and shows some points.

    Attributes:
        points: the points, m.
        bearing: direction in which the animals go, from the x axis, rad.
        elevation: height of the camera above the horizon, rad.
        follows: whether the view moves with the animal, so that it shows the points in the last
            frame.
    """

    points: Float[np.ndarray, "n 3"]
    bearing: float
    elevation: float
    follows: bool = False


class Take(NamedTuple):
    """Part of a story without a cut.

    Attributes:
        panel: the animal, perhaps with a crowd, and its world.
        seconds: length in the film, s. It includes half of the time that it shares with its
            neighbours.
        start: first instant of the recording that is shown, s.
        speed: recorded seconds per second of film.
        views: times in the take, s, and the views that the camera reaches at them. None is a view
            that follows the animal.
        hold: time in the film before the motion begins, s.
        goal: place that the arrow points to if there is no light, m, and its name.
        stop: instant of the recording at which the motion begins to come to rest, s, or None.
    """

    panel: Panel
    seconds: float
    start: float
    speed: float
    views: Sequence[tuple[float, Overview | None]] = ((0.0, None),)
    hold: float = 0.0
    goal: tuple[Float[np.ndarray, "3"], str] | None = None
    stop: float | None = None


class StoryFrames:
    """Frames of a story, laid out in a size (pixels) and ready to be drawn in order: a `Reel`."""

    def __init__(self, takes: Sequence[Take], size: tuple[int, int]):
        self._takes = takes
        width, height = self.size = size[0] // 2 * 2, size[1] // 2 * 2
        self._scale = oversampling(self.size, _OVERSAMPLING)
        self.rendered = round(width * self._scale), round(height * self._scale)
        self._spans = spans([take.seconds for take in takes])
        self.count = self._spans[-1][1]

    @contextlib.contextmanager
    def drawn(self) -> Iterator[Callable[[int], np.ndarray]]:
        """Yield a function that draws frames, see `Reel.drawn`. At most two scenes are kept."""
        open_takes: dict[int, tuple[contextlib.ExitStack, Callable[[int], np.ndarray]]] = {}

        def draw(frame: int) -> np.ndarray:
            shown = [i for i, (first, end) in enumerate(self._spans) if first <= frame < end]
            pictures = []
            for number in shown:
                if number not in open_takes:
                    for other in [each for each in open_takes if each < number - 1]:
                        open_takes.pop(other)[0].close()
                    stack = contextlib.ExitStack()
                    open_takes[number] = stack, stack.enter_context(self._take(number))
                pictures.append(open_takes[number][1](frame - self._spans[number][0]))
            if len(shown) != 2:
                return pictures[0]
            first, end = self._spans[shown[1]][0], self._spans[shown[0]][1]
            weight = float(eased(np.array((frame - first + 1) / (end - first + 1))))
            before, after = (picture.astype(np.float32) for picture in pictures)
            return (before * (1 - weight) + after * weight + 0.5).astype(np.uint8)

        try:
            yield draw
        finally:
            for stack, _ in open_takes.values():
                stack.close()

    @contextlib.contextmanager
    def _take(self, number: int) -> Iterator[Callable[[int], np.ndarray]]:
        """Draw the frames of one take: ``(height, width, 3)``, bottom row first."""
        take, (first, end) = self._takes[number], self._spans[number]
        clip = clip_of(take, end - first)
        scene = scene_of(take.panel, clip)
        aspect = self.size[0] / self.size[1]
        with canvas(self.rendered) as plotter:
            camera = camera_of(take, scene, aspect)
            wide = any(view is not None for _, view in take.views)
            stage = Stage(plotter, scene, camera, self._scale, wide=wide)
            goal, name = (scene.goal, "light") if take.goal is None else take.goal
            # The first take has the title at its top.
            point = pointer(camera, goal, scene.look, self.rendered, name, titled=number == 0)
            ahead = np.ones(end - first, bool)
            if take.goal is not None:
                # No arrow points back to a finish.
                centre = clip.position.mean(1)
                start = take.panel.recording.position[0].mean(0)
                ahead = (take.goal[0] - centre) @ (take.goal[0] - start) > 0
            shared = round(DISSOLVE * FPS)
            alone = shared * (number > 0), shared * (number < len(self._takes) - 1)
            tag = tags_of(camera, scene, self.rendered, alone)
            show = set_scene(stage, add_bodies(plotter, take.panel.creature, scene.look.ambient))

            def draw(frame: int) -> np.ndarray:
                seen = show(frame)
                if ahead[frame]:
                    point(seen, frame)
                tag(seen, frame)
                return seen

            yield draw


def spans(seconds: Sequence[float]) -> list[tuple[int, int]]:
    """Return the first frame of every take, and the frame after its last one.

    Takes share the frames in which one turns into the next. The sum of their lengths (s) is the
    length of the film.
    """
    ends = np.round(np.cumsum([0.0, *seconds]) * FPS).astype(int)
    half = round(DISSOLVE * FPS / 2)
    last = len(seconds) - 1
    return [
        (int(ends[i]) - half * (i > 0), int(ends[i + 1]) + half * (i < last))
        for i in range(len(seconds))
    ]


def clip_of(take: Take, count: int) -> Clip:
    """Return a take's recording at its frames. The motion starts gently, and comes to rest."""
    moving = np.maximum(np.arange(count) / FPS - take.hold, 0.0)
    eased = np.where(moving < EASE, moving**2 / (2 * EASE), moving - EASE / 2)
    time = take.start + take.speed * (eased if take.hold else moving)
    if take.stop is not None:
        after = np.maximum(time - take.stop, 0.0)
        time = np.minimum(time, take.stop) + GLIDE * (1 - np.exp(-after / GLIDE))
    recording = take.panel.recording
    return sample_at(recording, np.minimum(time, recording.time[-1]), FPS / take.speed)


def camera_of(take: Take, scene: Scene, aspect: float) -> CameraPath:
    """Return the camera of a take in all of its frames."""
    count, paths = len(scene.clip.time), []
    seconds = np.arange(count) / FPS
    for _, view in take.views:
        if view is None:
            paths.append(camera_path(scene, "follow", aspect, close=True))
            continue
        path = overview(view.points, view.bearing, view.elevation, aspect)
        if view.follows:
            centre = smooth(scene.clip.position.mean(1), SMOOTHING * scene.clip.rate)
            moved = centre - centre[-1]
            path = path._replace(position=path.position + moved, focus=path.focus + moved)
        paths.append(path)
    found = paths[0]
    for (start, _), (end, _), after in zip(take.views, take.views[1:], paths[1:], strict=False):
        found = between(found, after, eased((seconds - start) / (end - start)))
    if len(found.position) == count:
        return found
    return CameraPath(
        found.position.repeat(count, 0), found.focus.repeat(count, 0), found.view_angle
    )


def eased(part: Float[np.ndarray, " *n"]) -> Float[np.ndarray, " *n"]:
    """Return numbers from 0 to 1 that start and end gently, for parts from 0 to 1."""
    part = np.clip(part, 0.0, 1.0)
    return part * part * (3 - 2 * part)


def story_film(
    takes: Sequence[Take],
    words: Sequence[Words],
    path: Path,
    size: tuple[int, int],
    *,
    processes: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a story to a film of a size (pixels), with words at times of the film.

    Args:
        takes: the takes.
        words: the texts.
        path: path checked by `evo_cpg.view.output.output_path`.
        size: width and height, pixels.
        processes: number of processes that draw.
        progress: function that receives the number of finished frames and their total.

    Raises:
        SettingError: the size is out of range.
        OutputError: the film cannot be written.
    """
    check_size(size)
    frames, ends = StoryFrames(takes, size), np.cumsum([take.seconds for take in takes])
    styles = [
        scene_of(take.panel._replace(crowd=None), clip_of(take, round(take.seconds * FPS))).look
        for take in takes
    ]
    with (
        drawn_frames(frames, processes) as drawn,
        film_writer(path, frames.size, frames.rendered, FPS) as write,
    ):
        for number, bare in enumerate(drawn):
            # A picture from another process cannot be changed.
            frame = bare if bare.flags.writeable else bare.copy()
            time = number / FPS
            look = styles[min(int((ends <= time).sum()), len(styles) - 1)]
            with lettering(frame) as draw:
                for each in words:
                    written(draw, each, time, look, frames.rendered)
            write(frame)
            if progress is not None:
                progress(number + 1, frames.count)
    return path
