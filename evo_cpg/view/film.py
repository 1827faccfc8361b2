"""Films and stills of recordings, rendered off screen."""

import functools
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from evo_cpg.view.camera import aspect_of
from evo_cpg.view.frame_processes import drawing_processes, drawn_frames
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
