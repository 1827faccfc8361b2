"""Films and stills of recordings, rendered off screen."""

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from evo_cpg.view.camera import aspect_of
from evo_cpg.view.frame_processes import drawing_processes, drawn_frames
from evo_cpg.view.frames import Frames, Plan
from evo_cpg.view.output import (
    FILM_SUFFIXES,
    SettingError,
    check_size,
    frame_writer,
    is_numbered,
    numbered_path,
    output_path,
)
from evo_cpg.view.panel import Panel, check_panel
from evo_cpg.view.signals import SMALLEST


def film_path(
    path: str | os.PathLike[str],
    size: tuple[int, int],
    fps: float = 30.0,
    seconds: float | None = None,
    speed: float = 1.0,
    camera: str = "follow",
    sheet: tuple[int, int] | None = None,
    signals: bool = False,
) -> Path:
    """Check how a film is to be made, before there is anything to show.

    Args:
        path: see `side_by_side`.
        size: likewise.
        fps: likewise.
        seconds: likewise.
        speed: likewise.
        camera: likewise.
        sheet: likewise.
        signals: whether an animal's are shown under it.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
        SettingError: a setting out of range.
        ValueError: a camera that there is not.
    """
    path = Path(path)
    if sheet is None and is_numbered(path):
        path = numbered_path(path)
    else:
        path = output_path(path, FILM_SUFFIXES if sheet is None else (".png",))
    check_size(size)
    if signals:
        check_size(size, SMALLEST, " with signals")
    for name, value in (("fps", fps), ("speed", speed)):
        if not 0 < value < math.inf:
            raise SettingError(f"{name} is {value:g}; it must be positive and finite")
    if seconds is not None and not seconds >= 0:
        raise SettingError(f"seconds is {seconds:g}; it must be a number that is not negative")
    aspect_of(camera)
    return path


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
    processes: int = 1,
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
        processes: that draw a film; for a still or a sheet it is always this one. Each takes some
            400 MB of memory and a few seconds to start.
        progress: called with the number of frames done and their total.

    Returns:
        The path, or the folder of the pictures.

    Raises:
        DrawingError: one of several processes failed.
        OutputError: nothing can be written there, or not this kind of file.
        RecordingError: a recording that does not fit its creature, is empty or not finite.
        SettingError: a setting out of range.
        ValueError: a world or a camera that there is not.
    """
    strips = any(panel.signals is not None for panel in panels)
    path = film_path(path, size, fps, seconds, speed, camera, sheet, strips)
    numbered = sheet is None and is_numbered(path)
    still = path.suffix.lower() == ".png" and sheet is None and not numbered
    for panel in panels:
        check_panel(panel)
    plan = Plan(tuple(panels), size, fps, seconds, speed, camera, still, sheet, columns)
    frames = Frames(plan)
    if still or sheet is not None:
        processes = 1
    processes = drawing_processes(frames.count, processes)
    with (
        drawn_frames(plan, frames, processes) as drawn,
        frame_writer(path, frames.size, frames.rendered, fps, sheet, frames.gap) as write,
    ):
        for done, picture in enumerate(drawn, 1):
            write(picture)
            if progress is not None:
                progress(done, frames.count)
    return path.parent if numbered else path
