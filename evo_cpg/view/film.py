"""Films and stills of recordings, rendered off screen by one or several processes.

A software renderer leaves cores idle. Each process builds the whole scene once. A frame does not
depend on the process that draws it, except on uneven ground. The horizon follows the focus in steps
there, so an opacity may differ by one of 255 levels.
"""

import atexit
import contextlib
import functools
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

from evo_cpg.view.camera import aspect_of
from evo_cpg.view.frames import Film, Frames
from evo_cpg.view.output import (
    FILM_SUFFIXES,
    PICTURE_SUFFIXES,
    SettingError,
    check_size,
    film_writer,
    is_numbered,
    numbered_path,
    output_path,
    picture_of,
    save_numbered,
    save_picture,
)
from evo_cpg.view.scene import Panel, check_panel
from evo_cpg.view.signals import SMALLEST


def film_path(path: str | os.PathLike[str], film: Film, signals: bool = False) -> Path:
    """Check the settings of a film before any recording exists.

    Args:
        path: file or numbered pictures, see `side_by_side`.
        film: settings of the film.
        signals: whether signals are shown below an animal.

    Returns:
        The path.

    Raises:
        OutputError: the path cannot be written, or has another suffix.
        SettingError: a setting is out of range.
        ValueError: the camera is unknown.
    """
    path = Path(path)
    if film.sheet is None and is_numbered(path):
        path = numbered_path(path)
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
        processes: number of processes that draw a film. The calling process draws a still or a
            sheet. Each process takes some 400 MB of memory and a few seconds to start.
        progress: function that receives the number of finished frames and their total.

    Returns:
        The path, or the folder of the pictures.

    Raises:
        DrawingError: one of several processes failed.
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
        save_picture(picture(panels, film, progress), path)
        return path
    frames = Frames(panels, film)
    processes = drawing_processes(frames.count, processes)
    make = functools.partial(Frames, panels, film)
    with drawn_frames(frames, make, processes) as drawn:
        counted = _counted(drawn, frames.count, progress)
        if numbered:
            save_numbered((picture_of(frame, frames.size) for frame in counted), path)
            return path.parent
        with film_writer(path, frames.size, frames.rendered, film.fps) as write:
            for frame in counted:
                write(frame)
    return path


def picture(
    panels: Sequence[Panel],
    film: Film,
    progress: Callable[[int, int], None] | None = None,
) -> Image.Image:
    """Return a still, or a sheet of moments.

    Args:
        panels: the animals.
        film: settings. Without a sheet, the picture is a still.
        progress: function that receives the number of finished frames and their total.

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
    """Frames that can be drawn in any order, such as `evo_cpg.view.frames.Frames`.

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


# Function that lays out the frames, in a process that draws.
_makers: list[Callable[[], Reel]] = []


class DrawingError(RuntimeError):
    """A process that draws frames failed."""


def drawing_processes(frames: int, cores: int) -> int:
    """Return the number of processes that draw the frames fastest.

    Args:
        frames: number of frames.
        cores: number of usable cores.
    """
    return max(1, min(cores, frames // _WORTH, _MOST))


@contextlib.contextmanager
def drawn_frames(
    frames: Reel, make: Callable[[], Reel], processes: int
) -> Iterator[Iterator[np.ndarray]]:
    """Draw all frames, one after the other.

    Args:
        frames: the frames.
        make: function that lays out the same frames in another process.
        processes: number of drawing processes. With 1, this process draws.

    Yields:
        The frames in order: ``(height, width, 3)`` bytes, bottom row first. Each is valid until the
        next one.

    Raises:
        DrawingError: one of the processes failed.
    """
    if processes == 1:
        with frames.drawn() as draw:
            yield map(draw, range(frames.count))
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context, _prepare, (make,)) as pool:
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
            raise DrawingError(f"a process that draws frames failed: {error}") from error
        yield picture
        awaited.extend(pool.submit(_draw, number) for number in itertools.islice(numbers, 1))


def _prepare(make: Callable[[], Reel]) -> None:
    """Store the function that lays out the frames."""
    # Ignore Ctrl-C, because the parent process stops this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The CPU is enough for heights of the ground.
    jax.config.update("jax_platforms", "cpu")
    _makers[:] = [make]


def _draw(number: int) -> np.ndarray:
    return _scene()(number)


@functools.cache
def _scene() -> Callable[[int], np.ndarray]:
    stack = contextlib.ExitStack()
    atexit.register(stack.close)
    return stack.enter_context(_makers[0]().drawn())
