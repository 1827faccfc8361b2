"""Films, stills and sheets of recordings, rendered off screen by one or several processes.

Frames are rendered larger than the film and averaged down, which smooths edges, thin lines and
text. A software renderer leaves cores idle, so several processes may draw. Each builds the whole
scene once. A frame does not depend on the process that draws it, except on uneven ground. The
horizon follows the focus in steps there, so an opacity may differ by one of 255 levels.
"""

import atexit
import contextlib
import dataclasses
import itertools
import math
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Protocol

import jax
import numpy as np
from PIL import Image

from evo_cpg.files import OutputError, in_one_piece
from evo_cpg.view.camera import BodyBoxes, aspect_of, zoomed
from evo_cpg.view.captions import captions, growth_captions, pointer, wall_captions
from evo_cpg.view.drawing import set_scene
from evo_cpg.view.legible import lettering, write
from evo_cpg.view.meshes import add_bodies
from evo_cpg.view.offscreen import CELLS, canvas
from evo_cpg.view.output import (
    FILM_SUFFIXES,
    PICTURE_SUFFIXES,
    SettingError,
    check_size,
    film_writer,
    is_numbered,
    output_path,
    oversampling,
    picture_of,
    save_numbered,
)
from evo_cpg.view.scene import Clip, Panel, check_panel, sample, scene_of
from evo_cpg.view.signals import FRACTION, LOWEST, SMALLEST, Strip
from evo_cpg.view.stage import Stage, camera_path
from evo_cpg.view.wall import hung, wall_view

# Pixels rendered per pixel of the result, along a side. A frame of 1280 x 720 costs 46 ms at 1.25
# and 100 ms at 2 on one core of a software renderer. It costs 58 ms at 1.5, which looks hardly
# better.
_FILM_OVERSAMPLING = 1.25
_STILL_OVERSAMPLING = 3.0
# Gaps in pixels: between pictures of a sheet and animals side by side, height of a heading, and
# between moments. A sheet of several animals has a heading above each moment.
_GUTTER, _HEAD, _GAP = 4, 40, 24
# Height of a heading's letters, as a fraction of its line.
_HEADING = 0.6
# Growing animals: light and elevation of the camera, rad, and colour of new parts.
_GROWING = {"ambient": 0.5, "side_elevation": math.radians(35)}
_FRESH = np.array([1.0, 0.9, 0.25])
# Columns by number of animals. For more animals it is the square root, rounded up.
_COLUMNS = (1, 1, 2, 3, 2)


@dataclasses.dataclass(frozen=True)
class Film:
    """Settings of a film, a still or a sheet.

    Attributes:
        size: width and height of each animal's picture, pixels, rounded down to even numbers.
        fps: frames per second of the film.
        seconds: recorded time to show, s, or None for the whole recording. For a still: the shown
            instant, or None for the middle.
        speed: recorded seconds per second of film.
        camera: ``follow`` (from behind towards the light, or without a light from the side and a
            little ahead), ``side``, ``top`` or ``orbit`` (once around).
        sheet: columns and rows of moments in one picture, each with all animals. They run evenly
            from the first moment of the film to the last. Moments of a shorter recording lie closer
            together. A sheet of several animals has a column with a heading for each moment: its
            time or, if the recordings differ in length, its part of each film. None for a film or a
            still.
        columns: columns of animals. If None: 1, 2, 3 and 2 columns for one to four animals, and for
            more the square root of their number, rounded up. On a sheet of several animals, 1.
    """

    size: tuple[int, int] = (640, 360)
    fps: float = 30.0
    seconds: float | None = None
    speed: float = 1.0
    camera: str = "follow"
    sheet: tuple[int, int] | None = None
    columns: int | None = None


