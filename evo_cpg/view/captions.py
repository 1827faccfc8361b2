"""Words of a film: title, time, distance left and speed over it, and headings of moments."""

from collections.abc import Callable

import numpy as np
import pyvista as pv
from PIL import Image, ImageDraw, ImageFont

from evo_cpg.view.legible import BOLD, legible, write_legibly
from evo_cpg.view.look import Look

# In pixels of a picture 720 high; smaller pictures do not shrink below `_SMALLEST` of it.
_MARGIN = 34
_SMALLEST = 0.62
_COLUMNS = (0, 140, 290)
_SMALL = 200
# About as wide are a value and letters of the title and of the note; what has no room is left out.
_VALUE, _TITLE_LETTER, _NOTE_LETTER = 105, 13.5, 9.0
# Height of a heading's letters, as a fraction of its line.
_HEADING = 0.6
# A title shrinks to this share of its size, and ends so where it is cut.
_LEAST_SHARE, _CUT = 0.55, "..."


def add_captions(
    plotter: pv.Plotter,
    look: Look,
    title: str,
    distance: str,
    note: str,
    height: int,
    scale: float,
) -> Callable[[float, float, float], None]:
    """Lay the captions out.

    Args:
        plotter: draws them.
        look: of the world.
        title: bottom right; the upper part of the picture is left to the light. Where a picture is
            too narrow for it and the values, the last of these are left out; a small one has but
            title and time. A title that has no room beside the time is written smaller, and cut.
        distance: what the shown distance is.
        note: below the title.
        height: of the film, pixels.
        scale: pixels rendered per pixel of the film.

    Returns:
        A function of time (s), distance (m) and speed (m/s).
    """
    unit = scale * max(height / 720, _SMALLEST)
    left, right = _MARGIN * unit, plotter.window_size[0] - _MARGIN * unit
    bottom = _MARGIN * unit

    def write(
        text: str, x: float, y: float, size: float, *, dim: bool = False, side: str = "left"
    ) -> pv.Text:
        style = pv.TextProperty(
            color=look.text,
            font_size=round(size * unit),
            bold=not dim,
            justification_horizontal=side,
            justification_vertical="bottom",
        )
        style.SetOpacity(0.75 if dim else 1.0)
        label = pv.Text(text, position=(round(x), round(y)))
        label.prop = style
        write_legibly(label, text)
        plotter.renderer.AddViewProp(label)
        return label

    small = height < _SMALL
    free = plotter.window_size[0] / unit - 2 * _MARGIN - _VALUE
    shown, size = _fitting(title, free / _TITLE_LETTER)
    write(shown, right, bottom + (0 if small else 27) * unit, 25 * size, side="right")
    if not small:
        write(note, right, bottom, 17, dim=True, side="right")
    values = []
    beside = max(_TITLE_LETTER * size * len(shown), _NOTE_LETTER * len(note)) + _MARGIN
    room = plotter.window_size[0] / unit - _MARGIN - beside - _VALUE
    for name, column in zip(("time", distance, "speed"), _COLUMNS, strict=True):
        if column > (0 if small else max(room, 0)):
            break
        write(name, left + column * unit, bottom + 32 * unit, 16, dim=True)
        values.append(write("", left + column * unit, bottom, 25))

    def update(time: float, distance: float, speed: float) -> None:
        texts = (f"{time:.1f} s", f"{distance:.2f} m", f"{speed:.2f} m/s")
        for actor, text in zip(values, texts, strict=False):
            actor.input = text

    return update


def heading(text: str, width: int, height: int) -> np.ndarray:
    """Return a line of words, dark on white: ``(height, width, 3)`` bytes, bottom row first.

    Args:
        text: its words.
        width: pixels.
        height: pixels.
    """
    picture = Image.new("RGB", (width, height), "white")
    font = ImageFont.truetype(str(BOLD), _HEADING * height)
    place = width / 2, height / 2
    ImageDraw.Draw(picture).text(place, legible(text), fill="black", font=font, anchor="mm")
    return np.asarray(picture)[::-1]


def _fitting(title: str, letters: float) -> tuple[str, float]:
    """A title where so many letters have room, and its size as a share of what it would be."""
    share = min(1.0, letters / max(len(title), 1))
    if share >= _LEAST_SHARE:
        return title, share
    most = max(int(letters / _LEAST_SHARE) - len(_CUT), 0)
    return title[:most] + _CUT, _LEAST_SHARE
