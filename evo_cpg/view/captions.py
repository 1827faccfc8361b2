"""Write the captions of a film (title, time, distance, speed) and the headings of a sheet."""

from collections.abc import Callable

import numpy as np

from evo_cpg.view.legible import font, legible, lettering, write
from evo_cpg.view.look import Look

# Margin around the captions in a picture 720 pixels high, pixels, and the least factor by which
# margin and letters shrink in smaller pictures.
_MARGIN, _SMALLEST = 34, 0.62
# Height below which pictures show only title and time, pixels.
_SMALL = 200
# Sizes of letters in a picture 720 pixels high: of the title and values, of the note, and of the
# names of values. Left edges and width of values, pixels. Values without room are left out.
_LARGE, _NOTE, _NAME = 23, 16, 15
_COLUMNS, _VALUE = (0, 140, 290), 105
# Smallest fraction of its size to which a title shrinks, and the ending of a cut title.
_LEAST, _CUT = 0.55, "..."
# Height of a heading's letters, as a fraction of its line.
_HEADING = 0.6


def captions(
    look: Look, title: str, distance: str, note: str, size: tuple[int, int], scale: float
) -> Callable[[np.ndarray, float, float, float], None]:
    """Lay out the captions.

    Args:
        look: look of the world.
        title: text at the bottom right. If a picture is too narrow for the title and the values,
            the last values are left out. A title that does not fit next to the time shrinks, and
            may be cut. A small picture has only title and time.
        distance: name of the shown distance.
        note: text below the title.
        size: width and height of the film, pixels.
        scale: pixels rendered per pixel of the film.

    Returns:
        A function that writes them into a picture: bytes ``(height, width, 3)``, bottom row first,
        and time (s), distance (m) and speed (m/s).
    """
    unit = scale * max(size[1] / 720, _SMALLEST)
    width, margin, small = round(size[0] * scale), _MARGIN * unit, size[1] < _SMALL
    title, large = fitted(title, _LARGE * unit, width - 2 * margin - _VALUE * unit)
    note = "" if small else note
    beside = max(
        font(large).getlength(legible(title)), font(_NOTE * unit, False).getlength(legible(note))
    )
    room = (width - 2 * margin - beside) / unit - _VALUE
    shown = [x for x in _COLUMNS if x <= (0 if small else max(room, 0))]
    height = round(margin + 60 * unit)
    bottom, names = height - margin, ("time", distance, "speed")

    def write_into(picture: np.ndarray, time: float, distance: float, speed: float) -> None:
        values = (f"{time:.1f} s", f"{distance:.2f} m", f"{speed:.2f} m/s")
        with lettering(picture[:height]) as draw:
            above = 0 if small else 27 * unit
            write(draw, title, (width - margin, bottom - above), large, look.text, anchor="rd")
            dim = {"color": look.text, "bold": False, "opacity": 0.75}
            write(draw, note, (width - margin, bottom), _NOTE * unit, anchor="rd", **dim)
            for x, name, value in zip(shown, names, values, strict=False):
                left = margin + x * unit
                write(draw, name, (left, bottom - 32 * unit), _NAME * unit, **dim)
                write(draw, value, (left, bottom), _LARGE * unit, look.text)

    return write_into


def heading(text: str, width: int, height: int) -> np.ndarray:
    """Return a moment's heading, dark on white: ``(height, width, 3)`` bytes, bottom row first.

    Args:
        text: words of the line.
        width: width, pixels.
        height: height, pixels.
    """
    picture = np.full((height, width, 3), 255, np.uint8)
    with lettering(picture) as draw:
        write(draw, text, (width / 2, height / 2), _HEADING * height, "black", anchor="mm")
    return picture


def fitted(title: str, size: float, room: float) -> tuple[str, float]:
    """Return a title, cut if it is too long, and the letter size at which it fits.

    Args:
        title: text in any script.
        size: size of the letters if there is room, pixels.
        room: available width, pixels.
    """
    full = font(size).getlength(legible(title))
    if full * _LEAST <= room:
        return title, size * min(1.0, room / max(full, 1.0))
    least = size * _LEAST
    while title and font(least).getlength(legible(title) + _CUT) > room:
        title = title[:-1]
    return title + _CUT, least