class Frames:
    """Frames of animals, row by row, laid out and ready to be drawn in any order, as a `Reel`.

    Raises:
        SettingError: the sheet has more moments than the film has frames.
    """

    def __init__(self, panels: Sequence[Panel], film: Film, still: bool = False):
        self._panels, self._film, sheet = panels, film, film.sheet
        end = None if still else film.seconds
        self._clips = [sample(one.recording, film.fps, film.speed, end) for one in panels]
        self._instants = [_instants(clip, film.seconds, still, sheet) for clip in self._clips]
        self.count = max(map(len, self._instants))
        finely = still or sheet is not None
        self._scale = scale = oversampling(
            film.size, _STILL_OVERSAMPLING if finely else _FILM_OVERSAMPLING
        )
        self._one = width, height = film.size[0] // 2 * 2, film.size[1] // 2 * 2
        self._grouped = sheet is not None and len(panels) > 1
        columns = 1 if self._grouped and film.columns is None else film.columns
        if columns is None:
            most = len(panels)
            columns = _COLUMNS[most] if most < len(_COLUMNS) else int(np.ceil(np.sqrt(most)))
        self._columns, rows = columns, -(-len(panels) // columns)
        head = _HEAD if self._grouped else 0
        self.size = (
            self._columns * (width + _GUTTER) - _GUTTER,
            rows * (height + _GUTTER) - _GUTTER + head,
        )
        self._head = round(head * scale)
        self._pitch = round((width + _GUTTER) * scale), round((height + _GUTTER) * scale)
        self._rows = rows
        self.rendered = (
            (self._columns - 1) * self._pitch[0] + round(width * scale),
            (rows - 1) * self._pitch[1] + round(height * scale) + self._head,
        )

    @contextlib.contextmanager
    def drawn(self) -> Iterator[Callable[[int], np.ndarray]]:
        """Build the scenes of all animals, and yield a function that draws frames (see `Reel`)."""
        # The gaps stay white. The picture of each animal fills its place.
        picture = np.full((self.rendered[1], self.rendered[0], 3), 255, np.uint8)
        with contextlib.ExitStack() as stack:
            shows = [
                stack.enter_context(self._panel(panel, clip))
                for panel, clip in zip(self._panels, self._clips, strict=True)
            ]

            def draw(number: int) -> np.ndarray:
                if self._grouped:
                    clips = zip(self._clips, self._instants, strict=True)
                    times = {
                        f"{clip.time[own[number]] - clip.time[0]:.1f} s" for clip, own in clips
                    }
                    last = self.count - 1
                    # Recordings of different lengths have no common time.
                    words = "end" if number == last else f"{number / last:.0%} of each film"
                    words = times.pop() if len(times) == 1 else words
                    head = picture[-self._head :]
                    head[:] = 255
                    with lettering(head) as pen:
                        middle = self.rendered[0] / 2, self._head / 2
                        write(pen, words, middle, _HEADING * self._head, "black", anchor="mm")
                for i, (show, own) in enumerate(zip(shows, self._instants, strict=True)):
                    seen = show(own[min(number, len(own) - 1)])
                    if len(shows) == 1:
                        return seen
                    # The first row of the array is the lowest row of pixels.
                    below = (self._rows - 1 - i // self._columns) * self._pitch[1]
                    left = i % self._columns * self._pitch[0]
                    picture[below : below + len(seen), left : left + seen.shape[1]] = seen
                return picture

            yield draw

    def sheet(self, pictures: Iterable[Image.Image]) -> Image.Image:
        """Return a sheet of moments, row by row. A still is a sheet of one moment."""
        columns, rows = self._film.sheet or (1, 1)
        gap = _GAP if self._grouped else _GUTTER
        across, down = self.size[0] + gap, self.size[1] + gap
        sheet = Image.new("RGB", (columns * across - gap, rows * down - gap), "white")
        for number, picture in enumerate(pictures):
            sheet.paste(picture, (number % columns * across, number // columns * down))
        return sheet

    @contextlib.contextmanager
    def _panel(self, panel: Panel, clip: Clip) -> Iterator[Callable[[int], np.ndarray]]:
        """Draw an animal's picture, frame by frame: ``(height, width, 3)``, bottom row first."""
        if panel.exhibits:
            yield from self._wall(panel, clip)
            return
        growth, film, scale = panel.growth, self._film, self._scale
        (width, height), above = self._one, self._one[1]
        if growth is not None:
            now = np.searchsorted(panel.recording.time, clip.time).clip(max=len(growth.fresh) - 1)
            # Whatever moves points of a body by its rotation also gives it its size.
            clip = clip._replace(rotation=clip.rotation * growth.scale[now][..., None, :])
        scene = scene_of(panel, clip)
        strip, strip_height = None, 0
        if panel.signals is not None:
            above -= max(round(FRACTION * height), LOWEST)
            strip = Strip(panel.signals, scene.look, (width, height - above), scale)
            strip_height = strip.height
        title = panel.creature.name if panel.title is None else panel.title
        pace = f", {film.speed:g} x speed" if film.speed != 1 else ""
        note = "; ".join(
            filter(None, [panel.note, f"grid {scene.marks.spacing / CELLS:g} m{pace}"])
        )
        caption = captions(scene.look, title, scene.measured, note, (width, above), scale)
        if growth is not None:
            # From above, limbs on both sides are seen.
            scene = scene._replace(look=dataclasses.replace(scene.look, **_GROWING))
            rendered = round(width * scale), round(height * scale)
            caption = growth_captions(growth, scene.look, rendered)
        with canvas((round(width * scale), round(height * scale) - strip_height)) as plotter:
            camera = camera_path(scene, film.camera, width / above)
            if growth is not None:
                boxes = BodyBoxes(clip.position, clip.rotation, scene.half_extents)
                camera = zoomed(camera, boxes, clip.rate)
            stage = Stage(plotter, scene, camera, scale)
            point = pointer(
                camera, scene.goal, scene.look, (round(width * scale), round(above * scale))
            )
            bodies = add_bodies(plotter, panel.creature, scene.look.ambient)
            show = set_scene(stage, bodies, skins=growth is None)
            skins = [(own[0].prop, np.array(own[0].prop.color.float_rgb)) for own in bodies]

            def draw(instant: int) -> np.ndarray:
                if growth is not None:
                    for (skin, color), new in zip(skins, growth.fresh[now[instant]], strict=True):
                        skin.color = color + new * (_FRESH - color)
                seen, time = show(instant), clip.time[instant]
                point(seen, instant)
                caption(seen, time - clip.time[0], clip.distance[instant], clip.speed[instant])
                return seen if strip is None else np.concatenate([strip.at(time), seen])

            yield draw

    def _wall(self, panel: Panel, clip: Clip) -> Iterator[Callable[[int], np.ndarray]]:
        """Draw many animals as `_panel` draws one."""
        size, scale = self._one, self._scale
        scene = hung(panel, clip, size[0] / size[1])
        view = wall_view(scene, size[0] / size[1])
        caption = wall_captions(panel, scene, view, size, scale)
        with canvas((round(size[0] * scale), round(size[1] * scale))) as plotter:
            show = set_scene(Stage(plotter, scene, view, scale, wide=True), [])

            def draw(instant: int) -> np.ndarray:
                seen = show(instant)
                caption(seen, clip.time[instant] - clip.time[0])
                return seen

            yield draw


def _instants(
    clip: Clip, seconds: float | None, still: bool, sheet: tuple[int, int] | None
) -> Sequence[int]:
    """Return the shown frames of a clip: all, one, or the frames of a sheet."""
    if still:
        instant = np.median(clip.time) if seconds is None else clip.time[0] + seconds
        return [int(np.abs(clip.time - instant).argmin())]
    if sheet is None:
        return range(len(clip.time))
    frames, (columns, rows) = len(clip.time), sheet
    if min(sheet) < 1:
        raise SettingError(f"sheet is {columns}x{rows}, but needs at least 1 column and 1 row")
    if frames < columns * rows:
        raise SettingError(
            f"the film has {frames} frames, fewer than a sheet of {columns}x{rows} shows. "
            "Choose more frames per second or fewer moments"
        )
    return np.linspace(0, frames - 1, columns * rows).round().astype(int).tolist()


def film_path(path: str | os.PathLike[str], film: Film, signals: bool = False) -> Path:
    """Check path (see `side_by_side`) and settings of a film before any recording exists.

    Raises:
        OutputError: the path cannot be written, or has another suffix.
        SettingError: a setting is out of range.
        ValueError: the camera is unknown.
    """
    path = Path(path)
    if film.sheet is None and is_numbered(path):
        folder = path.parent
        if folder.is_dir() and any(folder.iterdir()):
            raise OutputError(
                f"cannot write {path}: the folder {folder} is not empty. Name a new folder"
            )
        if not folder.is_dir() and not folder.parent.is_dir():
            raise OutputError(
                f"cannot write {path}: there is no folder {folder.parent}. Create it first"
            )
        if not os.access(folder.parent, os.W_OK):
            raise OutputError(f"cannot write {path}: no permission to write in {folder.parent}")
    else:
        path = output_path(path, FILM_SUFFIXES if film.sheet is None else PICTURE_SUFFIXES)
    check_size(film.size)
    if signals:
        check_size(film.size, SMALLEST, " with signals")
    for name, value in (("fps", film.fps), ("speed", film.speed)):
        if not 0 < value < math.inf:
            raise SettingError(f"{name} is {value:g}, but must be positive and finite")
    if film.seconds is not None and not film.seconds >= 0:
        raise SettingError(f"seconds is {film.seconds:g}, but must be at least 0")
    aspect_of(film.camera)
    return path


def side_by_side(
    panels: Sequence[Panel],
    path: str | os.PathLike[str],
    film: Film,
    *,
    processes: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render recordings in one film, row by row. Shorter recordings stop at their last frame.

    Args:
        panels: the animals.
        path: ``.mp4`` (H.264), ``.webp`` or ``.gif`` for a film, ``.png`` for a still or a sheet. A
            name such as ``frames/%04d.png`` gives a picture of every frame, counted from 0, in a
            new folder.
        film: settings of the film.
        processes: number of processes that draw a film. Each takes some 400 MB of memory and a few
            seconds to start, so the calling process draws a still or a sheet.
        progress: function that receives the number of finished frames and their total.

    Returns:
        The path, or the folder of the pictures.

    Raises:
        RenderError: one of several processes failed.
        OutputError: the path cannot be written, or has another suffix.
        RecordingError: a recording does not fit its creature, is empty or is not finite.
        SettingError: a setting is out of range.
        ValueError: the world or the camera is unknown.
    """
    path = film_path(path, film, any(panel.signals is not None for panel in panels))
    for panel in panels:
        check_panel(panel)
    numbered = film.sheet is None and is_numbered(path)
    if path.suffix.lower() in PICTURE_SUFFIXES and not numbered:
        image = picture(panels, film, progress)
        with in_one_piece(path) as partial:
            image.save(partial)
        return path
    frames = Frames(panels, film)
    with drawn_frames(frames, processes) as drawn:
        counted = _counted(drawn, frames.count, progress)
        if numbered:
            save_numbered((picture_of(frame, frames.size) for frame in counted), path)
            return path.parent
        with film_writer(path, frames.size, frames.rendered, film.fps) as write:
            for frame in counted:
                write(frame)
    return path


def picture(
    panels: Sequence[Panel], film: Film, progress: Callable[[int, int], None] | None = None
) -> Image.Image:
    """Return a still or, if the film has a sheet, a sheet of moments. See `side_by_side`.

    Raises:
        SettingError: the sheet has more moments than the film has frames.
    """
    frames = Frames(panels, film, still=film.sheet is None)
    with frames.drawn() as draw:
        counted = _counted(map(draw, range(frames.count)), frames.count, progress)
        return frames.sheet(picture_of(frame, frames.size) for frame in counted)


def _counted(
    drawn: Iterable[np.ndarray], count: int, progress: Callable[[int, int], None] | None
) -> Iterator[np.ndarray]:
    for done, frame in enumerate(drawn, 1):
        yield frame
        if progress is not None:
            progress(done, count)


# Starting a process and building its scene takes as long as this many frames. Two processes took as
# long as one for 240 frames of the swimmer on two cores. They took 40 s instead of 47 s for 1000
# frames.
_WORTH = 120
# Most processes: each holds the libraries and a scene, some 400 MB.
_MOST = 8
# Frames for each process that are being drawn, or in memory, at once.
_AHEAD = 3


class Reel(Protocol):
    """Frames that can be drawn in any order, such as `evo_cpg.view.film.Frames`.

    Attributes:
        count: number of frames.
        size: width and height of a frame in the result, pixels.
        rendered: width and height of a frame before averaging, pixels.
    """

    count: int
    size: tuple[int, int]
    rendered: tuple[int, int]

    def drawn(self) -> contextlib.AbstractContextManager[Callable[[int], np.ndarray]]:
        """Build the scenes, and close them at the end of the context.

        Yields:
            A function that draws the frame of a given number: ``(height, width, 3)`` bytes, bottom
            row first. The next call may overwrite the result.
        """
        ...


# Frames to draw, in a process that draws, and the function that draws them.
_laid_out: list[Reel] = []
_drawing: list[Callable[[int], np.ndarray]] = []


class RenderError(RuntimeError):
    """A process that draws frames failed."""


@contextlib.contextmanager
def drawn_frames(frames: Reel, processes: int) -> Iterator[Iterator[np.ndarray]]:
    """Draw all frames, one after the other.

    Args:
        frames: the frames. Each drawing process receives a copy.
        processes: usable cores. For few frames, this process draws, because that is faster.

    Yields:
        The frames in order: ``(height, width, 3)`` bytes, bottom row first. Each is valid until the
        next one.

    Raises:
        RenderError: one of the processes failed.
    """
    processes = max(1, min(processes, frames.count // _WORTH, _MOST))
    if processes == 1:
        with frames.drawn() as draw:
            yield map(draw, range(frames.count))
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context, _prepare, (frames,)) as pool:
        try:
            yield _in_order(pool, frames.count, _AHEAD * processes)
        finally:
            pool.shutdown(cancel_futures=True)


def _in_order(pool: Executor, count: int, ahead: int) -> Iterator[np.ndarray]:
    numbers = iter(range(count))
    awaited = deque(pool.submit(_draw, number) for number in itertools.islice(numbers, ahead))
    while awaited:
        try:
            picture = awaited.popleft().result()
        except Exception as error:
            raise RenderError(f"a process that draws frames failed: {error}") from error
        yield picture
        awaited.extend(pool.submit(_draw, number) for number in itertools.islice(numbers, 1))


def _prepare(frames: Reel) -> None:
    """Store the frames in a process that draws."""
    # Ignore Ctrl-C, because the parent process stops this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The CPU is enough for heights of the ground.
    jax.config.update("jax_platforms", "cpu")
    _laid_out[:] = [frames]


def _draw(number: int) -> np.ndarray:
    if not _drawing:
        stack = contextlib.ExitStack()
        atexit.register(stack.close)
        _drawing.append(stack.enter_context(_laid_out[0].drawn()))
    return _drawing[0](number)
